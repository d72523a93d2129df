#![doc = include_str!("../ARCHITECTURE.md")]
// Rooms stand in the order the data takes; a room imports only rooms above it (`cargo xtask check`).
pub mod compute;
pub mod device;
pub mod fault;
pub mod field;
pub mod formats;
pub mod geometry;
pub mod kernels;
pub mod lumen;
pub mod render;
pub mod vk;
pub mod volume;
