// relax_step: one accelerated projected Jacobi step of the places of vertices on their grid edges.
// in   start    [V+1] u32  first entry of each vertex in `near` and `coupling` (CSR)
// in   near     [E]   u32  adjacent vertices, ascending
// in   coupling [E]   f32  c_ij / (2 D_i)
// in   bound    [V]   vec2 B_i / (2 D_i), and the most that s_i may be
// in   now      [V]   f32  y, the extrapolated places
// out  place    [V]   f32  s: z_i = clamp(y_i - (D_i y_i + B_i - sum_j c_ij y_j) / (2 D_i))
// out  next     [V]   f32  z_i + momentum (z_i - s_i), with s_i of before
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-5; 1e-4 of a grid edge after all steps
// src  Beck & Teboulle 2009, doi:10.1137/080716542, with constant momentum
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> coupling: array<f32>;
@group(0) @binding(3) var<storage, read> bound: array<vec2<f32>>;
@group(0) @binding(4) var<storage, read> now: array<f32>;
@group(0) @binding(5) var<storage, read_write> place: array<f32>;
@group(0) @binding(6) var<storage, read_write> next: array<f32>;

struct Params { momentum: f32, vertices: u32 }
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
    let b = bound[v];
    var sum = 0.5 * now[v] - b.x;
    for (var e = start[v]; e < start[v + 1u]; e++) { sum += coupling[e] * now[near[e]]; }
    let z = clamp(sum, -b.y, b.y);
    next[v] = z + params.momentum * (z - place[v]);
    place[v] = z;
}
