// gauss_axis: one separable pass of a Gaussian (any symmetric) filter along an axis.
// in   near   [27 S]  u32  neighbouring slots
// in   corner [3 S]   i32  first voxel of each brick
// in   weight [R+1]   f32  weight of the centre and of offsets 1..R
// in   f      [512 S] f32
// out  g      [512 S] f32  sum_k weight[|k|] f(p + k)
// grid one thread a line of eight voxels (64 a brick)
// tol  |gpu - cpu| <= 1e-5 (1 + |cpu|): sums of up to 2R+1 terms
// src  separable convolution; weights as scipy.ndimage.gaussian_filter, truncated at 4 sigma
// ours bricks that do not exist count as 0; positions are held in [low, high], so that a volume
//      filled with bricks repeats its edge; voxels outside that range get 0; each value that is
//      loaded serves all eight voxels of the line
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> f: array<f32>;
@group(0) @binding(4) var<storage, read_write> g: array<f32>;

struct Params { slots: u32, axis: u32, radius: u32, low: i32, high: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/lines.wgsl"
#include "lib/turn.wgsl"

const A = vec4(0, 1, 2, 3);
const B = vec4(4, 5, 6, 7);

// Weight of an offset of at least 0; 0 beyond the radius.
fn weight_at(k: u32) -> f32 {
    if k > params.radius { return 0.0; }
    return weight[k];
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = thread(group, groups, 0u, 1u);
    var sum_a = vec4(0.0);
    var sum_b = vec4(0.0);
    if slot < params.slots {
        let axis = params.axis;
        let stride = line_stride(axis);
        let line = line_start(local, axis);
        let first = corner[slot * 3u + axis];
        // Range of positions, counted from the brick's first voxel.
        let low = params.low - first;
        let high = params.high - first;
        if low <= 7 && high >= 0 {
            // Weights of the value at `q` for the eight voxels: from one value to the next they move
            // on by a voxel.
            var w_a = vec4(weight_at(0u), weight_at(1u), weight_at(2u), weight_at(3u));
            var w_b = vec4(weight_at(4u), weight_at(5u), weight_at(6u), weight_at(7u));
            var at = slot;
            var brick = 0;
            let radius = i32(params.radius);
            for (var q = 0; q <= 7 + radius; q++) {
                let held = clamp(q, low, high);
                if (held >> 3u) > brick && at != NONE { at = above(at, axis); brick++; }
                if at != NONE {
                    let value = f[at * 512u + line + u32(held & 7) * stride];
                    sum_a += w_a * value;
                    sum_b += w_b * value;
                }
                w_b = vec4(w_a.w, w_b.xyz);
                w_a = vec4(weight_at(u32(q) + 1u), w_a.xyz);
            }
            w_a = vec4(weight_at(1u), weight_at(2u), weight_at(3u), weight_at(4u));
            w_b = vec4(weight_at(5u), weight_at(6u), weight_at(7u), weight_at(8u));
            at = slot;
            brick = 0;
            for (var q = -1; q >= -radius; q--) {
                let held = clamp(q, low, high);
                if (held >> 3u) < brick && at != NONE { at = below(at, axis); brick--; }
                if at != NONE {
                    let value = f[at * 512u + line + u32(held & 7) * stride];
                    sum_a += w_a * value;
                    sum_b += w_b * value;
                }
                w_a = vec4(w_a.yzw, w_b.x);
                w_b = vec4(w_b.yzw, weight_at(u32(8 - q)));
            }
            sum_a = select(vec4(0.0), sum_a, A >= vec4(low) & A <= vec4(high));
            sum_b = select(vec4(0.0), sum_b, B >= vec4(low) & B <= vec4(high));
        }
    }
    var start = line_start(local, params.axis);
    var stride = line_stride(params.axis);
    if params.axis == 0u {
        let words = turned(Words(bitcast<vec4<u32>>(sum_a), bitcast<vec4<u32>>(sum_b)), local);
        sum_a = bitcast<vec4<f32>>(words.a);
        sum_b = bitcast<vec4<f32>>(words.b);
        start = local;
        stride = 64u;
    }
    if slot >= params.slots { return; }
    for (var i = 0u; i < 4u; i++) {
        g[slot * 512u + start + i * stride] = sum_a[i];
        g[slot * 512u + start + (4u + i) * stride] = sum_b[i];
    }
}
