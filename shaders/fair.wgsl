// fair: one step of Laplacian smoothing of vertex normals; vertices never move.
// in   start  [V+1] u32  first entry of each vertex in `near` and `weight` (CSR)
// in   near   [E]   u32  adjacent vertices, ascending
// in   weight [E]   f32  w_ij, summing to one at each vertex
// in   normal [3V]  f32  unit normals n
// out  faired [3V]  f32  normalize((1 - lambda) n_i + lambda sum_j w_ij n_j)
// grid one thread a vertex
// tol  |gpu - cpu| <= 2e-6 a component and step
// src  Taubin 1995, doi:10.1145/218380.218473; the paper's section 2, Eqs. 1-2
// ours weights are divided by their sum (Eq. 1 asks it, the inverse distance breaks it);
//      normals are renormalised each step; a sum shorter than 1e-6 keeps the old normal
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> normal: array<f32>;
@group(0) @binding(4) var<storage, read_write> faired: array<f32>;

struct Params { vertices: u32, lambda: f32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"

fn load(v: u32) -> vec3<f32> {
    return vec3(normal[3u * v], normal[3u * v + 1u], normal[3u * v + 2u]);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let v = thread(group, groups, local, 64u);
    if v >= params.vertices { return; }
    var sum = vec3(0.0);
    for (var e = start[v]; e < start[v + 1u]; e++) {
        sum += weight[e] * load(near[e]);
    }
    let old = load(v);
    let n = (1.0 - params.lambda) * old + params.lambda * sum;
    let len = length(n);
    let out = select(old, n / len, len >= 1e-6);
    faired[3u * v] = out.x;
    faired[3u * v + 1u] = out.y;
    faired[3u * v + 2u] = out.z;
}
