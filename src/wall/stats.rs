//! Statistics of the wall.

use glam::IVec3;

use super::profile::WallInput;
use super::{Contrast, Evidence, WallStats};
use crate::kernels::wall_level;
use crate::lumen::Lumen;

/// Computes statistics of the wall: voxels outside the lumen that share a side with it.
pub fn stats(
    input: &WallInput<'_>,
    sigma_mm: f64,
    lumen: &Lumen,
    mark: &[u32],
    level: &[i32],
) -> WallStats {
    let contrast: Contrast = input.contrast;
    let (mut thresholds, mut sheets, mut closed) = (Vec::new(), 0u64, 0u64);
    for e in lumen.elements(&lumen.boundary) {
        for side in SIDES {
            let beside = lumen.bricks.voxel(e) + side;
            if lumen.holds(beside) || !lumen.is_in_volume(beside) {
                continue;
            }
            let Some(at) = input.bricks.element(lumen.volume_voxel(beside)) else { continue };
            thresholds.push(wall_level::threshold(level[at]));
            match Evidence::new(mark[at], level[at]) {
                Evidence::Profile | Evidence::FluidLevel => {}
                Evidence::Sheet => sheets += 1,
                Evidence::Limit => closed += 1,
            }
        }
    }
    thresholds.sort_unstable();
    let count = thresholds.len().max(1) as f64;
    let percentile = |share: f64| {
        let at = (share * thresholds.len().saturating_sub(1) as f64).round() as usize;
        contrast.real(f64::from(thresholds.get(at).copied().unwrap_or(0)))
    };
    WallStats {
        contrast,
        sigma_mm,
        threshold_percentiles: [0.05, 0.25, 0.5, 0.75, 0.95].map(percentile),
        sheet_share: sheets as f64 / count,
        closed_by_limit_share: closed as f64 / count,
    }
}

/// Steps to the voxels that share a side with one.
const SIDES: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];
