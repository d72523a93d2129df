// Eigenvalues of a symmetric 3x3 matrix, ascending, in closed form, and the eigenvector of the
// largest. m = (xx, yy, zz), o = (xy, xz, yz).
// src  Smith 1961, doi:10.1145/355578.366316; ours: the vector is the longest cross product of rows
struct Eigen { values: vec3<f32>, vector: vec3<f32>, round: bool }

fn eigen(m: vec3<f32>, o: vec3<f32>) -> Eigen {
    let q = (m.x + m.y + m.z) / 3.0;
    let d = m - vec3(q);
    let p2 = dot(d, d) + 2.0 * dot(o, o);
    let p = sqrt(p2 / 6.0);
    // A multiple of the identity: no direction stands out.
    if p <= 1e-6 * abs(q) || p < 1e-30 {
        return Eigen(vec3(q), vec3(0.0, 0.0, 1.0), true);
    }
    let b = d / p;
    let c = o / p;
    let det = b.x * (b.y * b.z - c.z * c.z) - c.x * (c.x * b.z - c.z * c.y) + c.y * (c.x * c.z - b.y * c.y);
    let phi = acos(clamp(0.5 * det, -1.0, 1.0)) / 3.0;
    let high = q + 2.0 * p * cos(phi);
    let low = q + 2.0 * p * cos(phi + 2.0943951);
    let mid = 3.0 * q - high - low;
    let r0 = vec3(m.x - high, o.x, o.y);
    let r1 = vec3(o.x, m.y - high, o.z);
    let r2 = vec3(o.y, o.z, m.z - high);
    let a = cross(r0, r1);
    let e = cross(r0, r2);
    let g = cross(r1, r2);
    let la = dot(a, a);
    let le = dot(e, e);
    let lg = dot(g, g);
    var v = a;
    var l = la;
    if le > l { v = e; l = le; }
    if lg > l { v = g; l = lg; }
    if l < 1e-36 { return Eigen(vec3(low, mid, high), vec3(0.0, 0.0, 1.0), true); }
    return Eigen(vec3(low, mid, high), v / sqrt(l), false);
}
