//! The window: a [`Session`](crate::session::Session) computes, hands fly. It owns no stage.
//!
//! `model` holds the state and carries out actions; `ui` lays panels out and turns input into
//! actions; `panes` draws the two pictures of the wall; `stage` puts a frame together from these,
//! onto a window (`window`) or onto an image with a clock of its own (`script`).

mod action;
mod colouring;
mod export;
mod inside_marks;
mod junctions;
mod keys;
mod measure;
mod model;
mod painter;
mod panes;
mod script;
mod session_file;
mod side_panel;
mod slice_pane;
mod slices;
mod stage;
mod study;
mod timeline;
mod ui;
mod window;

pub use action::{
    Action, Colouring, Export, FOV_DEG, LumenChoice, Pane, Ruler, SPEED_MM_S, WallView,
};
pub use junctions::Choice;
pub use measure::Measurement;
pub use model::{Bookmark, Model, Products};
pub use painter::{Painter, Shown};
pub use script::Playing;
pub use script::{SCRIPT_SCHEMA, Script, ScriptStep, Wait, play};
pub use session_file::{SESSION_SCHEMA, SessionFile};
pub use study::{Case, News, Study};
pub use window::{WindowOptions, open};

use std::path::PathBuf;

use crate::formats::{FormatError, shown};
use crate::render::RenderError;
use crate::session::SessionError;
use crate::vk::VkError;

/// Why a window cannot be opened or goes down, or a script cannot be played.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum AppError {
    /// There is no display to open a window on.
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
        /// Which step, from 1.
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
        let lost = |e: &VkError| matches!(e, VkError::DeviceLost { .. });
        match self {
            Self::Vulkan(e) => lost(e),
            Self::Render(RenderError::Vulkan(e)) => lost(e),
            Self::Session(SessionError::Render(RenderError::Vulkan(e))) => lost(e),
            _ => false,
        }
    }
}
