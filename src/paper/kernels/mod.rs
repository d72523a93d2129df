//! Kernels of the paper's chain: the ridge test, and compaction of what it marks.

pub mod compact_count;
pub mod compact_scatter;
pub mod prefix_sum;
pub mod ridge_mark;
pub mod ridge_measure;

use crate::compute::Kernel;

/// All of them.
pub static ALL: &[&Kernel] = &[
    &ridge_mark::KERNEL,
    &compact_count::KERNEL,
    &prefix_sum::KERNEL,
    &compact_scatter::KERNEL,
    &ridge_measure::KERNEL,
];
