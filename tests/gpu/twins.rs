//! CPU twins alone, on the cases' lumens: no device is needed.

use glam::IVec3;
use intima::compute::run_cpu;
use intima::kernels::visibility::sees;

use crate::cases;

#[test]
fn every_kernel_has_cases_that_run_on_the_cpu() {
    for (kernel, cases) in cases::all() {
        assert!(cases.len() >= 4, "{} has {} cases", kernel.name(), cases.len());
        for case in &cases {
            assert!(!case.plan.downloads().is_empty(), "{}/{}", kernel.name(), case.name);
            run_cpu(&case.plan);
        }
    }
}

#[test]
fn cases_reach_beyond_64_voxels_a_side_and_distances_of_32() {
    let sides = |l: &intima::lumen::Lumen| l.grid.dims.min_element();
    let long = cases::lumens().into_iter().filter(|(_, l)| sides(l) > 64 && l.inside_voxels() > 0);
    assert!(long.count() > 0);
    let far = cases::of("edt_axis").into_iter().map(|case| {
        let out = run_cpu(&case.plan);
        let last = *case.plan.downloads().last().unwrap();
        out.words(last).iter().map(|w| f32::from_bits(*w)).fold(0.0, f32::max)
    });
    assert!(far.fold(0.0, f32::max) > 36.0);
}

#[test]
fn a_copy_is_whole_and_nothing_behind_it_is_written() {
    for case in cases::of("copy") {
        let out = run_cpu(&case.plan);
        let words = out.words(case.plan.downloads()[0]);
        let quads = case.plan.steps()[0].items;
        let same = (0..quads as u32)
            .all(|q| words[4 * q as usize..][..4] == [q, !q, q.wrapping_mul(7), q << 16]);
        assert!(same && words[4 * quads..].iter().all(|w| *w == 0), "{}", case.name);
    }
}

/// Plain ray walk in rational arithmetic over a closure: the reference of `sees`.
fn walk(d: IVec3, open: impl Fn(IVec3) -> bool) -> bool {
    let n = d.abs();
    let mut crossings: Vec<(i64, i64, usize)> = (0..3)
        .flat_map(|a| (0..n[a]).map(move |i| (i64::from(2 * i + 1), i64::from(n[a]), a)))
        .collect();
    crossings.sort_by(|x, y| (x.0 * y.1).cmp(&(y.0 * x.1)).then(x.2.cmp(&y.2)));
    let mut p = IVec3::ZERO;
    for (k, (_, _, axis)) in crossings.iter().enumerate() {
        p[*axis] += d[*axis].signum();
        if k + 1 < crossings.len() && !open(p) {
            return false;
        }
    }
    true
}

#[test]
fn the_ray_walk_equals_sorting_all_crossings() {
    for (name, lumen) in cases::lumens() {
        let near: Vec<u32> = lumen.bricks.near().iter().flatten().copied().collect();
        let open: &[u32] = bytemuck::cast_slice(&lumen.inside);
        let all: Vec<usize> = lumen.elements(&lumen.inside).collect();
        for (i, &a) in all.iter().enumerate().step_by(1 + all.len() / 60) {
            for &b in all.iter().skip(i % 5).step_by(1 + all.len() / 60) {
                let v = lumen.bricks.voxel(a);
                let d = lumen.bricks.voxel(b) - v;
                let want = walk(d, |q| lumen.holds(v + q));
                assert_eq!(sees(&near, open, b, d), want, "{name} from {v} by {d}");
            }
        }
    }
}
