//! CPU twin and cases of `ridge_measure`: the eigen-analysis of each candidate.

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::ridge_measure::{Bindings, Params};
use super::host::ridge_measure::{SHADER, open};
use super::ridge_mark::{Halo, ridge};
use super::{cases_on_bricks, smooth_distance};
use crate::compute::{Case, CpuArgs, Kernel, Tolerance};
use crate::lumen::bricks::BRICK;

/// Number of floats of a candidate.
pub const STRIDE: usize = 12;

/// See `shaders/ridge_measure.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "candidates",
    tolerance: Tolerance { abs: 2e-3, rel: 1e-3 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let n = (s.total[p.slots as usize]).min(p.capacity) as usize;
    let h = Vec3::from(p.spacing_mm);
    s.measure[..n * STRIDE].par_chunks_exact_mut(STRIDE).zip(&s.list[..n]).for_each(|(out, &e)| {
        crate::task::checkpoint();
        let e = e as usize;
        let halo = Halo::gather(s.near, s.f, e / BRICK);
        let r = ridge(&halo, e % BRICK, h, 3e38);
        out[..3].copy_from_slice(&r.offset_mm.to_array());
        out[3] = s.d[e];
        out[4..7].copy_from_slice(&r.axis.to_array());
        out[7] = r.gradient;
        out[8..11].copy_from_slice(&r.values.to_array());
    });
}

fn cases() -> Vec<Case> {
    cases_on_bricks(|plan, lumen, near, _| {
        let f = smooth_distance(lumen);
        let slots = lumen.bricks.len();
        let h = lumen.grid.spacing_mm.as_vec3();
        let flat: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
        // Accepted voxels, less those whose axis is free to turn.
        let list: Vec<u32> = lumen
            .elements(&lumen.inside)
            .filter(|&e| {
                let r = ridge(&Halo::gather(&flat, &f, e / BRICK), e % BRICK, h, 0.7);
                r.accepted && r.values.z - r.values.y > 0.05 && r.values.y < -0.02
            })
            .map(|e| e as u32)
            .collect();
        let mut total = vec![0u32; slots + 1];
        total[slots] = list.len() as u32;
        let measure = plan.zeroed::<f32>("measure", list.len() * STRIDE);
        let bindings = Bindings {
            near,
            f: plan.upload_owned("f", &f),
            d: plan.upload_owned("d", &f),
            total: plan.upload_owned("total", &total),
            list: plan.upload_owned("list", &list),
            measure,
        };
        let params = Params {
            spacing_mm: h.to_array(),
            slots: slots as u32,
            capacity: list.len() as u32,
            ..Default::default()
        };
        plan.launch(&KERNEL, bindings, params, list.len(), list.len());
        plan.download(measure);
    })
}
