//! Cases of the kernels of fields: distance, Gaussian, Hessian, visibility.

use glam::UVec3;
use intima::compute::Plan;
use intima::kernels::{edt_axis, edt_rows, gauss_axis, hessian, visibility};
use intima::lumen::Lumen;
use intima::lumen::bricks::{BRICK, bit_field};

use super::{Case, lumen_of, on_bricks, smooth_distance};

pub fn edt_rows() -> Vec<Case> {
    on_bricks(|plan, lumen, near, inside| {
        let slots = lumen.bricks.len();
        let square = plan.undefined::<f32>("square", lumen.bricks.field_len());
        let step2 = (lumen.grid.spacing_mm.x as f32).powi(2);
        let bindings = edt_rows::Bindings { near, inside, square };
        let params = edt_rows::Params { slots: slots as u32, step2 };
        plan.launch(&edt_rows::KERNEL, bindings, params, slots * 64, slots * BRICK);
        plan.download(square);
    })
}

pub fn edt_axis() -> Vec<Case> {
    let mut cases = one_pass();
    cases.push(far());
    cases
}

/// All passes over a ball of 37 voxels: searches go beyond 32 along every axis.
fn far() -> Case {
    let ball = |v: UVec3| (v.as_dvec3() - 37.2).length() < 37.0;
    let lumen = lumen_of([76; 3], [1.0; 3], &ball);
    let slots = lumen.bricks.len() as u32;
    let mut plan = Plan::new();
    let flat: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
    let near = plan.upload_owned("near", &flat);
    let inside = plan.upload_owned("inside", bytemuck::cast_slice::<u64, u32>(&lumen.inside));
    let mut square = plan.undefined::<f32>("square", lumen.bricks.field_len());
    let bindings = edt_rows::Bindings { near, inside, square };
    let threads = slots as usize * BRICK;
    let params = edt_rows::Params { slots, step2: 1.0 };
    plan.launch(&edt_rows::KERNEL, bindings, params, threads / 8, threads);
    for (axis, finish) in [(1u32, 0u32), (2, 1)] {
        let g = plan.undefined::<f32>("g", lumen.bricks.field_len());
        let params = edt_axis::Params { slots, axis, step2: 1.0, finish, scale: 1.0 };
        let bindings = edt_axis::Bindings { near, f: square, g };
        plan.launch(&edt_axis::KERNEL, bindings, params, threads / 8, threads);
        square = g;
    }
    plan.download(square);
    Case { name: "distances beyond 32 voxels", plan }
}

fn one_pass() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let spacing = lumen.grid.spacing_mm.as_vec3();
        // A first pass whose values vary: the bits times a small pattern.
        let bits = bit_field(&lumen.inside);
        let f: Vec<f32> =
            bits.iter().enumerate().map(|(i, &b)| b * (1 + i * 7 % 13) as f32).collect();
        let f = plan.upload_owned("f", &f);
        for (axis, finish) in [(1u32, 0u32), (2, 1)] {
            let g = plan.undefined::<f32>("g", lumen.bricks.field_len());
            let step2 = spacing[axis as usize].powi(2);
            let params = edt_axis::Params { slots: slots as u32, axis, step2, finish, scale: 0.5 };
            let bindings = edt_axis::Bindings { near, f, g };
            plan.launch(&edt_axis::KERNEL, bindings, params, slots * 64, slots * BRICK);
            plan.download(g);
        }
    })
}

