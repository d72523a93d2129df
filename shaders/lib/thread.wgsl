// Linear thread id of a launch that was folded into two dimensions of workgroups.
fn thread(group: vec3<u32>, groups: vec3<u32>, local: u32, size: u32) -> u32 {
    return (group.y * groups.x + group.x) * size + local;
}
