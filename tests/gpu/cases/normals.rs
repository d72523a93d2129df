//! Cases of the smoothing of normals.

use glam::{Vec3, Vec4};
use intima::compute::Plan;
use intima::kernels::{fair, scale_bands, scale_pool, scale_restore, scale_step};

use super::Case;

pub fn fair() -> Vec<Case> {
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
        let faired = plan.undefined::<f32>("faired", 3 * vertices);
        let bindings = fair::Bindings { start, near, weight, normal, faired };
        let params = fair::Params { vertices: vertices as u32, lambda: 0.5 };
        plan.launch(&fair::KERNEL, bindings, params, vertices, vertices);
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

pub fn scale_step() -> Vec<Case> {
    let case = |name, g: Ring| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let weight = plan.upload_owned("weight", &g.weight);
        let at = |v: usize| Vec4::new(0.37, 0.61, 0.83, 0.0) * v as f32;
        let values: Vec<[f32; 4]> = (0..vertices).map(|v| at(v).to_array().map(f32::sin)).collect();
        let mut now = plan.zeroed::<[f32; 4]>("now", vertices);
        let mut next = plan.upload_owned("next", &values);
        let level = plan.zeroed::<[f32; 4]>("level", 5 * vertices);
        for (turn, keep) in [(0.0, -1.0), (1.0, 0.0), (2.0, 1.0), (2.0, 1.0)] {
            let params = scale_step::Params {
                part: [0.4, 0.0, 0.2, -0.1],
                last_part: 0.05,
                turn,
                keep,
                vertices: vertices as u32,
            };
            let bindings = scale_step::Bindings { start, near, weight, now, next, level };
            plan.launch(&scale_step::KERNEL, bindings, params, vertices, vertices);
            std::mem::swap(&mut now, &mut next);
        }
        plan.download(now);
        plan.download(level);
        Case { name, plan }
    };
    vec![
        case("empty", ring(0)),
        case("one vertex", ring(1)),
        case("ring of 65", ring(65)),
        case("ring of 5000", ring(5000)),
    ]
}

pub fn scale_bands() -> Vec<Case> {
    let case = |name, (normal, level): (Vec<f32>, Vec<[f32; 4]>)| {
        let vertices = normal.len() / 3;
        let mut plan = Plan::new();
        let normal = plan.upload_owned("normal", &normal);
        let level = plan.upload_owned("level", &level);
        let energy = plan.undefined::<f32>("energy", 5 * vertices);
        let params = scale_bands::Params { vertices: vertices as u32 };
        let bindings = scale_bands::Bindings { normal, level, energy };
        plan.launch(&scale_bands::KERNEL, bindings, params, vertices, vertices);
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

/// Normals that swing, and smoothed ones that swing less.
fn swinging(vertices: usize) -> (Vec<f32>, Vec<[f32; 4]>) {
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

pub fn scale_pool() -> Vec<Case> {
    let case = |name, g: Ring| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let weight = plan.upload_owned("weight", &g.weight);
        let values: Vec<f32> = (0..5 * vertices).map(|i| (i as f32 * 0.61).sin().powi(2)).collect();
        let energy = plan.upload_owned("energy", &values);
        let pooled = plan.undefined::<f32>("pooled", 5 * vertices);
        let bindings = scale_pool::Bindings { start, near, weight, energy, pooled };
        let params = scale_pool::Params { vertices: vertices as u32 };
        plan.launch(&scale_pool::KERNEL, bindings, params, vertices, vertices);
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

/// A closed chain of vertices with weights that sum to less than one.
pub struct Ring {
    pub start: Vec<u32>,
    pub near: Vec<u32>,
    pub weight: Vec<f32>,
}

/// A chain of `n` vertices; a single one has no neighbours.
pub fn ring(n: u32) -> Ring {
    let each = if n > 1 { 2 } else { 0 };
    Ring {
        start: (0..=n).map(|v| each * v).collect(),
        near: (0..n)
            .flat_map(|v| [(v + n - 1) % n, (v + 1) % n])
            .take((each * n) as usize)
            .collect(),
        weight: (0..each * n).map(|e| 0.1 + 0.05 * (e % 7) as f32).collect(),
    }
}

pub fn scale_restore() -> Vec<Case> {
    let case = |name, vertices: usize, spacing: [f32; 3]| {
        let (normal, level) = swinging(vertices);
        let pooled: Vec<f32> =
            (0..5 * vertices).map(|i| 0.01 * (i as f32 * 0.13).sin().powi(2)).collect();
        let mut plan = Plan::new();
        let normal = plan.upload_owned("normal", &normal);
        let level = plan.upload_owned("level", &level);
        let pooled = plan.upload_owned("pooled", &pooled);
        let faired = plan.undefined::<f32>("faired", 3 * vertices);
        let params = scale_restore::Params {
            axis_x: [0.8, 0.6, 0.0, spacing[0]],
            axis_y: [-0.6, 0.8, 0.0, spacing[1]],
            axis_z: [0.0, 0.0, 1.0, spacing[2]],
            terrace: [spacing[0], spacing[1], 1.3 * spacing[2], 0.7],
            raw: 0.2,
            vertices: vertices as u32,
            ..scale_restore::Params::default()
        };
        let bindings = scale_restore::Bindings { normal, level, pooled, faired };
        plan.launch(&scale_restore::KERNEL, bindings, params, vertices, vertices);
        plan.download(faired);
        Case { name, plan }
    };
    vec![
        case("empty", 0, [1.0; 3]),
        case("one vertex", 1, [1.0; 3]),
        case("5000 vertices", 5000, [1.0; 3]),
        case("anisotropic", 5000, [0.3, 0.4, 1.0]),
    ]
}
