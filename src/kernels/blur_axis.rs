//! CPU twin of `blur_axis`: a separable symmetric filter in integers.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

pub use super::host::blur_axis::{Bindings, Params};
use super::host::blur_axis::{SHADER, open};
use super::neighbour;
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/blur_axis.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

/// Returns the weights of a Gaussian for the centre and offsets 1, 2, …, whose sum over both sides
/// is 4096; those that round to zero are left out.
pub fn integer_weights(sigma_vox: f64) -> Vec<i32> {
    let raw = super::gauss_axis::gaussian_weights(sigma_vox.max(0.05));
    let mut out: Vec<i32> = raw.iter().map(|w| (f64::from(*w) * 4096.0).round() as i32).collect();
    while out.len() > 1 && out.last() == Some(&0) {
        out.pop();
    }
    out[0] = 4096 - 2 * out[1..].iter().sum::<i32>();
    out
}

/// Lines of a brick along the axis: eight lanes a position, eight groups of lanes.
struct Lines<'a> {
    /// Lanes by group and position along the axis: [group][position][lane].
    groups: &'a [Vec<[i32; 8]>; 8],
    weight: &'a [i32],
    sums: &'a mut [[[i32; 8]; 8]; 8],
}

impl WithSimd for Lines<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let c = self.weight.len() - 1;
        for (lines, sums) in self.groups.iter().zip(self.sums) {
            for (at, sum) in sums.iter_mut().enumerate() {
                let mut s = [2048i32; 8];
                let centre = lines[at + c];
                for i in 0..8 {
                    s[i] += self.weight[0] * centre[i];
                }
                for (k, w) in self.weight.iter().enumerate().skip(1) {
                    let (a, b) = (lines[at + c + k], lines[at + c - k]);
                    for i in 0..8 {
                        s[i] += w * (a[i] + b[i]);
                    }
                }
                *sum = s.map(|s| s >> 12);
            }
        }
    }
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let axis = p.axis as usize;
    let radius = p.radius as usize;
    let span = 8 + 2 * radius;
    let weight = &s.weight[..=radius];
    let (step, across) = [(1, [8, 64]), (8, [1, 64]), (64, [1, 8])][axis];
    let arch = Arch::new();
    let scratch = || {
        let lines: [Vec<[i32; 8]>; 8] = std::array::from_fn(|_| vec![[0i32; 8]; span]);
        (lines, [[[0i32; 8]; 8]; 8])
    };
    let bricks = s.g.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8);
    bricks.for_each_init(scratch, |(lines, sums), (slot, out)| {
        crate::task::checkpoint();
        let first = s.corner[slot * 3 + axis];
        let mut constant = true;
        let mut seen = None;
        for i in 0..span {
            let place = (first + i as i32 - radius as i32).clamp(p.low, p.high) - first;
            let mut at = Some(slot);
            for _ in 0..(place >> 3).unsigned_abs() {
                at = at.and_then(|a| neighbour(s.near, a, axis, place > 0));
            }
            let Some(brick) = at else {
                for group in lines.iter_mut() {
                    group[i] = [p.missing; 8];
                }
                constant &= *seen.get_or_insert(p.missing) == p.missing;
                continue;
            };
            let base = brick * BRICK + (place & 7) as usize * step;
            for (g, group) in lines.iter_mut().enumerate() {
                let row = base + g * across[1];
                group[i] = match axis {
                    0 => std::array::from_fn(|l| s.f[row + l * across[0]]),
                    _ => s.f[row..row + 8].try_into().expect("eight lanes"),
                };
            }
            let v = *seen.get_or_insert(lines[0][i][0]);
            constant &= lines.iter().all(|g| g[i] == [v; 8]);
        }
        if let Some(v) = seen.filter(|_| constant) {
            out.fill(v); // the weights sum to one
            return;
        }
        arch.dispatch(Lines { groups: lines, weight, sums });
        for (g, sums) in sums.iter().enumerate() {
            for (at, sum) in sums.iter().enumerate() {
                let row = at * step + g * across[1];
                match axis {
                    0 => {
                        for (l, v) in sum.iter().enumerate() {
                            out[row + l * across[0]] = *v;
                        }
                    }
                    _ => out[row..row + 8].copy_from_slice(sum),
                }
            }
        }
    });
}

#[cfg(test)]
mod tests {
    #[test]
    fn integer_weights_sum_to_4096_and_end_where_they_vanish() {
        for sigma in [0.1, 0.5, 0.7, 1.5, 3.0] {
            let w = super::integer_weights(sigma);
            assert_eq!(w[0] + 2 * w[1..].iter().sum::<i32>(), 4096, "{sigma}");
            assert!(w.iter().all(|w| *w > 0), "{sigma}: {w:?}");
        }
    }
}
