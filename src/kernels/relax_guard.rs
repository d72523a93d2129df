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
        let allowed = 0.15 - 0.1 * ((s.bend[v] - 0.15) / 0.15).clamp(0.0, 1.0);
        let excess = s.shift[v] - s.shift[v].clamp(-allowed, allowed);
        let most = s.bound[v][1];
        *place = (*place - excess).clamp(-most, most);
    });
}
