//! The drawn wall: which part of it a camera sees, and how fine.
//!
//! A [`DrawnWall`] is a pair of buffers that stay on the device and a function of the camera that
//! names the ranges of indices to draw. There are three:
//!
//! * [`refined::RefinedWall`]: the whole mesh, with faces near the eye split onto the smooth wall.
//! * [`CulledWall`]: the whole mesh, less the cells of a [`FaceOctree`] that the camera cannot see.
//! * [`vds::SubdividedWall`]: the view-dependent subdivision of the paper (Li et al. 2004).
//!
//! All leave out faces outside the [`ViewFrustum`], faces that look away
//! from the eye, and faces that the wall itself hides ([`OcclusionTest`]).

mod cell_bits;
mod exterior;
mod face_octree;
mod hierarchical_z;
mod morph;
pub mod octree;
mod occlusion;
pub mod refined;
mod slot_cache;
pub mod vds;
mod view_frustum;

pub use exterior::ExteriorGrid;
pub use face_octree::{CulledWall, FaceOctree};
pub use hierarchical_z::{DepthMargin, HierarchicalZ};
pub use occlusion::{OcclusionTest, occlusion_grid, occlusion_grid_around};
pub use slot_cache::SlotCache;
pub use view_frustum::{ProjectedBounds, ViewFrustum};

use std::fmt::Debug;

use crate::geometry::Camera;

/// The shading tolerance applies in full where edges look at least this long, pixels: a wrong shade
/// over one or two pixels is noise, over a large triangle it is a dent.
const FULL_SHADING_PX: f64 = 16.0;

/// Largest deviation of a drawn wall from the original surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Screen-space error: distance on screen between any drawn point and the original and back,
    /// pixels.
    pub pixels: f32,
}

/// Indices that are drawn together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DrawnRange {
    /// First of the indices.
    pub first_index: u32,
    /// Number of indices, three a triangle.
    pub indices: u32,
    /// Vertex that index 0 means.
    pub first_vertex: u32,
    /// Fineness of a patch and of its three sides, a byte each; 0 for a mesh.
    pub morph: u32,
}

/// Part of a wall that a camera sees.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct VisibleWall {
    /// Ranges in an order that depends on the camera alone.
    pub ranges: Vec<DrawnRange>,
    /// Faces that are refined, of a wall that has such.
    pub refined: Vec<refined::RefinedFace>,
}

impl VisibleWall {
    /// Returns the number of triangles.
    pub fn triangles(&self) -> u64 {
        let flat: u64 = self.ranges.iter().map(|range| u64::from(range.indices / 3)).sum();
        flat + self.refined.iter().map(|face| u64::from(face.triangles())).sum::<u64>()
    }

    /// Adds faces of a mesh, in the order in which their indices lie.
    fn add_faces(&mut self, faces: std::ops::Range<u32>) {
        let (first, count) = (3 * faces.start, 3 * (faces.end - faces.start));
        match self.ranges.last_mut() {
            Some(last) if last.first_index + last.indices == first => last.indices += count,
            _ => self.ranges.push(DrawnRange {
                first_index: first,
                indices: count,
                first_vertex: 0,
                morph: 0,
            }),
        }
    }
}

impl FromIterator<DrawnRange> for VisibleWall {
    fn from_iter<I: IntoIterator<Item = DrawnRange>>(ranges: I) -> Self {
        Self { ranges: ranges.into_iter().collect(), refined: Vec::new() }
    }
}

/// A wall whose buffers stay on the device.
pub trait DrawnWall: Debug + Send + Sync {
    /// Returns the part that a camera sees. It depends on the camera alone.
    fn visible(&self, camera: &Camera) -> VisibleWall;

    /// Whether faces that look away from the eye are drawn. Inside a closed wall they are always
    /// hidden; through open ends they are not.
    fn shows_backs(&self) -> bool;
}
