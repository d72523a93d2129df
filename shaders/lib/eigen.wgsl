// Eigenvalues of a symmetric 3x3 matrix, ascending, and the eigenvector of the largest: the longest
// cross product of rows. m = (xx, yy, zz), o = (xy, xz, yz).
#include "lib/eigenvalues.wgsl"

struct Eigen { values: vec3<f32>, vector: vec3<f32>, round: bool }

fn eigen(m: vec3<f32>, o: vec3<f32>) -> Eigen {
    let l = eigenvalues(m, o);
    let high = l.z;
    // A multiple of the identity: no direction stands out.
    if l.x == high { return Eigen(l, vec3(0.0, 0.0, 1.0), true); }
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
    var longest = la;
    if le > longest { v = e; longest = le; }
    if lg > longest { v = g; longest = lg; }
    if longest < 1e-36 { return Eigen(l, vec3(0.0, 0.0, 1.0), true); }
    return Eigen(l, v / sqrt(longest), false);
}
