//! CPU twin of `wall_level`: the offset of each voxel from the wall.

use rayon::prelude::*;

use super::blocks::{bit, element, place};
pub use super::host::wall_level::{Bindings, Params};
use super::host::wall_level::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/wall_level.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

/// Returns the offset that a level holds, 1/1024 of the mean spacing.
pub fn offset(level: i32) -> i32 {
    level << 16 >> 16
}

/// Returns the threshold that a level holds: 0 lumen, 4096 wall.
pub fn threshold(level: i32) -> i32 {
    level >> 16 & 0x3fff
}

/// Whether the offset is limited by the distance to the core: the values show lumen beyond.
pub fn is_capped(level: i32) -> bool {
    level & CAPPED != 0
}

const CAPPED: i32 = 1 << 30;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    // Offsets to voxels within three, nearest first.
    let mut ball: Vec<(i32, [i32; 3])> = Vec::new();
    for z in -3..=3i32 {
        for y in -3..=3i32 {
            for x in -3..=3i32 {
                let d = x * x + y * y + z * z;
                if d < 10 {
                    ball.push((d, [x, y, z]));
                }
            }
        }
    }
    ball.sort_unstable();
    let core_distance = |slot: usize, q: [i32; 3]| {
        let is_core = |d: &[i32; 3]| {
            let at = std::array::from_fn(|a| q[a] + d[a]);
            element(s.near, slot, at).is_some_and(|e| bit(s.core, e))
        };
        ball.iter().find(|(_, d)| is_core(d)).map(|(d, _)| *d)
    };
    s.level.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8).for_each(|(slot, out)| {
        crate::task::checkpoint();
        for (local, out) in out.iter_mut().enumerate() {
            let e = slot * BRICK + local;
            let mean = |peak: &[i32], weight: &[i32]| {
                if weight[e] >= 4 { (peak[e] << 12) / weight[e] } else { 4096 }
            };
            let wide = mean(s.peak, s.weight);
            let top = wide.min(mean(s.peak1, s.weight1)).clamp(0, 4096);
            let i = ((top >> 3) as usize).min(511);
            let between = top - 8 * i as i32;
            let plain = s.law[i] + (((s.law[i + 1] - s.law[i]) * between) >> 3);
            let base = s.lumen[e].clamp(0, 3500);
            let threshold = plain + (((4096 - plain) * base) >> 12);
            let mut offset = ((s.value[e] - threshold) * 2253).div_euclid((top - base).max(414));
            let flags = s.mark[e];
            let mut capped = 0;
            if flags & 8 != 0
                && offset < 0
                && !bit(s.core, e)
                && let Some(d) = core_distance(slot, place(local))
            {
                let cap = s.cap[d as usize];
                if cap > offset {
                    (offset, capped) = (cap, CAPPED);
                }
            }
            if flags & 4 != 0 {
                offset = offset.max(p.forced);
            }
            *out = capped | threshold << 16 | offset.clamp(-3072, 3072) & 0xffff;
        }
    });
}
