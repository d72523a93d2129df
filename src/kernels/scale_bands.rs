//! CPU twin of `scale_bands`: energy of each band's residual after prediction from the
//! coarser band.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

pub use super::host::scale_bands::{Bindings, Params};
use super::host::scale_bands::{SHADER, open};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/scale_bands.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
};

/// Returns the unit normals of a vertex at six scales, finest first.
pub(super) fn ladder(normal: &[f32], level: &[[f32; 4]], v: usize) -> [Vec3; 6] {
    let raw = Vec3::from_slice(&normal[3 * v..]);
    let mut out = [raw; 6];
    for (l, n) in out.iter_mut().skip(1).enumerate() {
        let u = Vec4::from_array(level[l * normal.len() / 3 + v]).truncate();
        let len = u.length();
        *n = if len >= 1e-12 { u / len } else { raw };
    }
    out
}

/// Returns the share of a coarser band by which the next finer one is predicted.
pub(super) fn share(band: usize) -> f32 {
    if band == 0 { 1.0 } else { 0.5 }
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    let (energy, _) = s.energy.as_chunks_mut::<5>();
    energy.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, out)| {
        let n = ladder(s.normal, s.level, v);
        for (k, e) in out.iter_mut().enumerate() {
            let coarser = if k < 4 { share(k) * (n[k + 1] - n[k + 2]) } else { Vec3::ZERO };
            *e = (n[k] - n[k + 1] - coarser).length_squared();
        }
    });
}
