// Integers of the wall field. Values count 4096 from the lumen's to the wall's, lengths along an axis
// are scaled by spacings before they are compared.

// Square root rounded down, of x < 2^31.
fn isqrt(x: u32) -> u32 {
    var r = u32(sqrt(f32(x)));
    while r * r > x { r--; }
    while (r + 1u) * (r + 1u) <= x { r++; }
    return r;
}

// How far a vector is shifted right so that no component exceeds 2^14.
fn excess_bits(v: vec3<i32>) -> u32 {
    let a = abs(v);
    let most = u32(max(a.x, max(a.y, a.z)));
    return u32(max(i32(firstLeadingBit(most | 1u)) - 13, 0));
}

fn length_of(v: vec3<i32>) -> i32 {
    return i32(isqrt(u32(v.x * v.x) + u32(v.y * v.y) + u32(v.z * v.z)));
}
