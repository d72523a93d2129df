#![doc = include_str!("../ARCHITECTURE.md")]
// Rooms stand in the order the data takes; a room imports only rooms above it (`cargo xtask check`).
pub mod fault;
pub mod volume;
pub mod geometry;
pub mod formats;
pub mod lumen;
pub mod compute;
pub mod kernels;
pub mod field;
pub mod centerline;
pub mod surface;
pub mod vk;
pub mod render;
pub mod device;
