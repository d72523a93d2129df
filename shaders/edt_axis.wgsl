// edt_axis: one further separable pass of the exact squared distance transform, along y or z.
// in   near [27 S]  u32  neighbouring slots
// in   f    [512 S] f32  mm^2 (or voxel^2 on isotropic grids), 0 outside
// out  g    [512 S] f32  min over q on the line of f(q) + step2 (p - q)^2; with `finish` its root
//                        times `scale`, mm
// grid one thread a voxel
// tol  |gpu - cpu| <= 8e-7 |cpu|: Vulkan's square root may err by 4.5 ulp; isotropic squares are
//      integers and exact
// src  Meijster 2000, doi:10.1007/0-306-47025-X_36; Felzenszwalb & Huttenlocher 2012,
//      doi:10.4086/toc.2012.v008a019
// ours no envelope: the search goes outwards and stops once step2 k^2 >= best. It never passes an
//      external voxel, so it stays inside the run, and bricks that do not exist are never reached
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> f: array<f32>;
@group(0) @binding(2) var<storage, read_write> g: array<f32>;

struct Params { slots: u32, axis: u32, step2: f32, finish: u32, scale: f32 }
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
    let stride = select(64u, 8u, params.axis == 1u);
    let at = voxel & 511u;
    let p = (at / stride) & 7u;
    let line = at - p * stride;
    var best = f[voxel];
    var up = slot;
    var down = slot;
    var k = 1u;
    loop {
        let far = params.step2 * f32(k) * f32(k);
        if far >= best { break; }
        let q = p + k;
        if (q & 7u) == 0u && up != NONE { up = above(up, params.axis); }
        if ((p - k) & 7u) == 7u && down != NONE { down = below(down, params.axis); }
        if up == NONE && down == NONE { break; }
        // Not `min`, which leaves open what it makes of not-a-number: that stays where it was.
        if up != NONE {
            let there = f[up * 512u + line + (q & 7u) * stride] + far;
            if there < best { best = there; }
        }
        if down != NONE {
            let there = f[down * 512u + line + ((p - k) & 7u) * stride] + far;
            if there < best { best = there; }
        }
        k++;
    }
    if params.finish != 0u { best = params.scale * sqrt(best); }
    g[voxel] = best;
}
