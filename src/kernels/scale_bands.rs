//! CPU twin and cases of `scale_bands`: energy of each band's residual after prediction from the
//! coarser band.

use glam::{Vec3, Vec4};
use rayon::prelude::*;

pub use super::host::scale_bands::{Bindings, Params};
use super::host::scale_bands::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/scale_bands.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
    cases,
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

/// Returns normals that oscillate, and smoothed ones that oscillate less.
pub(super) fn swinging(vertices: usize) -> (Vec<f32>, Vec<[f32; 4]>) {
    let at = |v: usize, swing: f32| {
        let a = v as f32 * 0.01;
        let b = swing * (v as f32 * 2.3).sin();
        Vec3::new(a.cos(), a.sin(), b).normalize()
    };
    let normal = (0..vertices).flat_map(|v| at(v, 0.3).to_array()).collect();
    let level = (0..5)
        .flat_map(|l| {
            (0..vertices).map(move |v| at(v, 0.2 / (1 << l) as f32).extend(0.0).to_array())
        })
        .collect();
    (normal, level)
}

fn cases() -> Vec<Case> {
    let case = |name, (normal, level): (Vec<f32>, Vec<[f32; 4]>)| {
        let vertices = normal.len() / 3;
        let mut plan = Plan::new();
        let normal = plan.upload_owned("normal", &normal);
        let level = plan.upload_owned("level", &level);
        let energy = plan.zeroed::<f32>("energy", 5 * vertices);
        let params = Params { vertices: vertices as u32 };
        let bindings = Bindings { normal, level, energy };
        plan.launch(&KERNEL, bindings, params, vertices, vertices);
        plan.download(energy);
        Case { name, plan }
    };
    let flat = (vec![0.0, 0.0, 1.0], vec![[0.0; 4]; 5]);
    vec![
        case("empty", swinging(0)),
        case("smoothed to nothing", flat),
        case("65 vertices", swinging(65)),
        case("5000 vertices", swinging(5000)),
    ]
}
