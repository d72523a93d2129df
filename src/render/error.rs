//! Errors of drawing.

use crate::vk::VkError;

/// An error of the render room.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// A Vulkan call failed.
    #[error(transparent)]
    Vulkan(#[from] VkError),
    /// A face names a vertex that is not there.
    #[error("face {face} names vertex {vertex}, the mesh has {vertices}")]
    BadFace {
        /// Index of the face.
        face: usize,
        /// Vertex index that the face names.
        vertex: u32,
        /// Number of vertices of the mesh.
        vertices: usize,
    },
    /// A wall of that many pages cannot be made.
    #[error("a wall of {pages} pages (1 to {max} can be made)", max = super::MAX_PAGES)]
    BadPages {
        /// Number of pages asked for.
        pages: u32,
    },
    /// An upload does not fit a page, or names a vertex that it lacks.
    #[error("page {page} of {pages} cannot hold {triangles} triangles of {vertices} vertices")]
    BadUpload {
        /// Index of the page.
        page: u32,
        /// Number of pages of the wall.
        pages: usize,
        /// Number of vertices sent.
        vertices: usize,
        /// Number of triangles sent.
        triangles: usize,
    },
    /// More triangles of a page are to be drawn than it holds.
    #[error("page {page} is to draw {triangles} triangles and holds {there}")]
    EmptyPage {
        /// Index of the page.
        page: u32,
        /// Number of triangles to be drawn.
        triangles: u32,
        /// Number of triangles in the page.
        there: u32,
    },
    /// A patch is to be drawn that does not lie on the device.
    #[error("patch {patch} of {patches} is to draw {triangles} triangles that it does not have")]
    NoPatch {
        /// Number of the patch.
        patch: u32,
        /// Number of patches on the device.
        patches: u32,
        /// Number of triangles to be drawn.
        triangles: u32,
    },
    /// Level of detail failed.
    #[error(transparent)]
    Detail(#[from] crate::lod::WorkerError),
    /// The frame's size cannot be drawn.
    #[error("a frame of {width} x {height} at {samples} samples cannot be drawn")]
    BadSize {
        /// Number of columns.
        width: u32,
        /// Number of rows.
        height: u32,
        /// Number of samples a pixel: 1 or 4 are possible.
        samples: u32,
    },
}

impl RenderError {
    /// Whether the machine has no device to draw on (exit code 4).
    pub fn is_no_device(&self) -> bool {
        matches!(self, Self::Vulkan(e) if e.is_no_device())
    }
}
