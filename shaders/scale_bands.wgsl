// scale_bands: at each vertex, how much each band of scales holds that the coarser ones do not
// foretell.
// in   normal [3V]   f32  unit normals of the faces
// in   level  [5 V]  vec4 the same smoothed over times t, 2t, 4t, 8t, 16t; any length
// out  energy [5V]   f32  squared length of each band's residual, finest first
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-5: Vulkan's lengths and quotients may err by 7 ulp, of squares up to 4
// src  ours, see the restoring kernel
@group(0) @binding(0) var<storage, read> normal: array<f32>;
@group(0) @binding(1) var<storage, read> level: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read_write> energy: array<f32>;

struct Params { vertices: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/scales.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let v = thread(group, groups, local, 64u);
    if v >= params.vertices { return; }
    var b = bands(ladder(v, params.vertices));
    for (var k = 0u; k < 5u; k++) { energy[5u * v + k] = dot(b.r[k], b.r[k]); }
}
