//! Radius and clearance of a centerline from the wall that is drawn, and the way of points that lie
//! beyond it.
//!
//! A curve is proven to stay in the voxels of the lumen. The wall cuts the corners of voxels, so that
//! a curve in a lumen one or two voxels wide may pass through it. Centres of inside voxels never lie
//! beyond the wall, and neither do segments between those of voxels that share a face: the wall
//! crosses edges of the grid only between an inside and an outside voxel.

use std::collections::{BTreeMap, VecDeque};

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::inscribed::measure_radius;
use crate::geometry::{Branch, Centerline, CenterlinePoint, TriangleBvh};
use crate::lumen::Lumen;

/// A centerline measured against a wall.
#[derive(Clone, Debug)]
pub struct WithinWall {
    /// The line. Its radius is the radius of the inscribed sphere ([`measure_radius`]).
    pub line: Centerline,
    /// Least distance of the curve to the wall, between points too, mm.
    pub clearance_mm: f64,
    /// Number of points that were replaced because they, or the segments to them, lay beyond the wall.
    pub rerouted: usize,
    /// Points that lie beyond the wall: ends that someone gave there, LPS mm.
    pub outside_mm: Vec<DVec3>,
}

/// Resolution of the clearance between two points, mm.
const FINE_MM: f64 = 1e-3;
/// Largest number of points that a straight piece of a rerouted stretch passes.
const STRAIGHT: usize = 8;
/// No triangle.
const NONE: usize = usize::MAX;

/// Gives a centerline the radius of a wall, and leads it back to the lumen's side of the wall.
///
/// * `tree`: triangles of the closed wall of the lumen, LPS mm.
/// * `fixed`: whether the first point of the first branch and its last point stay where they are.
pub fn within_wall(
    line: &Centerline,
    lumen: &Lumen,
    tree: &TriangleBvh,
    fixed: [bool; 2],
) -> WithinWall {
    let wall = DrawnSide { lumen, tree };
    let made: Vec<(Vec<DVec3>, Vec<usize>, usize)> = line
        .branches
        .par_iter()
        .enumerate()
        .map(|(i, branch)| {
            crate::task::checkpoint();
            let is_fixed = if i == 0 { fixed } else { [false; 2] };
            wall.rerouted(branch, is_fixed)
        })
        .collect();
    let rerouted = made.iter().map(|m| m.2).sum();
    let mut out = Centerline::default();
    for (branch, (points, place, _)) in line.branches.iter().zip(&made) {
        let mapped = |mut to: crate::geometry::Attachment| {
            to.point = made[to.branch].1[to.point];
            to
        };
        let start = branch.start.map(mapped);
        let before = start.map_or(0.0, |s| out.branches[s.branch].points[s.point].abscissa_mm);
        let first = branch.points.first().map_or(0.0, |p| p.abscissa_mm);
        let offset = if start.is_some() { before } else { first };
        let mut abscissa_mm = offset;
        let point = |(k, at): (usize, &DVec3)| {
            if k > 0 {
                abscissa_mm += at.distance(points[k - 1]);
            }
            CenterlinePoint { position_mm: *at, radius_mm: 0.0, abscissa_mm }
        };
        debug_assert_eq!(place.len(), branch.points.len());
        let points = points.iter().enumerate().map(point).collect();
        out.branches.push(Branch { start, end: branch.end.map(mapped), points });
    }
    measure_radius(&mut out, tree, lumen.grid.spacing_mm.max_element());
    let outside = out.branches.iter().flat_map(|b| &b.points).map(|p| p.position_mm);
    WithinWall {
        clearance_mm: clearance_mm(&out, tree),
        outside_mm: outside.filter(|p| !wall.holds(*p)).collect(),
        line: out,
        rerouted,
    }
}

/// Returns the least distance of a line to a wall, between its points too.
pub fn clearance_mm(line: &Centerline, tree: &TriangleBvh) -> f64 {
    let distances = |b: &Branch| -> Vec<(DVec3, f64)> {
        let places = b.points.par_iter().map(|p| p.position_mm).with_min_len(64);
        places.map(|p| (p, tree.distance(p, f64::INFINITY))).collect()
    };
    let branches: Vec<Vec<(DVec3, f64)>> = line.branches.iter().map(distances).collect();
    let least = branches.iter().flatten().map(|p| p.1).fold(f64::INFINITY, f64::min);
    // Between points the distance is looked at only where it can be less.
    let mut open: Vec<[(DVec3, f64); 2]> =
        branches.iter().flat_map(|b| b.windows(2).map(|w| [w[0], w[1]])).collect();
    let mut least = least;
    while let Some([a, b]) = open.pop() {
        let length = a.0.distance(b.0);
        // It changes by no more than the length.
        if length < FINE_MM || 0.5 * (a.1 + b.1 - length) >= least {
            continue;
        }
        let at = 0.5 * (a.0 + b.0);
        let middle = (at, tree.distance(at, f64::INFINITY));
        least = least.min(middle.1);
        open.extend([[a, middle], [middle, b]]);
    }
    least
}

/// The lumen's side of a wall.
struct DrawnSide<'a> {
    lumen: &'a Lumen,
    tree: &'a TriangleBvh,
}

