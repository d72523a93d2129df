// scale_restore: normals from their smoothed versions, with every detail that stands out of the
// noise of the voxel steps.
// in   normal [3V]   f32  unit normals of the faces
// in   level  [5 V]  vec4 the same smoothed over times t, 2t, 4t, 8t, 16t; any length
// in   pooled [5V]   f32  energy of each band's residual, averaged around the vertex
// out  faired [3V]   f32  unit normals
// grid one thread a vertex
// tol  |gpu - cpu| <= 2e-5 a component
// src  bands of a heat flow as in diffusion wavelets: Coifman 2006,
//      doi:10.1016/j.acha.2006.04.004
// ours each band is foretold from the next coarser one (Richardson's extrapolation in t), and only
//      what differs is shrunk, by 1 - (noise² / energy)²; the noise of a digital plane is a table
//      by its slope to the axes
@group(0) @binding(0) var<storage, read> normal: array<f32>;
@group(0) @binding(1) var<storage, read> level: array<vec4<f32>>;
@group(0) @binding(2) var<storage, read> pooled: array<f32>;
@group(0) @binding(3) var<storage, read_write> faired: array<f32>;

// axis_*: a grid axis in patient space; its spacing over the largest. terrace: height of each
// axis's terraces; share of the noise of a mask that is here. raw: noise of the finest band, rad.
struct Params {
    axis_x: vec4<f32>,
    axis_y: vec4<f32>,
    axis_z: vec4<f32>,
    terrace: vec4<f32>,
    raw: f32,
    vertices: u32,
}
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/scales.wgsl"

// Noise of a band of a digital plane in general position, and with terraces wider than the band's
// scale, rad; the scale over the largest spacing.
const PLANE = array<f32, 5>(0.0, 0.04363, 0.02793, 0.01745, 0.01047);
const TERRACE = array<f32, 5>(0.0, 0.06981, 0.05236, 0.03927, 0.02531);
const SCALE = array<f32, 5>(0.0, 1.0, 1.4142136, 2.0, 2.8284271);

// How much of the terraces of an axis a band sees: all where they are wider than about two of its
// scales, none where they are narrower.
fn seen(n: vec3<f32>, axis: vec4<f32>, scale: f32) -> f32 {
    let c = min(abs(dot(n, axis.xyz)), 1.0);
    let slope = sqrt(1.0 - c * c) / max(c, 1e-6);
    let x = clamp((0.52 - slope * scale / axis.w) / 0.14, 0.0, 1.0);
    return x * x * (3.0 - 2.0 * x);
}

fn noise(n: vec3<f32>, band: u32) -> f32 {
    if band == 0u { return params.raw; }
    let high = vec3(
        dot(n, params.axis_x.xyz) * params.axis_x.w,
        dot(n, params.axis_y.xyz) * params.axis_y.w,
        dot(n, params.axis_z.xyz) * params.axis_z.w,
    );
    let terraces = vec3(
        seen(n, params.axis_x, SCALE[band]),
        seen(n, params.axis_y, SCALE[band]),
        seen(n, params.axis_z, SCALE[band]),
    ) * params.terrace.xyz;
    let widest = max(terraces.x, max(terraces.y, terraces.z));
    return params.terrace.w * max(PLANE[band] * length(high), TERRACE[band] * widest);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let v = thread(group, groups, local, 64u);
    if v >= params.vertices { return; }
    let all = ladder(v, params.vertices);
    var sum = all.n[5];
    var coarser = vec3(0.0);
    for (var i = 0u; i < 5u; i++) {
        let k = 4u - i;
        let t = noise(all.n[3], k);
        let q = t * t / max(pooled[5u * v + k], 1e-12);
        let foretold = share(k) * coarser;
        coarser = foretold + max(1.0 - q * q, 0.0) * (all.n[k] - all.n[k + 1u] - foretold);
        sum += coarser;
    }
    let len = length(sum);
    let out = select(all.n[5], sum / len, len >= 1e-6);
    faired[3u * v] = out.x;
    faired[3u * v + 1u] = out.y;
    faired[3u * v + 2u] = out.z;
}
