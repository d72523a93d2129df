//! Cases of the ridge test and of compaction.

use glam::Vec3;
use intima::compute::Plan;
use intima::kernels::halo::Halo;
use intima::lumen::Lumen;
use intima::lumen::bricks::BRICK;
use intima::paper::kernels::ridge_mark::ridge;
use intima::paper::kernels::{
    compact_count, compact_scatter, prefix_sum, ridge_mark, ridge_measure,
};

use super::{Case, on_bricks, smooth_distance};

pub fn ridge_mark() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let f = smooth_distance(lumen);
        let slots = lumen.bricks.len();
        let spacing = lumen.grid.spacing_mm.as_vec3();
        // Accept sets agree across devices only clear of their limits: keep voxels that are.
        let clear = clear_of_limits(lumen, &f, spacing);
        let inside = plan.upload_owned("clear", &clear);
        let f = plan.upload_owned("f", &f);
        let marked = plan.undefined::<u32>("marked", slots * 16);
        let spacing_mm = spacing.to_array();
        let params = ridge_mark::Params { spacing_mm, slots: slots as u32 };
        let bindings = ridge_mark::Bindings { near, inside, f, marked };
        plan.launch(&ridge_mark::KERNEL, bindings, params, slots * BRICK, slots * BRICK);
        plan.download(marked);
    })
}

/// Inside bits without the voxels whose decision hangs on rounding.
fn clear_of_limits(lumen: &Lumen, f: &[f32], h: Vec3) -> Vec<u32> {
    let near: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
    let mut bits: Vec<u32> = bytemuck::cast_slice::<u64, u32>(&lumen.inside).to_vec();
    for e in lumen.elements(&lumen.inside) {
        let r = ridge(&Halo::gather(&near, f, e / BRICK), e % BRICK, h);
        let close = |a: f32, b: f32, by: f32| (a - b).abs() <= by;
        let t = (r.offset_mm / h).abs();
        let unsure = t.to_array().iter().any(|t| close(*t, 0.6, 2e-3) || t.is_nan())
            || close(r.values.y * h.min_element(), -1e-4, 1e-3)
            // The axis is free to turn, and the offset across it with it.
            || r.values.z - r.values.y < 1e-3;
        if unsure {
            bits[e / 32] &= !(1 << (e % 32));
        }
    }
    bits
}

/// Bits of more bricks than a few workgroups take.
fn many_bricks() -> (usize, Vec<u32>) {
    let slots = 2000;
    (slots, (0..16 * slots as u32).map(|i| i.wrapping_mul(2_654_435_761) & (i << 7)).collect())
}

pub fn compact_count() -> Vec<Case> {
    let mut cases = count_on_bricks();
    let (slots, bits) = many_bricks();
    let mut plan = Plan::new();
    let marked = plan.upload_owned("marked", &bits);
    let count = plan.undefined::<u32>("count", slots);
    let params = compact_count::Params { slots: slots as u32 };
    let bindings = compact_count::Bindings { marked, count };
    plan.launch(&compact_count::KERNEL, bindings, params, slots, slots);
    plan.download(count);
    cases.push(Case { name: "2000 bricks", plan });
    cases
}

fn count_on_bricks() -> Vec<Case> {
    on_bricks(|plan, lumen, _, inside| {
        let slots = lumen.bricks.len();
        let count = plan.undefined::<u32>("count", slots);
        let params = compact_count::Params { slots: slots as u32 };
        plan.launch(
            &compact_count::KERNEL,
            compact_count::Bindings { marked: inside, count },
            params,
            slots,
            slots,
        );
        plan.download(count);
    })
}

