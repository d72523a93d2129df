//! CPU twin of `scale_pool`: one step of averaging over neighbours.

use rayon::prelude::*;

pub use super::host::scale_pool::{Bindings, Params};
use super::host::scale_pool::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/scale_pool.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    let (energy, _) = s.energy.as_chunks::<5>();
    let (pooled, _) = s.pooled.as_chunks_mut::<5>();
    pooled.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, out)| {
        let edges = s.start[v] as usize..s.start[v + 1] as usize;
        let mut sum = energy[v];
        for (j, w) in s.near[edges.clone()].iter().zip(&s.weight[edges]) {
            let other = &energy[*j as usize];
            for k in 0..5 {
                sum[k] += w * (other[k] - energy[v][k]);
            }
        }
        *out = sum;
    });
}
