//! CPU twin and cases of `visibility`: the first viewer of each boundary voxel.

use glam::{IVec3, UVec3};
use rayon::prelude::*;

pub use super::host::visibility::{Bindings, Params};
use super::host::visibility::{SHADER, open};
use super::{cases_on_bricks, neighbour};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/visibility.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "boundary voxels", tolerance: Tolerance::EXACT, cases };

/// Index that marks a voxel no candidate sees.
pub const UNSEEN: u32 = u32::MAX;

/// Whether every voxel strictly between the centres of a voxel and the one `d` away is open.
///
/// * `open`: one bit a voxel, 16 words a slot; voxels without a brick are closed.
pub fn sees(near: &[u32], open: &[u32], from: usize, d: IVec3) -> bool {
    let n = d.abs().as_uvec3();
    let way = d.signum();
    let mut slot = from / BRICK;
    let l = (from % BRICK) as i32;
    let mut p = [l & 7, l >> 3 & 7, l >> 6];
    let mut done = UVec3::ZERO;
    for _ in 1..n.element_sum() {
        // The next crossing of an axis is at (2 i + 1) / (2 n); ties go x before y before z.
        let next = 2 * done + 1;
        let sooner = |a: usize, b: usize| n[b] == 0 || next[a] * n[b] <= next[b] * n[a];
        let axis = if done.x < n.x && sooner(0, 1) && sooner(0, 2) {
            0
        } else if done.y < n.y && sooner(1, 2) {
            1
        } else {
            2
        };
        done[axis] += 1;
        p[axis] += way[axis];
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
            d2.element_sum() <= s.reach[rank as usize] && sees(s.near, s.open, v as usize, d)
        });
        *first = found.copied().unwrap_or(UNSEEN);
    });
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, near, inside| {
        let slots = lumen.bricks.len();
        let corners: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let seen: Vec<u32> = lumen.elements(&lumen.boundary).map(|e| e as u32).collect();
        // Every seventh inside voxel looks, with a reach that grows; every brick lists them all.
        let viewer: Vec<u32> =
            lumen.elements(&lumen.inside).step_by(7).take(200).map(|e| e as u32).collect();
        let reach: Vec<u32> = (0..viewer.len() as u32).map(|i| 30 + i * i % 900).collect();
        let start: Vec<u32> = (0..=slots as u32).map(|s| s * viewer.len() as u32).collect();
        let lists: Vec<u32> = (0..slots).flat_map(|_| 0..viewer.len() as u32).collect();
        let first = plan.zeroed::<u32>("first", seen.len());
        let bindings = Bindings {
            near,
            corner: plan.upload_owned("corner", &corners),
            open: inside,
            seen: plan.upload_owned("seen", &seen),
            viewer: plan.upload_owned("viewer", &viewer),
            reach: plan.upload_owned("reach", &reach),
            start: plan.upload_owned("start", &start),
            near_viewers: plan.upload_owned("near_viewers", &lists),
            first,
        };
        let params = Params { weight: [1, 1, 2], boundary: seen.len() as u32 };
        plan.launch(&KERNEL, bindings, params, seen.len(), seen.len());
        plan.download(first);
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Plain ray walk in rational arithmetic over a closure: the reference of `sees`.
    fn walk(d: IVec3, open: impl Fn(IVec3) -> bool) -> bool {
        let n = d.abs();
        let mut crossings: Vec<(i64, i64, usize)> = (0..3)
            .flat_map(|a| (0..n[a]).map(move |i| (i64::from(2 * i + 1), i64::from(n[a]), a)))
            .collect();
        crossings.sort_by(|x, y| (x.0 * y.1).cmp(&(y.0 * x.1)).then(x.2.cmp(&y.2)));
        let mut p = IVec3::ZERO;
        for (k, (_, _, axis)) in crossings.iter().enumerate() {
            p[*axis] += d[*axis].signum();
            if k + 1 < crossings.len() && !open(p) {
                return false;
            }
        }
        true
    }

    #[test]
    fn the_ray_walk_equals_sorting_all_crossings() {
        for (name, lumen) in super::super::test_lumens() {
            let near: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
            let open: &[u32] = bytemuck::cast_slice(&lumen.inside);
            let all: Vec<usize> = lumen.elements(&lumen.inside).collect();
            for (i, &a) in all.iter().enumerate().step_by(1 + all.len() / 60) {
                for &b in all.iter().skip(i % 5).step_by(1 + all.len() / 60) {
                    let v = lumen.bricks.voxel(a);
                    let d = lumen.bricks.voxel(b) - v;
                    let want = walk(d, |q| lumen.holds(v + q));
                    assert_eq!(sees(&near, open, a, d), want, "{name} from {v} by {d}");
                }
            }
        }
    }
}
