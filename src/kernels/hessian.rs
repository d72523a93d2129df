//! CPU twin and cases of `hessian`: eigenvalues or a response over a whole field.

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::hessian::{Bindings, Params};
use super::host::hessian::{SHADER, open};
use super::ridge_mark::{Halo, eigen};
use super::{cases_on_bricks, smooth_distance};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// See `shaders/hessian.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "voxels",
    tolerance: Tolerance { abs: 2e-4, rel: 2e-4 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let h = Vec3::from(p.spacing_mm);
    let stride = if p.kind == 0 { 3 } else { 1 };
    s.response.par_chunks_exact_mut(BRICK * stride).enumerate().with_min_len(4).for_each(
        |(slot, out)| {
            let inside = &s.inside[slot * 16..][..16];
            if inside.iter().all(|w| *w == 0) {
                return;
            }
            let halo = Halo::gather(s.near, s.f, slot);
            for local in 0..BRICK {
                if inside[local / 32] >> (local % 32) & 1 == 0 {
                    continue;
                }
                let (m, o) = halo.hessian(Halo::centre(local), h);
                let (l, _) = eigen(p.sign * m, p.sign * o);
                match p.kind {
                    0 => out[3 * local..][..3].copy_from_slice(&l.to_array()),
                    1 => out[local] = (-l.y).max(0.0),
                    _ => out[local] = if l.y < 0.0 { (l.x * l.y).sqrt() } else { 0.0 },
                }
            }
        },
    );
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, near, inside| {
        let f = smooth_distance(lumen);
        let slots = lumen.bricks.len();
        let f = plan.upload_owned("f", &f);
        for (kind, sign) in [(0u32, 1.0), (1, 1.0), (1, -1.0)] {
            let n = lumen.bricks.field_len() * if kind == 0 { 3 } else { 1 };
            let response = plan.zeroed::<f32>("response", n);
            let spacing_mm = lumen.grid.spacing_mm.as_vec3().to_array();
            let params =
                Params { spacing_mm, sign, slots: slots as u32, kind, ..Default::default() };
            let bindings = Bindings { near, inside, f, response };
            plan.launch(&KERNEL, bindings, params, slots * BRICK, slots * BRICK);
            plan.download(response);
        }
    })
}
