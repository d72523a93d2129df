//! Centerlines of analytic phantoms against their true axes.

use glam::{DVec3, IVec3};
use intima::centerline::{Ends, RouteOptions, Routed, Sampler, centerline, resample};
use intima::compute::{Plan, run_cpu};
use intima::field::{LumenBuffers, distance, smooth};
use intima::lumen::{Lumen, Recipe, Window};
use intima::volume::phantom::{Kind, Phantom, Truth, TruthBranch};

/// A phantom, its lumen and the exact distance, and what came of it. Axes are the grid's, the
/// first voxel is the origin: patient space and local millimetres agree.
struct Case {
    truth: Truth,
    lumen: Lumen,
    distance: Vec<f32>,
    routed: Routed,
}

fn run(kind: Kind, size: u32, spacing_mm: f64, tree: bool) -> Case {
    let phantom = Phantom::new(kind, size, [spacing_mm; 3]).unwrap();
    let recipe = Recipe::new(Window::Labels(vec![1]));
    let lumen = recipe.apply(&phantom.mask()).unwrap().0;
    let mut plan = Plan::new();
    let b = LumenBuffers::new(&mut plan, &lumen);
    let d = distance(&mut plan, &b);
    let f = smooth(&mut plan, &b, d, spacing_mm, None);
    plan.download(d);
    plan.download(f);
    let out = run_cpu(&plan);
    let (distance, smooth) = (out.get(d).to_vec(), out.get(f));
    let options = RouteOptions { ends: Ends::default(), tree };
    let routed = centerline(&lumen, &distance, smooth, options).unwrap();
    Case { truth: phantom.truth(), lumen, distance, routed }
}

impl Case {
    fn h(&self) -> f64 {
        self.lumen.grid.spacing_mm.x
    }

    fn points(&self, branch: usize) -> Vec<DVec3> {
        self.routed.line.branches[branch].points.iter().map(|p| p.position_mm).collect()
    }

    /// Every point and every quarter voxel between must lie in an inside voxel.
    fn assert_inside(&self, points: &[DVec3], what: &str) {
        for w in points.windows(2) {
            let n = (w[0].distance(w[1]) / (0.25 * self.h())).ceil().max(1.0);
            for k in 0..=n as u32 {
                let p = w[0].lerp(w[1], f64::from(k) / n);
                let v: IVec3 = (p / self.h()).round().as_ivec3();
                assert!(self.lumen.holds(v), "{what}: {p} is outside");
            }
        }
    }

    /// Least share of the best distance to the wall in the section across the curve that the curve
    /// itself has, a fiftieth of it left out at either end: two dozen rays as far as the wall.
    fn least_clearance(&self, points: &[DVec3]) -> f64 {
        let d = Sampler { lumen: &self.lumen, field: &self.distance };
        let q = resample(points, self.h().max(1.0));
        let (n, h) = (q.len(), 0.5 * self.h());
        let ratio = |i: usize| {
            let t = (q[(i + 1).min(n - 1)] - q[i.saturating_sub(1)]).normalize();
            let (u, v) = t.any_orthonormal_pair();
            let here = d.at(q[i]);
            let best = (0..24).fold(here, |mut best, k| {
                let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
                for step in 1.. {
                    let far = d.at(q[i] + (cos * u + sin * v) * (f64::from(step) * h));
                    if far <= h {
                        break;
                    }
                    best = best.max(far);
                }
                best
            });
            here / best
        };
        let skip = (n / 50).max(1);
        (skip..n - skip).map(ratio).fold(1.0, f64::min)
    }
}

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
fn off_axis(case: &Case) -> (f64, f64) {
    let axis = &case.truth.branches[0];
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
        let case = run(kind, size, 1.0, false);
        let what = format!("{} at {size}", kind.name());
        case.assert_inside(&case.points(0), &what);
        let (mean, most) = off_axis(&case);
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
    for kind in [Kind::Tube, Kind::Helix, Kind::Colon, Kind::Y] {
        for size in [64, 96] {
            let case = run(kind, size, 1.0, false);
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
        let case = run(Kind::Colon, size, spacing, false);
        let q = resample(&case.points(0), 1.0);
        let turns: Vec<f64> =
            q.windows(3).map(|w| (w[1] - w[0]).angle_between(w[2] - w[1]).to_degrees()).collect();
        let mean = turns.iter().sum::<f64>() / turns.len() as f64;
        println!("{size}: mean turn {mean:.2} degrees a mm");
        assert!(mean <= 3.0, "{size}: {mean}");
    }
}

#[test]
fn a_tree_has_the_four_tips_and_every_child_starts_on_its_parent() {
    for size in [64, 96] {
        let case = run(Kind::Y, size, 1.0, true);
        let branches = &case.routed.line.branches;
        let mut tips: Vec<(usize, f64)> = Vec::new();
        for (i, b) in branches.iter().enumerate() {
            let points = case.points(i);
            case.assert_inside(&points, "tree");
            let least = case.least_clearance(&points);
            println!("{size}: branch {i} of {:?}: least clearance {least:.3}", b.parent);
            assert!(least >= 0.90, "{size}, branch {i}: {least}");
            let tip = *points.last().unwrap();
            let near = |e: &DVec3| e.distance(tip);
            let nearest = (0..4)
                .min_by(|&a, &b| near(&case.truth.ends[a]).total_cmp(&near(&case.truth.ends[b])));
            tips.push((nearest.unwrap(), near(&case.truth.ends[nearest.unwrap()]) / case.h()));
            let Some(parent) = b.parent else { continue };
            assert!(parent < i, "branch {i} comes before its parent {parent}");
            let up = case.points(parent);
            let at = up.iter().position(|p| p.distance(points[0]) < 1e-6 * case.h());
            let at = at.unwrap_or_else(|| panic!("branch {i} hangs in the air"));
            let abscissa = branches[parent].points[at].abscissa_mm;
            assert!((b.points[0].abscissa_mm - abscissa).abs() < 1e-9);
        }
        println!("{size}: tips {tips:.2?}");
        assert_eq!(branches.iter().filter(|b| b.parent.is_none()).count(), 1);
        tips.sort_by_key(|t| t.0);
        assert_eq!(tips.iter().map(|t| t.0).collect::<Vec<_>>(), [0, 1, 2, 3]);
        // The lumen goes on for a radius of a twenty-fourth of the box beyond an axis' end.
        assert!(tips.iter().all(|t| t.1 < 0.042 * f64::from(size)), "{tips:?}");
        let root = case.points(0)[0].distance(case.truth.start) / case.h();
        assert!(root < 0.075 * f64::from(size), "the root is {root} voxels from the trunk's end");
    }
}
