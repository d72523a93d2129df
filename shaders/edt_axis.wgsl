// edt_axis: one further separable pass of the exact squared distance transform, along y or z.
// in   near [27 S]  u32  neighbouring slots
// in   f    [512 S] f32  mm^2 (or voxel^2 on isotropic grids), 0 outside
// out  g    [512 S] f32  min over q on the line of f(q) + step2 (p - q)^2; with `finish` its root
//                        times `scale`, mm
// grid one thread a line of eight voxels (64 a brick)
// tol  |gpu - cpu| <= 8e-7 |cpu|: Vulkan's square root may err by 4.5 ulp; isotropic squares are
//      integers and exact
// src  Meijster 2000, doi:10.1007/0-306-47025-X_36; Felzenszwalb & Huttenlocher 2012,
//      doi:10.4086/toc.2012.v008a019
// ours no envelope: the search goes outwards brick by brick, each value that is loaded serves all
//      eight voxels of the line, and it stops once no voxel can find less. It never passes an
//      external voxel by more than a brick, so bricks that do not exist are never reached
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> f: array<f32>;
@group(0) @binding(2) var<storage, read_write> g: array<f32>;

struct Params { slots: u32, axis: u32, step2: f32, finish: u32, scale: f32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"
#include "lib/lines.wgsl"

// Values of the eight voxels of a line.
struct Line { a: vec4<f32>, b: vec4<f32> }

const A = vec4(0.0, 1.0, 2.0, 3.0);
const B = vec4(4.0, 5.0, 6.0, 7.0);

fn squared(k: vec4<f32>) -> vec4<f32> {
    return params.step2 * k * k;
}

// Whether a voxel of the line may find less at the squared distances to the nearest voxel of a brick.
fn may_find(best: Line, a: vec4<f32>, b: vec4<f32>) -> bool {
    return any(squared(a) < best.a) || any(squared(b) < best.b);
}

// The line's values with those of the brick whose line starts at element `start` and, along the axis,
// at `first`.
fn lessened(best: Line, start: u32, first: f32) -> Line {
    var a = best.a;
    var b = best.b;
    let stride = line_stride(params.axis);
    for (var i = 0u; i < 8u; i++) {
        let there = vec4(f[start + i * stride]);
        let q = vec4(first + f32(i));
        // Not `min`, which leaves open what it makes of not-a-number: that stays where it was.
        let for_a = there + squared(A - q);
        let for_b = there + squared(B - q);
        a = select(a, for_a, for_a < a);
        b = select(b, for_b, for_b < b);
    }
    return Line(a, b);
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let slot = thread(group, groups, 0u, 1u);
    if slot >= params.slots { return; }
    let axis = params.axis;
    let stride = line_stride(axis);
    let line = line_start(local, axis);
    let at = slot * 512u + line;
    var best = Line(
        vec4(f[at], f[at + stride], f[at + 2u * stride], f[at + 3u * stride]),
        vec4(f[at + 4u * stride], f[at + 5u * stride], f[at + 6u * stride], f[at + 7u * stride]),
    );
    if may_find(best, vec4(1.0), vec4(1.0)) { best = lessened(best, at, 0.0); }
    var up = slot;
    var down = slot;
    // Looked up a brick ahead, beside the values of the one before.
    var next_up = above(slot, axis);
    var next_down = below(slot, axis);
    var first = 8.0;
    loop {
        if up != NONE {
            if may_find(best, vec4(first) - A, vec4(first) - B) { up = next_up; } else { up = NONE; }
        }
        if up != NONE {
            next_up = above(up, axis);
            best = lessened(best, up * 512u + line, first);
        }
        if down != NONE {
            let k = vec4(first - 7.0);
            if may_find(best, k + A, k + B) { down = next_down; } else { down = NONE; }
        }
        if down != NONE {
            next_down = below(down, axis);
            best = lessened(best, down * 512u + line, -first);
        }
        if up == NONE && down == NONE { break; }
        first += 8.0;
    }
    if params.finish != 0u { best = Line(params.scale * sqrt(best.a), params.scale * sqrt(best.b)); }
    for (var i = 0u; i < 4u; i++) {
        g[at + i * stride] = best.a[i];
        g[at + (4u + i) * stride] = best.b[i];
    }
}