pub fn gauss_axis() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let bits = bit_field(&lumen.inside);
        let f: Vec<f32> =
            bits.iter().enumerate().map(|(i, &b)| b * (1 + i * 5 % 11) as f32 - 2.0).collect();
        let f = plan.upload_owned("f", &f);
        let flat: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let corner = plan.upload_owned("corner", &flat);
        let weights = gauss_axis::gaussian_weights(1.3);
        let weight = plan.upload_owned("weight", &weights);
        let edge = lumen.grid.dims.as_ivec3() - 1;
        for axis in 0..3u32 {
            for (low, high) in [(i32::MIN / 2, i32::MAX / 2), (0, edge[axis as usize])] {
                let g = plan.undefined::<f32>("g", lumen.bricks.field_len());
                let radius = weights.len() as u32 - 1;
                let params = gauss_axis::Params { slots: slots as u32, axis, radius, low, high };
                let bindings = gauss_axis::Bindings { near, corner, weight, f, g };
                plan.launch(&gauss_axis::KERNEL, bindings, params, slots * 64, slots * BRICK);
                plan.download(g);
            }
        }
    })
}

pub fn hessian() -> Vec<Case> {
    on_bricks(|plan, lumen, near, inside| {
        let f = smooth_distance(lumen);
        let slots = lumen.bricks.len();
        let f = plan.upload_owned("f", &f);
        let sheets = plan.upload_owned("sheets", &sheets(lumen));
        // All slots; then from one in the middle on, as where a response takes several buffers.
        for (kind, sign, first, f) in [
            (0u32, 1.0, 0, f),
            (1, 1.0, 0, f),
            (1, -1.0, 0, f),
            (0, 1.0, slots / 2, f),
            (2, 1.0, 0, sheets),
            (2, -1.0, 0, sheets),
        ] {
            let slots = slots - first;
            let n = slots * BRICK * if kind == 0 { 3 } else { 1 };
            let response = plan.undefined::<f32>("response", n);
            let spacing_mm = lumen.grid.spacing_mm.as_vec3().to_array();
            let (first, count) = (first as u32, slots as u32);
            let params = hessian::Params {
                spacing_mm,
                sign,
                first,
                slots: count,
                kind,
                ..Default::default()
            };
            let bindings = hessian::Bindings { near, inside, f, response };
            plan.launch(&hessian::KERNEL, bindings, params, slots * 64, slots * BRICK);
            plan.download(response);
        }
    })
}

/// A field that is curved along one axis alone, by another amount at each voxel: two eigenvalues
/// are 0 but for rounding, and tubeness is the root of their product.
fn sheets(lumen: &Lumen) -> Vec<f32> {
    let at = |e: usize| {
        let x = lumen.bricks.voxel(e).x as f32;
        0.013 * x * x + 0.0007 * x * x * x
    };
    (0..lumen.bricks.field_len()).map(at).collect()
}

pub fn visibility() -> Vec<Case> {
    on_bricks(|plan, lumen, near, inside| {
        let slots = lumen.bricks.len();
        let corners: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let seen: Vec<u32> = lumen.elements(&lumen.boundary).map(|e| e as u32).collect();
        // Every seventh inside voxel looks, with a reach that grows; every brick lists them all.
        let viewer: Vec<u32> =
            lumen.elements(&lumen.inside).step_by(7).take(200).map(|e| e as u32).collect();
        let reach: Vec<u32> = (0..viewer.len() as u32).map(|i| 30 + i * i % 900).collect();
        let start: Vec<u32> = (0..=slots as u32).map(|s| s * viewer.len() as u32).collect();
        let lists: Vec<u32> = (0..slots).flat_map(|_| 0..viewer.len() as u32).collect();
        let first = plan.undefined::<u32>("first", seen.len());
        let bindings = visibility::Bindings {
            near,
            corner: plan.upload_owned("corner", &corners),
            open: inside,
            seen: plan.upload_owned("seen", &seen),
            viewer: plan.upload_owned("viewer", &viewer),
            reach: plan.upload_owned("reach", &reach),
            start: plan.upload_owned("start", &start),
            near_viewers: plan.upload_owned("near_viewers", &lists),
            first,
        };
        let params = visibility::Params { weight: [1, 1, 2], boundary: seen.len() as u32 };
        plan.launch(&visibility::KERNEL, bindings, params, seen.len(), seen.len());
        plan.download(first);
    })
}
