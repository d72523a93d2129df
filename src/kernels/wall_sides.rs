//! CPU twin of `wall_sides`: offsets whose sign agrees with the mask.

use rayon::prelude::*;

use super::blocks::{bit, element, place};
pub use super::host::wall_sides::{Bindings, Params};
use super::host::wall_sides::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/wall_sides.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    let level = s.level;
    s.offset
        .par_chunks_exact_mut(BRICK)
        .zip(s.edge.par_chunks_exact_mut(BRICK))
        .zip(s.filled.par_chunks_exact_mut(BRICK))
        .zip(s.closed.par_chunks_exact_mut(BRICK))
        .enumerate()
        .with_min_len(8)
        .for_each(|(slot, (((offset, edge), filled), closed))| {
            crate::task::checkpoint();
            for local in 0..BRICK {
                let e = slot * BRICK + local;
                let raw = level[e] << 16 >> 16;
                let inside = bit(s.inside, e);
                let mut at_limit = false;
                let o = if inside {
                    raw.min(-20)
                } else if raw > 0 {
                    raw.max(20)
                } else {
                    let q = place(local);
                    at_limit = (0..6).any(|n| {
                        let mut at = q;
                        at[n / 2] += if n % 2 == 0 { -1 } else { 1 };
                        element(s.near, slot, at).is_some_and(|e| bit(s.inside, e))
                    });
                    512
                };
                offset[local] = o;
                edge[local] = o.clamp(-512, 512) * 64;
                filled[local] = if inside { 32768 } else { 0 };
                closed[local] = if at_limit { 32768 } else { 0 };
            }
        });
}
