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
