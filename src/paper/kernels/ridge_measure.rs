//! CPU twin of `ridge_measure`: the eigen-analysis of each candidate.

use glam::Vec3;
use rayon::prelude::*;

use super::ridge_mark::ridge;
use crate::compute::{CpuArgs, Kernel, Tolerance};
use crate::kernels::halo::Halo;
pub use crate::kernels::host::ridge_measure::{Bindings, Params};
use crate::kernels::host::ridge_measure::{SHADER, open};
use crate::lumen::bricks::BRICK;

/// Number of floats of a candidate.
pub const STRIDE: usize = 12;

/// See `shaders/ridge_measure.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "candidates",
    tolerance: Tolerance { abs: 2e-3, rel: 1e-3 },
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let n = (s.total[p.slots as usize]).min(p.capacity) as usize;
    let h = Vec3::from(p.spacing_mm);
    s.measure[..n * STRIDE].par_chunks_exact_mut(STRIDE).zip(&s.list[..n]).for_each(|(out, &e)| {
        crate::task::checkpoint();
        let e = e as usize;
        let halo = Halo::gather(s.near, s.f, e / BRICK);
        let r = ridge(&halo, e % BRICK, h);
        out[..3].copy_from_slice(&r.offset_mm.to_array());
        out[3] = s.d[e];
        out[4..7].copy_from_slice(&r.axis.to_array());
        out[7] = r.gradient;
        out[8..11].copy_from_slice(&r.values.to_array());
    });
}
