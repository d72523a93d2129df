//! Gaussian smoothing of a whole volume, for scans so noisy that a threshold falls apart.

use rayon::prelude::*;

use crate::volume::{Sample, SampleBuffer, Samples, Volume, with_samples};

/// The volume's real values, smoothed along each axis; beyond the edge the last value goes on.
///
/// * `sigma_mm`: standard deviation.
/// * `least`: smaller values count as this one, so that padding does not spread.
pub(super) fn smoothed(volume: &Volume, sigma_mm: f64, least: f64) -> Volume {
    let grid = volume.grid;
    let mut values: Vec<f32> = with_samples!(&volume.samples, |s| {
        s.par_iter().map(|v| volume.rescale.real(v.to_f64()).max(least) as f32).collect()
    });
    let [nx, ny, nz] = grid.dims.to_array().map(|n| n as usize);
    let slice = nx * ny;
    let [wx, wy, wz] = grid.spacing_mm.to_array().map(|h| weights(sigma_mm / h));
    values.par_chunks_mut(slice).for_each(|slice| {
        let mut line = Vec::new();
        for row in slice.chunks_mut(nx) {
            line.clear();
            line.extend_from_slice(row);
            for (x, out) in row.iter_mut().enumerate() {
                *out = sum(&wx, x, nx, |i| line[i]);
            }
        }
        let before = slice.to_vec();
        for (y, row) in slice.chunks_mut(nx).enumerate() {
            for (x, out) in row.iter_mut().enumerate() {
                *out = sum(&wy, y, ny, |j| before[x + nx * j]);
            }
        }
    });
    // Slices as they were, of which as many are kept as the weights reach.
    let reach = wz.len() - 1;
    let mut kept: std::collections::VecDeque<Vec<f32>> = std::collections::VecDeque::new();
    let mut first = 0;
    for z in 0..nz {
        crate::task::checkpoint();
        for next in first + kept.len()..=(z + reach).min(nz - 1) {
            kept.push_back(values[next * slice..(next + 1) * slice].to_vec());
        }
        let out = &mut values[z * slice..(z + 1) * slice];
        out.par_iter_mut().enumerate().with_min_len(4096).for_each(|(i, out)| {
            *out = sum(&wz, z, nz, |k| kept[k - first][i]);
        });
        if z >= reach {
            kept.pop_front();
            first += 1;
        }
    }
    let samples = Samples::F32(SampleBuffer::from(values));
    Volume::new(grid, samples)
}

/// Weights of the middle and of each step away from it, summing to 1 with both sides.
fn weights(sigma: f64) -> Vec<f32> {
    let reach = (3.0 * sigma).ceil() as usize;
    let raw: Vec<f64> =
        (0..=reach).map(|k| (-0.5 * (k as f64 / sigma.max(1e-9)).powi(2)).exp()).collect();
    let total = raw[0] + 2.0 * raw[1..].iter().sum::<f64>();
    raw.iter().map(|w| (w / total) as f32).collect()
}

#[inline]
fn sum(weights: &[f32], at: usize, len: usize, value: impl Fn(usize) -> f32) -> f32 {
    let mut out = weights[0] * value(at);
    for (k, w) in weights.iter().enumerate().skip(1) {
        out += w * (value(at.saturating_sub(k)) + value((at + k).min(len - 1)));
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Grid;

    #[test]
    fn a_point_becomes_a_gaussian_and_a_constant_stays() {
        let grid = Grid::axis_aligned([21, 19, 17], [1.0, 1.0, 2.0]);
        let mut values = vec![5i16; grid.len()];
        let out = smoothed(&Volume::new(grid, Samples::I16(values.clone().into())), 1.2, 0.0);
        assert!((0..grid.len()).all(|i| (out.real(i) - 5.0).abs() < 1e-5));
        values.fill(0);
        let middle = grid.index(glam::UVec3::new(10, 9, 8));
        values[middle] = 30_000;
        let out = smoothed(&Volume::new(grid, Samples::I16(values.into())), 1.2, 0.0);
        let at = |x, y, z| out.real(grid.index(glam::UVec3::new(x, y, z)));
        let total: f64 = (0..grid.len()).map(|i| out.real(i)).sum();
        assert!((total - 30_000.0).abs() < 0.1, "{total}");
        for (ratio, mm) in [(at(12, 9, 8), 2.0), (at(10, 6, 8), 3.0), (at(10, 9, 9), 2.0)] {
            let wanted = (-0.5f64 * (mm / 1.2) * (mm / 1.2)).exp();
            assert!((ratio / at(10, 9, 8) - wanted).abs() < 1e-3, "{mm}");
        }
    }
}
