//! The chain as calls: stages build plans, this room runs them on a device, reads back and goes
//! on. It also keeps the stage clock, the memory estimate and the report.

mod beside;
mod chain;
mod clock;
pub mod copy;
pub mod detail;
mod error;
mod fields;
mod memory;
mod report;
mod surface;

pub use crate::vk::return_freed_memory;
pub use beside::beside;
pub use chain::{Centered, Mode, Seen, Settings, centered, paper_centered, route, seen};
pub use clock::{Clock, Stage};
pub use detail::{Detail, Lod};
pub use error::PipelineError;
pub use fields::{Fields, distance_field, fields, hessian_field, volume_as_bricks};
pub use memory::{estimate_bytes, peak_memory_mb, refuse_above, reset_peak};
pub use report::{
    CenterlineReport, FramesReport, InputReport, LumenReport, Modes, Report, SurfaceReport,
};
pub use surface::{SurfaceOptions, Wall, faired, gradient_normals, wall};
