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
