//! CPU twin of `scale_restore`: smooth normals with the detail that exceeds noise.

use std::f32::consts::SQRT_2;

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::scale_restore::{Bindings, Params};
use super::host::scale_restore::{SHADER, open};
use super::scale_bands::{ladder, share};
use crate::compute::{CpuArgs, Kernel, Tolerance};

/// See `shaders/scale_restore.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 2e-5, rel: 0.0 },
};

// As in the shader.
const PLANE: [f32; 5] = [0.0, 0.04363, 0.02793, 0.01745, 0.01047];
const TERRACE: [f32; 5] = [0.0, 0.06981, 0.05236, 0.03927, 0.02531];
const SCALE: [f32; 5] = [0.0, 1.0, SQRT_2, 2.0, 2.0 * SQRT_2];

fn noise(n: Vec3, band: usize, p: &Params) -> f32 {
    if band == 0 {
        return p.raw;
    }
    let (mut high, mut widest) = (0.0f32, 0.0f32);
    for (axis, height) in [p.axis_x, p.axis_y, p.axis_z].into_iter().zip(p.terrace) {
        let c = n.dot(Vec3::from_slice(&axis));
        high += (c * axis[3]).powi(2);
        let c = c.abs().min(1.0);
        let slope = (1.0 - c * c).sqrt() / c.max(1e-6);
        let x = ((0.52 - slope * SCALE[band] / axis[3]) / 0.14).clamp(0.0, 1.0);
        widest = widest.max(x * x * (3.0 - 2.0 * x) * height);
    }
    p.terrace[3] * (PLANE[band] * high.sqrt()).max(TERRACE[band] * widest)
}

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let (faired, _) = s.faired.as_chunks_mut::<3>();
    faired.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, out)| {
        let n = ladder(s.normal, s.level, v);
        let (mut sum, mut coarser) = (n[5], Vec3::ZERO);
        for k in (0..5).rev() {
            let t = noise(n[3], k, &p);
            let q = t * t / s.pooled[5 * v + k].max(1e-12);
            let foretold = share(k) * coarser;
            coarser = foretold + (1.0 - q * q).max(0.0) * (n[k] - n[k + 1] - foretold);
            sum += coarser;
        }
        let len = sum.length();
        *out = if len >= 1e-6 { sum / len } else { n[5] }.to_array();
    });
}
