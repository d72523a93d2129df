//! One file a kernel: its bindings (generated from the shader of the same name) and its CPU twin.
//! [`ALL`] lists them; `tests/gpu/cases` runs each on both sides.

mod blocks;
pub mod blur_axis;
pub mod copy;
pub mod edt_axis;
pub mod edt_rows;
pub mod fair;
pub mod gauss_axis;
pub mod halo;
pub mod hessian;
pub mod least_axis;
pub mod relax_average;
pub mod relax_coefficients;
pub mod relax_guard;
pub mod relax_step;
pub mod ridge_grow;
pub mod scale_bands;
pub mod scale_pool;
pub mod scale_restore;
pub mod scale_step;
pub mod visibility;
pub mod wall_correct;
pub mod wall_level;
pub mod wall_peak;
pub mod wall_sides;

use crate::compute::Kernel;
use crate::lumen::bricks::{NONE, near_index};

/// Host side of every shader, written by the build script from naga's reflection.
#[allow(missing_docs, dead_code, clippy::all)]
pub mod host {
    include!(concat!(env!("OUT_DIR"), "/kernels.rs"));
}

/// All kernels but those of the paper's chain.
pub static ALL: &[&Kernel] = &[
    &edt_rows::KERNEL,
    &edt_axis::KERNEL,
    &gauss_axis::KERNEL,
    &blur_axis::KERNEL,
    &least_axis::KERNEL,
    &ridge_grow::KERNEL,
    &wall_peak::KERNEL,
    &wall_level::KERNEL,
    &wall_sides::KERNEL,
    &wall_correct::KERNEL,
    &hessian::KERNEL,
    &visibility::KERNEL,
    &fair::KERNEL,
    &scale_step::KERNEL,
    &scale_bands::KERNEL,
    &scale_pool::KERNEL,
    &scale_restore::KERNEL,
    &relax_coefficients::KERNEL,
    &relax_step::KERNEL,
    &relax_average::KERNEL,
    &relax_guard::KERNEL,
    &copy::KERNEL,
];

/// Returns the neighbouring slot of `slot` along an axis, from the flat neighbour table kernels
/// bind.
#[inline]
fn neighbour(near: &[u32], slot: usize, axis: usize, up: bool) -> Option<usize> {
    const AT: [[usize; 2]; 3] = [
        [near_index(-1, 0, 0), near_index(1, 0, 0)],
        [near_index(0, -1, 0), near_index(0, 1, 0)],
        [near_index(0, 0, -1), near_index(0, 0, 1)],
    ];
    match near[slot * 27 + AT[axis][usize::from(up)]] {
        NONE => None,
        s => Some(s as usize),
    }
}
