//! Centerlines of analytic phantoms against their true axes.

use common::curves::{Case, run, turns};
use glam::DVec3;
use intima::centerline::resample;
use intima::volume::phantom::{Kind, Truth, TruthBranch};

/// Distance to a polyline, whether the nearest point is one of its ends, and its radius there.
fn nearest(line: &TruthBranch, p: DVec3) -> (f64, bool, f64) {
    let at = |i: usize| DVec3::from_slice(&line.points[i][..3]);
    let n = line.points.len();
    let one = |i: usize| {
        let (a, b) = (at(i), at(i + 1));
        let t = ((p - a).dot(b - a) / a.distance_squared(b)).clamp(0.0, 1.0);
        let end = !line.closed && ((i == 0 && t == 0.0) || (i + 2 == n && t == 1.0));
        (p.distance(a.lerp(b, t)), end, line.points[i][3])
    };
    (0..n - 1).map(one).min_by(|a, b| a.0.total_cmp(&b.0)).unwrap()
}

/// Mean and largest distance to the axis in voxels, one radius left out at either end.
fn off_axis((case, truth): &(Case, Truth)) -> (f64, f64) {
    let axis = &truth.branches[0];
    let curve = resample(&case.points(0), 0.25 * case.h());
    let radius = axis.points[0][3];
    let trim = (radius / (0.25 * case.h())).ceil() as usize;
    let core = &curve[trim..curve.len() - trim];
    let off: Vec<f64> = core
        .iter()
        .map(|p| nearest(axis, *p))
        .filter(|(_, end, _)| !end)
        .map(|(d, ..)| d / case.h())
        .collect();
    assert!(2 * off.len() > curve.len(), "most of the curve lies beside the axis");
    // Nothing of the axis may be missing either; a ring is cut open where the curve ends.
    let mut points = axis.points.iter().map(|q| DVec3::from_slice(&q[..3]));
    let reached = points.all(|q| curve.iter().any(|p| p.distance(q) <= radius));
    assert!(axis.closed || reached, "the curve misses a part of the axis");
    (off.iter().sum::<f64>() / off.len() as f64, off.iter().copied().fold(0.0, f64::max))
}

#[test]
fn curves_follow_the_axes_of_tubes_helices_rings_and_bends_within_a_tenth_of_a_voxel() {
    let kinds = [Kind::Tube, Kind::Ellipse, Kind::Bend, Kind::Helix, Kind::Torus];
    for (kind, size) in kinds.into_iter().flat_map(|k| [64, 96].map(|s| (k, s))) {
        let found = run(kind, size, 1.0, false);
        let (case, _) = &found;
        let what = format!("{} at {size}", kind.name());
        case.assert_inside(&case.points(0), &what);
        let (mean, most) = off_axis(&found);
        println!("{what}: mean {mean:.3}, largest {most:.3} voxel, {:?}", case.routed.proof);
        assert!(mean <= 0.1 && most <= 0.75, "{what}: mean {mean}, largest {most} voxel");
        assert_eq!(case.routed.proof.replaced, 0, "{what}");
    }
}

#[test]
fn the_curve_of_a_colon_with_folds_keeps_within_three_tenths_of_a_voxel_of_its_axis() {
    for size in [64, 96] {
        let (mean, most) = off_axis(&run(Kind::Colon, size, 1.0, false));
        println!("{size}: mean {mean:.3}, largest {most:.3} voxel");
        assert!(mean <= 0.3 && most <= 0.75, "{size}: mean {mean}, largest {most} voxel");
    }
}

#[test]
fn curves_keep_nine_tenths_of_the_clearance_there_is() {
    // In smaller colons the folds leave two or three voxels, of which the very axis keeps 0.89 to
    // 0.92 by this measure.
    for kind in [Kind::Tube, Kind::Helix, Kind::Colon, Kind::Y] {
        for size in [64, 80, 96].into_iter().filter(|s| kind != Kind::Colon || *s == 96) {
            let (case, _) = run(kind, size, 1.0, false);
            let what = format!("{} at {size}", kind.name());
            case.assert_inside(&case.points(0), &what);
            let least = case.least_clearance(&case.points(0));
            println!("{what}: least clearance {least:.3}, {:?}", case.routed.proof);
            assert!(least >= 0.90, "{what}: {least}");
        }
    }
}

#[test]
fn curves_through_a_colon_turn_no_more_than_three_degrees_a_millimetre() {
    // The mean radius is 0.055 of the box: 8 mm.
    for (size, spacing) in [(64, 2.3), (96, 1.53)] {
        let (case, _) = run(Kind::Colon, size, spacing, false);
        let turns = turns(&case.points(0));
        let mean = turns.iter().sum::<f64>() / turns.len() as f64;
        println!("{size}: mean turn {mean:.2} degrees a mm");
        assert!(mean <= 3.0, "{size}: {mean}");
    }
}
