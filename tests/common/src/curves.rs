//! What the tests of centerlines share: running them on lumens, and measures of curves.

use glam::{DVec3, IVec3};
use intima::centerline::{RouteOptions, Routed, centerline, resample};
use intima::compute::{Plan, run_cpu};
use intima::field::{LumenBuffers, Sampler, distance, smooth};
use intima::lumen::{IntensitySelection, Lumen, SegmentationOptions};
use intima::volume::phantom::{Kind, Phantom, Truth};

/// A lumen, its exact distance, and what came of it.
pub struct Case {
    pub lumen: Lumen,
    pub distance: Vec<f32>,
    pub routed: Routed,
}

pub fn run(kind: Kind, size: u32, spacing_mm: f64, tree: bool) -> (Case, Truth) {
    let phantom = Phantom::new(kind, size, [spacing_mm; 3]).unwrap();
    let options = SegmentationOptions::new(IntensitySelection::Labels(vec![1]));
    let mask = phantom.mask();
    let lumen = Lumen::of_volume(mask.grid, &options.select(&mask).unwrap().0);
    (route(lumen, tree), phantom.truth())
}

pub fn route(lumen: Lumen, tree: bool) -> Case {
    route_with(lumen, RouteOptions { tree, ..RouteOptions::default() })
}

pub fn route_with(lumen: Lumen, options: RouteOptions) -> Case {
    let mut plan = Plan::new();
    let b = LumenBuffers::new(&mut plan, &lumen);
    let d = distance(&mut plan, &b);
    let f = smooth(&mut plan, &b, d, lumen.grid.spacing_mm.min_element(), None);
    plan.download(d);
    plan.download(f);
    let out = run_cpu(&plan);
    let (distance, smooth) = (out.get(d).to_vec(), out.get(f));
    let routed = centerline(&lumen, &distance, smooth, options).unwrap();
    Case { lumen, distance, routed }
}

impl Case {
    pub fn h(&self) -> f64 {
        self.lumen.grid.spacing_mm.x
    }

    /// Points in millimetres along the axes of the lumen's grid.
    pub fn local(&self, points: &[DVec3]) -> Vec<DVec3> {
        let inverse = self.lumen.grid.voxel_from_world();
        let h = self.lumen.grid.spacing_mm;
        points.iter().map(|p| inverse.transform_point3(*p) * h).collect()
    }

    /// A branch in patient space.
    pub fn points(&self, branch: usize) -> Vec<DVec3> {
        self.routed.line.branches[branch].points.iter().map(|p| p.position_mm).collect()
    }

    /// Every point and every quarter voxel between must lie in an inside voxel.
    pub fn assert_inside(&self, points: &[DVec3], what: &str) {
        for w in self.local(points).windows(2) {
            let n = (w[0].distance(w[1]) / (0.25 * self.h())).ceil().max(1.0);
            for k in 0..=n as u32 {
                let p = w[0].lerp(w[1], f64::from(k) / n);
                let v: IVec3 = (p / self.lumen.grid.spacing_mm).round().as_ivec3();
                assert!(self.lumen.holds(v), "{what}: {p} is outside");
            }
        }
    }

    /// Least share of the best distance to the wall in the section across the curve that the curve
    /// itself has, a fiftieth of it left out at either end: two dozen rays as far as the wall.
    pub fn least_clearance(&self, points: &[DVec3]) -> f64 {
        let d = Sampler { lumen: &self.lumen, field: &self.distance };
        let q = resample(&self.local(points), self.h().max(1.0));
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

/// Angles between millimetre steps, degrees.
pub fn turns(points: &[DVec3]) -> Vec<f64> {
    let q = resample(points, 1.0);
    q.windows(3).map(|w| (w[1] - w[0]).angle_between(w[2] - w[1]).to_degrees()).collect()
}
