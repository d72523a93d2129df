//! CPU twin and cases of `scale_pool`: one step of averaging over neighbours.

use rayon::prelude::*;

pub use super::host::scale_pool::{Bindings, Params};
use super::host::scale_pool::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/scale_pool.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-6, rel: 0.0 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, _, _) = open(args);
    let (energy, _) = s.energy.as_chunks::<5>();
    let (pooled, _) = s.pooled.as_chunks_mut::<5>();
    pooled.par_iter_mut().enumerate().with_min_len(4096).for_each(|(v, out)| {
        let edges = s.start[v] as usize..s.start[v + 1] as usize;
        let mut sum = energy[v];
        for (j, w) in s.near[edges.clone()].iter().zip(&s.weight[edges]) {
            let other = &energy[*j as usize];
            for k in 0..5 {
                sum[k] += w * (other[k] - energy[v][k]);
            }
        }
        *out = sum;
    });
}

/// A closed chain of vertices with weights that sum to less than one.
pub(super) struct WeightedRing {
    pub start: Vec<u32>,
    pub near: Vec<u32>,
    pub weight: Vec<f32>,
}

/// Returns a chain of `n` vertices; a single one has no neighbours.
pub(super) fn ring(n: u32) -> WeightedRing {
    let each = if n > 1 { 2 } else { 0 };
    WeightedRing {
        start: (0..=n).map(|v| each * v).collect(),
        near: (0..n)
            .flat_map(|v| [(v + n - 1) % n, (v + 1) % n])
            .take((each * n) as usize)
            .collect(),
        weight: (0..each * n).map(|e| 0.1 + 0.05 * (e % 7) as f32).collect(),
    }
}

fn cases() -> Vec<Case> {
    let case = |name, g: WeightedRing| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let weight = plan.upload_owned("weight", &g.weight);
        let values: Vec<f32> = (0..5 * vertices).map(|i| (i as f32 * 0.61).sin().powi(2)).collect();
        let energy = plan.upload_owned("energy", &values);
        let pooled = plan.zeroed::<f32>("pooled", 5 * vertices);
        let bindings = Bindings { start, near, weight, energy, pooled };
        let params = Params { vertices: vertices as u32 };
        plan.launch(&KERNEL, bindings, params, vertices, vertices);
        plan.download(pooled);
        Case { name, plan }
    };
    vec![
        case("empty", ring(0)),
        case("one vertex", ring(1)),
        case("ring of 65", ring(65)),
        case("ring of 5000", ring(5000)),
    ]
}
