//! CPU twin of `gauss_axis`: a separable symmetric filter.

use pulp::{Arch, Simd, WithSimd};
use rayon::prelude::*;

pub use super::host::gauss_axis::{Bindings, Params};
use super::host::gauss_axis::{SHADER, open};
use super::neighbour;
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/gauss_axis.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 1e-5, rel: 1e-5 } };

/// Returns the weights of a Gaussian for the centre and offsets 1 to ⌈4σ⌉, σ in voxels; they sum to
/// one over both sides. As `scipy.ndimage.gaussian_filter`.
pub fn gaussian_weights(sigma_vox: f64) -> Vec<f32> {
    let radius = (4.0 * sigma_vox + 0.5).floor() as i32;
    let w: Vec<f64> =
        (0..=radius).map(|k| (-0.5 * (f64::from(k) / sigma_vox).powi(2)).exp()).collect();
    let sum = w[0] + 2.0 * w[1..].iter().sum::<f64>();
    w.iter().map(|w| (w / sum) as f32).collect()
}

/// Slot and place in its brick of a position along the axis; `None` where there is no brick.
type SlotAddress = Option<(usize, usize)>;

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let axis = p.axis as usize;
    let radius = p.radius as usize;
    let span = 8 + 2 * radius;
    let weight = &s.weight[..=radius];
    // The slots that a span crosses, then each position held in [low, high]: the edge repeats.
    let places = |slot: usize, places: &mut Vec<SlotAddress>| {
        let reach = radius.div_ceil(8);
        let mut slots = vec![None; 2 * reach + 1];
        slots[reach] = Some(slot);
        for k in 1..=reach {
            let next_slot = |at: Option<usize>, up| at.and_then(|a| neighbour(s.near, a, axis, up));
            slots[reach + k] = next_slot(slots[reach + k - 1], true);
            slots[reach - k] = next_slot(slots[reach + 1 - k], false);
        }
        let corner = i64::from(s.corner[slot * 3 + axis]);
        places.clear();
        places.extend((0..span as i64).map(|i| {
            let at = (corner + i - radius as i64).clamp(i64::from(p.low), i64::from(p.high));
            let q = at - corner + 8 * reach as i64;
            let slot = *slots.get(usize::try_from(q).ok()? >> 3)?;
            Some((slot?, (q & 7) as usize))
        }));
    };
    // Voxels outside the volume are worth 0, whatever their neighbours see in their place.
    let outside = |slot: usize, at: usize| {
        let place = s.corner[slot * 3 + axis] + at as i32;
        place < p.low || place > p.high
    };
    let arch = Arch::new();
    let scratch = || (Vec::with_capacity(span), vec![[0.0f32; 8]; 8 * span]);
    s.g.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8).for_each_init(
        scratch,
        |(around, lines), (slot, out)| {
            crate::task::checkpoint();
            places(slot, around);
            if !gather(lines, around, s.f, axis) {
                out.fill(0.0);
                return;
            }
            let outside = [0, 1, 2, 3, 4, 5, 6, 7].map(|at| outside(slot, at));
            arch.dispatch(Sums { out, lines, weight, axis, outside });
        },
    );
}

/// Weighted sums of a brick, in SIMD lanes as wide as the processor has: for that all of the code
/// must be inlined.
struct Sums<'a> {
    out: &'a mut [f32],
    lines: &'a [[f32; 8]],
    weight: &'a [f32],
    axis: usize,
    outside: [bool; 8],
}

impl WithSimd for Sums<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, _: S) {
        let Self { out, lines, weight, axis, outside } = self;
        match axis {
            0 => along_x(out, lines.as_flattened(), weight, outside),
            1 => across_x(out, lines, weight, (1, 8), outside),
            _ => across_x(out, lines, weight, (8, 1), outside),
        }
    }
}

