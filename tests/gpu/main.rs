//! Vulkan: kernels beside their CPU twins, pictures, validation, planted faults.

mod all_round;
mod behind;
mod cases;
mod compare;
mod contrast;
mod golden;
mod lod_draw;
mod lod_occlusion;
mod lod_patches;
mod oracle_distance;
mod oracle_fair;
mod oracle_ridge;
mod parity;
mod pieces;
mod plan_memory;
mod twins;
mod vulkan;
