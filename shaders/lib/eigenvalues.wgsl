// Eigenvalues of a symmetric 3x3 matrix, ascending, in closed form. m = (xx, yy, zz),
// o = (xy, xz, yz). No angle: with the determinant r of the scaled matrix, cos(acos(r) / 3) is a
// smooth function of sqrt((1 + r) / 2), and the smallest root is the largest of the matrix turned.
// A cosine that errs upward would put the smallest eigenvalue above the middle one.
// src  Smith 1961, doi:10.1145/355578.366316; ours: the polynomial
fn eigenvalues(m: vec3<f32>, o: vec3<f32>) -> vec3<f32> {
    let q = (m.x + m.y + m.z) / 3.0;
    let d = m - vec3(q);
    let p = sqrt((dot(d, d) + 2.0 * dot(o, o)) / 6.0);
    // A multiple of the identity.
    if p <= 1e-6 * abs(q) || p < 1e-30 { return vec3(q); }
    let b = d / p;
    let c = o / p;
    let det = b.x * (b.y * b.z - c.z * c.z) - c.x * (c.x * b.z - c.z * c.y) + c.y * (c.x * c.z - b.y * c.y);
    let half = clamp(0.25 * det, -0.5, 0.5);
    let high = q + 2.0 * p * third(sqrt(0.5 + half));
    let low = q - 2.0 * p * third(sqrt(0.5 - half));
    return vec3(low, clamp(3.0 * q - high - low, low, high), high);
}

// cos(2/3 acos s) for s in [0, 1], within 1e-7: Chebyshev interpolation of degree 8.
fn third(s: f32) -> f32 {
    var sum = -0.00062604534;
    sum = sum * s + 0.0036541196;
    sum = sum * s - 0.010237508;
    sum = sum * s + 0.01960032;
    sum = sum * s - 0.031925414;
    sum = sum * s + 0.05327935;
    sum = sum * s - 0.11109449;
    sum = sum * s + 0.57734966;
    return sum * s + 0.5;
}
