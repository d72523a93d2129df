//! The wall field: where the wall of a lumen lies in grey values, given a *core* of the lumen.
//!
//! The mask that decides the route does not decide the position of the wall. Region growing needs a
//! threshold that does not leak; in an edge blurred from gas to tissue that value lies deep in the
//! lumen, where noise decides. So the core only identifies the lumen. About it one field is
//! computed, negative in the lumen: value minus a threshold that follows from the wall's own
//! profile (see `law`). The final mask, the surface, its normals and all distances follow from the
//! field.
//!
//! Two plans run on a device, each followed by a choice of components on the CPU:
//! 1. [`WallInput::profile`]: smoothing, growth up to the ridge of the wall, peaks, offsets.
//! 2. [`WallProfile::correct`]: shift of curved edges by blur, round ends.
//!
//! All of it is in integers, so that every device and any number of threads give the same mask.

mod bridges;
mod contrast;
mod correct;
mod evidence;
mod fluid;
mod fluid_level;
mod launches;
mod law;
mod mesh_field;
mod normals;
mod profile;
mod select;
mod spline;
mod stats;

pub use contrast::{Contrast, bricks_about};
pub use evidence::{Evidence, vertex_evidence};
pub use fluid::CleansedFluid;
pub use fluid_level::{FluidLevel, fluid_levels};
pub use normals::{field_normals, smoothed_field};
pub use profile::{ProfileBuffers, WallInput, WallProfile};
pub use spline::WallSpline;

use glam::IVec3;

use crate::lumen::Lumen;
use crate::surface::{Crossing, clamp_fraction};

/// Number of offset units in a mean spacing.
const OFFSET: f64 = 1024.0;

/// Lumen and surrounding tissue, which decide the constants of the method.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Tissue {
    /// Gas in lung: a thin wall with air beyond it.
    Airway,
    /// Gas in the colon; folds are sheets with gas on both sides.
    Colon,
    /// Blood brighter or darker than everything around it.
    Vessel,
    /// Unknown tissue, decided from the values: gas of a CT as an airway, else as a vessel.
    Unknown,
}

/// Errors of making a wall field.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum WallError {
    /// Lumen and surroundings have the same value, so that there is no edge.
    #[error("no wall field: the core and what lies about it have the same values")]
    NoContrast,
    /// No voxel is left in the lumen.
    #[error("no wall field: no voxel of the core is darker than the wall about it")]
    Empty,
}

/// Statistics of the wall.
#[derive(Clone, Debug, PartialEq)]
pub struct WallStats {
    /// Values of lumen and wall, and their noise.
    pub contrast: Contrast,
    /// Standard deviation of the scan's blur, mm.
    pub sigma_mm: f64,
    /// Thresholds at 5, 25, 50, 75 and 95 % of the voxels beside the wall, real units.
    pub threshold_percentiles: [f64; 5],
    /// Share of the wall that was drawn as the crest of a sheet.
    pub sheet_share: f64,
    /// Share of the wall that a limit of growth has closed: the values show no wall there.
    pub closed_by_limit_share: f64,
}

/// Offset of each voxel of a lumen's bricks from its wall.
pub struct WallField {
    /// Signed offset from the wall, mm, in slot order of the lumen's bricks: negative inside.
    pub offset_mm: Vec<f32>,
    /// Evidence for the wall at each voxel, in the same order; only voxels beside the lumen matter.
    pub evidence: Vec<Evidence>,
    /// Statistics of the wall.
    pub stats: WallStats,
}

/// Crossings of a wall field with grid edges.
pub struct FieldCrossing<'a> {
    /// Lumen whose bricks the field is on.
    pub lumen: &'a Lumen,
    /// Offsets from the wall.
    pub field: &'a WallField,
}

impl Crossing for FieldCrossing<'_> {
    fn fraction(&self, inside: IVec3, outside: IVec3) -> f32 {
        if !self.lumen.is_in_volume(outside) {
            return 0.5; // the volume's edge
        }
        let at = |v: IVec3| self.lumen.bricks.element(v).map(|e| self.field.offset_mm[e]);
        match (at(inside), at(outside)) {
            (Some(a), Some(b)) => clamp_fraction(a / (a - b)),
            _ => 0.5,
        }
    }
}

#[cfg(test)]
mod tests;
