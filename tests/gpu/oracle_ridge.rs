//! Ridge voxels and their measures against an f64 analysis with a general eigensolver.
//!
//! The fixtures' reading `zero`: the blurred distance continues as 0 outside.

use std::collections::BTreeSet;

use common::fixtures::{devices, ints, json, list, lumen, real};
use glam::{DVec3, IVec3, UVec3};
use intima::compute::Plan;
use intima::device::Device;
use intima::field::{LumenBuffers, distance, smooth};
use intima::lumen::Lumen;
use intima::paper::kernels::ridge_mark;
use intima::paper::{RidgePoint, ridge};
use serde_json::Value;

const NAMES: [&str; 5] = ["tube", "oblique", "torus", "oblique_thick", "torus_thick"];

/// Linear indices of the voxels marked.
fn marked(device: &mut Device, lumen: &Lumen) -> BTreeSet<i64> {
    let mut plan = Plan::new();
    let b = LumenBuffers::new(&mut plan, lumen);
    let d = distance(&mut plan, &b);
    let f = smooth(&mut plan, &b, d, lumen.grid.spacing_mm.min_element(), None);
    let slots = b.slots as usize;
    let marked = plan.zeroed::<u32>("ridge bits", slots * 16);
    let bindings = ridge_mark::Bindings { near: b.near, inside: b.inside, f, marked };
    let params = ridge_mark::Params {
        spacing_mm: lumen.grid.spacing_mm.as_vec3().to_array(),
        slots: b.slots,
    };
    plan.launch(&ridge_mark::KERNEL, bindings, params, b.field_len(), b.items);
    plan.download(marked);
    let out = device.run(&plan).unwrap();
    let bits = out.get(marked).iter().enumerate();
    bits.flat_map(|(w, &word)| (0..32).filter(move |i| word >> i & 1 != 0).map(move |i| w * 32 + i))
        .map(|e| index(lumen, e))
        .collect()
}

fn index(lumen: &Lumen, element: usize) -> i64 {
    lumen.grid.index(lumen.bricks.voxel(element).as_uvec3()) as i64
}

/// Differences outside the voxels that may go either way.
fn disagreement(got: &BTreeSet<i64>, sure: &BTreeSet<i64>, unsure: &Value) -> Vec<i64> {
    let unsure: BTreeSet<i64> = ints(unsure).into_iter().collect();
    got.symmetric_difference(sure).filter(|i| !unsure.contains(i)).copied().collect()
}

#[test]
fn accepted_voxels_are_those_of_the_fixture() {
    for mut device in devices() {
        let device_name = device.name().to_owned();
        for name in NAMES {
            let lumen = lumen(name);
            let want = &json(&format!("ridge/{name}.json"))["zero"];
            let sure = ints(&want["paper_accepted"]).into_iter().collect();
            let got = marked(&mut device, &lumen);
            let wrong = disagreement(&got, &sure, &want["paper_uncertain"]);
            let at = |i: &i64| -> UVec3 { lumen.grid.voxel(*i as usize) };
            let wrong: Vec<UVec3> = wrong.iter().map(at).collect();
            println!("{device_name}: {name}: {} of {}", got.len(), sure.len());
            assert!(wrong.is_empty(), "{name} on {device_name}: {wrong:?}");
        }
    }
}

/// Every voxel the paper's test accepts, measured.
fn measured(device: &mut Device, lumen: &Lumen) -> Vec<RidgePoint> {
    let mut plan = Plan::new();
    let b = LumenBuffers::new(&mut plan, lumen);
    let d = distance(&mut plan, &b);
    let f = smooth(&mut plan, &b, d, lumen.grid.spacing_mm.min_element(), None);
    let r = ridge(&mut plan, &b, d, f, 20_000);
    r.read(&device.run(&plan).unwrap()).expect("room for all")
}

/// Whether the bricks hold all that the blur and the differences at a voxel reach. Where they do
/// not, the blur has lost what passes through a missing brick between its three directions.
fn is_whole(lumen: &Lumen, at: IVec3) -> bool {
    let h = lumen.grid.spacing_mm;
    let reach = (4.0 * h.min_element() / h + 0.5).floor().as_ivec3() + 1;
    let (lo, hi): (IVec3, IVec3) = ((at - reach) >> 3i32, (at + reach) >> 3i32);
    let size = hi - lo + 1;
    (0..size.element_product()).all(|i| {
        let brick = lo + IVec3::new(i % size.x, i / size.x % size.y, i / size.x / size.y);
        lumen.bricks.slot_of(brick * 8).is_some()
    })
}

/// Largest errors of l1 and l2 (in 1/h), of the offset (in h, times the flatter curvature that it
/// was divided by), and of the slope.
type Errors = [f64; 3];
/// Single precision: second differences of a map some voxels high.
const WHOLE: Errors = [2e-5, 5e-5, 1e-5];
/// Next to a missing brick a thousandth of the blur is lost.
const CUT: Errors = [2e-3, 3e-3, 2e-3];

#[test]
fn offsets_eigenvalues_and_slopes_are_those_of_the_fixture() {
    for mut device in devices() {
        let device_name = device.name().to_owned();
        for name in NAMES {
            let lumen = lumen(name);
            let h = lumen.grid.spacing_mm.min_element();
            let candidates = measured(&mut device, &lumen);
            let (mut whole, mut cut) = ((0, Errors::default()), (0, Errors::default()));
            for row in list(&json(&format!("ridge/{name}.json"))["zero"]["accepted"]) {
                let row: Vec<f64> = list(row).iter().map(real).collect();
                let found = candidates.iter().find(|c| index(&lumen, c.element) == row[0] as i64);
                let c = found.unwrap_or_else(|| panic!("{name}: {} is missing", row[0]));
                let at = lumen.bricks.voxel(c.element);
                let depth = (f64::from(c.distance_mm) / row[1] - 1.0).abs();
                assert!(depth <= 1e-5, "{name} {at}: {}, not {}", c.distance_mm, row[1]);
                let [l1, l2] = c.across.map(f64::from);
                let offset = c.offset_mm.as_dvec3() - DVec3::from_slice(&row[5..8]);
                let errors = [
                    (l1 - row[2]).abs().max((l2 - row[3]).abs()) * h,
                    offset.length() * row[3].abs(),
                    (f64::from(c.gradient) - row[8]).abs(),
                ];
                let is_whole = is_whole(&lumen, at);
                let limit = if is_whole { WHOLE } else { CUT };
                let seen = if is_whole { &mut whole } else { &mut cut };
                seen.0 += 1;
                for k in 0..3 {
                    seen.1[k] = seen.1[k].max(errors[k]);
                    let e = errors[k];
                    assert!(e <= limit[k], "{name} {at} on {device_name}: {k} is off by {e}");
                }
            }
            assert!(whole.0 > 50, "{name}: {}", whole.0);
            println!("{device_name}: {name}: whole {whole:.7?}, cut {cut:.7?}");
        }
    }
}
