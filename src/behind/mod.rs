//! The tissue behind the wall: a band that rays from the drawn wall pass through.
//!
//! A ray starts at the wall and goes on outwards. Tissue takes light from it by its CT number
//! ([`Opacity`]), down to a depth behind the wall, so that fat, soft tissue, tagged stool, vessels and
//! calcification have colours of their own. Values and signed distances from the wall lie in bricks
//! about the wall ([`TissueField`]). A shader marches through them; [`BehindWall::seen`] is its twin.
//!
//! * Depth is the distance from the wall, not the length of the ray: a grazing ray does not look
//!   shallower than a steep one.
//! * Rays start behind the skin in which every voxel mixes lumen and tissue: from gas to soft tissue
//!   the values pass those of fat.
//! * A ray that comes out into the lumen behind a fold goes on to the next wall, which is opaque.
//! * No jitter: equal inputs give equal pictures.
//!
//! Opacity is integrated over the piece of the ray between two samples before (Engel, Kraus & Ertl
//! 2001, doi:10.1145/383507.383515), and the first sample lies exactly where the band begins. Both
//! together halve the error of steps of one voxel; without the second, the first is worse than neither.
//!
//! The colour of a thing smaller than three voxels is no measurement: the largest value is given beside
//! the colour ([`Seen::largest`]).

mod cast;
mod distance;
mod opacity;
mod tissue;

pub use cast::{Band, Seen};
pub use opacity::{Opacity, OpacityTable, TABLE_SIDE, VALUES};
pub use tissue::{ABSENT, MAX_TILES_BYTES, TILE_SIDE, TissueBricks, TissueError, TissueField};

use glam::{DVec3, Vec3};

/// The tissue behind a wall, and what rays look at of it.
#[derive(Debug)]
pub struct BehindWall {
    /// Values and distances.
    pub tissue: TissueField,
    /// Opacity of the tissue.
    pub opacity: Opacity,
    /// The same for the steps of a ray: mean voxel sides.
    pub table: OpacityTable,
    /// Part of the tissue that rays look at.
    pub band: Band,
}

impl BehindWall {
    /// Prepares tissue for rays.
    ///
    /// * `noise`: standard deviation of the values, HU.
    pub fn new(tissue: TissueField, opacity: Opacity, noise: f32, depth_mm: f32) -> Self {
        let table = OpacityTable::new(opacity, tissue.mean_side_mm());
        let band = Band { skin_vox: opacity.skin_vox(noise), depth_mm };
        Self { tissue, opacity, table, band }
    }

    /// Looks along a ray from the wall outwards.
    ///
    /// * `from`: place where the ray meets the wall, LPS mm.
    /// * `way`: unit vector, away from the eye.
    pub fn seen(&self, from: DVec3, way: Vec3) -> Seen {
        cast::cast(&self.tissue, &self.table, &self.band, from, way)
    }
}

#[cfg(test)]
mod tests;
