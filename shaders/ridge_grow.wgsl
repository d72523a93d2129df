// ridge_grow: one round of growth from the core up the edge of the wall, and no further than its ridge.
// in   near   [27 S]  u32  neighbouring slots
// in   corner [3 S]   i32  first voxel of each brick
// in   core   [16 S]  u32  one bit a voxel
// in   value  [512 S] i32  smoothed values: 0 lumen, 4096 wall
// in   before [512 S] i32  least over paths from the core of the greatest value on the path, plus
//                          32768; 0 where no path leads
// out  after  [512 S] i32  the same with paths one voxel longer
// grid one thread a voxel
// tol  none
// src  ours; a path over a ridge falls behind it, and is not followed there
// ours a voxel joins if its value is at least `fall` below the greatest on the best path to one of its
//      six neighbours, and at most `most`; core voxels are paths of themselves
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> core: array<u32>;
@group(0) @binding(3) var<storage, read> value: array<i32>;
@group(0) @binding(4) var<storage, read> before: array<i32>;
@group(0) @binding(5) var<storage, read_write> after: array<i32>;

struct Params { slots: u32, fall: i32, most: i32, width: i32, height: i32, depth: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

const BIAS: i32 = 32768;

fn path(e: u32) -> i32 {
    if (core[e >> 5u] & (1u << (e & 31u))) != 0u { return value[e] + BIAS; }
    return before[e];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let voxel = thread(group, groups, local, 64u);
    let slot = voxel >> 9u;
    if slot >= params.slots { return; }
    let own = path(voxel);
    if own != 0 {
        after[voxel] = own;
        return;
    }
    let p = position(voxel & 511u);
    let v = vec3(corner[slot * 3u], corner[slot * 3u + 1u], corner[slot * 3u + 2u]) + p;
    var joined = 0;
    if all(v >= vec3(0)) && all(v < vec3(params.width, params.height, params.depth)) {
        var best = 0;
        for (var n = 0u; n < 6u; n++) {
            var step = vec3(0);
            step[n >> 1u] = select(-1, 1, (n & 1u) != 0u);
            let e = element(slot, p + step);
            if e == NONE { continue; }
            let c = path(e);
            if c != 0 && (best == 0 || c < best) { best = c; }
        }
        let j = value[voxel] + BIAS;
        if best != 0 && j >= best - params.fall && j <= params.most + BIAS { joined = max(best, j); }
    }
    after[voxel] = joined;
}
