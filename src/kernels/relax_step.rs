//! CPU twin and cases of `relax_step`: one step of the relaxed wall.

use rayon::prelude::*;

pub use super::host::relax_step::{Bindings, Params};
use super::host::relax_step::{SHADER, open};
use super::scale_pool::{WeightedRing, ring};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/relax_step.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
    cases,
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

fn cases() -> Vec<Case> {
    let case = |name, g: WeightedRing, poison: Option<f32>| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let weight: Vec<f32> = g.weight.iter().map(|w| 0.5 * w).collect();
        let coupling = plan.upload_owned("coupling", &weight);
        let of = |v: usize| {
            let most = if (v + 1).is_multiple_of(4) { 0.0 } else { 0.375 };
            [0.3 * (0.71 * v as f32).sin(), most]
        };
        let bounds: Vec<[f32; 2]> = (0..vertices).map(of).collect();
        let bound = plan.upload_owned("bound", &bounds);
        let mut first: Vec<f32> = (0..vertices).map(|v| 0.4 * (0.37 * v as f32).cos()).collect();
        if let (Some(x), Some(f)) = (poison, first.first_mut()) {
            *f = x;
        }
        let mut now = plan.upload_owned("now", &first);
        let mut next = plan.zeroed::<f32>("next", vertices);
        let place = plan.zeroed::<f32>("place", vertices);
        for _ in 0..4 {
            let params = Params { momentum: 0.87, vertices: vertices as u32 };
            let bindings = Bindings { start, near, coupling, bound, now, place, next };
            plan.launch(&KERNEL, bindings, params, vertices, vertices);
            std::mem::swap(&mut now, &mut next);
        }
        plan.download(place);
        plan.download(now);
        Case { name, plan }
    };
    vec![
        case("empty", ring(0), None),
        case("one vertex", ring(1), None),
        case("ring of 65", ring(65), None),
        case("ring of 5000", ring(5000), None),
        case("far beyond the limit", ring(9), Some(1e30)),
    ]
}