impl DrawnSide<'_> {
    fn world(&self, v: IVec3) -> DVec3 {
        self.lumen.grid.world_from_voxel().transform_point3(v.as_dvec3())
    }

    fn voxel(&self, p: DVec3) -> IVec3 {
        self.lumen.grid.voxel_from_world().transform_point3(p).round().as_ivec3()
    }

    /// Whether no triangle lies between two points.
    fn joins(&self, a: DVec3, b: DVec3) -> bool {
        // A ray begins at a place that single precision holds.
        let eye = a.as_vec3().as_dvec3();
        self.tree.occluder(eye, b - eye, NONE).is_none()
    }

    /// Whether a point lies on the lumen's side: nothing lies between it and the centre of its own
    /// voxel or of one beside it, which do.
    fn holds(&self, p: DVec3) -> bool {
        let own = self.voxel(p);
        let joins = |v: IVec3| self.lumen.holds(v) && self.joins(self.world(v), p);
        joins(own) || IVec3::AXES.into_iter().any(|d| joins(own + d) || joins(own - d))
    }

    /// Points of a branch on the lumen's side, the new place of each old one, and the number of points
    /// that were replaced.
    fn rerouted(&self, branch: &Branch, fixed: [bool; 2]) -> (Vec<DVec3>, Vec<usize>, usize) {
        let points: Vec<DVec3> = branch.points.iter().map(|p| p.position_mm).collect();
        let last = points.len().saturating_sub(1);
        let stays = |i: usize| i == 0 && fixed[0] || i == last && fixed[1];
        let is_good: Vec<bool> = points.iter().map(|p| self.holds(*p)).collect();
        let is_joined: Vec<bool> = points.windows(2).map(|w| self.joins(w[0], w[1])).collect();
        if is_good.iter().zip(0..).all(|(good, i)| *good || stays(i))
            && is_joined.iter().all(|j| *j)
        {
            return (points, (0..=last).collect(), 0);
        }
        let (mut out, mut place, mut replaced) = (Vec::new(), Vec::new(), 0);
        let mut i = 0;
        while i <= last {
            if is_good[i] && (i == 0 || is_joined[i - 1]) || stays(i) {
                place.push(out.len());
                out.push(points[i]);
                i += 1;
                continue;
            }
            // A stretch up to the next point that is good, and joined to the one after it.
            let begin = i;
            let rest = is_good[i..].iter().zip(i..);
            let end = rest
                .filter(|(good, j)| **good && *j > begin.saturating_sub(1))
                .map(|(_, j)| j)
                .find(|j| *j == last || is_joined[*j])
                .unwrap_or(last);
            let from = out.last().copied();
            let goal = (is_good[end] || stays(end)).then_some(points[end]);
            let way = self.way(from.unwrap_or(points[begin]), goal.unwrap_or(points[end]));
            let first = out.len();
            out.extend(way);
            replaced += end - begin;
            if goal.is_some() {
                out.push(points[end]);
            } else {
                replaced += 1;
            }
            let span = (out.len() - first).max(1);
            let count = end - begin + 1;
            for k in 0..count {
                let share = if count > 1 { k * (span - 1) / (count - 1) } else { span - 1 };
                place.push((first + share).min(out.len() - 1));
            }
            i = end + 1;
        }
        (out, place, replaced)
    }

    /// Shortest way between the voxels of two points, over centres of voxels that share faces. Centres
    /// that a straight piece can skip are left out.
    fn way(&self, from: DVec3, to: DVec3) -> Vec<DVec3> {
        let [a, b] = [from, to].map(|p| self.inside_voxel(p));
        let mut parent: BTreeMap<[i32; 3], IVec3> = BTreeMap::from([(a.to_array(), a)]);
        let mut open = VecDeque::from([a]);
        while let Some(v) = open.pop_front() {
            if v == b {
                break;
            }
            for step in IVec3::AXES.into_iter().flat_map(|d| [d, -d]) {
                let next = v + step;
                if self.lumen.holds(next) && !parent.contains_key(&next.to_array()) {
                    parent.insert(next.to_array(), v);
                    open.push_back(next);
                }
            }
        }
        let mut way = vec![b];
        while let Some(v) = parent.get(&way[way.len() - 1].to_array()).copied() {
            if v == way[way.len() - 1] {
                break;
            }
            way.push(v);
        }
        way.reverse();
        let centres: Vec<DVec3> = way.into_iter().map(|v| self.world(v)).collect();
        let mut out = vec![centres[0]];
        let mut at = 0;
        while at + 1 < centres.len() {
            let far = (at + 2..(at + STRAIGHT).min(centres.len()))
                .rev()
                .find(|j| self.joins(centres[at], centres[*j]));
            at = far.unwrap_or(at + 1);
            out.push(centres[at]);
        }
        out
    }

    /// The inside voxel of a point: its own, or the nearest that joins it.
    fn inside_voxel(&self, p: DVec3) -> IVec3 {
        let own = self.voxel(p);
        let off = |v: &IVec3| self.world(*v).distance_squared(p);
        let mut near: Vec<IVec3> = (0..27)
            .map(|n| own + crate::lumen::bricks::near_offset(n))
            .filter(|v| self.lumen.holds(*v))
            .collect();
        near.sort_by(|a, b| off(a).total_cmp(&off(b)));
        let joined = near.iter().copied().find(|v| self.joins(self.world(*v), p));
        joined.or(near.first().copied()).unwrap_or(own)
    }
}
