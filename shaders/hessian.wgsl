// hessian: eigenvalues of the Hessian of a smoothed field, or a response made of them.
// in   near     [27 S]    u32  neighbouring slots
// in   inside   [16 S]    u32  one bit a voxel; others get 0
// in   f        [512 S]   f32  smoothed field
// out  response [512 R C] f32  of slots `first` to `first` + R; C = 3: eigenvalues ascending, field
//                              unit / mm^2; C = 1: ridge max(0, -l2), or tubeness sqrt(l1 l2)
//                              where l2 < 0
// grid one thread a voxel of these slots
// tol  |gpu - cpu| <= 2e-4 * (1 + |cpu|)
// src  Sato 1998, doi:10.1016/S1361-8415(98)80009-1; Lindeberg 1998, doi:10.1023/A:1008097225773
// ours `sign` -1 looks for dark ridges; no scale normalisation: values are plain derivatives
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> inside: array<u32>;
@group(0) @binding(2) var<storage, read> f: array<f32>;
@group(0) @binding(3) var<storage, read_write> response: array<f32>;

struct Params { spacing_mm: vec3<f32>, sign: f32, first: u32, slots: u32, kind: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/ridge.wgsl"
#include "lib/eigenvalues.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let at = thread(group, groups, local, 64u);
    if (at >> 9u) >= params.slots { return; }
    let voxel = at + 512u * params.first;
    let slot = voxel >> 9u;
    var l = vec3(0.0);
    if ((inside[voxel >> 5u] >> (voxel & 31u)) & 1u) != 0u {
        let n = derivatives(slot, position(voxel & 511u), params.spacing_mm);
        l = eigenvalues(params.sign * n.m, params.sign * n.o);
    }
    if params.kind == 0u {
        response[3u * at] = l.x;
        response[3u * at + 1u] = l.y;
        response[3u * at + 2u] = l.z;
    } else if params.kind == 1u {
        response[at] = max(0.0, -l.y);
    } else {
        response[at] = select(0.0, sqrt(l.x * l.y), l.y < 0.0);
    }
}
