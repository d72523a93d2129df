//! CPU twin of `edt_axis`: squared distance, y and z passes.
//!
//! The twin narrows its searches by the monotone order of minimisers (Aggarwal et al. 1987,
//! doi:10.1007/BF01840359), which the shader, with one thread a voxel, cannot use.

use rayon::prelude::*;

pub use super::host::edt_axis::{Bindings, Params};
use super::host::edt_axis::{SHADER, open};
use super::neighbour;
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/edt_axis.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 8e-7 } };

/// Search distance, rows, above which it pays to record the positions of minima.
const NEAR: i32 = 16;

/// Values of eight x-neighbours, processed together.
type RowLanes = [f32; 8];

/// Minima of a row and the position of each, counted along the axis from the brick's start.
type Least = (RowLanes, [i32; 8]);

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let axis = p.axis as usize;
    // `across` from line to line of a brick, `along` from row to row of a line.
    let (along, across) = if axis == 1 { (8, 64) } else { (64, 8) };
    let far = |k: i32| p.step2 * (k as f32) * (k as f32);
    let chain = || BrickChain { near: s.near, axis, up: Vec::new(), down: Vec::new() };
    let slots = s.g.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8);
    slots.for_each_init(chain, |chain, (slot, out)| {
        crate::task::checkpoint();
        chain.start(slot);
        for line in (0..8).map(|i| i * across) {
            let mut rows = Rows { f: s.f, chain, line, along, step2: p.step2 };
            let wide = (0..8).any(|at| rows.row(slot, at).iter().any(|f| *f > far(NEAR)));
            let found = if wide { rows.wide() } else { [[0.0; 8]; 8] };
            for at in 0..8 {
                let best = if wide { found[at] } else { rows.near(at) };
                let best = if p.finish != 0 { best.map(|b| p.scale * b.sqrt()) } else { best };
                out[line + at * along..][..8].copy_from_slice(&best);
            }
        }
    });
}

/// The neighbours of a brick along the axis, as far as searches have reached; each list ends where
/// no brick follows.
struct BrickChain<'a> {
    near: &'a [u32],
    axis: usize,
    up: Vec<usize>,
    down: Vec<usize>,
}

impl BrickChain<'_> {
    fn start(&mut self, slot: usize) {
        for list in [&mut self.up, &mut self.down] {
            list.clear();
            list.push(slot);
        }
    }

    /// Returns the slot of the brick `brick` bricks away along the axis; those on the way are
    /// looked up once.
    fn slot(&mut self, brick: i32) -> Option<usize> {
        let (list, up) = if brick < 0 { (&mut self.down, false) } else { (&mut self.up, true) };
        let away = brick.unsigned_abs() as usize;
        while list.len() <= away {
            list.push(neighbour(self.near, *list.last()?, self.axis, up)?);
        }
        Some(list[away])
    }
}

/// The rows of one line through a chain of bricks.
struct Rows<'a, 'b> {
    f: &'a [f32],
    chain: &'b mut BrickChain<'a>,
    line: usize,
    along: usize,
    step2: f32,
}

impl Rows<'_, '_> {
    fn row(&self, slot: usize, q: i32) -> &RowLanes {
        let at = slot * BRICK + self.line + (q & 7) as usize * self.along;
        self.f[at..][..8].try_into().expect("eight lanes")
    }

    /// Returns the squared distance to a row `k` rows away: all searches compute it alike, so that
    /// they round alike.
    fn far(&self, k: i32) -> f32 {
        self.step2 * (k as f32) * (k as f32)
    }

    /// Returns the minima of a row of the brick: the search goes outwards until no lane can find a
    /// lower value.
    #[inline(always)]
    fn near(&self, at: usize) -> RowLanes {
        let slot = self.chain.up[0];
        let step = |s_: usize, up| neighbour(self.chain.near, s_, self.chain.axis, up);
        let mut best = *self.row(slot, at as i32);
        // Not `min`: not-a-number stays where it was.
        let lower = |b: &mut f32, there: f32| *b = if there < *b { there } else { *b };
        let (mut up, mut down) = (Some(slot), Some(slot));
        for k in 1i32.. {
            let far = self.far(k);
            let worst = best.iter().fold(0.0f32, |a, &b| a.max(b));
            if far >= worst {
                break;
            }
            let (high, low) = (at as i32 + k, at as i32 - k);
            if high & 7 == 0 {
                up = up.and_then(|s| step(s, true));
            }
            if low & 7 == 7 {
                down = down.and_then(|s| step(s, false));
            }
            if up.is_none() && down.is_none() {
                break;
            }
            if let Some(u) = up {
                best.iter_mut().zip(self.row(u, high)).for_each(|(b, f)| lower(b, f + far));
            }
            if let Some(d) = down {
                best.iter_mut().zip(self.row(d, low)).for_each(|(b, f)| lower(b, f + far));
            }
        }
        best
    }

