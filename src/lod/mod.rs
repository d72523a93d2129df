//! Level of detail: which patches of which fineness a camera needs, and what has to be uploaded.
//!
//! A [`Refine`] owns a surface at many levels. It is asked step by step for the cut that a camera
//! wants and answers with patches to be written into pages and the list of pages to be drawn. A
//! cut always covers the whole surface, coarsely where the camera does not look, so that a late
//! answer shows less detail but never a hole; what lies outside the frustum is culled when drawn.

pub mod clusters;
mod eye;
pub mod octree;
mod outside;
mod pool;
pub mod vds;
mod worker;

pub use eye::{Camera, Cone, Eye, Sphere, Spot};
pub use outside::{Cells, Outside};
pub use pool::{Full, Pool};
pub use worker::{Worker, WorkerError};

use crate::geometry::Vertex;

/// Vertices of one page, at most: not much more than what pages hold, since memory between them is
/// brought in with them.
pub const PAGE_VERTICES: usize = 96;
/// Triangles of one page, at most.
pub const PAGE_TRIANGLES: usize = 96;
/// Bytes of a full page on the device: vertices, and three 16-bit indices a triangle.
pub const PAGE_BYTES: u64 = (PAGE_VERTICES * size_of::<Vertex>() + PAGE_TRIANGLES * 6) as u64;

/// How far a cut may be from the original.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Tolerance {
    /// Distance on screen between any drawn point and the original, both ways, pixels.
    pub pixels: f32,
}

/// Content of one page.
#[derive(Clone, Debug, PartialEq)]
pub struct Upload {
    /// Where it goes.
    pub page: u32,
    /// At most [`PAGE_VERTICES`].
    pub vertices: Vec<Vertex>,
    /// At most [`PAGE_TRIANGLES`], each three places in `vertices`.
    pub triangles: Vec<[u8; 3]>,
}

/// A resident patch of the cut.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Drawn {
    /// Its page.
    pub page: u32,
    /// Triangles in it.
    pub triangles: u32,
    /// Holds all of it.
    pub sphere: Sphere,
    /// Holds the normals of all its faces.
    pub cone: Cone,
}

/// Answer to one step: what changed, and what is to be drawn from now on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Step {
    /// To be written before anything is drawn.
    pub uploads: Vec<Upload>,
    /// The whole cut, in an order that depends on nothing but the cut.
    pub drawn: Vec<Drawn>,
    /// Octree leaves whose state changed in this step.
    pub leaves_changed: u32,
    /// No further step would change anything while the camera stays.
    pub settled: bool,
    /// The wanted cut did not fit the pages: settled, but coarser than asked for.
    pub degraded: bool,
}

/// A surface at many levels of detail.
pub trait Refine: Send {
    /// One step from the current cut towards the one for `camera`, within what `pool` can give.
    /// [`Pool::begin`] has been called for this step. Once settled, the cut depends on nothing but
    /// camera, tolerance and number of pages.
    fn step(&mut self, camera: &Camera, tolerance: &Tolerance, pool: &mut Pool) -> Step;

    /// A number that says which cut is drawn now: content, not pages. Equal cuts give equal
    /// numbers whatever came before.
    fn state_hash(&self) -> u64;

    /// Faces of the whole surface at its finest.
    fn finest_faces(&self) -> u64;
}
