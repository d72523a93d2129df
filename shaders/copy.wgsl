// copy: one buffer into another, sixteen bytes a thread: what the device's memory gives.
// in   source [Q] u32x4
// out  copied [Q] u32x4  the same
// grid one thread a quad
// tol  exact
// src  McCalpin 1995, STREAM: copy
@group(0) @binding(0) var<storage, read> source: array<vec4<u32>>;
@group(0) @binding(1) var<storage, read_write> copied: array<vec4<u32>>;

struct Params { quads: u32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) local: u32,
) {
    let q = thread(group, groups, local, 64u);
    if q >= params.quads { return; }
    copied[q] = source[q];
}
