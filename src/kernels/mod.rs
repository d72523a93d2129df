//! One file a kernel: its bindings (generated from the shader of the same name), its CPU twin and
//! its test cases. [`ALL`] lists them.

pub mod fair;

use crate::compute::Kernel;

/// Host side of every shader, written by the build script from naga's reflection.
#[allow(missing_docs, dead_code, clippy::all)]
pub mod host {
    include!(concat!(env!("OUT_DIR"), "/kernels.rs"));
}

/// Every kernel there is.
pub static ALL: &[&Kernel] = &[&fair::KERNEL];
