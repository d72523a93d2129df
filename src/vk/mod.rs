//! Vulkan: one [`Gpu`] owns everything and runs [`Plan`](crate::compute::Plan)s and draw passes.
//!
//! All `unsafe` of the program is in this room, and no Vulkan type leaves it. Handles are plain
//! and owned once; what is freed while the device may still use it waits in a retire queue until
//! the timeline has passed its last use. `Gpu` goes down in this order: device idle, retired
//! things, pipelines, allocator, device, instance.
#![allow(unsafe_code)]

mod cache;
mod commands;
mod device;
mod draw;
mod draw_pipeline;
mod error;
mod frame;
mod gpu;
mod heap;
mod info;
mod instance;
mod memory;
mod passes;
mod pipeline;
mod resources;
mod retire;
mod runner;
mod slab;
mod spirv;
mod staging;
mod threads;
mod timeline;
mod written;

pub use draw::{Area, Draw, Pass, Piece, Take};
pub use draw_pipeline::{Attribute, Blend, DepthUse, DrawPipeline, DrawPipelineId, DrawSpec};
pub use error::VkError;
pub use frame::{Frame, FrameOptions, Write};
pub use gpu::{Gpu, OpenOptions};
pub use heap::return_freed_memory;
pub use info::{Choice, DeviceInfo, DeviceKind, MemoryHeap, list};
pub use instance::Validate;
pub use resources::{BufferId, Format, GpuBuffer, GpuImage, ImageId, ImageSpec};
pub use retire::Releaser;
pub use runner::RunOptions;
pub use slab::Handle;
pub use staging::STAGING_BYTES;
pub use threads::set_lavapipe_threads;
