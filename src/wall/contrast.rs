//! Values of lumen, wall and noise about a core, by which grey values are quantised.

use glam::{DVec3, IVec3, UVec3};
use rayon::prelude::*;

use super::Tissue;
use crate::lumen::bricks::{BRICK, SIDE};
use crate::lumen::{BitVolume, Bricks, GreyValues, dilated, eroded, surrounding_bricks};
use crate::volume::{Grid, Sample, Volume, with_samples};

/// Difference between the wall's quantised value and the lumen's.
pub(super) const UNIT: f64 = 4096.0;
/// Contrast of a CT between gas and tissue, HU: sizes in HU below are converted as shares of it.
const GAS_CONTRAST_HU: f64 = 990.0;
/// Value of soft tissue, HU.
const TISSUE_HU: f64 = 40.0;
/// Value of lung parenchyma, HU.
const LUNG_HU: f64 = -850.0;
/// Range of gas in a CT, HU.
const GAS_HU: std::ops::Range<f64> = -1150.0..-750.0;
/// Upper bound of the 75th percentile of values about gas in a body, HU.
const MAX_BESIDE_GAS_HU: f64 = 150.0;
/// Largest number of voxels of which a median is taken.
const SAMPLES: usize = 8192;
/// Rounds of growth beyond a core, least and most: how far values about it are read.
pub(super) const ROUNDS: (f64, f64) = (2.0, 3.0);
/// Inner and outer distance from the core, mm, of the shell in which the wall's value is measured.
const SHELL_MM: (f64, f64) = (2.0, 4.0);

/// Converts a size in HU of a CT with gas to quantised units of the present contrast.
pub(super) fn of_hu(hu: f64) -> i32 {
    (hu / GAS_CONTRAST_HU * UNIT).round() as i32
}

/// Values of lumen and wall, and the noise between them.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contrast {
    /// Value of the lumen, real units.
    pub lumen: f64,
    /// Value of the wall, real units.
    pub wall: f64,
    /// Value of the tissue beyond the wall, as a share of the contrast: 0 the lumen's, 1 the
    /// wall's.
    pub(super) beyond: f64,
    /// Standard deviation of noise in the lumen, real units.
    pub noise: f64,
    /// Standard deviation of noise after the smoothing, real units.
    pub(super) calm_noise: f64,
    /// Standard deviation of the smoothing along each axis, voxels.
    pub(super) sigma_vox: DVec3,
}

impl Contrast {
    /// Measures lumen, wall and noise. `None` where lumen and wall have the same value.
    pub(super) fn measured(grey: GreyValues<'_>, core: &BitVolume, tissue: Tissue) -> Option<Self> {
        let h = grey.grid().spacing_mm;
        let inner = eroded(core, DVec3::ONE, 1.0);
        let inner = spread(if inner.is_empty() { core } else { &inner });
        let values = |at: &[UVec3]| -> Vec<f64> {
            let real = at.iter().map(|v| grey.real(*v));
            real.filter(|v| v.is_finite()).collect()
        };
        let (lumen, noise) = median_and_noise(values(&inner))?;
        let around = |tissue: Tissue| -> Option<(f64, f64)> {
            match tissue {
                Tissue::Airway => Some((TISSUE_HU, (LUNG_HU - lumen) / (TISSUE_HU - lumen))),
                Tissue::Colon => Some((TISSUE_HU, 0.0)),
                _ => {
                    let mut shell = dilated(core, h, shell_mm(h));
                    shell.remove(&dilated(core, h, SHELL_MM.0));
                    let mut shell = values(&spread(&shell));
                    shell.sort_by(f64::total_cmp);
                    let at = |share: f64| {
                        shell.get((share * shell.len().saturating_sub(1) as f64) as usize)
                    };
                    let is_gas = tissue == Tissue::Unknown
                        && GAS_HU.contains(&lumen)
                        && *at(0.75)? < MAX_BESIDE_GAS_HU
                        && *at(0.95)? > -500.0;
                    let air = (TISSUE_HU, (LUNG_HU - lumen) / (TISSUE_HU - lumen));
                    Some(if is_gas { air } else { (*at(0.5)?, 1.0) })
                }
            }
        };
        let (wall, beyond) = around(tissue)?;
        let contrast = wall - lumen;
        if !(contrast.is_finite() && contrast.abs() > 1e-9 * lumen.abs().max(wall.abs())) {
            return None;
        }
        // More noise is smoothed more: 20 and 40 HU of a CT with gas.
        let share = noise / contrast.abs();
        let sigma = match share * GAS_CONTRAST_HU {
            n if n <= 20.0 => 0.5,
            n if n <= 40.0 => 0.6,
            _ => 0.7,
        };
        let sigma_vox = sigma * h.min_element() / h;
        let calm: Vec<f64> = inner.iter().map(|v| smoothed_at(grey, *v, sigma_vox)).collect();
        let calm_noise = median_and_noise(calm)?.1;
        Some(Self { lumen, wall, beyond: beyond.clamp(0.0, 1.0), noise, calm_noise, sigma_vox })
    }

    /// Quantises a real value: 0 for the lumen, 4096 for the wall, clamped to half a contrast below
    /// the lumen and five above the wall; not-a-number becomes the wall's value.
    #[inline]
    pub(super) fn quantised(&self, real: f64) -> i32 {
        let u = (real - self.lumen) * (UNIT / (self.wall - self.lumen));
        if u.is_nan() { UNIT as i32 } else { u.round().clamp(-0.5 * UNIT, 6.0 * UNIT) as i32 }
    }

