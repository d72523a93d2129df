//! Errors as the user meets them, and their exit codes.

use crate::device::DeviceError;
use crate::flight::{FlightError, ScriptError};
use crate::formats::FormatError;
use crate::lumen::LumenError;
use crate::mesh::{MeshError, ParameterizationError};
use crate::pipeline::PipelineError;
use crate::render::RenderError;
use crate::volume::GridError;

/// What a command fails with.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CliError {
    /// The arguments make no sense together.
    #[error("{0}")]
    Usage(String),
    /// The input is not what the command needs.
    #[error("{0}")]
    Input(String),
    /// A file.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// A stage or the device.
    #[error(transparent)]
    Pipeline(#[from] PipelineError),
    /// A mesh that cannot be worked on.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A parameterisation.
    #[error(transparent)]
    Maps(#[from] ParameterizationError),
    /// The camera path found no place.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// A camera path file.
    #[error(transparent)]
    Script(#[from] ScriptError),
    /// The renderer.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Standard output.
    #[error("standard output: {0}")]
    Output(std::io::Error),
    /// The system.
    #[error("{0}")]
    System(String),
}

impl CliError {
    /// 1 failed, 2 bad arguments, 3 bad input, 4 no usable device.
    pub fn exit_code(&self) -> u8 {
        match self {
            Self::Usage(_) => 2,
            Self::Input(_) | Self::Mesh(_) | Self::Maps(_) | Self::Flight(_) | Self::Script(_) => 3,
            Self::Format(e) | Self::Pipeline(PipelineError::Format(e)) if e.is_bad_input() => 3,
            Self::Pipeline(PipelineError::Lumen(_) | PipelineError::Centerline(_)) => 3,
            Self::Pipeline(PipelineError::Device(e)) if e.is_no_device() => 4,
            Self::Render(e) if e.is_no_device() => 4,
            _ => 1,
        }
    }

    /// Whether standard output was closed by its reader.
    pub fn is_broken_pipe(&self) -> bool {
        matches!(self, Self::Output(e) if e.kind() == std::io::ErrorKind::BrokenPipe)
    }
}

impl From<LumenError> for CliError {
    fn from(e: LumenError) -> Self {
        Self::Pipeline(e.into())
    }
}

impl From<DeviceError> for CliError {
    fn from(e: DeviceError) -> Self {
        Self::Pipeline(e.into())
    }
}

impl From<GridError> for CliError {
    fn from(e: GridError) -> Self {
        Self::Usage(e.to_string())
    }
}
