// relax_coefficients: the quadratic form that the sliding vertices of a mask's wall minimise.
// in   start    [V+1] u32  first entry of each vertex in `near` (CSR)
// in   near     [E]   u32  adjacent vertices, ascending
// in   edge     [V]   u32  grid edge of each vertex (lib/grid_edge.wgsl)
// in   normal   [3V]  f32  unit normals
// out  bound    [V]   vec2 B_i / (2 D_i), and the most that s_i may be: 0 for a fixed vertex
// out  coupling [E]   f32  c_ij / (2 D_i)
// out  bend     [V]   f32  h sqrt(sum_j |n_i - n_j|^2 / sum_j |m_i - m_j|^2)
// grid one thread a vertex
// tol  |gpu - cpu| <= 2e-5
// src  positions from normals: Nehab 2005, doi:10.1145/1073204.1073226
// ours one unknown a vertex, its place on the grid edge; the mean of two normals, for which
//      circles and spheres have no residual
// E(s) = 1/2 sum_ij w_ij (n_ij . (x_i - x_j))^2 + 1/2 mu sum_i s_i^2, lengths over the smallest
// spacing h; x_i = m_i + s_i e_i, m_i the middle of the grid edge, e_i from inside to outside;
// n_ij the mean of the two normals, normalised; w_ij = 1 / |m_i - m_j|^2. Then dE/ds_i =
// D_i s_i + B_i - sum_j c_ij s_j. Edges of opposed or undefined normals are left out.
@group(0) @binding(0) var<storage, read> start: array<u32>;
@group(0) @binding(1) var<storage, read> near: array<u32>;
@group(0) @binding(2) var<storage, read> edge: array<u32>;
@group(0) @binding(3) var<storage, read> normal: array<f32>;
@group(0) @binding(4) var<storage, read_write> bound: array<vec2<f32>>;
@group(0) @binding(5) var<storage, read_write> coupling: array<f32>;
@group(0) @binding(6) var<storage, read_write> bend: array<f32>;

// Grid axes over h: unit direction times spacing, and its length. The most that s may be on each.
struct Params {
    axis_x: vec4<f32>,
    axis_y: vec4<f32>,
    axis_z: vec4<f32>,
    limit_x: f32,
    limit_y: f32,
    limit_z: f32,
    stiffness: f32,
    vertices: u32,
}
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/grid_edge.wgsl"

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
    let own = edge[v];
    let n = load(v);
    let size = vec3(params.axis_x.w, params.axis_y.w, params.axis_z.w);
    var diagonal = params.stiffness;
    var offset = 0.0;
    var turn = 0.0;
    var reach = 0.0;
    for (var e = start[v]; e < start[v + 1u]; e++) {
        let other = edge[near[e]];
        let m = load(near[e]);
        let d = 0.5 * middle_difference(own, other);
        let apart = dot(d * size, d * size);
        let sum = n + m;
        let squared = dot(sum, sum);
        var c = 0.0;
        if squared >= 1e-6 && squared < 16.0 && apart > 0.0 {
            let u = sum / sqrt(squared);
            let along = vec3(
                dot(u, params.axis_x.xyz),
                dot(u, params.axis_y.xyz),
                dot(u, params.axis_z.xyz),
            );
            let p = outward(own, along);
            diagonal += p * p / apart;
            offset += p * dot(d, along) / apart;
            c = p * outward(other, along) / apart;
            turn += dot(n - m, n - m);
            reach += apart;
        }
        coupling[e] = c;
    }
    let half = 0.5 / diagonal;
    for (var e = start[v]; e < start[v + 1u]; e++) { coupling[e] *= half; }
    var limits = vec3(params.limit_x, params.limit_y, params.limit_z);
    bound[v] = vec2(half * offset, select(limits[edge_axis(own)], 0.0, is_fixed(own)));
    bend[v] = select(0.0, sqrt(turn / reach), reach > 0.0);
}
