// wall_correct: moves the wall where blur has moved a curved edge towards its centre, and rounds off
// ends that a limit has closed.
// in   near   [27 S]  u32  neighbouring slots
// in   offset [512 S] i32  of wall_sides
// in   edge   [512 S] i32  of wall_sides, smoothed
// in   filled [512 S] i32  of wall_sides, smoothed
// in   closed [512 S] i32  of wall_sides, smoothed
// out  moved  [512 S] i32  offset in 1/1024 of the mean spacing
// grid one thread a voxel
// tol  none
// src  an edge of curvature k, blurred by s, moves by s^2 k / 2 (van Vliet & Verbeek 1994)
// ours the curvature is the divergence of the unit gradient of the smoothed edge, in integers
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> offset: array<i32>;
@group(0) @binding(2) var<storage, read> edge: array<i32>;
@group(0) @binding(3) var<storage, read> filled: array<i32>;
@group(0) @binding(4) var<storage, read> closed: array<i32>;
@group(0) @binding(5) var<storage, read_write> moved: array<i32>;

struct Params {
    slope: vec3<i32>, // least spacing over the axis's, times 1024
    slots: u32,
    shift: i32,       // half the blur's variance over least and mean spacing, times 1024; 0 for none
    most: i32,        // greatest curvature, a least spacing, times 4096
    rise: i32,        // mean over least spacing, times 1024
}
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/wall.wgsl"

// Unit gradient times 4096 of `edge` at the voxel at p (-1 to 8) of a brick.
fn direction(slot: u32, p: vec3<i32>) -> vec3<i32> {
    var g = vec3(0);
    for (var axis = 0u; axis < 3u; axis++) {
        var d = vec3(0);
        d[axis] = 1;
        g[axis] = (value(slot, p + d) - value(slot, p - d)) * params.slope[axis];
    }
    g = g >> vec3(excess_bits(g));
    let length = length_of(g);
    if length == 0 { return vec3(0); }
    return (g << vec3(12u)) / vec3(length);
}

// Beyond all bricks is outside. Positions run from -2 to 9: one brick further at most.
fn value(slot: u32, p: vec3<i32>) -> i32 {
    let e = element(slot, p);
    if e == NONE { return 32768; }
    return edge[e];
}

fn offset_at(slot: u32, p: vec3<i32>) -> i32 {
    let e = element(slot, p);
    if e == NONE { return 3072; }
    return offset[e];
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
    var o = offset[voxel];
    let p = position(voxel & 511u);
    if params.shift != 0 && abs(o) < 1024 {
        var turn = 0;
        var g = vec3(0);
        for (var axis = 0u; axis < 3u; axis++) {
            var d = vec3(0);
            d[axis] = 1;
            let n = direction(slot, p + d)[axis] - direction(slot, p - d)[axis];
            turn += n * params.slope[axis];
            g[axis] = (offset_at(slot, p + d) - offset_at(slot, p - d)) * params.slope[axis];
        }
        let curvature = clamp(turn >> 11u, -params.most, params.most);
        let excess = excess_bits(g);
        // Offset a mm of way, times 1024: `rise` takes it from the least spacing to the mean one.
        let steep = ((length_of(g >> vec3(excess)) << excess) >> 11u) * params.rise >> 10u;
        o -= ((((curvature * params.shift) >> 12u) * clamp(steep, 307, 2560)) >> 10u);
    }
    let w = min((closed[voxel] * 5) >> 4u, 4096); // two and a half times the share, of 4096
    if w > 0 {
        let round = (16384 - filled[voxel]) >> 4u; // 1/2 less the share inside, times 2048
        o += ((round - o) * w) >> 12u;
    }
    moved[voxel] = clamp(o, -3072, 3072);
}
