// scale_step: one step of the Chebyshev series of heat flow over a surface, a vector a vertex (and 0).
// in   start  [V+1] u32  first entry of each vertex in `near` and `weight` (CSR)
// in   near   [E]   u32  adjacent vertices, ascending
// in   weight [E]   f32  c_ij / (m_i rho): at each vertex they sum to at most one
// in   now    [V]   vec4 T_k(S) u, with (S x)_i = x_i + sum_j w_ij (x_j - x_i)
// out  next   [V]   vec4 holds T_(k-1)(S) u, becomes turn S now - keep next = T_(k+1)(S) u
// out  level  [5 V] vec4 exp(-t_l L) u of five times, each gains part_l of what `next` became
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-5 a component
// src  series of a graph's Laplacian: Hammond 2011, doi:10.1016/j.acha.2010.04.005, section 6
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> now: array<vec4<f32>>;
@group(0) @binding(4) var<storage, read_write> next: array<vec4<f32>>;
@group(0) @binding(5) var<storage, read_write> level: array<vec4<f32>>;

struct Params {
    part: vec4<f32>,
    last_part: f32,
    turn: f32,
    keep: f32,
    vertices: u32,
}
var<immediate> params: Params;

#include "lib/thread.wgsl"

fn gain(at: u32, part: f32, x: vec4<f32>) {
    if part != 0.0 { level[at] += part * x; }
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let v = thread(group, groups, local, 64u);
    if v >= params.vertices { return; }
    var sum = vec4(0.0);
    var rest = 1.0;
    for (var e = start[v]; e < start[v + 1u]; e++) {
        let w = weight[e];
        sum += w * now[near[e]];
        rest -= w;
    }
    let x = params.turn * (sum + rest * now[v]) - params.keep * next[v];
    next[v] = x;
    gain(v, params.part.x, x);
    gain(params.vertices + v, params.part.y, x);
    gain(2u * params.vertices + v, params.part.z, x);
    gain(3u * params.vertices + v, params.part.w, x);
    gain(4u * params.vertices + v, params.last_part, x);
}
