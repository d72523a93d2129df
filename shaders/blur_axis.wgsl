// blur_axis: one separable pass of a symmetric filter along an axis, in integers.
// in   near   [27 S]  u32  neighbouring slots
// in   corner [3 S]   i32  first voxel of each brick
// in   weight [R+1]   i32  weight of the centre and of offsets 1..R; both sides sum to 4096
// in   f      [512 S] i32  |f| <= 2^18
// out  g      [512 S] i32  (sum_k weight[|k|] f(p + k) + 2048) >> 12
// grid one thread a line of eight voxels (64 a brick)
// tol  none: sums stay below 2^31, so that every device gives the same integers
// src  separable convolution; weights as scipy.ndimage.gaussian_filter
// ours positions are held in [low, high], so that a volume's edge repeats, beyond it too; bricks that
//      do not exist count as `missing`; each value that is loaded serves all eight voxels of the line
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> weight: array<i32>;
@group(0) @binding(3) var<storage, read> f: array<i32>;
@group(0) @binding(4) var<storage, read_write> g: array<i32>;

struct Params { slots: u32, axis: u32, radius: i32, low: i32, high: i32, missing: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/lines.wgsl"
#include "lib/turn.wgsl"

// Weight of an offset of at least 0; 0 beyond the radius.
fn weight_at(k: i32) -> i32 {
    if k > params.radius { return 0; }
    return weight[k];
}

// A position of the walk along a line: the slot and which brick it is, counted from the first.
struct Walk { slot: u32, brick: i32 }

fn walked(start: Walk, q: i32) -> Walk {
    var w = start;
    while w.brick < (q >> 3u) && w.slot != NONE { w.slot = above(w.slot, params.axis); w.brick++; }
    while w.brick > (q >> 3u) && w.slot != NONE { w.slot = below(w.slot, params.axis); w.brick--; }
    return w;
}

fn value(at: Walk, q: i32, line: u32) -> i32 {
    if at.slot == NONE { return params.missing; }
    return f[at.slot * 512u + line + u32(q & 7) * line_stride(params.axis)];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = thread(group, groups, 0u, 1u);
    var sum_a = vec4(2048);
    var sum_b = vec4(2048);
    if slot < params.slots {
        let line = line_start(local, params.axis);
        let first = corner[slot * 3u + params.axis];
        // Range of positions, counted from the brick's first voxel. Held positions move one way only,
        // but where a brick lies beyond the volume they all are its edge.
        let low = params.low - first;
        let high = params.high - first;
        // Weights of the value at `q` for the eight voxels: from one value to the next they move on
        // by a voxel.
        var w_a = vec4(weight_at(0), weight_at(1), weight_at(2), weight_at(3));
        var w_b = vec4(weight_at(4), weight_at(5), weight_at(6), weight_at(7));
        var at = Walk(slot, 0);
        for (var q = 0; q <= 7 + params.radius; q++) {
            let held = clamp(q, low, high);
            at = walked(at, held);
            let there = value(at, held, line);
            sum_a += w_a * there;
            sum_b += w_b * there;
            w_b = vec4(w_a.w, w_b.xyz);
            w_a = vec4(weight_at(q + 1), w_a.xyz);
        }
        w_a = vec4(weight_at(1), weight_at(2), weight_at(3), weight_at(4));
        w_b = vec4(weight_at(5), weight_at(6), weight_at(7), weight_at(8));
        at = Walk(slot, 0);
        for (var q = -1; q >= -params.radius; q--) {
            let held = clamp(q, low, high);
            at = walked(at, held);
            let there = value(at, held, line);
            sum_a += w_a * there;
            sum_b += w_b * there;
            w_a = vec4(w_a.yzw, w_b.x);
            w_b = vec4(w_b.yzw, weight_at(8 - q));
        }
    }
    sum_a = sum_a >> vec4(12u);
    sum_b = sum_b >> vec4(12u);
    var start = line_start(local, params.axis);
    var stride = line_stride(params.axis);
    if params.axis == 0u {
        let words = turned(Words(bitcast<vec4<u32>>(sum_a), bitcast<vec4<u32>>(sum_b)), local);
        sum_a = bitcast<vec4<i32>>(words.a);
        sum_b = bitcast<vec4<i32>>(words.b);
        start = local;
        stride = 64u;
    }
    if slot >= params.slots { return; }
    for (var i = 0u; i < 4u; i++) {
        g[slot * 512u + start + i * stride] = sum_a[i];
        g[slot * 512u + start + (4u + i) * stride] = sum_b[i];
    }
}
