// relax_average: half of a value and half of the mean of its neighbours.
// in   start   [V+1] u32  first entry of each vertex in `near` (CSR)
// in   near    [E]   u32  adjacent vertices, ascending
// in   value   [V]   f32
// out  average [V]   f32  (x_i + mean_j x_j) / 2; x_i where there is no neighbour
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-6
// src  Taubin 1995, doi:10.1145/218380.218473: Laplacian smoothing with a factor of 1/2
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> value: array<f32>;
@group(0) @binding(3) var<storage, read_write> average: array<f32>;

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
    let first = start[v];
    let end = start[v + 1u];
    let x = value[v];
    if first == end {
        average[v] = x;
        return;
    }
    var sum = 0.0;
    for (var e = first; e < end; e++) { sum += value[near[e]]; }
    average[v] = 0.5 * (x + sum / f32(end - first));
}