/// Sums along the rows of a brick; `flat` holds each row with the values on both sides of it.
#[inline(always)]
fn along_x(out: &mut [f32], flat: &[f32], weight: &[f32], outside: [bool; 8]) {
    let radius = weight.len() - 1;
    let span = 8 + 2 * radius;
    for (row, out) in out.as_chunks_mut::<8>().0.iter_mut().enumerate() {
        let row = &flat[row * span..][..span];
        let at =
            |from: usize| -> &[f32; 8] { row[from..from + 8].try_into().expect("eight lanes") };
        let mut sum = at(radius).map(|f| weight[0] * f);
        for (k, w) in weight.iter().enumerate().skip(1) {
            let (a, b) = (at(radius + k), at(radius - k));
            for i in 0..8 {
                sum[i] += w * (a[i] + b[i]);
            }
        }
        for (x, (out, sum)) in out.iter_mut().zip(sum).enumerate() {
            *out = if outside[x] { 0.0 } else { sum };
        }
    }
}

/// Sums across the rows of a brick. A position along the axis holds eight lane groups; `step` and
/// `across` place them in the brick.
#[inline(always)]
fn across_x(
    out: &mut [f32],
    lines: &[[f32; 8]],
    weight: &[f32],
    (step, across): (usize, usize),
    outside: [bool; 8],
) {
    let groups = out.as_chunks_mut::<8>().0;
    for at in (0..8).filter(|at| !outside[*at]) {
        let c = weight.len() - 1 + at;
        for pair in 0..4 {
            let of = |i: usize| -> &[[f32; 8]; 2] {
                lines[8 * i + 2 * pair..][..2].try_into().expect("two groups")
            };
            let mut sum = of(c).map(|g| g.map(|f| weight[0] * f));
            for (k, w) in weight.iter().enumerate().skip(1) {
                let (a, b) = (of(c + k), of(c - k));
                for j in 0..2 {
                    for i in 0..8 {
                        sum[j][i] += w * (a[j][i] + b[j][i]);
                    }
                }
            }
            for (j, sum) in sum.into_iter().enumerate() {
                groups[at * step + (2 * pair + j) * across] = sum;
            }
        }
    }
}

/// Copies the values around a brick along an axis; returns whether any of them is not 0.
///
/// Across x (axes y and z) `lines` is [position][group of eight x]; along x it is [row][position].
fn gather(lines: &mut [[f32; 8]], places: &[SlotAddress], f: &[f32], axis: usize) -> bool {
    let mut any = 0u32;
    let span = places.len();
    if axis == 0 {
        let flat = lines.as_flattened_mut();
        // Positions of one brick follow each other, save where the volume's edge repeats.
        let mut i = 0;
        while i < span {
            let Some((slot, q)) = places[i] else {
                for row in 0..64 {
                    flat[row * span + i] = 0.0;
                }
                i += 1;
                continue;
            };
            let follows = |n: &usize| places.get(i + n) == Some(&Some((slot, q + n)));
            let n = (1..8 - q).take_while(follows).count() + 1;
            let brick = f[slot * BRICK..][..BRICK].as_chunks::<8>().0;
            if n == 8 {
                for (row, from) in brick.iter().enumerate() {
                    flat[row * span + i..][..8].copy_from_slice(from);
                    any |= from.iter().fold(0, |any, v| any | v.to_bits());
                }
            } else {
                for (row, from) in brick.iter().enumerate() {
                    for (to, v) in flat[row * span + i..][..n].iter_mut().zip(&from[q..]) {
                        *to = *v;
                        any |= v.to_bits();
                    }
                }
            }
            i += n;
        }
        return any << 1 != 0; // a negative 0 adds nothing either
    }
    let (step, across) = if axis == 1 { (8, 64) } else { (64, 8) };
    for (groups, place) in lines.as_chunks_mut::<8>().0.iter_mut().zip(places) {
        let Some((slot, q)) = *place else {
            *groups = [[0.0; 8]; 8];
            continue;
        };
        for (j, group) in groups.iter_mut().enumerate() {
            group.copy_from_slice(&f[slot * BRICK + q * step + j * across..][..8]);
            any |= group.iter().fold(0, |any, v| any | v.to_bits());
        }
    }
    any << 1 != 0
}

#[cfg(test)]
mod tests {
    #[test]
    fn weights_sum_to_one_and_reach_four_sigma() {
        let w = super::gaussian_weights(1.0);
        assert_eq!(w.len(), 5);
        assert!((w[0] + 2.0 * w[1..].iter().sum::<f32>() - 1.0).abs() < 1e-6);
    }
}
