// compact_count: set bits of each brick.
// in   marked [16 S] u32  one bit a voxel
// out  count  [S]    u32
// grid one thread a brick
// tol  exact
// src  the first step of compaction by prefix sum: Harris 2007, GPU Gems 3, chapter 39
@group(0) @binding(0) var<storage, read> marked: array<u32>;
@group(0) @binding(1) var<storage, read_write> count: array<u32>;

struct Params { slots: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = thread(group, groups, local, 64u);
    if slot >= params.slots { return; }
    var n = 0u;
    for (var w = 0u; w < 16u; w++) { n += countOneBits(marked[slot * 16u + w]); }
    count[slot] = n;
}
