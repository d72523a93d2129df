//! Everything a chain can fail with.

use crate::centerline::CenterlineError;
use crate::device::DeviceError;
use crate::formats::FormatError;
use crate::lod::clusters::ClusterError;
use crate::lod::vds::VdsError;
use crate::lumen::LumenError;
use crate::mesh::{MeshError, ParameterizationError};

/// Why a chain stopped.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum PipelineError {
    /// A file.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The choice of the lumen.
    #[error(transparent)]
    Lumen(#[from] LumenError),
    /// The centerline.
    #[error(transparent)]
    Centerline(#[from] CenterlineError),
    /// The device.
    #[error(transparent)]
    Device(#[from] DeviceError),
    /// Clusters of a mesh.
    #[error(transparent)]
    Clusters(#[from] ClusterError),
    /// A surface that cannot be subdivided.
    #[error(transparent)]
    Subdivision(#[from] VdsError),
    /// A mesh that half-edges cannot hold.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A parameterisation.
    #[error(transparent)]
    Maps(#[from] ParameterizationError),
    /// More memory than allowed.
    #[error("this needs about {needed_mb} MB, more than --max-memory {allowed_mb} MB ({what})")]
    Memory {
        /// Estimate, MB.
        needed_mb: u64,
        /// Limit, MB.
        allowed_mb: u64,
        /// What takes it.
        what: &'static str,
    },
}
