//! Everything a session can fail with.

use std::path::PathBuf;

use super::{Product, SettingError};
use crate::behind::TissueError;
use crate::centerline::CenterlineError;
use crate::device::DeviceError;
use crate::flight::{CameraPathError, FlightError};
use crate::formats::{FormatError, shown};
use crate::lod::vds::VdsError;
use crate::lumen::{LumenError, VoxelizeError};
use crate::mesh::{MeshError, ParameterizationError};
use crate::organ::{Organ, OrganError};
use crate::render::RenderError;
use crate::surface::RelaxError;
use crate::wall::WallError;

/// Why a product could not be made.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum SessionError {
    /// A file.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// The choice of the lumen.
    #[error(transparent)]
    Lumen(#[from] LumenError),
    /// No such organ in the volume.
    #[error(transparent)]
    Organ(#[from] OrganError),
    /// The wall field.
    #[error(transparent)]
    Wall(#[from] WallError),
    /// A wall that cannot be relaxed.
    #[error(transparent)]
    Relax(#[from] RelaxError),
    /// The centerline.
    #[error(transparent)]
    Centerline(#[from] CenterlineError),
    /// The device.
    #[error(transparent)]
    Device(DeviceError),
    /// A surface that cannot be subdivided.
    #[error(transparent)]
    Subdivision(#[from] VdsError),
    /// A mesh that half-edges cannot hold.
    #[error(transparent)]
    Mesh(#[from] MeshError),
    /// A parameterisation.
    #[error(transparent)]
    Maps(#[from] ParameterizationError),
    /// The tissue behind the wall.
    #[error(transparent)]
    Tissue(#[from] TissueError),
    /// The flight.
    #[error(transparent)]
    Flight(#[from] FlightError),
    /// A camera path file.
    #[error(transparent)]
    CameraPath(#[from] CameraPathError),
    /// The renderer.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// A setting out of its range.
    #[error(transparent)]
    Setting(#[from] SettingError),
    /// A grid whose axes are not orthogonal.
    #[error("{name}: the grid's axes are not orthogonal (sheared); distances would be wrong")]
    ShearedGrid {
        /// Name of the volume.
        name: String,
    },
    /// A mesh that encloses no lumen.
    #[error("{name}: {why}")]
    Enclosed {
        /// Name of the mesh.
        name: String,
        /// Fault of the mesh.
        why: VoxelizeError,
    },
    /// A volume from which nothing says how to choose a lumen.
    #[error(
        "{name}: not a label map, so the lumen must be chosen: by a label map, \
         by a threshold with a seed, or by a threshold alone for the largest component{}",
        .organ.map_or(String::new(), |o| format!("; it seems to show a lumen of this organ: {}", o.name()))
    )]
    LumenNotChosen {
        /// Name of the volume.
        name: String,
        /// Organ that was found in the volume.
        organ: Option<Organ>,
    },
    /// A product that no stage makes with the session's settings.
    #[error("{product:?} cannot be made with {settings}")]
    Unavailable {
        /// Requested product.
        product: Product,
        /// Settings that decide which products there are, with their values.
        settings: String,
    },
    /// Another run is writing into the same folder.
    #[error("{}: another run is writing into this folder", shown(.folder))]
    FolderInUse {
        /// Path of the folder.
        folder: PathBuf,
    },
    /// More memory than allowed.
    #[error("this needs about {needed_mb} MB, more than the {allowed_mb} MB allowed ({what})")]
    Memory {
        /// Estimate, MB.
        needed_mb: u64,
        /// Limit, MB.
        allowed_mb: u64,
        /// Data that take the memory.
        what: &'static str,
    },
    /// Stopped before it was done, because someone asked for it.
    #[error("cancelled")]
    Cancelled,
    /// The system gave no thread, or took one away.
    #[error("{0}")]
    System(String),
}

impl SessionError {
    /// Whether the device went away: another one may do.
    pub fn is_device_lost(&self) -> bool {
        match self {
            Self::Render(RenderError::Vulkan(e)) | Self::Device(DeviceError::Vulkan(e)) => {
                e.is_lost()
            }
            _ => false,
        }
    }
}

impl From<DeviceError> for SessionError {
    fn from(e: DeviceError) -> Self {
        match e {
            DeviceError::Cancelled => Self::Cancelled,
            other => Self::Device(other),
        }
    }
}
