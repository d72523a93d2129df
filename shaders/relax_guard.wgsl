// relax_guard: takes back the part of a low-pass shift of the wall that the curvature forbids.
// in   bend   [V] f32  turn of the normals a voxel, smoothed, rad
// in   bound  [V] vec2 second: the most that s_i may be
// in   shift  [V] f32  l, a low-pass of s
// out  place  [V] f32  s_i - sign(l_i) max(|l_i| - allowed, 0), within its limit
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-6
// src  soft threshold: Donoho 1995, doi:10.1109/18.382009
// ours the noise of a mask's steps averages out along the wall; a low-pass shift by more than 0.15
//      of a grid edge, or 0.05 on small bumps, comes from normals that are too smooth there
@group(0) @binding(0) var<storage, read> bend: array<f32>;
@group(0) @binding(1) var<storage, read> bound: array<vec2<f32>>;
@group(0) @binding(2) var<storage, read> shift: array<f32>;
@group(0) @binding(3) var<storage, read_write> place: array<f32>;

struct Params { vertices: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let v = thread(group, groups, local, 64u);
    if v >= params.vertices { return; }
    let allowed = 0.15 - 0.1 * clamp((bend[v] - 0.15) / 0.15, 0.0, 1.0);
    let excess = shift[v] - clamp(shift[v], -allowed, allowed);
    let most = bound[v].y;
    place[v] = clamp(place[v] - excess, -most, most);
}
