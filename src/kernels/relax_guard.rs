//! CPU twin and cases of `relax_guard`: limits the low-pass shift of the relaxed wall.

use rayon::prelude::*;

pub use super::host::relax_guard::{Bindings, Params};
use super::host::relax_guard::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/relax_guard.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    s.place.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, place)| {
        let allowed = 0.15 - 0.1 * ((s.bend[v] - 0.15) / 0.15).clamp(0.0, 1.0);
        let excess = s.shift[v] - s.shift[v].clamp(-allowed, allowed);
        let most = s.bound[v][1];
        *place = (*place - excess).clamp(-most, most);
    });
}

fn cases() -> Vec<Case> {
    let case = |name, vertices: usize, bend: f32| {
        let wave = |a: f32, b: f32| -> Vec<f32> {
            (0..vertices).map(|v| a * (b * v as f32).sin()).collect()
        };
        let mut plan = Plan::new();
        let bends: Vec<f32> = wave(bend, 0.31).iter().map(|x| x.abs()).collect();
        let bend = plan.upload_owned("bend", &bends);
        let bounds: Vec<[f32; 2]> = wave(0.4, 0.17).iter().map(|x| [*x, x.abs()]).collect();
        let bound = plan.upload_owned("bound", &bounds);
        let shift = plan.upload_owned("shift", &wave(0.3, 0.53));
        let place = plan.upload_owned("place", &wave(0.375, 0.71));
        let bindings = Bindings { bend, bound, shift, place };
        plan.launch(&KERNEL, bindings, Params { vertices: vertices as u32 }, vertices, vertices);
        plan.download(place);
        Case { name, plan }
    };
    vec![
        case("empty", 0, 0.4),
        case("one vertex", 1, 0.4),
        case("65 vertices", 65, 0.4),
        case("5000 vertices, flat", 5000, 0.1),
        case("5000 vertices, bent", 5000, 2.0),
    ]
}
