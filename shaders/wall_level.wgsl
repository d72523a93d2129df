// wall_level: signed offset of each voxel from the wall, from the threshold of the wall about it.
// in   near    [27 S]  u32  neighbouring slots
// in   core    [16 S]  u32  one bit a voxel
// in   value   [512 S] i32  smoothed values: 0 lumen, 4096 wall
// in   mark    [512 S] u32  of wall_peak
// in   peak    [512 S] i32  peaks times weights, smoothed widely
// in   weight  [512 S] i32  weights, smoothed as `peak`
// in   peak1   [512 S] i32  the same, smoothed narrowly
// in   weight1 [512 S] i32
// in   lumen   [512 S] i32  value of the lumen about each voxel; 0 where it is the same everywhere
// in   law     [513]   i32  threshold of a peak of 8 times the index
// in   cap     [10]    i32  least offset at a squared distance, voxels, from the core
// out  level   [512 S] i32  low 16 bits: offset in 1/1024 of the mean spacing, negative in the lumen,
//                           held within 3; then 14 bits: the threshold; bit 30: the offset is that of
//                           `cap`, the values alone would be deeper in the lumen
// grid one thread a voxel
// tol  none
// src  ours; lib and law in src/wall/law.rs
// ours the narrow mean may only lower the peak: a bronchus between a vessel and lung would take the
//      bright side's threshold all round. The offset's sign is that of value minus threshold
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> core: array<u32>;
@group(0) @binding(2) var<storage, read> value: array<i32>;
@group(0) @binding(3) var<storage, read> mark: array<u32>;
@group(0) @binding(4) var<storage, read> peak: array<i32>;
@group(0) @binding(5) var<storage, read> weight: array<i32>;
@group(0) @binding(6) var<storage, read> peak1: array<i32>;
@group(0) @binding(7) var<storage, read> weight1: array<i32>;
@group(0) @binding(8) var<storage, read> lumen: array<i32>;
@group(0) @binding(9) var<storage, read> law: array<i32>;
@group(0) @binding(10) var<storage, read> cap: array<i32>;
@group(0) @binding(11) var<storage, read_write> level: array<i32>;

struct Params { slots: u32, forced: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

fn divided_down(a: i32, b: i32) -> i32 {
    return a / b - select(0, 1, a < 0 && a % b != 0);
}

// Squared distance to the nearest core voxel, 10 beyond 3 voxels.
fn core_distance(slot: u32, p: vec3<i32>) -> i32 {
    var least = 10;
    for (var z = -3; z <= 3; z++) {
        for (var y = -3; y <= 3; y++) {
            for (var x = -3; x <= 3; x++) {
                let d = x * x + y * y + z * z;
                if d >= least { continue; }
                let e = element(slot, p + vec3(x, y, z));
                if e != NONE && (core[e >> 5u] & (1u << (e & 31u))) != 0u { least = d; }
            }
        }
    }
    return least;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let voxel = thread(group, groups, local, 64u);
    let slot = voxel >> 9u;
    if slot >= params.slots { return; }
    var top = 4096;
    if weight[voxel] >= 4 { top = (peak[voxel] << 12u) / weight[voxel]; }
    if weight1[voxel] >= 4 { top = min(top, (peak1[voxel] << 12u) / weight1[voxel]); }
    top = clamp(top, 0, 4096);
    let i = min(top >> 3u, 511);
    // The law counts from the lumen's value to the wall's: where a vessel is so thin that its blood is
    // mixed with tissue, the lumen's is higher.
    let base = clamp(lumen[voxel], 0, 3500);
    let plain = law[i] + (((law[i + 1] - law[i]) * (top - 8 * i)) >> 3u);
    let threshold = plain + (((4096 - plain) * base) >> 12u);
    var offset = divided_down((value[voxel] - threshold) * 2253, max(top - base, 414));
    let flags = mark[voxel];
    var capped = 0;
    if (flags & 8u) != 0u && offset < 0 && (core[voxel >> 5u] & (1u << (voxel & 31u))) == 0u {
        let d = core_distance(slot, position(voxel & 511u));
        if d < 10 && cap[d] > offset {
            offset = cap[d];
            capped = 1 << 30u;
        }
    }
    if (flags & 4u) != 0u { offset = max(offset, params.forced); }
    level[voxel] = capped | (threshold << 16u) | (clamp(offset, -3072, 3072) & 0xffff);
}
