//! Evidence in the grey values for each place of a wall.

use glam::IVec3;
use rayon::prelude::*;

use super::WallField;
use crate::geometry::Mesh;
use crate::kernels::{wall_level, wall_peak};
use crate::lumen::Lumen;

/// Evidence for a place of the wall.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[repr(u8)]
pub enum Evidence {
    /// Profile of grey values that passes the threshold.
    #[default]
    Profile,
    /// Crest of a sheet thinner than the scan's blur.
    Sheet,
    /// Limit of growth: the values show no wall there.
    Limit,
    /// Surface of a pool of fluid ([`super::fluid_levels`]): no mucosa.
    FluidLevel,
}

impl Evidence {
    /// Returns the evidence at a voxel outside the lumen, from the field's marks and levels.
    pub(super) fn new(mark: u32, level: i32) -> Self {
        if wall_level::offset(level) <= 0 || wall_level::is_capped(level) {
            Self::Limit
        } else if mark & wall_peak::CREST != 0 {
            Self::Sheet
        } else {
            Self::Profile
        }
    }
}

/// Returns the evidence at each vertex of a mesh whose vertices lie on grid edges between a voxel
/// of the lumen and one outside. Where that edge leaves the volume, the wall is a cap and counts as
/// [`Evidence::Profile`].
pub fn vertex_evidence(lumen: &Lumen, field: &WallField, mesh: &Mesh) -> Vec<Evidence> {
    let to_voxel = lumen.grid.voxel_from_world();
    let at = |v: IVec3| lumen.bricks.element(v).map(|e| field.evidence[e]);
    mesh.positions
        .par_iter()
        .with_min_len(1024)
        .map(|p| {
            let v = to_voxel.transform_point3(p.as_dvec3());
            // Crossings keep a 256th of the edge from voxel centres, rounding of positions does not
            // reach so far: the one coordinate that is no whole number is the edge's axis.
            let off = (v - v.round()).abs();
            let axis = (0..3).max_by(|a, b| off[*a].total_cmp(&off[*b])).unwrap_or(0);
            let mut low = v.round().as_ivec3();
            low[axis] = v[axis].floor() as i32;
            let high = low + IVec3::AXES[axis];
            let outside = if lumen.holds(low) { high } else { low };
            at(outside).unwrap_or_default()
        })
        .collect()
}
