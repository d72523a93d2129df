//! CPU twin and cases of `gauss_axis`: a separable symmetric filter.

use rayon::prelude::*;

pub use super::host::gauss_axis::{Bindings, Params};
use super::host::gauss_axis::{SHADER, open};
use super::{cases_on_bricks, neighbour};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::{BRICK, bit_field};

/// See `shaders/gauss_axis.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "voxels",
    tolerance: Tolerance { abs: 1e-5, rel: 1e-5 },
    cases,
};

/// Weights of a Gaussian for the centre and offsets 1 to ⌈4σ⌉, σ in voxels; they sum to one over
/// both sides. As `scipy.ndimage.gaussian_filter`.
pub fn gaussian_weights(sigma_vox: f64) -> Vec<f32> {
    let radius = (4.0 * sigma_vox + 0.5).floor() as i32;
    let w: Vec<f64> =
        (0..=radius).map(|k| (-0.5 * (f64::from(k) / sigma_vox).powi(2)).exp()).collect();
    let sum = w[0] + 2.0 * w[1..].iter().sum::<f64>();
    w.iter().map(|w| (w / sum) as f32).collect()
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let axis = p.axis as usize;
    let radius = p.radius as usize;
    let span = 8 + 2 * radius;
    // Where each position of the span lies: slot and place in it, None where no brick is.
    let places = |slot: usize| -> Vec<Option<(usize, usize)>> {
        let corner = s.corner[slot * 3 + axis];
        let mut slots = vec![None; span];
        let side = |up: bool, slots: &mut Vec<Option<(usize, usize)>>| {
            let mut at = Some(slot);
            for k in 1..=radius {
                let q = if up { 7 + k as i32 } else { -(k as i32) };
                if (up && q & 7 == 0) || (!up && q & 7 == 7) {
                    at = at.and_then(|a| neighbour(s.near, a, axis, up));
                }
                let i = (q + radius as i32) as usize;
                slots[i] = at.map(|a| (a, (q & 7) as usize));
            }
        };
        for i in 0..8 {
            slots[radius + i] = Some((slot, i));
        }
        side(true, &mut slots);
        side(false, &mut slots);
        // Hold positions in [low, high]: the edge repeats.
        let hold = |i: usize| {
            let place = i64::from(corner) + i as i64 - radius as i64;
            let held = place.clamp(i64::from(p.low), i64::from(p.high));
            let j = held - i64::from(corner) + radius as i64;
            usize::try_from(j).ok().filter(|j| *j < span)
        };
        (0..span).map(|i| hold(i).and_then(|j| slots[j])).collect()
    };
    // Voxels outside the volume are worth 0, whatever their neighbours see in their place.
    let outside = |slot: usize, at: usize| {
        let place = s.corner[slot * 3 + axis] + at as i32;
        place < p.low || place > p.high
    };
    s.g.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8).for_each(|(slot, out)| {
        let places = places(slot);
        if axis == 0 {
            let mut row = vec![0.0f32; span];
            for r in 0..64 {
                for (v, place) in row.iter_mut().zip(&places) {
                    *v = place.map_or(0.0, |(a, q)| s.f[a * BRICK + r * 8 + q]);
                }
                let centre = radius;
                for x in 0..8 {
                    let c = centre + x;
                    if outside(slot, x) {
                        continue; // zeroed already
                    }
                    let mut sum = s.weight[0] * row[c];
                    for k in 1..=radius {
                        sum += s.weight[k] * (row[c + k] + row[c - k]);
                    }
                    out[r * 8 + x] = sum;
                }
            }
        } else {
            let (along, across) = if axis == 1 { (8, 64) } else { (64, 8) };
            const ZERO: [f32; 8] = [0.0; 8];
            let lanes = |i: usize, line: usize| -> &[f32; 8] {
                places[i].map_or(&ZERO, |(a, q)| {
                    s.f[a * BRICK + line + q * along..][..8].try_into().expect("eight lanes")
                })
            };
            for line in (0..8).map(|i| i * across) {
                for at in 0..8 {
                    let c = radius + at;
                    if outside(slot, at) {
                        continue; // zeroed already
                    }
                    let mut sum = lanes(c, line).map(|f| s.weight[0] * f);
                    for k in 1..=radius {
                        let (a, b) = (lanes(c + k, line), lanes(c - k, line));
                        for i in 0..8 {
                            sum[i] += s.weight[k] * (a[i] + b[i]);
                        }
                    }
                    out[line + at * along..][..8].copy_from_slice(&sum);
                }
            }
        }
    });
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let bits = bit_field(&lumen.inside);
        let f: Vec<f32> =
            bits.iter().enumerate().map(|(i, &b)| b * (1 + i * 5 % 11) as f32 - 2.0).collect();
        let f = plan.upload_owned("f", &f);
        let flat: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let corner = plan.upload_owned("corner", &flat);
        let weights = gaussian_weights(1.3);
        let weight = plan.upload_owned("weight", &weights);
        let edge = lumen.grid.dims.as_ivec3() - 1;
        for axis in 0..3u32 {
            for (low, high) in [(i32::MIN / 2, i32::MAX / 2), (0, edge[axis as usize])] {
                let g = plan.zeroed::<f32>("g", lumen.bricks.field_len());
                let radius = weights.len() as u32 - 1;
                let params = Params { slots: slots as u32, axis, radius, low, high };
                let bindings = Bindings { near, corner, weight, f, g };
                plan.launch(&KERNEL, bindings, params, slots * BRICK, slots * BRICK);
                plan.download(g);
            }
        }
    })
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
