//! Why a window cannot be opened or goes down, or a script cannot be played.

use std::path::PathBuf;

use crate::formats::{FormatError, shown};
use crate::render::RenderError;
use crate::session::SessionError;
use crate::vk::VkError;

/// Why a window cannot be opened or goes down, or a script cannot be played.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AppError {
    /// No display to open a window on.
    #[error("no display: {0}")]
    NoDisplay(String),
    /// A stage, or the level-of-detail thread.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// Vulkan.
    #[error(transparent)]
    Vulkan(#[from] VkError),
    /// Drawing.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A file.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// An invalid script.
    #[error("step {step} of the script: {what}")]
    Script {
        /// Number of the step, from 1.
        step: usize,
        /// The fault.
        what: String,
    },
    /// An invalid session file, or one of another volume.
    #[error("{}: {what}", shown(.path))]
    SessionFile {
        /// The file.
        path: PathBuf,
        /// The fault.
        what: String,
    },
}

impl AppError {
    /// Whether the device went away: another one may do.
    pub fn is_device_lost(&self) -> bool {
        match self {
            Self::Vulkan(e) => e.is_lost(),
            Self::Render(RenderError::Vulkan(e)) => e.is_lost(),
            Self::Session(e) => e.is_device_lost(),
            _ => false,
        }
    }
}
