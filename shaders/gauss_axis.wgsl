// gauss_axis: one separable pass of a Gaussian (any symmetric) filter along an axis.
// in   near   [27 S]  u32  neighbouring slots
// in   corner [3 S]   i32  first voxel of each brick
// in   weight [R+1]   f32  weight of the centre and of offsets 1..R
// in   f      [512 S] f32
// out  g      [512 S] f32  sum_k weight[|k|] f(p + k)
// grid one thread a voxel
// tol  |gpu - cpu| <= 1e-5 (1 + |cpu|): sums of up to 2R+1 terms
// src  separable convolution; weights as scipy.ndimage.gaussian_filter, truncated at 4 sigma
// ours bricks that do not exist count as 0; positions are held in [low, high], so that a volume
//      filled with bricks repeats its edge; voxels outside that range get 0
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> corner: array<i32>;
@group(0) @binding(2) var<storage, read> weight: array<f32>;
@group(0) @binding(3) var<storage, read> f: array<f32>;
@group(0) @binding(4) var<storage, read_write> g: array<f32>;

struct Params { slots: u32, axis: u32, radius: u32, low: i32, high: i32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let voxel = thread(group, groups, local, 64u);
    let slot = voxel >> 9u;
    if slot >= params.slots { return; }
    let axis = params.axis;
    let stride = select(select(64u, 8u, axis == 1u), 1u, axis == 0u);
    let at = voxel & 511u;
    let p = (at / stride) & 7u;
    let line = at - p * stride;
    let place = corner[slot * 3u + axis] + i32(p);
    if place < params.low || place > params.high {
        g[voxel] = 0.0;
        return;
    }
    var sum = weight[0] * f[voxel];
    var up = slot;
    var down = slot;
    var q_up = p;
    var q_down = p;
    for (var k = 1u; k <= params.radius; k++) {
        if place + i32(k) <= params.high {
            q_up++;
            if (q_up & 7u) == 0u && up != NONE { up = above(up, axis); }
        }
        if place - i32(k) >= params.low {
            q_down--;
            if (q_down & 7u) == 7u && down != NONE { down = below(down, axis); }
        }
        var pair = 0.0;
        if up != NONE { pair += f[up * 512u + line + (q_up & 7u) * stride]; }
        if down != NONE { pair += f[down * 512u + line + (q_down & 7u) * stride]; }
        sum += weight[k] * pair;
    }
    g[voxel] = sum;
}