pub fn prefix_sum() -> Vec<Case> {
    let case = |name, count: Vec<u32>| {
        let mut plan = Plan::new();
        let len = count.len();
        let sum = plan.undefined::<u32>("sum", len + 1);
        let count = plan.upload_owned("count", &count);
        plan.launch(
            &prefix_sum::KERNEL,
            prefix_sum::Bindings { count, sum },
            prefix_sum::Params { len: len as u32 },
            prefix_sum::THREADS,
            len,
        );
        plan.download(sum);
        Case { name, plan }
    };
    vec![
        case("empty", vec![]),
        case("one", vec![7]),
        case("odd length", (0..1001).map(|i| i * 37 % 11).collect()),
        case("shorter than the workgroup", (0..200).collect()),
        case("70,000 counts", (0..70_000).map(|i| i % 513).collect()),
    ]
}

pub fn compact_scatter() -> Vec<Case> {
    let mut cases = scatter_on_bricks();
    let (slots, bits) = many_bricks();
    let mut sums = vec![0];
    for brick in bits.chunks(16) {
        sums.push(sums[sums.len() - 1] + brick.iter().map(|w| w.count_ones()).sum::<u32>());
    }
    let capacity = sums[slots];
    let mut plan = Plan::new();
    let marked = plan.upload_owned("marked", &bits);
    let sum = plan.upload_owned("sum", &sums);
    let list = plan.zeroed::<u32>("list", capacity as usize);
    let params = compact_scatter::Params { slots: slots as u32, capacity };
    let bindings = compact_scatter::Bindings { marked, sum, list };
    plan.launch(&compact_scatter::KERNEL, bindings, params, slots, slots);
    plan.download(list);
    cases.push(Case { name: "2000 bricks", plan });
    cases
}

fn scatter_on_bricks() -> Vec<Case> {
    on_bricks(|plan, lumen, _, inside| {
        let slots = lumen.bricks.len();
        let counts: Vec<u32> =
            lumen.inside.chunks(8).map(|w| w.iter().map(|w| w.count_ones()).sum()).collect();
        let sums: Vec<u32> = std::iter::once(0)
            .chain(counts.iter().scan(0, |at, n| {
                *at += n;
                Some(*at)
            }))
            .collect();
        let sum = plan.upload_owned("sum", &sums);
        let all = lumen.inside_voxels() as u32;
        // Room for all, and room for two thirds: the rest is left out, nothing else is touched.
        for capacity in [all, all * 2 / 3] {
            let list = plan.zeroed::<u32>("list", capacity as usize);
            let params = compact_scatter::Params { slots: slots as u32, capacity };
            let bindings = compact_scatter::Bindings { marked: inside, sum, list };
            plan.launch(&compact_scatter::KERNEL, bindings, params, slots, slots);
            plan.download(list);
        }
    })
}

pub fn ridge_measure() -> Vec<Case> {
    on_bricks(|plan, lumen, near, _| {
        let f = smooth_distance(lumen);
        let slots = lumen.bricks.len();
        let h = lumen.grid.spacing_mm.as_vec3();
        let flat: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
        // Accepted voxels, less those whose axis is free to turn.
        let list: Vec<u32> = lumen
            .elements(&lumen.inside)
            .filter(|&e| {
                let r = ridge(&Halo::gather(&flat, &f, e / BRICK), e % BRICK, h);
                r.accepted && r.values.z - r.values.y > 0.05 && r.values.y < -0.02
            })
            .map(|e| e as u32)
            .collect();
        let mut total = vec![0u32; slots + 1];
        total[slots] = list.len() as u32;
        let measure = plan.zeroed::<f32>("measure", list.len() * ridge_measure::STRIDE);
        let bindings = ridge_measure::Bindings {
            near,
            f: plan.upload_owned("f", &f),
            d: plan.upload_owned("d", &f),
            total: plan.upload_owned("total", &total),
            list: plan.upload_owned("list", &list),
            measure,
        };
        let params = ridge_measure::Params {
            spacing_mm: h.to_array(),
            slots: slots as u32,
            capacity: list.len() as u32,
            ..Default::default()
        };
        plan.launch(&ridge_measure::KERNEL, bindings, params, list.len(), list.len());
        plan.download(measure);
    })
}
