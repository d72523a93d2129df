// wall_peak: the greatest value of the wall behind each voxel of the rim, and whether it is the crest
// of a sheet.
// in   near   [27 S]  u32  neighbouring slots
// in   corner [3 S]   i32  first voxel of each brick
// in   core   [16 S]  u32  one bit a voxel
// in   value  [512 S] i32  smoothed values: 0 lumen, 4096 wall
// in   sharp  [512 S] i32  the same, sharpened by a twelfth of their second differences: linear
//                          interpolation between voxels lowers peaks by so much in the mean
// in   calm   [512 S] i32  the same, smoothed more: its gradient leads across the wall
// in   path   [512 S] i32  of ridge_grow: 0 where a voxel did not join
// out  mark   [512 S] u32  bit 0 rim, 1 crest, 2 strong crest, 3 joined; from bit 8 on the peak
// out  peak   [512 S] i32  peak times weight, weight 0 to 64
// out  weight [512 S] i32  weight times 4096
// grid one thread a voxel
// tol  none
// src  ours; the first maximum along the gradient is the peak of the plate that blurs into it. A
//      crest falls on both sides by so many thirds of its rise within two least spacings along the
//      gradient: bulges of thick tissue are no sheets
// ours the rim are voxels that joined, and core voxels beside one that did not. Rays take `steps`
//      steps and end where the value has fallen by `fall` below its greatest, or where no brick is.
//      Values between voxels are trilinear in steps of 1/256; beyond the volume its edge repeats
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> core: array<u32>;
@group(0) @binding(3) var<storage, read> value: array<i32>;
@group(0) @binding(4) var<storage, read> sharp: array<i32>;
@group(0) @binding(5) var<storage, read> calm: array<i32>;
@group(0) @binding(6) var<storage, read> path: array<i32>;
@group(0) @binding(7) var<storage, read_write> mark: array<u32>;
@group(0) @binding(8) var<storage, read_write> peak: array<i32>;
@group(0) @binding(9) var<storage, read_write> weight: array<i32>;

struct Params {
    slope: vec3<i32>, // least spacing over the axis's, times 1024
    slots: u32,
    step: vec3<i32>,  // half the least spacing over the axis's, times 65536
    steps: i32,
    size: vec3<i32>,  // voxels of the volume
    fall: i32,
    gain: i32,        // weight's root a gradient, see below
    crest: i32,       // least fall on both sides of a crest
    strong: i32,      // least fall of a strong crest
    rise: i32,        // thirds of the rise that a crest falls on both sides
}
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/wall.wgsl"

fn first(slot: u32) -> vec3<i32> {
    return vec3(corner[slot * 3u], corner[slot * 3u + 1u], corner[slot * 3u + 2u]);
}

// Element of the voxel at p (-8 to 15) of a brick, held in the volume; NONE where there is no brick.
fn held(slot: u32, p: vec3<i32>) -> u32 {
    let c = first(slot);
    let q = clamp(p + c, vec3(0), params.size - 1) - c;
    if any(q < vec3(-8)) || any(q > vec3(15)) { return NONE; }
    return element(slot, q);
}

fn is_core(e: u32) -> bool { return (core[e >> 5u] & (1u << (e & 31u))) != 0u; }

fn is_rim(slot: u32, p: vec3<i32>, voxel: u32) -> bool {
    if !is_core(voxel) { return true; }
    for (var n = 0u; n < 6u; n++) {
        var step = vec3(0);
        step[n >> 1u] = select(-1, 1, (n & 1u) != 0u);
        let e = element(slot, p + step);
        if e == NONE || path[e] == 0 { return true; }
    }
    return false;
}

fn blend(a: i32, b: i32, f: i32) -> i32 { return a + (((b - a) * f + 128) >> 8u); }

// Sharpened value at a place in 1/65536 of a voxel; false where a voxel about it has no brick.
fn sample(slot: u32, at: vec3<i32>, out: ptr<function, i32>) -> bool {
    let p = at >> vec3(16u);
    let f = (at >> vec3(8u)) & vec3(255);
    var v: array<i32, 8>;
    for (var n = 0; n < 8; n++) {
        let e = held(slot, p + vec3(n & 1, (n >> 1u) & 1, n >> 2u));
        if e == NONE { return false; }
        v[n] = sharp[e];
    }
    let low = blend(blend(v[0], v[1], f.x), blend(v[2], v[3], f.x), f.y);
    let high = blend(blend(v[4], v[5], f.x), blend(v[6], v[7], f.x), f.y);
    *out = blend(low, high, f.z);
    return true;
}

// Fall on the weaker side of a crest, over the 13 directions; 0 where it is none.
fn crest_fall(slot: u32, p: vec3<i32>, here: i32) -> i32 {
    var most = 0;
    for (var n = 14; n < 27; n++) {
        let d = vec3(n % 3 - 1, (n / 3) % 3 - 1, n / 9 - 1);
        let a1 = held(slot, p + d);
        let a2 = held(slot, p + 2 * d);
        let b1 = held(slot, p - d);
        let b2 = held(slot, p - 2 * d);
        if a1 == NONE || a2 == NONE || b1 == NONE || b2 == NONE { continue; }
        if value[a1] > here || value[b1] > here { continue; }
        let a = here - min(value[a1], value[a2]);
        let b = here - min(value[b1], value[b2]);
        most = max(most, min(a, b));
    }
    return most;
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
    mark[voxel] = 0u;
    peak[voxel] = 0;
    weight[voxel] = 0;
    if path[voxel] == 0 { return; }
    let p = position(voxel & 511u);
    if !is_rim(slot, p, voxel) {
        mark[voxel] = 8u;
        return;
    }
    let here = value[voxel];
    var g = vec3(0);
    for (var axis = 0u; axis < 3u; axis++) {
        var d = vec3(0);
        d[axis] = 1;
        let above = held(slot, p + d);
        let below = held(slot, p - d);
        if above != NONE && below != NONE { g[axis] = (calm[above] - calm[below]) * params.slope[axis]; }
    }
    let excess = excess_bits(g);
    g = g >> vec3(excess);
    let length = length_of(g);
    var run = here;
    var rise = 0;
    if length > 0 {
        let step = (g * params.step) / vec3(length);
        var at = p << vec3(16u);
        for (var n = 0; n < params.steps; n++) {
            at += step;
            var v = 0;
            if !sample(slot, at, &v) { break; }
            run = max(run, v);
            if n < 4 { rise = run - here; }
            if run - v > params.fall { break; }
        }
    }
    // A bulge of thick tissue is lower on both sides too, but rises behind: no sheet.
    let fall = crest_fall(slot, p, here);
    let is_thin = fall > params.crest && 2 * fall > here && 3 * fall >= params.rise * rise;
    if is_thin && here > 614 {
        // A crest lies up to half a voxel beside its voxel: half as much is lost in the mean.
        let top = clamp((here + sharp[voxel]) / 2, 0, 4096);
        mark[voxel] = 11u | select(0u, 4u, fall > params.strong) | (u32(top) << 8u);
        peak[voxel] = top * 64;
        weight[voxel] = 64 << 12u;
        return;
    }
    let top = clamp(run, 0, 4096);
    // The gradient over twelve hundredths of the contrast a voxel, times 256.
    let root = clamp((length * params.gain) >> (20u - excess), 5, 256);
    let w = max((root * root) >> 10u, 1);
    mark[voxel] = 9u | (u32(top) << 8u);
    peak[voxel] = top * w;
    weight[voxel] = w << 12u;
}
