//! Phantoms as voxels.

use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::Phantom;
use crate::volume::Volume;

/// Side, voxels, of the blocks that are filled with one value or voxel by voxel.
const BLOCK: u32 = 8;

/// Grey values of a CT: gas in the lumen, soft tissue around it.
const LUMEN_HU: f64 = -950.0;
const WALL_HU: f64 = 40.0;

impl Phantom {
    /// Returns the lumen as 0 and 1 (u8), sampled at voxel centres.
    pub fn mask(&self) -> Volume {
        let samples =
            self.fill(0.0, u8::from, |p| u8::from(self.shape.field(self.to_unit(p)) < 0.0));
        Volume::new(self.grid, samples.into())
    }

    /// Returns a CT-like volume (i16, HU): lumen -950, wall +40, in between a linear ramp over the
    /// signed distance that is as wide as a voxel is along the wall's normal. `noise` is the
    /// standard deviation (HU, finite) of Gaussian noise; values saturate at the ends of i16. Equal
    /// seeds give equal volumes.
    pub fn grey(&self, noise: Option<f64>, seed: u64) -> Volume {
        let spacing = self.grid.spacing_mm;
        let cubic = spacing.max_element() - spacing.min_element() < 1e-9 * spacing.x;
        let hu = |wall: f64| (LUMEN_HU + (WALL_HU - LUMEN_HU) * wall).round() as i16;
        // The colon's field can be some four times the distance.
        let band = 4.0 * spacing.max_element();
        let plain = |inside| hu(if inside { 0.0 } else { 1.0 });
        let value = |p: DVec3| {
            let f = self.field(p);
            if f.abs() > band {
                return plain(f < 0.0);
            }
            let d = self.distance(p);
            let width = if cubic { spacing.x } else { (self.normal(p) * spacing).length() };
            hu((0.5 + d / width).clamp(0.0, 1.0))
        };
        let mut samples = self.fill(band, plain, value);
        if let Some(sd) = noise {
            add_noise(&mut samples, sd, seed);
        }
        Volume::new(self.grid, samples.into())
    }

    /// Fills the grid: blocks farther than `band` (mm) from the wall with one value, the others
    /// voxel by voxel.
    fn fill<T: Copy + Send + Sync>(
        &self,
        band: f64,
        plain: impl Fn(bool) -> T + Sync,
        value: impl Fn(DVec3) -> T + Sync,
    ) -> Vec<T> {
        let (dims, spacing) = (self.grid.dims, self.grid.spacing_mm);
        let mut out = vec![plain(false); self.grid.len()];
        let plane = dims.x as usize * dims.y as usize;
        out.par_chunks_mut(plane * BLOCK as usize).enumerate().for_each(|(slab, out)| {
            let z0 = slab as u32 * BLOCK;
            let depth = (out.len() / plane) as u32;
            for y0 in (0..dims.y).step_by(BLOCK as usize) {
                for x0 in (0..dims.x).step_by(BLOCK as usize) {
                    let from = UVec3::new(x0, y0, z0);
                    let size = UVec3::new(dims.x - x0, dims.y - y0, depth).min(UVec3::splat(BLOCK));
                    let half = 0.5 * (size - 1).as_dvec3() * spacing;
                    let margin = (half.length() + band) / self.side_mm;
                    let middle = self.to_unit(from.as_dvec3() * spacing + half);
                    let (low, high) = self.shape.bounds(middle);
                    if low > margin {
                        continue;
                    }
                    let whole = (high < -margin).then(|| plain(true));
                    for (z, y) in (0..size.z).flat_map(|z| (0..size.y).map(move |y| (z, y))) {
                        let row = z as usize * plane + (y0 + y) as usize * dims.x as usize;
                        let row = &mut out[row + x0 as usize..][..size.x as usize];
                        for (x, v) in row.iter_mut().enumerate() {
                            let at = from + UVec3::new(x as u32, y, z);
                            *v = whole.unwrap_or_else(|| value(at.as_dvec3() * spacing));
                        }
                    }
                }
            }
        });
        out
    }
}

/// Adds Gaussian noise. Every pair of samples draws from its own place in the sequence, so the
/// result does not depend on the number of threads.
fn add_noise(samples: &mut [i16], sd: f64, seed: u64) {
    let start = mixed(seed);
    samples.par_chunks_mut(2).enumerate().for_each(|(pair, values)| {
        let bits = mixed(start.wrapping_add(2 * pair as u64));
        let more = mixed(start.wrapping_add(2 * pair as u64 + 1));
        let unit = |b: u64| ((b >> 11) as f64 + 0.5) / (1u64 << 53) as f64;
        let radius = sd * (-2.0 * unit(bits).ln()).sqrt();
        let (sin, cos) = (std::f64::consts::TAU * unit(more)).sin_cos();
        for (v, wave) in values.iter_mut().zip([cos, sin]) {
            *v = (f64::from(*v) + radius * wave).round() as i16;
        }
    });
}

/// The splitmix64 finaliser.
fn mixed(i: u64) -> u64 {
    let z = i.wrapping_add(1).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    let z = (z ^ (z >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let z = (z ^ (z >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    z ^ (z >> 31)
}
