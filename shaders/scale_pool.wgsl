// scale_pool: one step of averaging of five numbers a vertex over its neighbours.
// in   start  [V+1] u32  first entry of each vertex in `near` and `weight` (CSR)
// in   near   [E]   u32  adjacent vertices, ascending
// in   weight [E]   f32  at each vertex they sum to at most one
// in   energy [5V]  f32
// out  pooled [5V]  f32  e_i + sum_j w_ij (e_j - e_i)
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-6
// src  heat flow by explicit steps
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> energy: array<f32>;
@group(0) @binding(4) var<storage, read_write> pooled: array<f32>;

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
    var sum: array<f32, 5>;
    for (var k = 0u; k < 5u; k++) { sum[k] = energy[5u * v + k]; }
    for (var e = start[v]; e < start[v + 1u]; e++) {
        let w = weight[e];
        let j = near[e];
        for (var k = 0u; k < 5u; k++) {
            sum[k] += w * (energy[5u * j + k] - energy[5u * v + k]);
        }
    }
    for (var k = 0u; k < 5u; k++) { pooled[5u * v + k] = sum[k]; }
}
