// compact_scatter: elements of all set bits, ascending.
// in   marked [16 S] u32   one bit a voxel
// in   sum    [S+1]  u32   exclusive prefix sums of the bricks' counts
// out  list   [N]    u32   elements; what does not fit is left out and shows as sum[S] > N
// grid one thread a brick
// tol  exact
// src  Harris 2007, GPU Gems 3, chapter 39
@group(0) @binding(0) var<storage, read> marked: array<u32>;
@group(0) @binding(1) var<storage, read> sum: array<u32>;
@group(0) @binding(2) var<storage, read_write> list: array<u32>;

struct Params { slots: u32, capacity: u32 }
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
    var at = sum[slot];
    for (var w = 0u; w < 16u; w++) {
        var bits = marked[slot * 16u + w];
        while bits != 0u {
            if at < params.capacity { list[at] = slot * 512u + w * 32u + countTrailingZeros(bits); }
            at++;
            bits &= bits - 1u;
        }
    }
}
