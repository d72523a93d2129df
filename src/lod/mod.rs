//! Level of detail (LOD): selection of the patches, and of their resolution, that a camera needs,
//! and of the pages to upload.
//!
//! An [`LodHierarchy`] holds one surface at many resolutions. Each step moves the current cut
//! towards the one that a camera needs and returns the patches to write into pages of the
//! [`PageCache`] and the list of pages to draw. A cut always covers the whole surface, coarsely
//! outside the view frustum, so a late step shows less detail but never a hole. Frustum and
//! back-face culling happen when the cut is drawn ([`ViewFrustum`]); the [`OcclusionTest`] rejects
//! patches that the wall itself occludes.
//!
//! * [`clusters`]: a hierarchy of triangle clusters with two-sided error bounds.
//! * [`vds`]: the view-dependent subdivision of the paper (Li et al. 2004).
//!
//! A [`FaceOctree`] has one resolution: it culls the whole wall.

pub mod clusters;
mod face_octree;
pub mod octree;
mod occlusion;
mod page_cache;
pub mod vds;
mod worker;

pub use face_octree::FaceOctree;
pub use occlusion::{OcclusionTest, occlusion_grid, occlusion_grid_around};
pub use page_cache::{NoPage, PageCache};
pub use worker::{Worker, WorkerError};

use std::sync::Arc;

use glam::Vec3;

use crate::geometry::{Camera, Cone, HierarchicalZ, Sphere, Vertex, ViewFrustum};

/// Most vertices of one page. Not much more than clusters fill, since unused memory between pages
/// is fetched with them.
pub const PAGE_VERTICES: usize = 96;
/// Most triangles of one page.
pub const PAGE_TRIANGLES: usize = 96;
/// Bytes of a full page on the device: its vertices, and three 16-bit indices a triangle.
pub const PAGE_BYTES: u64 = (PAGE_VERTICES * size_of::<Vertex>() + PAGE_TRIANGLES * 6) as u64;

/// The shading tolerance applies in full where edges look at least this long, pixels: a wrong shade
/// over one or two pixels is noise, over a large triangle it is a dent.
const FULL_SHADING_PX: f64 = 16.0;

/// Largest deviation of a cut from the original surface.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Screen-space error: distance on screen between any drawn point and the original and back,
    /// pixels.
    pub pixels: f32,
}

/// Content of one page.
#[derive(Clone, Debug, PartialEq)]
pub struct Upload {
    /// The page to write.
    pub page: u32,
    /// Vertices of the page, at most [`PAGE_VERTICES`].
    pub vertices: Vec<Vertex>,
    /// Triangles of the page, at most [`PAGE_TRIANGLES`], as indices into `vertices`.
    pub triangles: Vec<[u8; 3]>,
}

/// Template and morph of a patch that stays on the device ([`vds::ResidentPatches`]).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ResidentPatch {
    /// First index of its template.
    pub first_index: u32,
    /// Fineness of the patch and of its three sides, a byte each.
    pub morph: u32,
}

/// A patch of the current cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct VisiblePatch {
    /// Page that holds the patch, or its number among the resident ones.
    pub page: u32,
    /// Template and morph of a patch that stays on the device; `None` for one in a page.
    pub resident: Option<ResidentPatch>,
    /// Number of triangles in the patch.
    pub triangles: u32,
    /// Bounding sphere of the patch.
    pub sphere: Sphere,
    /// Half extent of the patch's bounding box, which has the centre of the sphere, mm.
    pub half: Vec3,
    /// Cone that contains the normals of all its faces.
    pub cone: Cone,
}

impl VisiblePatch {
    /// Whether any point of the patch may be inside the view frustum.
    pub fn is_inside(&self, frustum: &ViewFrustum) -> bool {
        let centre = self.sphere.centre.as_dvec3() - frustum.position();
        frustum.intersects_box(centre, self.half.as_dvec3())
    }

    /// Whether a patch of a wall seen from within may be seen: it is inside the view frustum, does
    /// not face away, and is not occluded.
    pub fn is_visible(&self, frustum: &ViewFrustum, depths: Option<&HierarchicalZ>) -> bool {
        self.is_inside(frustum)
            && !frustum.is_backfacing(&self.sphere, &self.cone)
            && !depths.is_some_and(|d| d.hides_box(self.sphere.centre, self.half))
    }
}

/// Result of one step: what changed, and what to draw from now on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct LodStep {
    /// Pages to write before anything is drawn.
    pub uploads: Vec<Upload>,
    /// The whole cut, in an order that depends on the cut alone.
    pub drawn: Vec<VisiblePatch>,
    /// Octree leaves whose state changed in this step.
    pub leaves_changed: u32,
    /// Whether no further step would change anything while the camera stays.
    pub settled: bool,
    /// Whether the required cut did not fit the page cache: settled, but coarser than the tolerance
    /// asks.
    pub degraded: bool,
    /// Depths behind which the wall hides from the camera of the step; `None` if the cut is not
    /// within the tolerance, or without an occlusion test.
    pub depths: Option<Arc<HierarchicalZ>>,
}

/// A surface at many resolutions.
pub trait LodHierarchy: Send {
    /// One step from the current cut towards the one for `camera`, within the pages and uploads
    /// that `cache` has left. [`PageCache::begin_step`] must have been called for this step. Once
    /// settled, the cut depends on camera, tolerance and number of pages alone.
    fn step(&mut self, camera: &Camera, tolerance: &Tolerance, cache: &mut PageCache) -> LodStep;

    /// Hash of the current cut: of its content, not of its pages. Equal cuts have equal hashes,
    /// whatever came before.
    fn state_hash(&self) -> u64;

    /// Faces of the whole surface at its finest level.
    fn finest_faces(&self) -> u64;
}
