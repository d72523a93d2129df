//! Values of some voxels of a volume.

use glam::UVec3;

pub(super) use super::numbers::of_every_organ::values::MIN_HU;
use crate::lumen::{BitVolume, IntensitySelection};
use crate::volume::Volume;

/// Voxels between two values, inclusive.
pub(super) fn between(volume: &Volume, lo: f64, hi: f64) -> BitVolume {
    IntensitySelection::Range { lo, hi }.select(volume)
}

/// Real values of voxels, sorted.
pub(super) fn sorted(volume: &Volume, voxels: impl Iterator<Item = UVec3>) -> Vec<f64> {
    let mut out: Vec<f64> = voxels.map(|v| volume.real(volume.grid.index(v))).collect();
    out.retain(|v| v.is_finite());
    out.sort_by(f64::total_cmp);
    out
}

/// The value below which a share of sorted values lies; 0 of none.
pub(super) fn quantile(sorted: &[f64], share: f64) -> f64 {
    let at = (share * sorted.len().saturating_sub(1) as f64).round() as usize;
    sorted.get(at).copied().unwrap_or(0.0)
}

/// Standard deviation of normal noise with this median absolute deviation.
pub(super) fn noise(sorted: &[f64]) -> f64 {
    let middle = quantile(sorted, 0.5);
    let mut off: Vec<f64> = sorted.iter().map(|v| (v - middle).abs()).collect();
    off.sort_by(f64::total_cmp);
    1.4826 * quantile(&off, 0.5)
}

/// Share of the voxels of one mask that are in another.
pub(super) fn share(of: &BitVolume, inside: &BitVolume) -> f64 {
    let all = of.count();
    let mut both = of.clone();
    both.keep(inside);
    if all == 0 { 0.0 } else { both.count() as f64 / all as f64 }
}
