// ridge_mark: which inside voxels are ridge candidates of the smoothed distance map.
// in   near   [27 S]  u32  neighbouring slots
// in   inside [16 S]  u32  one bit a voxel
// in   f      [512 S] f32  smoothed distance, mm
// out  marked [16 S]  u32  one bit a voxel
// grid one thread a voxel, 64 a workgroup: two words of `marked`
// tol  bits agree except where |offset| is within 2e-3 voxel of 0.6, or the second eigenvalue within
//      1e-4 of its limit; the cases stay clear of those
// src  lib/ridge.wgsl
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> inside: array<u32>;
@group(0) @binding(2) var<storage, read> f: array<f32>;
@group(0) @binding(3) var<storage, read_write> marked: array<u32>;

struct Params { spacing_mm: vec3<f32>, slots: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/ridge.wgsl"

var<workgroup> words: array<atomic<u32>, 2>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let block = thread(group, groups, 0u, 1u);
    if local < 2u { atomicStore(&words[local], 0u); }
    workgroupBarrier();
    let voxel = block * 64u + local;
    let slot = voxel >> 9u;
    if slot < params.slots {
        let bit = 1u << (voxel & 31u);
        if (inside[voxel >> 5u] & bit) != 0u {
            let r = ridge(slot, position(voxel & 511u), params.spacing_mm);
            if r.accepted { atomicOr(&words[local >> 5u], bit); }
        }
    }
    workgroupBarrier();
    if local < 2u && slot < params.slots { marked[block * 2u + local] = atomicLoad(&words[local]); }
}
