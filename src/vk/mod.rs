//! Vulkan: one [`Gpu`] owns everything and runs [`Plan`](crate::compute::Plan)s and draw passes.
//!
//! All `unsafe` of the program is in this room, and no Vulkan type leaves it. Handles are keys of
//! slot maps, owned once. Resources that are freed while the device may still use them are retired
//! (`retire`): they wait in a queue until the timeline has reached their last use. A frame is
//! checked before anything of it is recorded (`check`), plans run with `robustBufferAccess`. `Gpu`
//! goes down in this order: device idle, resources, pipelines, allocator, device, instance.
#![allow(unsafe_code)]

mod arena;
mod cache;
mod check;
mod commands;
mod counts;
mod device;
mod draw;
mod draw_pipeline;
mod error;
mod frame;
mod gpu;
mod hazards;
mod ids;
mod info;
mod instance;
mod memory;
mod passes;
mod pieces;
mod pipeline;
mod plan_memory;
mod plan_pools;
mod presentation;
mod process;
mod resources;
mod retire;
mod rates;
mod runner;
mod spirv;
mod staging;
mod timeline;
mod transfers;

/// Pipeline stages and kinds of access of one side of a barrier.
type StageAccess = (ash::vk::PipelineStageFlags2, ash::vk::AccessFlags2);

pub use counts::PlanCounts;
pub use draw::{Area, Draw, DrawRange, IndexedRange, Pass};
pub use draw_pipeline::{Attribute, Blend, DepthUse, DrawEntry, DrawShader, DrawSpec};
pub use error::VkError;
pub use frame::{Frame, FrameOptions, ImageWrite, Write};
pub use gpu::{Gpu, OpenOptions};
pub use ids::{BufferId, DrawPipelineId, ImageId};
pub use info::{Choice, DeviceInfo, DeviceKind, MemoryHeap, list};
pub use instance::{Validate, all_validation_messages};
pub use presentation::WindowHandles;
pub use process::{
    ThreadsError, exit_now, return_freed_memory, set_lavapipe_threads, survive_file_size_limit,
};
pub use resources::{Format, ImageSpec};
pub use retire::Releaser;
pub use runner::RunOptions;
pub use staging::STAGING_BYTES;
