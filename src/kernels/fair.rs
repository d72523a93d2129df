//! CPU twin and cases of `fair`: one step of normals-only Laplacian smoothing.

use glam::Vec3;
use rayon::prelude::*;

pub use super::host::fair::{Bindings, Params};
use super::host::fair::{SHADER, open};
use crate::compute::{Case, CpuArgs, Kernel, Plan, Tolerance};

/// See `shaders/fair.wgsl`.
pub static KERNEL: Kernel = Kernel {
    shader: &SHADER,
    twin,
    unit: "vertices",
    tolerance: Tolerance { abs: 1e-5, rel: 0.0 },
    cases,
};

fn twin(args: &mut CpuArgs<'_>) {
    let (s, p, _) = open(args);
    let at = |v: usize| Vec3::from_slice(&s.normal[3 * v..]);
    let step = |v: usize, out: &mut [f32]| {
        let edges = s.start[v] as usize..s.start[v + 1] as usize;
        let sum: Vec3 = edges.map(|e| s.weight[e] * at(s.near[e] as usize)).sum();
        let n = (1.0 - p.lambda) * at(v) + p.lambda * sum;
        let len = n.length();
        let n = if len >= 1e-6 { n / len } else { at(v) };
        out.copy_from_slice(&n.to_array());
    };
    let chunk = 4096;
    s.faired.par_chunks_mut(3 * chunk).enumerate().for_each(|(c, out)| {
        crate::task::checkpoint();
        for (i, out) in out.chunks_exact_mut(3).enumerate() {
            step(c * chunk + i, out);
        }
    });
}

fn cases() -> Vec<Case> {
    let ring = |n: u32| -> (Vec<u32>, Vec<u32>, Vec<f32>, Vec<f32>) {
        let start = (0..=n).map(|v| 2 * v).collect();
        let near = (0..n).flat_map(|v| [(v + n - 1) % n, (v + 1) % n]).collect();
        let weight = (0..n).flat_map(|v| [0.25 + 0.01 * (v % 7) as f32; 2]).collect();
        let normal = (0..n)
            .flat_map(|v| {
                let a = v as f32 * 0.37;
                Vec3::new(a.cos(), a.sin(), (3.0 * a).sin()).normalize().to_array()
            })
            .collect();
        (start, near, weight, normal)
    };
    let case = |name, (start, near, weight, normal): (Vec<u32>, Vec<u32>, Vec<f32>, Vec<f32>)| {
        let vertices = start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &start);
        let near = plan.upload_owned("near", &near);
        let weight = plan.upload_owned("weight", &weight);
        let normal = plan.upload_owned("normal", &normal);
        let faired = plan.zeroed::<f32>("faired", 3 * vertices);
        let bindings = Bindings { start, near, weight, normal, faired };
        let params = Params { vertices: vertices as u32, lambda: 0.5 };
        plan.launch(&KERNEL, bindings, params, vertices, vertices);
        plan.download(faired);
        Case { name, plan }
    };
    let opposed = (vec![0, 1, 2], vec![1, 0], vec![1.0; 2], vec![1., 0., 0., -1., 0., 0.]);
    let not_a_number =
        (vec![0, 1, 2], vec![1, 0], vec![1.0; 2], vec![1., 0., 0., f32::NAN, 0., 0.]);
    vec![
        case("empty", (vec![0], vec![], vec![], vec![])),
        case("one vertex", (vec![0, 0], vec![], vec![], vec![0.0, 0.6, 0.8])),
        case("ring of 65", ring(65)),
        case("ring of 5000", ring(5000)),
        case("opposed normals cancel", opposed),
        case("not a number", not_a_number),
    ]
}
