// prefix_sum: exclusive prefix sum of a list of counts, and the total behind it.
// in   count [N]   u32
// out  sum   [N+1] u32  sum[i] = count[0] + … + count[i-1]
// grid one workgroup of 256: each thread sums a stretch, the stretches are scanned in shared memory
// tol  exact
// src  Blelloch 1990, CMU-CS-90-190
// ours one workgroup: the lists here are bricks, at most some 100,000, and the sum is never the
//      long pole; the scan of 256 stretch sums is serial
@group(0) @binding(0) var<storage, read> count: array<u32>;
@group(0) @binding(1) var<storage, read_write> sum: array<u32>;

struct Params { len: u32 }
var<immediate> params: Params;

var<workgroup> stretch: array<u32, 256>;

@compute @workgroup_size(256)
fn main(@builtin(local_invocation_index) local: u32) {
    let size = (params.len + 255u) / 256u;
    let begin = min(local * size, params.len);
    let end = min(begin + size, params.len);
    var n = 0u;
    for (var i = begin; i < end; i++) { n += count[i]; }
    stretch[local] = n;
    workgroupBarrier();
    if local == 0u {
        var total = 0u;
        for (var i = 0u; i < 256u; i++) {
            let s = stretch[i];
            stretch[i] = total;
            total += s;
        }
        sum[params.len] = total;
    }
    workgroupBarrier();
    var at = stretch[local];
    for (var i = begin; i < end; i++) {
        sum[i] = at;
        at += count[i];
    }
}
