// least_axis: the least value within some voxels along an axis.
// in   near   [27 S]  u32  neighbouring slots
// in   f      [512 S] i32
// out  g      [512 S] i32  min over |k| <= radius of f(p + k)
// grid one thread a voxel
// tol  none
// src  erosion of grey values by a line (Serra 1982); three passes make a box
// ours what has no brick does not count; radius is at most 8
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> f: array<i32>;
@group(0) @binding(2) var<storage, read_write> g: array<i32>;

struct Params { slots: u32, axis: u32, radius: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let voxel = thread(group, groups, local, 64u);
    let slot = voxel >> 9u;
    if slot >= params.slots { return; }
    let p = position(voxel & 511u);
    var least = f[voxel];
    for (var k = -params.radius; k <= params.radius; k++) {
        var q = p;
        q[params.axis] += k;
        let e = element(slot, q);
        if e != NONE { least = min(least, f[e]); }
    }
    g[voxel] = least;
}
