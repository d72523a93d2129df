//! CPU twin of `visibility`: the first viewer of each boundary voxel.

use glam::{IVec3, UVec3};
use rayon::prelude::*;

pub use super::host::visibility::{Bindings, Params};
use super::host::visibility::{SHADER, open};
use super::neighbour;
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/visibility.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "boundary voxels", tolerance: Tolerance::EXACT };

/// Index that marks a voxel no candidate sees.
pub const UNSEEN: u32 = u32::MAX;

/// Whether every voxel strictly between the centres of a voxel and of the one `d` before it is open.
/// The ray is walked back from `to`: a viewer's own end of it lies within a ball that is open.
///
/// * `open`: one bit a voxel, 16 words a slot; voxels without a brick are closed.
pub fn sees(near: &[u32], open: &[u32], to: usize, d: IVec3) -> bool {
    let n = d.abs();
    let way = d.signum();
    let mut slot = to / BRICK;
    let l = (to % BRICK) as i32;
    let mut p = [l & 7, l >> 3 & 7, l >> 6];
    // The last crossing of an axis that is left is at `last` / (2 n).
    let mut last = 2 * n - 1;
    for _ in 1..n.element_sum() {
        // Forward, ties go x before y before z.
        let later = |a: usize, b: usize| last[a] * n[b] >= last[b] * n[a];
        let axis = if last.z > 0 && later(2, 0) && later(2, 1) {
            2
        } else if last.y > 0 && later(1, 0) {
            1
        } else {
            0
        };
        last[axis] -= 2;
        p[axis] -= way[axis];
        if p[axis] & !7 != 0 {
            match neighbour(near, slot, axis, p[axis] > 7) {
                Some(s) => slot = s,
                None => return false,
            }
            p[axis] &= 7;
        }
        let e = (p[0] + 8 * p[1] + 64 * p[2]) as usize;
        if open[slot * 16 + e / 32] >> (e % 32) & 1 == 0 {
            return false;
        }
    }
    true
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let voxel = |e: u32| {
        let l = (e as usize % BRICK) as i32;
        IVec3::from_slice(&s.corner[3 * (e as usize / BRICK)..])
            + IVec3::new(l & 7, l >> 3 & 7, l >> 6)
    };
    let weight = UVec3::from(p.weight);
    s.first.par_iter_mut().zip(s.seen).with_min_len(256).for_each(|(first, &e)| {
        crate::task::checkpoint();
        let here = voxel(e);
        let slot = e as usize / BRICK;
        let ranks = &s.near_viewers[s.start[slot] as usize..s.start[slot + 1] as usize];
        let found = ranks.iter().find(|&&rank| {
            let v = s.viewer[rank as usize];
            let d = here - voxel(v);
            let d2 = (d * d).as_uvec3() * weight;
            d2.element_sum() <= s.reach[rank as usize] && sees(s.near, s.open, e as usize, d)
        });
        *first = found.copied().unwrap_or(UNSEEN);
    });
}
