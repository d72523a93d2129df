//! The lumen's voxels from signs of the field, and figures of its wall.

use glam::IVec3;
use rayon::prelude::*;

use super::{Contrast, Evidence, WallInput, WallStats};
use crate::kernels::wall_level;
use crate::lumen::bricks::BRICK;
use crate::lumen::{BitVolume, Bricks, Lumen, fill_cavities, pieces};

/// A component has at least this share of the largest one's voxels.
const LEAST_SHARE: f64 = 0.0005;

/// The 6-components of `is_lumen` that meet the core, cavities filled; `None` where there is none.
pub(super) fn lumen(
    bricks: &Bricks,
    core: &BitVolume,
    is_lumen: impl Fn(usize) -> bool + Sync,
) -> Option<BitVolume> {
    // One byte a row of a brick, which lies within a word of the grid's row.
    let rows: Vec<[u8; 64]> = (0..bricks.len())
        .into_par_iter()
        .with_min_len(16)
        .map(|slot| {
            std::array::from_fn(|row| {
                let at = slot * BRICK + 8 * row;
                (0..8).fold(0, |byte, x| byte | u8::from(is_lumen(at + x)) << x)
            })
        })
        .collect();
    let mut all = BitVolume::new(core.dims());
    for (rows, corner) in rows.iter().zip(bricks.corners()) {
        for (r, byte) in rows.iter().enumerate().filter(|(_, byte)| **byte != 0) {
            let (y, z) = (corner[1] + (r as i32 & 7), corner[2] + (r as i32 >> 3));
            all.set_byte(corner[0], y, z, *byte);
        }
    }
    let pieces = pieces(&all, 1);
    let least = LEAST_SHARE * pieces.first()?.component.voxels as f64;
    let meets = |piece: &&crate::lumen::Piece| {
        piece.component.voxels as f64 >= least && piece.voxels().any(|v| core.at(v.x, v.y, v.z))
    };
    let mut out = BitVolume::new(core.dims());
    for piece in pieces.iter().filter(meets) {
        piece.runs.iter().for_each(|&(run, y, z)| out.set_run(run, y, z));
    }
    fill_cavities(&mut out);
    (!out.is_empty()).then_some(out)
}

/// Figures of the wall: voxels outside the lumen that share a side with it.
pub(super) fn stats(
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
            if lumen.holds(beside) || !lumen.grid.contains(beside) {
                continue;
            }
            let Some(at) = input.bricks.element(beside) else { continue };
            thresholds.push(wall_level::threshold(level[at]));
            match Evidence::new(mark[at], level[at]) {
                Evidence::Profile => {}
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

/// Ways to the voxels that share a side with one.
const SIDES: [IVec3; 6] = [IVec3::X, IVec3::NEG_X, IVec3::Y, IVec3::NEG_Y, IVec3::Z, IVec3::NEG_Z];
