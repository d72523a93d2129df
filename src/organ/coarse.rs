//! Coarse copies of a volume, and its noise.

use glam::{DMat3, DVec3, UVec3};
use rayon::prelude::*;

use super::numbers::of_vessel::coarse::*;
use super::values::{MIN_HU, quantile};
use crate::volume::{Grid, SampleBuffer, Samples, Volume};

/// Standard deviation of a volume's noise, from the differences of neighbours along rows in soft tissue.
pub(super) fn noise_between_neighbours(volume: &Volume) -> f64 {
    let width = volume.grid.dims.x as usize;
    let pairs = (0..volume.grid.len()).step_by(NOISE_EVERY).filter(|i| i % width + 1 < width);
    let pairs = pairs.map(|i| (volume.real(i), volume.real(i + 1)));
    let soft = pairs.filter(|(a, b)| SOFT_HU.contains(&(0.5 * (a + b))));
    let mut off: Vec<f64> = soft.map(|(a, b)| (a - b).abs()).collect();
    off.sort_by(f64::total_cmp);
    // Of the difference of two normal values the median is 0.6745 √2 of their deviation.
    quantile(&off, 0.5) / (0.6745 * std::f64::consts::SQRT_2)
}

/// Returns the means of blocks of voxels, and the number of a block's voxels along each axis.
///
/// * `sides_mm`: of the blocks, about.
pub(super) fn block_means(volume: &Volume, sides_mm: DVec3) -> (Volume, UVec3) {
    let grid = &volume.grid;
    let factor = (sides_mm / grid.spacing_mm).round().as_uvec3().clamp(UVec3::ONE, grid.dims);
    let dims = grid.dims / factor;
    let spacing_mm = grid.spacing_mm * factor.as_dvec3();
    let slice = dims.x as usize * dims.y as usize;
    let mut values = vec![0f32; slice * dims.z as usize];
    let n = f64::from(factor.x * factor.y * factor.z);
    values.par_chunks_mut(slice).enumerate().for_each(|(z, out)| {
        for (i, out) in out.iter_mut().enumerate() {
            let at = UVec3::new(i as u32 % dims.x, i as u32 / dims.x, z as u32) * factor;
            let mut sum = 0.0;
            for dz in 0..factor.z {
                for dy in 0..factor.y {
                    let first = grid.index(at + UVec3::new(0, dy, dz));
                    let row = first..first + factor.x as usize;
                    sum += row.map(|j| volume.real(j).max(MIN_HU)).sum::<f64>();
                }
            }
            *out = (sum / n) as f32;
        }
    });
    let samples = Samples::F32(SampleBuffer::from(values));
    let axes = DMat3::IDENTITY;
    let grid =
        Grid::new(dims.to_array().map(u64::from), spacing_mm, DVec3::ZERO, axes).unwrap_or(*grid);
    (Volume::new(grid, samples), factor)
}
