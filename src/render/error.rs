//! What can go wrong while drawing.

use crate::vk::VkError;

/// An error of the render room.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// From Vulkan.
    #[error(transparent)]
    Vulkan(#[from] VkError),
    /// A face names a vertex that is not there.
    #[error("face {face} names vertex {vertex}, the mesh has {vertices}")]
    BadFace {
        /// Index of the face.
        face: usize,
        /// The vertex it names.
        vertex: u32,
        /// Vertices of the mesh.
        vertices: usize,
    },
    /// A wall of that many pages cannot be made.
    #[error("a wall of {pages} pages (1 to {max} can be made)", max = super::MAX_PAGES)]
    BadPages {
        /// Pages asked for.
        pages: u32,
    },
    /// What is to be written does not fit a page, or names a vertex that is not there.
    #[error("page {page} of {pages} cannot hold {triangles} triangles of {vertices} vertices")]
    BadUpload {
        /// The page named.
        page: u32,
        /// Pages there are.
        pages: usize,
        /// Vertices sent.
        vertices: usize,
        /// Triangles sent.
        triangles: usize,
    },
    /// A page is to be drawn that does not hold so much.
    #[error("page {page} is to draw {triangles} triangles and holds {there}")]
    EmptyPage {
        /// The page named.
        page: u32,
        /// Triangles to be drawn.
        triangles: u32,
        /// Triangles in it.
        there: u32,
    },
    /// Level of detail failed.
    #[error(transparent)]
    Detail(#[from] crate::lod::WorkerError),
    /// The frame's size cannot be drawn.
    #[error("a frame of {width} x {height} at {samples} samples cannot be drawn")]
    BadSize {
        /// Columns asked for.
        width: u32,
        /// Rows asked for.
        height: u32,
        /// Samples asked for: 1 or 4.
        samples: u32,
    },
}

impl RenderError {
    /// Whether the machine has no device to draw on (exit code 4).
    pub fn is_no_device(&self) -> bool {
        matches!(self, Self::Vulkan(e) if e.is_no_device())
    }
}
