// Eigenvalues of a symmetric 3x3 matrix, ascending, in closed form. m = (xx, yy, zz),
// o = (xy, xz, yz). No angle: with a the angle of the cubic's roots, whose cosine is half the
// determinant of the scaled matrix B, the largest root is 2 cos(a / 3), a polynomial in cos(a / 2),
// and the smallest is the largest of -B, in sin(a / 2). Of these two the smaller, taken from the
// cosine, would turn an error of 1e-7 in the determinant into 3e-4 beside a double root; it comes
// from sin a, which is the length of the part of B^2 that lies across B and the identity, over
// sqrt(6): no cancellation. A cosine that errs upward would put the smallest eigenvalue above the
// middle one.
// src  Smith 1961, doi:10.1145/355578.366316; the discriminant as a sum of squares as in Harari &
//      Albocher 2022, doi:10.1002/nme.7153; ours: the residual of B^2, and the polynomial
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
    // Diagonal and rest of B^2, less its parts along the identity and B.
    let cc = c * c;
    let square = b * b + vec3(cc.x + cc.y, cc.x + cc.z, cc.y + cc.z);
    let across = square - vec3(2.0) - 2.0 * half * b;
    let apart = vec3(c.y * c.z - c.x * b.z, c.x * c.z - c.y * b.y, c.x * c.y - c.z * b.x) - 2.0 * half * c;
    let sine = sqrt((dot(across, across) + 2.0 * dot(apart, apart)) / 6.0);
    let large = sqrt(0.5 + abs(half));
    let small = min(0.5 * sine / large, large);
    let high = q + 2.0 * p * third(select(small, large, half >= 0.0));
    let low = q - 2.0 * p * third(select(large, small, half >= 0.0));
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
