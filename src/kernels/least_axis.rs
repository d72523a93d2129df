//! CPU twin of `least_axis`: the minimum within a radius, in voxels, along an axis.

use rayon::prelude::*;

use super::blocks::{element, place};
pub use super::host::least_axis::{Bindings, Params};
use super::host::least_axis::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/least_axis.wgsl`.
pub static KERNEL: Kernel =
    Kernel { shader: &SHADER, twin, unit: "voxels", tolerance: Tolerance { abs: 0.0, rel: 0.0 } };

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let (axis, radius) = (p.axis as usize, p.radius);
    let stride = [1, 8, 64][axis];
    s.g.par_chunks_exact_mut(BRICK).enumerate().with_min_len(8).for_each(|(slot, out)| {
        crate::task::checkpoint();
        // The line through each row of voxels along the axis, with the radius at both ends.
        let mut line = [i32::MAX; 24];
        for start in (0..BRICK).filter(|l| l / stride % 8 == 0) {
            for (i, v) in line.iter_mut().take((8 + 2 * radius) as usize).enumerate() {
                let mut q = place(start);
                q[axis] = i as i32 - radius;
                *v = element(s.near, slot, q).map_or(i32::MAX, |e| s.f[e]);
            }
            for at in 0..8 {
                let around = &line[at..=at + 2 * radius as usize];
                out[start + at * stride] = around.iter().copied().min().unwrap_or(i32::MAX);
            }
        }
    });
}
