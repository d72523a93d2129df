//! Cases of the kernels of the wall field.

use intima::kernels::blur_axis::integer_weights;
use intima::kernels::{
    blur_axis, least_axis, ridge_grow, wall_correct, wall_level, wall_peak, wall_sides,
};
use intima::lumen::bricks::BRICK;

use super::{Case, edge_values, on_bricks};

pub fn blur_axis() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let f: Vec<i32> =
            (0..lumen.bricks.field_len()).map(|i| (i * 7919 % 30011) as i32 - 9000).collect();
        let f = plan.upload_owned("f", &f);
        let flat: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let corner = plan.upload_owned("corner", &flat);
        let edge = lumen.grid.dims.as_ivec3() - 1;
        for (axis, sigma) in [(0u32, 0.6), (1, 1.5), (2, 3.3)] {
            let weights = integer_weights(sigma);
            let weight = plan.upload_owned("weight", &weights);
            let g = plan.undefined::<i32>("g", lumen.bricks.field_len());
            let (radius, high) = (weights.len() as i32 - 1, edge[axis as usize]);
            let params = blur_axis::Params {
                slots: slots as u32,
                axis,
                radius,
                low: 0,
                high,
                missing: 4096,
            };
            let bindings = blur_axis::Bindings { near, corner, weight, f, g };
            plan.launch(&blur_axis::KERNEL, bindings, params, slots * 64, slots * BRICK);
            plan.download(g);
        }
    })
}

pub fn least_axis() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let n = lumen.bricks.field_len();
        let values: Vec<i32> = (0..n).map(|i| (i * 7919 % 30011) as i32 - 9000).collect();
        let f = plan.upload_owned("f", &values);
        for (axis, radius) in [(0, 3), (1, 1), (2, 8)] {
            let g = plan.undefined::<i32>("g", n);
            let params = least_axis::Params { slots: slots as u32, axis, radius };
            plan.launch(
                &least_axis::KERNEL,
                least_axis::Bindings { near, f, g },
                params,
                slots * BRICK,
                slots * BRICK,
            );
            plan.download(g);
        }
    })
}

pub fn ridge_grow() -> Vec<Case> {
    on_bricks(|plan, lumen, near, core| {
        let slots = lumen.bricks.len();
        let corners: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let corner = plan.upload_owned("corner", &corners);
        let value: Vec<i32> = edge_values(lumen);
        let value = plan.upload_owned("value", &value);
        let n = lumen.bricks.field_len();
        let mut before = plan.zeroed::<i32>("before", n);
        let mut after = plan.undefined::<i32>("after", n);
        let [width, height, depth] = lumen.grid.dims.as_ivec3().to_array();
        for _ in 0..3 {
            let bindings = ridge_grow::Bindings { near, corner, core, value, before, after };
            let params = ridge_grow::Params {
                slots: slots as u32,
                fall: 150,
                most: 2700,
                width,
                height,
                depth,
            };
            plan.launch(&ridge_grow::KERNEL, bindings, params, slots * BRICK, slots * BRICK);
            std::mem::swap(&mut before, &mut after);
        }
        plan.download(before);
    })
}

pub fn wall_peak() -> Vec<Case> {
    on_bricks(|plan, lumen, near, core| {
        let slots = lumen.bricks.len();
        let corners: Vec<i32> = lumen.bricks.corners().iter().flatten().copied().collect();
        let corner = plan.upload_owned("corner", &corners);
        let values = edge_values(lumen);
        // Voxels about the core joined, as far as the values say.
        let path: Vec<i32> = values.iter().map(|v| if *v < 2700 { v + 32768 } else { 0 }).collect();
        let [value, sharp, calm] =
            ["value", "sharp", "calm"].map(|name| plan.upload_owned(name, &values));
        let path = plan.upload_owned("path", &path);
        let n = lumen.bricks.field_len();
        let mark = plan.undefined::<u32>("mark", n);
        let [peak, weight] = ["peak", "weight"].map(|name| plan.undefined::<i32>(name, n));
        let h = lumen.grid.spacing_mm;
        let ratio = |scale: f64| (h.min_element() / h * scale).round().as_ivec3().to_array();
        let params = wall_peak::Params {
            slope: ratio(1024.0),
            slots: slots as u32,
            step: ratio(32768.0),
            steps: 8,
            size: lumen.grid.dims.as_ivec3().to_array(),
            fall: 90,
            gain: 300,
            crest: 150,
            rise: 2,
            strong: 300,
        };
        let bindings = wall_peak::Bindings {
            near,
            corner,
            core,
            value,
            sharp,
            calm,
            path,
            mark,
            peak,
            weight,
        };
        plan.launch(&wall_peak::KERNEL, bindings, params, slots * BRICK, slots * BRICK);
        plan.download(mark);
        plan.download(peak);
        plan.download(weight);
    })
}

