//! CPU twin of `ridge_grow`: growth from the core up to the ridge of the wall.

use rayon::prelude::*;

use super::blocks::{BrickBlock, element, place};
pub use super::host::ridge_grow::{Bindings, Params};
use super::host::ridge_grow::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::{BRICK, NONE};

/// See `shaders/ridge_grow.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

/// Offset that is added to the values of paths, so that 0 means no path.
const BIAS: i32 = 32768;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let size = [p.width, p.height, p.depth];
    let has_core = |slot: usize| s.core[slot * 16..][..16].iter().any(|w| *w != 0);
    // A path of three voxels starts in a brick around.
    let is_near = |slot: usize| {
        has_core(slot)
            || s.near[slot * 27..][..27].iter().any(|n| *n != NONE && has_core(*n as usize))
    };
    let bricks = s.after.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8);
    bricks.for_each_init(
        || BrickBlock::new(1),
        |block, (slot, out)| {
            crate::task::checkpoint();
            if !is_near(slot) {
                out.fill(0);
                return;
            }
            let corner = &s.corner[slot * 3..][..3];
            block.fill(s.near, slot, s.before, 0);
            overlay_core(block, s.near, slot, s.core, s.value);
            let strides = block.strides();
            let paths = block.values();
            for (local, out) in out.iter_mut().enumerate() {
                let q = place(local);
                let at = block.index(q);
                *out = paths[at];
                let outside = (0..3).any(|a| !(0..size[a]).contains(&(corner[a] + q[a])));
                if *out != 0 || outside {
                    continue;
                }
                let near = strides.iter().flat_map(|d| [paths[at - d], paths[at + d]]);
                let Some(best) = near.filter(|c| *c != 0).min() else { continue };
                let j = s.value[slot * BRICK + local] + BIAS;
                if j >= best - p.fall && j <= p.most + BIAS {
                    *out = best.max(j);
                }
            }
        },
    );
}

/// Writes core voxels into the block as paths of their own.
fn overlay_core(block: &mut BrickBlock, near: &[u32], slot: usize, core: &[u32], value: &[i32]) {
    for z in -1..9 {
        for y in -1..9 {
            for (first, range) in [(-8, -1..0), (0, 0..8), (8, 8..9)] {
                let Some(row) = element(near, slot, [first, y, z]) else { continue };
                let byte = core[row >> 5] >> (row & 31) & 255;
                for x in range.filter(|_| byte != 0) {
                    if byte >> (x & 7) & 1 != 0 {
                        let at = block.index([x, y, z]);
                        block.values_mut()[at] = value[row + (x & 7) as usize] + BIAS;
                    }
                }
            }
        }
    }
}
