// ridge_measure: offset, distance and eigen-analysis of each ridge candidate.
// in   near    [27 S]  u32  neighbouring slots
// in   f       [512 S] f32  smoothed distance, mm
// in   d       [512 S] f32  exact distance, mm
// in   total   [S+1]   u32  prefix sums; the last holds the number of candidates
// in   list    [N]     u32  elements of the candidates, ascending
// out  measure [12 N]  f32  offset x y z mm, d mm, axis x y z, |g|, eigenvalues across the axis
//                           (ascending) and along it, 0
// grid one thread a candidate
// tol  |gpu - cpu| <= 2e-3: the axis of a nearly round section turns freely
// src  lib/ridge.wgsl
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> f: array<f32>;
@group(0) @binding(2) var<storage, read> d: array<f32>;
@group(0) @binding(3) var<storage, read> total: array<u32>;
@group(0) @binding(4) var<storage, read> list: array<u32>;
@group(0) @binding(5) var<storage, read_write> measure: array<f32>;

struct Params { spacing_mm: vec3<f32>, slots: u32, capacity: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/ridge.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = thread(group, groups, local, 64u);
    if i >= min(total[params.slots], params.capacity) { return; }
    let voxel = list[i];
    let r = ridge(voxel >> 9u, position(voxel & 511u), params.spacing_mm);
    let o = 12u * i;
    measure[o] = r.offset_mm.x;
    measure[o + 1u] = r.offset_mm.y;
    measure[o + 2u] = r.offset_mm.z;
    measure[o + 3u] = d[voxel];
    measure[o + 4u] = r.axis.x;
    measure[o + 5u] = r.axis.y;
    measure[o + 6u] = r.axis.z;
    measure[o + 7u] = r.gradient;
    measure[o + 8u] = r.values.x;
    measure[o + 9u] = r.values.y;
    measure[o + 10u] = r.values.z;
}