    /// Converts a quantised threshold to a real value.
    pub(super) fn real(&self, u: f64) -> f64 {
        self.lumen + u * (self.wall - self.lumen) / UNIT
    }

    /// Returns the standard deviation of noise after smoothing, in quantised units.
    pub(super) fn noise_units(&self) -> f64 {
        self.calm_noise / (self.wall - self.lumen).abs() * UNIT
    }
}

/// Returns at most [`SAMPLES`] voxels of a mask, evenly spread over it.
fn spread(mask: &BitVolume) -> Vec<UVec3> {
    let each = (mask.count() as usize).div_ceil(SAMPLES).max(1);
    mask.voxels().step_by(each).collect()
}

/// Returns the median, and the standard deviation of normal noise with the same median absolute
/// deviation.
fn median_and_noise(mut values: Vec<f64>) -> Option<(f64, f64)> {
    if values.is_empty() {
        return None;
    }
    let median = |values: &mut Vec<f64>| {
        let at = values.len() / 2;
        *values.select_nth_unstable_by(at, f64::total_cmp).1
    };
    let middle = median(&mut values);
    values.iter_mut().for_each(|v| *v = (*v - middle).abs());
    Some((middle, 1.4826 * median(&mut values)))
}

/// Returns the value at a voxel after a Gaussian; beyond the volume its edge repeats.
fn smoothed_at(grey: GreyValues<'_>, v: UVec3, sigma_vox: DVec3) -> f64 {
    let top = grey.grid().dims.as_ivec3() - 1;
    let weight = |k: i32, axis: usize| {
        let x = f64::from(k) / sigma_vox[axis].max(0.05);
        (-0.5 * x * x).exp()
    };
    let (mut sum, mut all) = (0.0, 0.0);
    for z in -2..=2 {
        for y in -2..=2 {
            for x in -2..=2 {
                let w = weight(x, 0) * weight(y, 1) * weight(z, 2);
                let at = (v.as_ivec3() + glam::IVec3::new(x, y, z)).clamp(glam::IVec3::ZERO, top);
                let real = grey.real(at.as_uvec3());
                if real.is_finite() {
                    sum += w * real;
                    all += w;
                }
            }
        }
    }
    sum / all
}

/// Outer radius of the shell in which the wall's value is measured, mm.
fn shell_mm(spacing_mm: DVec3) -> f64 {
    SHELL_MM.1.max(1.5 * spacing_mm.max_element())
}

/// Returns the bricks that hold all values about a core that a wall field reads, for a volume that
/// is read in parts.
pub fn bricks_about(core: &BitVolume, grid: &Grid) -> Bricks {
    let mut near = dilated(core, grid.spacing_mm, shell_mm(grid.spacing_mm));
    let (side, last) = (SIDE as u32, grid.dims - 1);
    for corner in surrounding_bricks(core, ROUNDS.1).corners() {
        // Beyond the volume its edge is read, which is in a brick beside it.
        let v = IVec3::from(*corner) + SIDE / 2;
        let v = v.clamp(IVec3::ZERO, last.as_ivec3()).as_uvec3() / side * side;
        near.set_run((v.x, (v.x + side - 1).min(last.x)), v.y, v.z);
    }
    Bricks::about(&near)
}

/// Returns the quantised values of a volume in bricks; beyond the volume its edge repeats.
pub(super) fn values_in(bricks: &Bricks, grey: GreyValues<'_>, contrast: &Contrast) -> Vec<i32> {
    match grey {
        GreyValues::Whole(volume) => values_of(bricks, volume, contrast),
        GreyValues::Bricks(_) => {
            let top = grey.grid().dims.as_ivec3() - 1;
            let mut out = vec![0i32; bricks.field_len()];
            out.par_chunks_exact_mut(BRICK).enumerate().for_each(|(slot, out)| {
                crate::task::checkpoint();
                for (l, to) in out.iter_mut().enumerate() {
                    let v = bricks.voxel(slot * BRICK + l).clamp(IVec3::ZERO, top);
                    *to = contrast.quantised(grey.real(v.as_uvec3()));
                }
            });
            out
        }
    }
}

/// Returns the quantised values of a volume in memory in bricks.
fn values_of(bricks: &Bricks, volume: &Volume, contrast: &Contrast) -> Vec<i32> {
    let grid = volume.grid;
    let top = grid.dims.as_ivec3() - 1;
    let mut out = vec![0i32; bricks.field_len()];
    with_samples!(&volume.samples, |samples| {
        out.par_chunks_exact_mut(BRICK).zip(bricks.corners()).for_each(|(out, c)| {
            crate::task::checkpoint();
            for (r, row) in out.chunks_exact_mut(8).enumerate() {
                let y = (c[1] + (r as i32 & 7)).clamp(0, top.y);
                let z = (c[2] + (r as i32 >> 3)).clamp(0, top.z);
                let start = grid.index(UVec3::new(0, y as u32, z as u32));
                for (x, v) in row.iter_mut().enumerate() {
                    let x = (c[0] + x as i32).clamp(0, top.x) as usize;
                    *v = contrast.quantised(volume.rescale.real(samples[start + x].to_f64()));
                }
            }
        });
    });
    out
}
