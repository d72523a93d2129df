// wall_sides: offsets that agree with the mask, and where the wall was closed by a limit.
// in   near   [27 S]  u32  neighbouring slots
// in   inside [16 S]  u32  the mask, one bit a voxel
// in   level  [512 S] i32  of wall_level
// out  offset [512 S] i32  offset, at most -20 inside and at least 20 outside
// out  edge   [512 S] i32  the same, held within half a voxel, times 64
// out  filled [512 S] i32  32768 inside, 0 outside
// out  closed [512 S] i32  32768 where a voxel beside the mask has the lumen's values, 0 elsewhere
// grid one thread a voxel
// tol  none
// src  ours
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> inside: array<u32>;
@group(0) @binding(2) var<storage, read> level: array<i32>;
@group(0) @binding(3) var<storage, read_write> offset: array<i32>;
@group(0) @binding(4) var<storage, read_write> edge: array<i32>;
@group(0) @binding(5) var<storage, read_write> filled: array<i32>;
@group(0) @binding(6) var<storage, read_write> closed: array<i32>;

struct Params { slots: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

fn is_inside(e: u32) -> bool { return (inside[e >> 5u] & (1u << (e & 31u))) != 0u; }

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let voxel = thread(group, groups, local, 64u);
    let slot = voxel >> 9u;
    if slot >= params.slots { return; }
    let raw = (level[voxel] << 16u) >> 16u;
    var o = raw;
    var at_limit = 0;
    if is_inside(voxel) {
        o = min(raw, -20);
    } else if raw > 0 {
        o = max(raw, 20);
    } else {
        o = 512;
        let p = position(voxel & 511u);
        for (var n = 0u; n < 6u; n++) {
            var step = vec3(0);
            step[n >> 1u] = select(-1, 1, (n & 1u) != 0u);
            let e = element(slot, p + step);
            if e != NONE && is_inside(e) { at_limit = 32768; }
        }
    }
    offset[voxel] = o;
    edge[voxel] = clamp(o, -512, 512) * 64;
    filled[voxel] = select(0, 32768, is_inside(voxel));
    closed[voxel] = at_limit;
}
