// Ridge of a smoothed distance map at one voxel. The including kernel binds `near` and `f` (the
// smoothed map) and includes lib/bricks.wgsl.
// src  Eberly, Ridges in Image and Data Analysis, 1996 (height ridge); Steger 1998,
//      doi:10.1109/34.659930 (offset test); the paper's section 3.1
// ours the pair v1.g = v2.g = 0 never holds on a grid: one Newton step in the plane across v3 must
//      stay within 0.6 voxel
#include "lib/eigen.wgsl"

struct Ridge {
    accepted: bool,
    offset_mm: vec3<f32>,
    gradient: f32,
    // Eigenvalues across v3 (ascending), and along it.
    values: vec3<f32>,
    axis: vec3<f32>,
}

fn at(slot: u32, p: vec3<i32>) -> f32 {
    let e = element(slot, p);
    if e == NONE { return 0.0; }
    return f[e];
}

struct Derivatives { g: vec3<f32>, m: vec3<f32>, o: vec3<f32> }

fn derivatives(slot: u32, p: vec3<i32>, h: vec3<f32>) -> Derivatives {
    let x = vec3(1, 0, 0);
    let y = vec3(0, 1, 0);
    let z = vec3(0, 0, 1);
    let c = at(slot, p);
    let xp = at(slot, p + x); let xm = at(slot, p - x);
    let yp = at(slot, p + y); let ym = at(slot, p - y);
    let zp = at(slot, p + z); let zm = at(slot, p - z);
    let g = vec3(xp - xm, yp - ym, zp - zm) / (2.0 * h);
    let m = (vec3(xp, yp, zp) - 2.0 * vec3(c) + vec3(xm, ym, zm)) / (h * h);
    let xy = at(slot, p + x + y) - at(slot, p + x - y) - at(slot, p - x + y) + at(slot, p - x - y);
    let xz = at(slot, p + x + z) - at(slot, p + x - z) - at(slot, p - x + z) + at(slot, p - x - z);
    let yz = at(slot, p + y + z) - at(slot, p + y - z) - at(slot, p - y + z) + at(slot, p - y - z);
    let o = vec3(xy / (4.0 * h.x * h.y), xz / (4.0 * h.x * h.z), yz / (4.0 * h.y * h.z));
    return Derivatives(g, m, o);
}

fn ridge(slot: u32, p: vec3<i32>, h: vec3<f32>) -> Ridge {
    let n = derivatives(slot, p, h);
    var out: Ridge;
    out.gradient = length(n.g);
    let e = eigen(n.m, n.o);
    out.axis = e.vector;
    out.values = e.values;
    let least = min(h.x, min(h.y, h.z));
    if e.round {
        out.offset_mm = -n.g / e.values.x;
    } else {
        // Orthonormal basis across the axis.
        let v = e.vector;
        var a = vec3(0.0, -v.z, v.y);
        if abs(v.x) > 0.57735 { a = vec3(-v.z, 0.0, v.x); }
        a = normalize(a);
        let b = cross(v, a);
        let ha = vec3(n.m.x * a.x + n.o.x * a.y + n.o.y * a.z, n.o.x * a.x + n.m.y * a.y + n.o.z * a.z, n.o.y * a.x + n.o.z * a.y + n.m.z * a.z);
        let hb = vec3(n.m.x * b.x + n.o.x * b.y + n.o.y * b.z, n.o.x * b.x + n.m.y * b.y + n.o.z * b.z, n.o.y * b.x + n.o.z * b.y + n.m.z * b.z);
        let kaa = dot(a, ha);
        let kab = dot(a, hb);
        let kbb = dot(b, hb);
        let half = 0.5 * (kaa + kbb);
        let root = sqrt(max(0.25 * (kaa - kbb) * (kaa - kbb) + kab * kab, 0.0));
        out.values = vec3(half - root, half + root, e.values.z);
        let det = kaa * kbb - kab * kab;
        let ga = dot(a, n.g);
        let gb = dot(b, n.g);
        out.offset_mm = -(a * (kbb * ga - kab * gb) + b * (kaa * gb - kab * ga)) / det;
    }
    let falls = out.values.y < -1e-4 / least;
    out.accepted = falls && all(abs(out.offset_mm) <= 0.6 * h);
    return out;
}