pub fn wall_level() -> Vec<Case> {
    on_bricks(|plan, lumen, near, core| {
        let slots = lumen.bricks.len();
        let n = lumen.bricks.field_len();
        let value = plan.upload_owned("value", &edge_values(lumen));
        let number = |i: usize, most: usize| (i * 7919 % most) as i32;
        let marks: Vec<u32> = (0..n).map(|i| number(i, 16) as u32).collect();
        let mark = plan.upload_owned("mark", &marks);
        let weights: Vec<i32> = (0..n).map(|i| number(i, 1 << 18)).collect();
        let peaks: Vec<i32> =
            weights.iter().enumerate().map(|(i, w)| w / 4096 * number(i, 4097)).collect();
        let [peak, peak1] = ["peak", "peak1"].map(|name| plan.upload_owned(name, &peaks));
        let [weight, weight1] = ["weight", "weight1"].map(|name| plan.upload_owned(name, &weights));
        let lumens: Vec<i32> = (0..n).map(|i| number(i, 5000) - 500).collect();
        let lumen_value = plan.upload_owned("lumen", &lumens);
        let law: Vec<i32> = (0..513).map(|i| 3 * i + i * i / 700).collect();
        let law = plan.upload_owned("law", &law);
        let cap: Vec<i32> = (0..10).map(|i| 400 * i - 2560).collect();
        let cap = plan.upload_owned("cap", &cap);
        let level = plan.undefined::<i32>("level", n);
        let bindings = wall_level::Bindings {
            near,
            core,
            value,
            mark,
            peak,
            weight,
            peak1,
            weight1,
            lumen: lumen_value,
            law,
            cap,
            level,
        };
        let params = wall_level::Params { slots: slots as u32, forced: 123 };
        plan.launch(&wall_level::KERNEL, bindings, params, slots * BRICK, slots * BRICK);
        plan.download(level);
    })
}

pub fn wall_sides() -> Vec<Case> {
    on_bricks(|plan, lumen, near, inside| {
        let slots = lumen.bricks.len();
        let n = lumen.bricks.field_len();
        let levels: Vec<i32> =
            edge_values(lumen).iter().map(|v| (v - 2048).clamp(-3000, 3000) & 0xffff).collect();
        let level = plan.upload_owned("level", &levels);
        let [offset, edge, filled, closed] =
            ["offset", "edge", "filled", "closed"].map(|name| plan.undefined::<i32>(name, n));
        let bindings = wall_sides::Bindings { near, inside, level, offset, edge, filled, closed };
        plan.launch(
            &wall_sides::KERNEL,
            bindings,
            wall_sides::Params { slots: slots as u32 },
            slots * BRICK,
            slots * BRICK,
        );
        [offset, edge, filled, closed].into_iter().for_each(|b| plan.download(b));
    })
}

pub fn wall_correct() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let slots = lumen.bricks.len();
        let n = lumen.bricks.field_len();
        let values = edge_values(lumen);
        let offsets: Vec<i32> = values.iter().map(|v| (v - 2048).clamp(-3000, 3000)).collect();
        let edges: Vec<i32> = offsets.iter().map(|o| (o * 8).clamp(-32768, 32768)).collect();
        let filled: Vec<i32> = edges.iter().map(|e| (32768 - e) / 2).collect();
        let closed: Vec<i32> =
            (0..n).map(|i| (i * 7919 % 32769) as i32 / (1 + i as i32 % 7)).collect();
        let offset = plan.upload_owned("offset", &offsets);
        let edge = plan.upload_owned("edge", &edges);
        let filled = plan.upload_owned("filled", &filled);
        let closed = plan.upload_owned("closed", &closed);
        let h = lumen.grid.spacing_mm;
        let slope = (h.min_element() / h * 1024.0).round().as_ivec3().to_array();
        for amount in [0, 700] {
            let moved = plan.undefined::<i32>("moved", n);
            let params = wall_correct::Params {
                slope,
                slots: slots as u32,
                shift: amount,
                most: 4000,
                rise: 1100,
                ..bytemuck::Zeroable::zeroed()
            };
            let bindings = wall_correct::Bindings { near, offset, edge, filled, closed, moved };
            plan.launch(&wall_correct::KERNEL, bindings, params, slots * BRICK, slots * BRICK);
            plan.download(moved);
        }
    })
}
