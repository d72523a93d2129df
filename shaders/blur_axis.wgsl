// blur_axis: one separable pass of a symmetric filter along an axis, in integers.
// in   near   [27 S]  u32  neighbouring slots
// in   corner [3 S]   i32  first voxel of each brick
// in   weight [R+1]   i32  weight of the centre and of offsets 1..R; both sides sum to 4096
// in   f      [512 S] i32  |f| <= 2^18
// out  g      [512 S] i32  (sum_k weight[|k|] f(p + k) + 2048) >> 12
// grid one thread a voxel
// tol  none: sums stay below 2^31, so that every device gives the same integers
// src  separable convolution; weights as scipy.ndimage.gaussian_filter
// ours positions are held in [low, high], so that a volume's edge repeats, beyond it too; bricks that
//      do not exist count as `missing`
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> weight: array<i32>;
@group(0) @binding(3) var<storage, read> f: array<i32>;
@group(0) @binding(4) var<storage, read_write> g: array<i32>;

struct Params { slots: u32, axis: u32, radius: i32, low: i32, high: i32, missing: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

// Value at a position along the axis, counted from the brick's first voxel; `line` is the element of
// its row's start within a brick.
fn value(slot: u32, q: i32, line: u32, stride: u32) -> i32 {
    var s = slot;
    for (var brick = q >> 3u; brick > 0 && s != NONE; brick--) { s = above(s, params.axis); }
    for (var brick = q >> 3u; brick < 0 && s != NONE; brick++) { s = below(s, params.axis); }
    if s == NONE { return params.missing; }
    return f[s * 512u + line + u32(q & 7) * stride];
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
    let stride = select(select(64u, 8u, params.axis == 1u), 1u, params.axis == 0u);
    let at = voxel & 511u;
    let p = (at / stride) & 7u;
    let line = at - p * stride;
    let first = corner[slot * 3u + params.axis];
    var sum = 2048;
    for (var k = -params.radius; k <= params.radius; k++) {
        let place = clamp(first + i32(p) + k, params.low, params.high);
        sum += weight[abs(k)] * value(slot, place - first, line, stride);
    }
    g[voxel] = sum >> 12u;
}
