//! CPU twin of `relax_guard`: limits the low-pass shift of the relaxed wall.

use rayon::prelude::*;

pub use super::host::relax_guard::{Bindings, Params};
use super::host::relax_guard::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/relax_guard.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    s.place.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, place)| {
        // Not `clamp`, which panics where a limit is not a number.
        let within = |x: f32, least: f32, most: f32| x.max(least).min(most);
        let allowed = 0.15 - 0.1 * within((s.bend[v] - 0.15) / 0.15, 0.0, 1.0);
        let excess = s.shift[v] - within(s.shift[v], -allowed, allowed);
        let most = s.bound[v][1];
        *place = within(*place - excess, -most, most);
    });
}
