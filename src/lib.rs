//! Virtual endoscopy: from a CT or MR volume to a flight through a hollow organ inside it.
//!
//! A [`session::Session`] drives everything. Ask it for a *product* (lumen, distance field,
//! centerline, wall, flight, frames, coverage) and it computes what that needs, once:
//!
//! ```
//! use std::sync::Arc;
//! use intima::session::{Session, Settings, Source, VolumeSource};
//! use intima::volume::phantom::{Kind, Phantom};
//!
//! let mask = Phantom::new(Kind::Bend, 48, [1.0; 3])?.mask();
//! let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
//! let session = Session::new(source, Settings::default())?;
//! let centerline = session.centerline()?;
//! println!("{:.1} mm, {:.2} mm off the wall", centerline.line.length_mm(), centerline.min_clearance_mm);
//! assert!(centerline.min_clearance_mm > 0.0);
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```
//!
//! [`session::stages::STAGES`] is the table of what needs what. `examples/fly.rs` goes from a file
//! to frames, `examples/stages.rs` asks for single products.
//!
//! Modules stand in the order the data takes; each imports only from those above it. Lengths are
//! millimetres and points are in patient space, LPS (x to the left, y to the back, z to the head).
//! Errors are one enum a module. Plans run on the CPU ([`compute`]) or on Vulkan ([`vk`]); only
//! drawing needs Vulkan. Without the feature `cli` the crate is a library alone.
//!
//! **Research and education only. Not a medical device. Not for diagnosis.**
pub mod fault;
pub mod task;
pub mod volume;
pub mod geometry;
pub mod formats;
pub mod lumen;
pub mod compute;
pub mod kernels;
pub mod field;
pub mod organ;
pub mod centerline;
pub mod surface;
pub mod wall;
pub mod mesh;
pub mod lod;
pub mod behind;
pub mod flight;
pub mod vk;
pub mod render;
pub mod device;
pub mod paper;
pub mod session;
pub mod report_page;
#[cfg(feature = "cli")]
pub mod cohort;
#[cfg(feature = "window")]
pub mod app;
#[cfg(feature = "cli")]
pub mod cli;
