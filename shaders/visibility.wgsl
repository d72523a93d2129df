// visibility: the first candidate, in rank order, that sees each boundary voxel.
// in   near   [27 S] u32  neighbouring slots
// in   corner [3 S]  i32  first voxel of each brick
// in   open   [16 S] u32  one bit a voxel a ray may pass
// in   seen   [B]    u32  elements of the boundary voxels
// in   viewer [C]    u32  elements of the candidates, by rank
// in   reach  [C]    u32  squared radius of each candidate, in units of `weight`
// in   start  [S+1]  u32  stretch of `near_viewers` of each brick
// in   near_viewers [L] u32  ranks of the candidates whose ball meets the brick, ascending
// out  first  [B]    u32  rank of the first viewer, or 0xffffffff
// grid one thread a boundary voxel
// tol  exact: integers throughout
// src  He, Hong, Chen & Liang 2001 (reliable path); Amanatides & Woo 1987,
//      doi:10.2312/egtp.19871000 (ray walk)
// ours rays run between voxel centres in exact integer arithmetic, ties step x before y before z,
//      and are walked from the seen voxel, whose end is hidden more often than the viewer's;
//      the first viewer is found by going through the candidates in rank order, which equals
//      inserting them one by one and keeping those that see something new
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> open: array<u32>;
@group(0) @binding(3) var<storage, read> seen: array<u32>;
@group(0) @binding(4) var<storage, read> viewer: array<u32>;
@group(0) @binding(5) var<storage, read> reach: array<u32>;
@group(0) @binding(6) var<storage, read> start: array<u32>;
@group(0) @binding(7) var<storage, read> near_viewers: array<u32>;
@group(0) @binding(8) var<storage, read_write> first: array<u32>;

struct Params { weight: vec3<u32>, boundary: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

fn voxel_of(e: u32) -> vec3<i32> {
    let s = 3u * (e >> 9u);
    return vec3(corner[s], corner[s + 1u], corner[s + 2u]) + position(e & 511u);
}

// Whether every voxel strictly between the centres of a voxel and of the one `d` before it is open.
fn sees(to_element: u32, d: vec3<i32>) -> bool {
    let n = abs(d);
    let way = sign(d);
    var slot = to_element >> 9u;
    var p = position(to_element & 511u);
    // The last crossing of an axis that is left is at last / (2 n).
    var last = 2 * n - vec3(1);
    let steps = n.x + n.y + n.z;
    for (var k = 1; k < steps; k++) {
        var axis = 0u;
        if last.z > 0 && last.z * n.x >= last.x * n.z && last.z * n.y >= last.y * n.z {
            axis = 2u;
        } else if last.y > 0 && last.y * n.x >= last.x * n.y {
            axis = 1u;
        }
        last[axis] -= 2;
        p[axis] -= way[axis];
        if p[axis] < 0 {
            slot = below(slot, axis);
            p[axis] = 7;
        } else if p[axis] > 7 {
            slot = above(slot, axis);
            p[axis] = 0;
        }
        if slot == NONE { return false; }
        let e = u32(p.x + 8 * p.y + 64 * p.z);
        if ((open[slot * 16u + (e >> 5u)] >> (e & 31u)) & 1u) == 0u { return false; }
    }
    return true;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let i = thread(group, groups, local, 64u);
    if i >= params.boundary { return; }
    let s = seen[i];
    let here = voxel_of(s);
    let slot = s >> 9u;
    var found = NONE;
    for (var k = start[slot]; k < start[slot + 1u]; k++) {
        let rank = near_viewers[k];
        let v = viewer[rank];
        let d = here - voxel_of(v);
        let d2 = vec3<u32>(d * d) * params.weight;
        if d2.x + d2.y + d2.z <= reach[rank] && sees(s, d) {
            found = rank;
            break;
        }
    }
    first[i] = found;
}
