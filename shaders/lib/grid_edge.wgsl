// A vertex of the wall of a mask as the grid edge it lies on, in one word: bits 8k to 8k + 7 hold
// twice the coordinate k of the edge's middle, modulo 256; bit 24 says that the outside voxel is
// the lower one, bit 25 that the vertex may not move. The odd coordinate is the axis.

// Twice the difference of two middles, in voxels. Adjacent vertices are at most a voxel apart.
fn middle_difference(a: u32, b: u32) -> vec3<f32> {
    let d = vec3(a - b, (a >> 8u) - (b >> 8u), (a >> 16u) - (b >> 16u));
    return vec3<f32>(extractBits(bitcast<vec3<i32>>(d), 0u, 8u));
}

fn edge_axis(code: u32) -> u32 {
    if (code & 1u) != 0u { return 0u; }
    return select(2u, 1u, (code & 256u) != 0u);
}

// Component of `along` (a number for each grid axis) in the direction from inside to outside.
fn outward(code: u32, along: vec3<f32>) -> f32 {
    let x = along[edge_axis(code)];
    return select(x, -x, (code & 0x1000000u) != 0u);
}

fn is_fixed(code: u32) -> bool { return (code & 0x2000000u) != 0u; }
