// edt_rows: first pass of the exact squared Euclidean distance transform, along x.
// in   near   [27 S] u32  neighbouring slots
// in   inside [16 S] u32  one bit a voxel, bit x + 8 y + 64 z of a brick
// out  square [512 S] f32 step2 * k^2, k voxels to the nearest external voxel of the x-line; 0 outside
// grid one thread a row of eight voxels (64 a brick)
// tol  exact while k < 4096 and step2 = 1; else 2 ulp
// src  Meijster 2000, doi:10.1007/0-306-47025-X_36 (first phase)
// ours works on the runs inside the lumen alone: what lies past an external voxel cannot win
@group(0) @binding(0) var<storage, read> near: array<u32>;
@group(0) @binding(1) var<storage, read> inside: array<u32>;
@group(0) @binding(2) var<storage, read_write> square: array<f32>;

struct Params { slots: u32, step2: f32 }
var<immediate> params: Params;

#include "lib/thread.wgsl"
#include "lib/bricks.wgsl"

fn row_bits(slot: u32, row: u32) -> u32 {
    return (inside[slot * 16u + (row >> 2u)] >> (8u * (row & 3u))) & 255u;
}

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) row: u32,
) {
    let slot = thread(group, groups, 0u, 1u);
    if slot >= params.slots { return; }
    let bits = row_bits(slot, row);
    // Inside voxels that continue the row without a gap, below and above it.
    var low = 0u;
    var high = 0u;
    if (bits & 1u) != 0u {
        var s = below(slot, 0u);
        while s != NONE {
            let b = row_bits(s, row);
            if b != 255u { low += countLeadingZeros(~(b << 24u)); break; }
            low += 8u;
            s = below(s, 0u);
        }
    }
    if (bits & 128u) != 0u {
        var s = above(slot, 0u);
        while s != NONE {
            let b = row_bits(s, row);
            if b != 255u { high += countTrailingZeros(~b); break; }
            high += 8u;
            s = above(s, 0u);
        }
    }
    let base = slot * 512u + row * 8u;
    for (var x = 0u; x < 8u; x++) {
        var k = 0u;
        if ((bits >> x) & 1u) != 0u {
            // Ones directly below x (to bit 0 they go on into `low`), and directly above.
            let ones_below = countLeadingZeros(~(bits << (31u - x)));
            let ones_above = countTrailingZeros(~(bits >> x));
            let left = select(ones_below, x + 1u + low, ones_below == x + 1u);
            let right = select(ones_above, 8u - x + high, ones_above == 8u - x);
            k = min(left, right);
        }
        square[base + x] = params.step2 * f32(k) * f32(k);
    }
}