    /// Returns the minima of the eight rows of the brick, in a wide lumen.
    ///
    /// The position of the minimum never decreases from row to row. So the first and last row are
    /// searched outwards, and each row between them is searched only between the positions found
    /// for its neighbours: the lumen is crossed twice a brick instead of eight times. Recording
    /// positions costs a quarter, so in narrow lumens [`Rows::near`] is faster.
    fn wide(&mut self) -> [RowLanes; 8] {
        let mut found: [Least; 8] = [([0.0; 8], [0; 8]); 8];
        for at in [0, 7] {
            found[at] = self.outwards(at as i32);
        }
        for (at, below, above) in [(3, 0, 7), (1, 0, 3), (5, 3, 7), (2, 1, 3), (4, 3, 5), (6, 5, 7)]
        {
            let lo = found[below].1.into_iter().fold(i32::MAX, i32::min);
            let hi = found[above].1.into_iter().fold(i32::MIN, i32::max);
            found[at] = self.between(at as i32, (lo, hi));
        }
        found.map(|(best, _)| best)
    }

    /// Returns the minima of a row as [`Rows::near`] does, and their positions.
    fn outwards(&mut self, at: i32) -> Least {
        let mut best = *self.row(self.chain.up[0], at);
        let mut from = [at; 8];
        let (mut up, mut down) = (Some(self.chain.up[0]), Some(self.chain.up[0]));
        for k in 1.. {
            let far = self.far(k);
            let worst = best.iter().fold(0.0f32, |a, &b| a.max(b));
            if far >= worst {
                break;
            }
            let (high, low) = (at + k, at - k);
            if high & 7 == 0 {
                up = up.and_then(|_| self.chain.slot(high >> 3));
            }
            if low & 7 == 7 {
                down = down.and_then(|_| self.chain.slot(low >> 3));
            }
            if up.is_none() && down.is_none() {
                break;
            }
            for (slot, q) in [(up, high), (down, low)] {
                if let Some(slot) = slot {
                    take((&mut best, &mut from), self.row(slot, q), far, q);
                }
            }
        }
        (best, from)
    }

    /// Searches the rows from `lo` to `hi`, which earlier searches have reached.
    fn between(&mut self, at: i32, (lo, hi): (i32, i32)) -> Least {
        let (mut best, mut from) = ([f32::INFINITY; 8], [at; 8]);
        let mut q = lo;
        while q <= hi {
            let slot = self.chain.slot(q >> 3).expect("reached before");
            for q in q..=hi.min(q | 7) {
                let row = self.row(slot, q);
                take((&mut best, &mut from), row, self.far(at - q), q);
            }
            q = (q | 7) + 1;
        }
        (best, from)
    }
}

/// Updates minima and their positions with row `q`, at squared distance `far`.
#[inline]
fn take((best, from): (&mut RowLanes, &mut [i32; 8]), row: &RowLanes, far: f32, q: i32) {
    for ((best, from), f) in best.iter_mut().zip(from).zip(row) {
        let by = f + far;
        *from = if by < *best { q } else { *from };
        *best = best.min(by);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::compute::{Plan, run_cpu};
    use crate::lumen::bricks::bit_field;
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;
    use glam::IVec3;

    /// A box 45 x 43 x 41 inside, with an external voxel here and there.
    fn wide() -> Lumen {
        let grid = Grid::axis_aligned([45, 43, 41], [1.0, 0.7, 1.9]);
        let mut mask = BitVolume::new(grid.dims);
        for v in (0..grid.len()).filter(|i| i % 1999 != 7).map(|i| grid.voxel(i)) {
            mask.set(v.x, v.y, v.z);
        }
        Lumen::of_volume(grid, &mask)
    }

    #[test]
    fn a_wide_lumen_has_the_distances_of_a_search_through_all_rows() {
        let lumen = wide();
        let near: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
        let bits = bit_field(&lumen.inside);
        let scattered = |i: usize| (i.wrapping_mul(2_654_435_761) >> 7) % 400;
        let f: Vec<f32> = bits.iter().enumerate().map(|(i, b)| b * scattered(i) as f32).collect();
        for (axis, step, step2) in [(1u32, IVec3::Y, 1.0f32), (2, IVec3::Z, 1.25)] {
            let mut plan = Plan::new();
            let near = plan.upload("near", &near);
            let from = plan.upload("f", &f);
            let g = plan.undefined::<f32>("g", f.len());
            let slots = lumen.bricks.len();
            let params = Params { slots: slots as u32, axis, step2, finish: 0, scale: 1.0 };
            plan.launch(&KERNEL, Bindings { near, f: from, g }, params, f.len(), f.len());
            plan.download(g);
            let out = run_cpu(&plan);
            for (e, got) in out.get(g).iter().enumerate() {
                let walk = |d: IVec3| {
                    let next = |e: &usize| lumen.bricks.step(*e, d);
                    let steps = std::iter::successors(Some(e), next);
                    let far = |k: usize| step2 * (k as f32) * (k as f32);
                    steps.enumerate().map(|(k, e)| f[e] + far(k)).fold(f32::INFINITY, f32::min)
                };
                let want = walk(step).min(walk(-step));
                assert_eq!(*got, want, "axis {axis}, element {e}");
            }
        }
    }
}
