//! CPU twin and cases of `relax_average`: one step of averaging over neighbours.

use rayon::prelude::*;

pub use super::host::relax_average::{Bindings, Params};
use super::host::relax_average::{SHADER, open};
use super::scale_pool::{WeightedRing, ring};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/relax_average.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    s.average.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, out)| {
        let near = &s.near[s.start[v] as usize..s.start[v + 1] as usize];
        let own = s.value[v];
        let mut sum = 0.0;
        for j in near {
            sum += s.value[*j as usize];
        }
        *out = if near.is_empty() { own } else { 0.5 * (own + sum / near.len() as f32) };
    });
}

fn cases() -> Vec<Case> {
    let case = |name, g: WeightedRing, poison: bool| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let mut values: Vec<f32> = (0..vertices).map(|v| (0.61 * v as f32).sin()).collect();
        if poison {
            values[3] = f32::NAN;
        }
        let value = plan.upload_owned("value", &values);
        let average = plan.zeroed::<f32>("average", vertices);
        let bindings = Bindings { start, near, value, average };
        plan.launch(&KERNEL, bindings, Params { vertices: vertices as u32 }, vertices, vertices);
        plan.download(average);
        Case { name, plan }
    };
    vec![
        case("empty", ring(0), false),
        case("one vertex", ring(1), false),
        case("ring of 65", ring(65), false),
        case("ring of 5000", ring(5000), false),
        case("not a number", ring(9), true),
    ]
}
