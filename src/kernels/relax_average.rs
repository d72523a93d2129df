//! CPU twin of `relax_average`: one step of averaging over neighbours.

use rayon::prelude::*;

pub use super::host::relax_average::{Bindings, Params};
use super::host::relax_average::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/relax_average.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    s.average.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, out)| {
        let near = &s.near[s.start[v] as usize..s.start[v + 1] as usize];
        let own = s.value[v];
        let mut sum = 0.0;
        for j in near {
            sum += s.value[*j as usize];
        }
        *out = if near.is_empty() { own } else { 0.5 * (own + sum / near.len() as f32) };
    });
}
