//! Cases of relaxed walls, and of copying.

use glam::Vec3;
use intima::compute::Plan;
use intima::kernels::{copy, relax_average, relax_coefficients, relax_guard, relax_step};

use super::Case;
use super::normals::{Ring, ring};

/// Quads that the twin of `copy` takes at a time.
const CHUNK: usize = 1 << 16;

pub fn relax_coefficients() -> Vec<Case> {
    // A staircase: the middles go up and down by half a voxel, through the end of the byte.
    let code = |v: u32| {
        let middle = [2 * v + 1, 2 * (v / 3), 254 + 2 * (v % 2)];
        let middle = [middle, [2 * v, 2 * (v / 3) + 1, 254]][(v % 2) as usize];
        let [x, y, z] = middle.map(|m| m & 255);
        let side = if v.is_multiple_of(3) { relax_coefficients::OUTSIDE_IS_LOWER } else { 0 };
        x | y << 8
            | z << 16
            | side
            | if (v + 1).is_multiple_of(7) { relax_coefficients::FIXED } else { 0 }
    };
    let swinging = |n: u32| -> Vec<f32> {
        let at = |v: u32| 0.37 * v as f32;
        let one = |a: f32| Vec3::new(0.3 * a.cos(), 1.0, (3.0 * a).sin()).normalize();
        (0..n).flat_map(|v| one(at(v)).to_array()).collect()
    };
    let case = |name, spacing: [f32; 3], normals: Vec<f32>| {
        let vertices = normals.len() / 3;
        let g = ring(vertices as u32);
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let codes: Vec<u32> = (0..vertices as u32).map(code).collect();
        let edge = plan.upload_owned("edge", &codes);
        let normal = plan.upload_owned("normal", &normals);
        let bound = plan.undefined::<[f32; 2]>("bound", vertices);
        let coupling = plan.undefined::<f32>("coupling", g.near.len());
        let bend = plan.undefined::<f32>("bend", vertices);
        let [x, y, z] = spacing;
        let params = relax_coefficients::Params {
            axis_x: [0.8 * x, 0.6 * x, 0.0, x],
            axis_y: [-0.6 * y, 0.8 * y, 0.0, y],
            axis_z: [0.0, 0.0, z, z],
            limit_x: 0.375,
            limit_y: 0.4,
            limit_z: 0.45,
            stiffness: 0.05,
            vertices: vertices as u32,
            ..relax_coefficients::Params::default()
        };
        let bindings =
            relax_coefficients::Bindings { start, near, edge, normal, bound, coupling, bend };
        plan.launch(&relax_coefficients::KERNEL, bindings, params, vertices, vertices);
        plan.download(bound);
        plan.download(coupling);
        plan.download(bend);
        Case { name, plan }
    };
    vec![
        case("empty", [1.0; 3], vec![]),
        case("one vertex", [1.0; 3], swinging(1)),
        case("ring of 65", [1.0; 3], swinging(65)),
        case("ring of 5000, unequal spacing", [1.0, 1.3, 2.5], swinging(5000)),
        case("opposed normals", [1.0; 3], vec![1.0, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0, 0.6, 0.8]),
        case("not a number", [1.0; 3], vec![1.0, 0.0, 0.0, f32::NAN, 0.0, 0.0, 0.0, 0.6, 0.8]),
    ]
}

pub fn relax_step() -> Vec<Case> {
    let case = |name, g: Ring, poison: Option<f32>| {
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
        let mut next = plan.undefined::<f32>("next", vertices);
        let place = plan.zeroed::<f32>("place", vertices);
        for _ in 0..4 {
            let params = relax_step::Params { momentum: 0.87, vertices: vertices as u32 };
            let bindings = relax_step::Bindings { start, near, coupling, bound, now, place, next };
            plan.launch(&relax_step::KERNEL, bindings, params, vertices, vertices);
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

pub fn relax_average() -> Vec<Case> {
    let case = |name, g: Ring, poison: bool| {
        let vertices = g.start.len() - 1;
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &g.start);
        let near = plan.upload_owned("near", &g.near);
        let mut values: Vec<f32> = (0..vertices).map(|v| (0.61 * v as f32).sin()).collect();
        if poison {
            values[3] = f32::NAN;
        }
        let value = plan.upload_owned("value", &values);
        let average = plan.undefined::<f32>("average", vertices);
        let bindings = relax_average::Bindings { start, near, value, average };
        plan.launch(
            &relax_average::KERNEL,
            bindings,
            relax_average::Params { vertices: vertices as u32 },
            vertices,
            vertices,
        );
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

pub fn relax_guard() -> Vec<Case> {
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
        let bindings = relax_guard::Bindings { bend, bound, shift, place };
        plan.launch(
            &relax_guard::KERNEL,
            bindings,
            relax_guard::Params { vertices: vertices as u32 },
            vertices,
            vertices,
        );
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

pub fn copy() -> Vec<Case> {
    let case = |name, quads: usize, room: usize| {
        let mut plan = Plan::new();
        let values: Vec<[u32; 4]> = (0..quads as u32).map(|q| [q, !q, 7 * q, q << 16]).collect();
        let source = plan.upload_owned("source", &values);
        let copied = plan.zeroed::<[u32; 4]>("copied", room);
        let params = copy::Params { quads: quads as u32 };
        plan.launch(&copy::KERNEL, copy::Bindings { source, copied }, params, quads, quads);
        plan.download(copied);
        Case { name, plan }
    };
    vec![
        case("empty", 0, 0),
        case("one quad", 1, 1),
        case("a group and one", 65, 65),
        case("more than a chunk", CHUNK + 3, CHUNK + 3),
        case("what lies behind stays", 100, 300),
    ]
}
