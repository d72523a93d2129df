// hessian: eigenvalues of the Hessian of a smoothed field, or a response made of them.
// in   near     [27 S]    u32  neighbouring slots
// in   inside   [16 S]    u32  one bit a voxel; others get 0
// in   f        [512 S]   f32  smoothed field
// out  response [512 R C] f32  of slots `first` to `first` + R; C = 3: eigenvalues ascending, field
//                              unit / mm^2; C = 1: ridge max(0, -l2), or tubeness sqrt(l1 l2)
//                              where l2 < 0
// grid one workgroup a brick of these slots, each thread a column of eight voxels along z
// tol  |gpu - cpu| <= 2e-4 * (1 + |cpu|)
// src  Sato 1998, doi:10.1016/S1361-8415(98)80009-1; Lindeberg 1998, doi:10.1023/A:1008097225773
// ours the brick and the voxels around it are loaded once, into shared memory; `sign` -1 looks for dark ridges; no scale normalisation: values are plain derivatives
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> inside: array<u32>;
@group(0) @binding(2) var<storage, read> f: array<f32>;
@group(0) @binding(3) var<storage, read_write> response: array<f32>;

struct Params { spacing_mm: vec3<f32>, sign: f32, first: u32, slots: u32, kind: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/eigenvalues.wgsl"

// The brick's voxels and their neighbours, 10 x 10 x 10.
var<workgroup> tile: array<f32, 1000>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let brick = thread(group, groups, 0u, 1u);
    let slot = params.first + brick;
    if brick < params.slots {
        for (var i = local; i < 1000u; i += 64u) {
            let e = element(slot, vec3<i32>(vec3(i % 10u, (i / 10u) % 10u, i / 100u)) - vec3(1));
            tile[i] = 0.0;
            if e != NONE { tile[i] = f[e]; }
        }
    }
    workgroupBarrier();
    if brick >= params.slots { return; }
    let h = params.spacing_mm;
    let across = 4.0 * vec3(h.x * h.y, h.x * h.z, h.y * h.z);
    for (var z = 0u; z < 8u; z++) {
        let voxel = 64u * z + local;
        var l = vec3(0.0);
        if ((inside[slot * 16u + (voxel >> 5u)] >> (voxel & 31u)) & 1u) != 0u {
            let c = 111u + (local & 7u) + 10u * (local >> 3u) + 100u * z;
            let up = vec3(tile[c + 1u], tile[c + 10u], tile[c + 100u]);
            let down = vec3(tile[c - 1u], tile[c - 10u], tile[c - 100u]);
            let m = (up - vec3(2.0 * tile[c]) + down) / (h * h);
            let o = vec3(
                tile[c + 11u] - tile[c - 9u] - tile[c + 9u] + tile[c - 11u],
                tile[c + 101u] - tile[c - 99u] - tile[c + 99u] + tile[c - 101u],
                tile[c + 110u] - tile[c - 90u] - tile[c + 90u] + tile[c - 110u],
            ) / across;
            l = eigenvalues(params.sign * m, params.sign * o);
        }
        let at = brick * 512u + voxel;
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
}
