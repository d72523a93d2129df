//! CPU twin of `relax_step`: one step of the relaxed wall.

use rayon::prelude::*;

pub use super::host::relax_step::{Bindings, Params};
use super::host::relax_step::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/relax_step.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let places = s.place.par_iter_mut().zip(s.next.par_iter_mut());
    places.enumerate().with_min_len(4096).for_each(|(v, (place, next))| {
        let edges = s.start[v] as usize..s.start[v + 1] as usize;
        let [offset, most] = s.bound[v];
        let mut sum = 0.5 * s.now[v] - offset;
        for (j, c) in s.near[edges.clone()].iter().zip(&s.coupling[edges]) {
            sum += c * s.now[*j as usize];
        }
        let z = sum.max(-most).min(most);
        *next = z + p.momentum * (z - *place);
        *place = z;
    });
}
