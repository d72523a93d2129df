// Lines of eight voxels along an axis through a brick: 64 a brick, one a thread. Neighbouring threads
// have neighbouring lines, so that each load of a workgroup is of whole sectors along y and z.

// First voxel of a line within its brick.
fn line_start(line: u32, axis: u32) -> u32 {
    if axis == 0u { return line << 3u; }
    if axis == 1u { return (line & 7u) + ((line >> 3u) << 6u); }
    return line;
}
// Elements from a voxel of a line to the next.
fn line_stride(axis: u32) -> u32 {
    return 1u << (3u * axis);
}
