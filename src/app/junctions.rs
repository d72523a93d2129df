//! Places where the path that is flown leaves other branches of the centerline behind.

use glam::DVec3;

use crate::flight::FlightPath;
use crate::geometry::{Centerline, CenterlinePoint};
use crate::session::FlightRoute;

/// A branch that can be taken instead.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BranchChoice {
    /// Number of the branch.
    pub branch: usize,
    /// Place on the path where the branch leaves, mm from the start.
    pub arc_mm: f64,
    /// Place a little way into the branch, LPS mm.
    pub ahead_mm: DVec3,
    /// Length of the branch from where it leaves to its tip, mm.
    pub length_mm: f64,
    /// Radius of the branch at that place, mm.
    pub radius_mm: f64,
}

/// Distance into a branch at which its direction is taken, mm.
const AHEAD_MM: f64 = 8.0;

/// All choices along a path, in its order.
///
/// * `route`: what the path was made of.
pub fn choices(line: &Centerline, path: &FlightPath, route: FlightRoute) -> Vec<BranchChoice> {
    // Branches from the root to the one that is flown to its tip, and the point at which each of
    // them is left.
    let mut way: Vec<(usize, usize)> = Vec::new();
    let last = match route {
        FlightRoute::Leaf(branch) => branch,
        FlightRoute::Trunk => 0,
        // Every branch is flown anyway.
        FlightRoute::All => return Vec::new(),
    };
    let mut next = line.branches.get(last).map(|b| (last, b.points.len().max(1) - 1));
    while let Some((branch, left_at)) = next {
        way.push((branch, left_at));
        next = line.branches[branch].start.map(|s| (s.branch, s.point));
    }
    let mut found = Vec::new();
    let mut choose = |branch: usize, from: DVec3, points: &[CenterlinePoint]| {
        let is_into = |p: &&CenterlinePoint| p.position_mm.distance(from) >= AHEAD_MM;
        let into = points.iter().find(is_into).or(points.last());
        let Some(CenterlinePoint { position_mm, radius_mm, .. }) = into.copied() else { return };
        let mut last = from;
        let length_mm = points
            .iter()
            .map(|p| std::mem::replace(&mut last, p.position_mm).distance(p.position_mm))
            .sum();
        let arc_mm = path.nearest_to(from);
        found.push(BranchChoice { branch, arc_mm, ahead_mm: position_mm, length_mm, radius_mm });
    };
    for (branch, left_at) in &way {
        let points = &line.branches[*branch].points;
        // The rest of a branch that is left before its tip.
        if left_at + 1 < points.len() {
            choose(*branch, points[*left_at].position_mm, &points[left_at + 1..]);
        }
        for (other, b) in line.branches.iter().enumerate() {
            let Some(start) = b.start.filter(|s| s.branch == *branch && s.point <= *left_at) else {
                continue;
            };
            if way.iter().all(|w| w.0 != other) {
                choose(other, points[start.point].position_mm, &b.points);
            }
        }
    }
    found.sort_by(|a, b| a.arc_mm.total_cmp(&b.arc_mm).then(a.branch.cmp(&b.branch)));
    found
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::flight::Flight;
    use crate::geometry::{Attachment, Branch, Pose};
    use glam::Quat;

    fn branch(start: Option<(usize, usize)>, points: &[[f64; 2]]) -> Branch {
        let point = |p: &[f64; 2]| CenterlinePoint {
            position_mm: DVec3::new(p[0], p[1], 0.0),
            radius_mm: 1.0,
            abscissa_mm: 0.0,
        };
        let start = start.map(|(branch, point)| Attachment { branch, point });
        Branch { start, end: None, points: points.iter().map(point).collect() }
    }

    /// A trunk along x, a branch up at 20 mm, one down at 40 mm, one off the branch.
    pub fn tree() -> Centerline {
        let trunk: Vec<[f64; 2]> = (0..=6).map(|i| [10.0 * f64::from(i), 0.0]).collect();
        Centerline {
            branches: vec![
                branch(None, &trunk),
                branch(Some((0, 2)), &[[20.0, 0.0], [20.0, 10.0], [20.0, 20.0]]),
                branch(Some((0, 4)), &[[40.0, 0.0], [40.0, -10.0]]),
                branch(Some((1, 1)), &[[20.0, 10.0], [10.0, 10.0]]),
            ],
        }
    }

    /// A flight to the tip of a branch.
    pub fn path(line: &Centerline, leaf: usize) -> FlightPath {
        let points = line.path_to(leaf);
        let pose = |p: &CenterlinePoint| Pose {
            position_mm: p.position_mm.as_vec3(),
            rotation: Quat::IDENTITY,
        };
        let n = points.len();
        let flight = Flight {
            poses: points.iter().map(pose).collect(),
            near_mm: vec![1.0; n],
            seconds: (0..n).map(|i| i as f64).collect(),
            arc_mm: points
                .iter()
                .scan((points[0].position_mm, 0.0), |(last, arc), p| {
                    *arc += p.position_mm.distance(std::mem::replace(last, p.position_mm));
                    Some(*arc)
                })
                .collect(),
            clearance_mm: vec![1.0; n],
            room_mm: vec![1.0; n],
            fov_y_rad: 1.0,
            aspect: 1.0,
            moved: 0,
            cuts: Vec::new(),
            left_out: 0,
        };
        FlightPath::new(&flight, line).unwrap()
    }

    #[test]
    fn every_branch_beside_the_way_can_be_chosen_where_it_leaves() {
        let line = tree();
        let of = |leaf, route| {
            let all = choices(&line, &path(&line, leaf), route);
            all.iter().map(|c| (c.branch, c.arc_mm)).collect::<Vec<_>>()
        };
        assert_eq!(of(0, FlightRoute::Trunk), [(1, 20.0), (2, 40.0)]);
        // On the branch the rest of the trunk is a choice, and what leaves the trunk later is not.
        assert_eq!(of(1, FlightRoute::Leaf(1)), [(0, 20.0), (3, 30.0)]);
        assert_eq!(of(3, FlightRoute::Leaf(3)), [(0, 20.0), (1, 30.0)]);
        assert_eq!(of(0, FlightRoute::All), []);
        let into = choices(&line, &path(&line, 1), FlightRoute::Leaf(1));
        assert_eq!((into[0].length_mm, into[0].radius_mm), (40.0, 1.0), "the rest of the trunk");
        assert_eq!(into[0].ahead_mm, DVec3::new(30.0, 0.0, 0.0));
        assert_eq!(into[1].ahead_mm, DVec3::new(10.0, 10.0, 0.0));
    }
}
