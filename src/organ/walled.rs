//! Share of wall about a part of some air, which distinguishes a bronchus from lung.

use glam::{IVec3, UVec3};

use super::SIDES;
pub(super) use super::numbers::of_airway::walled::WALL_HU;
use super::numbers::of_airway::walled::*;
use crate::volume::Volume;

/// Returns the share of the rays leaving a part of some air through its voxels' six sides that meet
/// a value of a wall. Rays that leave the volume at once do not count. 1 where no ray leaves.
///
/// * `is_air`: whether a voxel belongs to the part or to the air it is joined to.
pub(super) fn walled(
    volume: &Volume,
    part: impl Iterator<Item = UVec3>,
    is_air: impl Fn(IVec3) -> bool,
) -> f64 {
    let grid = &volume.grid;
    let reach = |side: IVec3| {
        let step_mm = (side.as_dvec3() * grid.spacing_mm).length();
        ((REACH_MM / step_mm).round() as i32).clamp(*REACH_VOXELS.start(), *REACH_VOXELS.end())
    };
    let rays = SIDES.map(|side| (side, reach(side)));
    let (mut all, mut met) = (0u64, 0u64);
    for v in part.map(|v| v.as_ivec3()) {
        for (side, reach) in rays.iter().filter(|(side, _)| !is_air(v + side)) {
            let on_ray = || (1..=*reach).map(|k| v + k * side).take_while(|w| grid.contains(*w));
            all += u64::from(on_ray().count() > 0);
            let value = |w: IVec3| volume.real(grid.index(w.as_uvec3()));
            met += u64::from(on_ray().any(|w| value(w) >= WALL_HU));
        }
    }
    if all == 0 { 1.0 } else { met as f64 / all as f64 }
}
