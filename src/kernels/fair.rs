//! CPU twin of `fair`: one step of normals-only Laplacian smoothing.

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::fair::{Bindings, Params};
use super::host::fair::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/fair.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let at = |v: usize| Vec3::from_slice(&s.normal[3 * v..]);
    let step = |v: usize, out: &mut [f32]| {
        let edges = s.start[v] as usize..s.start[v + 1] as usize;
        let sum: Vec3 = edges.map(|e| s.weight[e] * at(s.near[e] as usize)).sum();
        let n = (1.0 - p.lambda) * at(v) + p.lambda * sum;
        let len = n.length();
        let n = if len >= 1e-6 { n / len } else { at(v) };
        out.copy_from_slice(&n.to_array());
    };
    let chunk = 4096;
    s.faired.par_chunks_mut(3 * chunk).enumerate().for_each(|(c, out)| {
        crate::task::checkpoint();
        for (i, out) in out.chunks_exact_mut(3).enumerate() {
            step(c * chunk + i, out);
        }
    });
}
