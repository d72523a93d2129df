// Bricks of 8^3 voxels in slot order: voxel local = x + 8 y + 64 z of slot s is element 512 s + local.
// The including kernel binds `near`: 27 slots a brick, index (dx+1) + 3 (dy+1) + 9 (dz+1).
const NONE: u32 = 0xffffffffu;

// Slot beside `slot` along an axis (0 x, 1 y, 2 z).
fn above(slot: u32, axis: u32) -> u32 {
    var at = 14u;
    if axis == 1u { at = 16u; }
    if axis == 2u { at = 22u; }
    return near[slot * 27u + at];
}
fn below(slot: u32, axis: u32) -> u32 {
    var at = 12u;
    if axis == 1u { at = 10u; }
    if axis == 2u { at = 4u; }
    return near[slot * 27u + at];
}
// Element of the voxel at position p (components -1 to 8) of a brick, or NONE.
fn element(slot: u32, p: vec3<i32>) -> u32 {
    let over = p >> vec3(3u);
    var s = slot;
    if any(over != vec3(0)) {
        s = near[slot * 27u + u32((over.x + 1) + 3 * (over.y + 1) + 9 * (over.z + 1))];
        if s == NONE { return NONE; }
    }
    let q = vec3<u32>(p & vec3(7));
    return s * 512u + q.x + 8u * q.y + 64u * q.z;
}
fn position(local: u32) -> vec3<i32> {
    return vec3(i32(local & 7u), i32((local >> 3u) & 7u), i32(local >> 6u));
}
