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

// Steps to the nearest external voxel, nine words a row: no two rows begin in the same bank.
var<workgroup> steps: array<u32, 576>;

@compute @workgroup_size(64)
fn main(
    @builtin(workgroup_id) group: vec3<u32>,
    @builtin(num_workgroups) groups: vec3<u32>,
    @builtin(local_invocation_index) row: u32,
) {
    let slot = thread(group, groups, 0u, 1u);
    var bits = 0u;
    if slot < params.slots { bits = row_bits(slot, row); }
    // Inside voxels that continue the row without a gap, below and above it.
    var low = 0u;
    var high = 0u;
    if (bits & 1u) != 0u {
        var s = below(slot, 0u);
        while s != NONE {
            // Both loads at once: each depends on the brick alone.
            let next = below(s, 0u);
            let b = row_bits(s, row);
            if b != 255u { low += countLeadingZeros(~(b << 24u)); break; }
            low += 8u;
            s = next;
        }
    }
    if (bits & 128u) != 0u {
        var s = above(slot, 0u);
        while s != NONE {
            let next = above(s, 0u);
            let b = row_bits(s, row);
            if b != 255u { high += countTrailingZeros(~b); break; }
            high += 8u;
            s = next;
        }
    }
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
        steps[9u * row + x] = k;
    }
    workgroupBarrier();
    if slot >= params.slots { return; }
    // Neighbouring threads write neighbouring elements.
    for (var i = 0u; i < 8u; i++) {
        let voxel = i * 64u + row;
        let k = f32(steps[9u * (voxel >> 3u) + (voxel & 7u)]);
        square[slot * 512u + voxel] = params.step2 * k * k;
    }
}
