//! Trees of a branching phantom, and a lumen whose sections disagree.

use common::curves::{route, run, turns};
use glam::DVec3;
use intima::lumen::{BitVolume, Lumen};
use intima::volume::Grid;
use intima::volume::phantom::Kind;

#[test]
fn a_curve_through_uneven_pockets_does_not_fold() {
    // Balls of all sizes, off a line to all sides: the best places of neighbouring sections jump.
    let random = |i: u32, k: u32| f64::from((i * 7919 + k * 104_729 + i * i * 31) % 1000) / 1000.0;
    let balls: Vec<(DVec3, f64)> = (0..14)
        .map(|i| {
            let off = |k| 14.0 * (random(i, k) - 0.5);
            let c = DVec3::new(20.0 + 13.0 * f64::from(i), 32.0 + off(1), 32.0 + off(2));
            (c, 9.0 + 7.0 * random(i, 3))
        })
        .collect();
    let grid = Grid::axis_aligned([210, 65, 65], [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        if balls.iter().any(|(c, r)| c.distance(v.as_dvec3()) < *r) {
            bits.set(v.x, v.y, v.z);
        }
    }
    let case = route(Lumen::of_volume(grid, &bits), false);
    let points = case.points(0);
    case.assert_inside(&points, "pockets");
    let length = case.routed.line.length_mm();
    let centres: f64 = balls.windows(2).map(|w| w[0].0.distance(w[1].0)).sum();
    let most = turns(&points).into_iter().fold(0.0, f64::max);
    println!(
        "pockets: {length:.1} mm, {centres:.1} mm from centre to centre, sharpest turn {most:.1} degrees"
    );
    assert!(length < centres && most < 20.0, "{length} for {centres}, {most} degrees");
}

#[test]
fn a_tree_has_the_four_tips_and_every_child_starts_on_its_parent() {
    for size in [64, 96] {
        let (case, truth) = run(Kind::Y, size, 1.0, true);
        let branches = &case.routed.line.branches;
        let mut tips: Vec<(usize, f64)> = Vec::new();
        for (i, b) in branches.iter().enumerate() {
            let points = case.points(i);
            case.assert_inside(&points, "tree");
            let least = case.least_clearance(&points);
            println!("{size}: branch {i} of {:?}: least clearance {least:.3}", b.parent());
            assert!(least >= 0.90, "{size}, branch {i}: {least}");
            let tip = *points.last().unwrap();
            let near = |e: &DVec3| e.distance(tip);
            let nearest =
                (0..4).min_by(|&a, &b| near(&truth.ends[a]).total_cmp(&near(&truth.ends[b])));
            tips.push((nearest.unwrap(), near(&truth.ends[nearest.unwrap()]) / case.h()));
            let Some(parent) = b.parent() else { continue };
            assert!(parent < i, "branch {i} comes before its parent {parent}");
            let up = case.points(parent);
            let at = up.iter().position(|p| p.distance(points[0]) < 1e-6 * case.h());
            let at = at.unwrap_or_else(|| panic!("branch {i} hangs in the air"));
            let abscissa = branches[parent].points[at].abscissa_mm;
            assert!((b.points[0].abscissa_mm - abscissa).abs() < 1e-9);
        }
        println!("{size}: tips {tips:.2?}");
        assert_eq!(branches.iter().filter(|b| b.parent().is_none()).count(), 1);
        tips.sort_by_key(|t| t.0);
        assert_eq!(tips.iter().map(|t| t.0).collect::<Vec<_>>(), [0, 1, 2, 3]);
        // The lumen goes on for a radius of a twenty-fourth of the box beyond an axis' end.
        assert!(tips.iter().all(|t| t.1 < 0.042 * f64::from(size)), "{tips:?}");
        let root = case.points(0)[0].distance(truth.start) / case.h();
        assert!(root < 0.075 * f64::from(size), "the root is {root} voxels from the trunk's end");
    }
}

#[test]
fn a_single_path_without_ends_starts_in_the_trunk_and_not_between_two_side_branches() {
    // A wide trunk that ends in two long thin twigs: the longest path joins the twigs.
    use glam::DVec3;
    use intima::lumen::{BitVolume, Lumen};
    let grid = intima::volume::Grid::axis_aligned([120, 24, 60], [1.0; 3]);
    let mut bits = BitVolume::new(grid.dims);
    let segment = |p: DVec3, a: DVec3, b: DVec3| {
        let t = ((p - a).dot(b - a) / (b - a).length_squared()).clamp(0.0, 1.0);
        p.distance(a.lerp(b, t))
    };
    let at = |x: f64, z: f64| DVec3::new(x, 12.0, z);
    for v in (0..grid.len()).map(|i| grid.voxel(i)) {
        let p = v.as_dvec3();
        let inside = segment(p, at(60.0, 50.0), at(60.0, 20.0)) < 8.0
            || segment(p, at(60.0, 20.0), at(8.0, 6.0)) < 3.0
            || segment(p, at(60.0, 20.0), at(112.0, 6.0)) < 3.0;
        if inside {
            bits.set(v.x, v.y, v.z);
        }
    }
    let lumen = Lumen::of_volume(grid, &bits);
    let mut plan = intima::compute::Plan::new();
    let buffers = intima::field::LumenBuffers::new(&mut plan, &lumen);
    let d = intima::field::distance(&mut plan, &buffers);
    let f = intima::field::smooth(&mut plan, &buffers, d, 1.0, None);
    plan.download(d);
    plan.download(f);
    let out = intima::compute::run_cpu(&plan);
    let options = intima::centerline::RouteOptions::default();
    let routed = intima::centerline::centerline(&lumen, out.get(d), out.get(f), options).unwrap();
    let points = &routed.line.branches[0].points;
    assert!(points[0].position_mm.distance(at(60.0, 50.0)) < 3.0, "{}", points[0].position_mm);
    let tip = points[points.len() - 1].position_mm;
    assert!(tip.z < 9.0 && (tip.x < 15.0 || tip.x > 105.0), "{tip}");
}
