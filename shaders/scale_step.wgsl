// scale_step: one step of the Chebyshev series of heat flow over a surface, three numbers a vertex.
// in   start  [V+1] u32  first entry of each vertex in `near` and `weight` (CSR)
// in   near   [E]   u32  adjacent vertices, ascending
// in   weight [E]   f32  c_ij / (m_i rho): at each vertex they sum to at most one
// in   now    [3V]  f32  T_k(S) u, with (S x)_i = x_i + sum_j w_ij (x_j - x_i)
// out  next   [3V]  f32  holds T_(k-1)(S) u, becomes turn S now - keep next = T_(k+1)(S) u
// out  level  [5 3V] f32 exp(-t_l L) u of five times, each gains part_l of what `next` became
// grid one thread a vertex
// tol  |gpu - cpu| <= 1e-5 a component
// src  heat by Chebyshev series: Tal-Ezer 1989, doi:10.1137/0726001; on graphs: Hammond 2011,
//      doi:10.1016/j.acha.2010.04.005
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> now: array<f32>;
@group(0) @binding(4) var<storage, read_write> next: array<f32>;
@group(0) @binding(5) var<storage, read_write> level: array<f32>;

struct Params {
    part: vec4<f32>,
    last_part: f32,
    turn: f32,
    keep: f32,
    vertices: u32,
}
var<immediate> params: Params;

#include "lib/thread.wgsl"

fn load(v: u32) -> vec3<f32> {
    return vec3(now[3u * v], now[3u * v + 1u], now[3u * v + 2u]);
}

fn gain(at: u32, part: f32, x: vec3<f32>) {
    if part == 0.0 { return; }
    level[at] += part * x.x;
    level[at + 1u] += part * x.y;
    level[at + 2u] += part * x.z;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let v = thread(group, groups, local, 64u);
    if v >= params.vertices { return; }
    let own = load(v);
    var sum = own;
    for (var e = start[v]; e < start[v + 1u]; e++) {
        sum += weight[e] * (load(near[e]) - own);
    }
    let before = vec3(next[3u * v], next[3u * v + 1u], next[3u * v + 2u]);
    let x = params.turn * sum - params.keep * before;
    next[3u * v] = x.x;
    next[3u * v + 1u] = x.y;
    next[3u * v + 2u] = x.z;
    let stride = 3u * params.vertices;
    gain(3u * v, params.part.x, x);
    gain(stride + 3u * v, params.part.y, x);
    gain(2u * stride + 3u * v, params.part.z, x);
    gain(3u * stride + 3u * v, params.part.w, x);
    gain(4u * stride + 3u * v, params.last_part, x);
}
