//! A tree of curves split into branches and bifurcations, as VMTK's branch extractor splits it
//! (Antiga and Steinman 2004, Robust and objective decomposition and mapping of bifurcating
//! vessels, IEEE Transactions on Medical Imaging 23(6), 704-713, doi:10.1109/TMI.2004.826946).
//!
//! A path leads from a root to a tip. Where two paths part, each has left the other's tube (the
//! union of its inscribed spheres) at some point; the bifurcation extends from there back to the
//! inscribed sphere that touches that point. Departures: paths are split at their own points, half
//! a voxel apart, not between them; the upstream limit is common to all paths, the farthest back of
//! them; bifurcations that overlap on one path are one.

use std::collections::BTreeMap;
use std::ops::Range;

use crate::geometry::{Attachment, Centerline, CenterlinePoint};

/// A stretch of a path.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Tract {
    /// Index of the path.
    pub path: usize,
    /// Number of the branch or bifurcation, shared by the stretches of several paths in it.
    pub group: usize,
    /// Position of the stretch along the path, from 0.
    pub tract: usize,
    /// Whether the stretch lies within a bifurcation.
    pub blanking: bool,
    /// Points of the path in the stretch; neighbouring stretches share one.
    pub points: Range<usize>,
}

/// Paths from the root to every tip, and their stretches.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Tracts {
    /// Points of each path.
    pub paths: Vec<Vec<CenterlinePoint>>,
    /// Stretches, path by path.
    pub tracts: Vec<Tract>,
}

/// A fork and the stretches of the branches about it. Points are counted along the paths through
/// it.
struct Bifurcation {
    fork: Attachment,
    /// Last point before the fork that is not part of the bifurcation.
    start: usize,
    /// Branches that continue from the fork, each with its first point outside the others' tubes.
    ways: Vec<(usize, usize)>,
}

impl Centerline {
    /// Splits all paths at bifurcations.
    ///
    /// # Panics
    /// Where [`Centerline::check_attachments`] has an error.
    pub fn tracts(&self) -> Tracts {
        let offsets = self.offsets();
        let bifurcations = self.bifurcations(&offsets);
        let tips: Vec<usize> = self.tips().collect();
        // What each path passes through: bifurcation, and the points it takes there.
        let passed: Vec<Vec<(usize, Range<usize>)>> =
            tips.iter().map(|tip| self.passed(*tip, &bifurcations)).collect();
        let mut merged: Vec<usize> = (0..bifurcations.len()).collect();
        while passed.iter().any(|p| merge_overlaps(p, &mut merged)) {}

        let mut out = Tracts::default();
        let mut groups = GroupNumbers::default();
        for (path, (tip, passed)) in tips.iter().zip(&passed).enumerate() {
            let points = self.path_to(*tip);
            let last = points.len().saturating_sub(1);
            let mut tract = 0;
            let mut add = |group, points: Range<usize>, blanking| {
                if points.start < points.end || last == 0 {
                    out.tracts.push(Tract { path, group, tract, blanking, points });
                    tract += 1;
                }
            };
            let mut from = 0;
            for (b, within) in blanks(passed, &merged) {
                if from < within.start {
                    add(groups.branch(&points, from..within.start), from..within.start, false);
                }
                from = within.end.min(last);
                add(groups.bifurcation(b), within.start..from, true);
            }
            if from < last || last == 0 {
                add(groups.branch(&points, from..last), from..last, false);
            }
            out.paths.push(points);
        }
        out
    }

    /// Returns the position of each branch's first point in a path along it.
    fn offsets(&self) -> Vec<usize> {
        let mut offsets: Vec<usize> = Vec::with_capacity(self.branches.len());
        for b in &self.branches {
            let of = b.start.map_or(0, |s| {
                let parent = &self.branches[s.branch].points;
                let gap = parent.get(s.point).zip(b.points.first());
                let same =
                    gap.is_some_and(|(p, q)| p.position_mm.distance_squared(q.position_mm) < 1e-12);
                offsets[s.branch] + s.point + usize::from(!same)
            });
            offsets.push(of);
        }
        offsets
    }

    fn bifurcations(&self, offsets: &[usize]) -> Vec<Bifurcation> {
        let mut forks: BTreeMap<Attachment, Vec<usize>> = BTreeMap::new();
        for (i, b) in self.branches.iter().enumerate() {
            let Some(mut at) = b.start else { continue };
            // At the start of a branch: where that one leaves its parent.
            while let (0, Some(to)) = (at.point, self.branches[at.branch].start) {
                at = to;
            }
            forks.entry(at).or_default().push(i);
        }
        let mut found = Vec::new();
        for (at, children) in forks {
            let trunk = &self.branches[at.branch].points;
            let goes_on = at.point + 1 < trunk.len();
            let mut ways: Vec<(usize, &[CenterlinePoint])> = Vec::new();
            if goes_on {
                ways.push((at.branch, &trunk[at.point..]));
            }
            ways.extend(children.iter().map(|c| (*c, &self.branches[*c].points[..])));
            if ways.len() < 2 {
                continue;
            }
            let stem = self.path_to(at.branch);
            let fork = offsets[at.branch] + at.point;
            let stem = &stem[..=fork];
            let mut bifurcation = Bifurcation { fork: at, start: fork, ways: Vec::new() };
            for (i, (branch, points)) in ways.iter().enumerate() {
                let others = || ways.iter().enumerate().filter(|(j, _)| *j != i).map(|(_, w)| w.1);
                let left = |p: &CenterlinePoint| others().all(|way| !is_in_tube(p, way));
                let out = (1..points.len()).find(|k| left(&points[*k])).unwrap_or(points.len() - 1);
                let first = if i == 0 && goes_on { fork } else { offsets[*branch] };
                bifurcation.ways.push((*branch, first + out));
                let to = points[out].position_mm;
                let outside = |p: &CenterlinePoint| p.position_mm.distance(to) >= p.radius_mm;
                let touching = stem.iter().rposition(outside).unwrap_or(0);
                bifurcation.start = bifurcation.start.min(touching);
            }
            found.push(bifurcation);
        }
        found
    }

    /// Returns the bifurcations that the path to a tip passes through, each with its range of
    /// points.
    fn passed(&self, tip: usize, all: &[Bifurcation]) -> Vec<(usize, Range<usize>)> {
        // Branches of the path, with the point that it leaves each at.
        let mut chain: BTreeMap<usize, usize> = BTreeMap::from([(tip, usize::MAX)]);
        let mut branch = tip;
        while let Some(start) = self.branches[branch].start {
            branch = start.branch;
            chain.insert(branch, start.point);
        }
        let within = |(i, b): (usize, &Bifurcation)| {
            chain.get(&b.fork.branch).filter(|leaves| b.fork.point <= **leaves)?;
            // The trunk is the first way, and in the chain of paths along its children too.
            let way = b.ways.iter().rev().find(|w| chain.contains_key(&w.0))?;
            Some((i, b.start..way.1))
        };
        all.iter().enumerate().filter_map(within).collect()
    }
}

/// Whether a point lies within one of the inscribed spheres along `way`.
fn is_in_tube(p: &CenterlinePoint, way: &[CenterlinePoint]) -> bool {
    way.iter().any(|q| q.position_mm.distance_squared(p.position_mm) <= q.radius_mm * q.radius_mm)
}

/// Gives the overlapping bifurcations of a path one number; returns whether any were merged.
fn merge_overlaps(passed: &[(usize, Range<usize>)], merged: &mut [usize]) -> bool {
    let all = blanks(passed, merged);
    let mut any = false;
    for w in all.windows(2) {
        if w[1].1.start <= w[0].1.end {
            let (a, b) = (w[0].0.min(w[1].0), w[0].0.max(w[1].0));
            merged.iter_mut().filter(|m| **m == b).for_each(|m| *m = a);
            any = a != b;
            if any {
                break;
            }
        }
    }
    any
}

/// Returns the merged bifurcations along a path with the points they span, by their first point.
fn blanks(passed: &[(usize, Range<usize>)], merged: &[usize]) -> Vec<(usize, Range<usize>)> {
    let mut spans: BTreeMap<usize, Range<usize>> = BTreeMap::new();
    for (i, r) in passed {
        let span = spans.entry(merged[*i]).or_insert_with(|| r.clone());
        *span = span.start.min(r.start)..span.end.max(r.end);
    }
    let mut all: Vec<_> = spans.into_iter().collect();
    all.sort_by_key(|(i, r)| (r.start, *i));
    all
}

/// Numbers of groups, in the order in which they are met.
#[derive(Default)]
struct GroupNumbers {
    bifurcations: BTreeMap<usize, usize>,
    /// Numbers of branches by the bits of their first and last position.
    branches: BTreeMap<[[u64; 3]; 2], usize>,
}

impl GroupNumbers {
    fn next(&self) -> usize {
        self.bifurcations.len() + self.branches.len()
    }

    fn bifurcation(&mut self, which: usize) -> usize {
        let next = self.next();
        *self.bifurcations.entry(which).or_insert(next)
    }

    fn branch(&mut self, path: &[CenterlinePoint], points: Range<usize>) -> usize {
        let bits = |i: usize| path[i].position_mm.to_array().map(f64::to_bits);
        let next = self.next();
        *self.branches.entry([bits(points.start), bits(points.end)]).or_insert(next)
    }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::geometry::Branch;

    /// A line of points 0.25 mm apart, radius 1 mm.
    fn line(from: DVec3, to: DVec3) -> Vec<CenterlinePoint> {
        let n = (from.distance(to) / 0.25).round() as usize;
        let at = |i: usize| CenterlinePoint {
            position_mm: from.lerp(to, i as f64 / n as f64),
            radius_mm: 1.0,
            abscissa_mm: 0.25 * i as f64,
        };
        (0..=n).map(at).collect()
    }

    fn branch(start: Option<(usize, usize)>, points: Vec<CenterlinePoint>) -> Branch {
        let start = start.map(|(branch, point)| Attachment { branch, point });
        Branch { start, end: None, points }
    }

    type Row = (usize, usize, usize, bool);

    fn rows(t: &Tracts) -> Vec<Row> {
        t.tracts.iter().map(|t| (t.path, t.group, t.tract, t.blanking)).collect()
    }

    #[test]
    fn a_y_has_three_branches_and_one_bifurcation() {
        let trunk = line(DVec3::ZERO, DVec3::X * 10.0);
        let fork = DVec3::X * 10.0;
        let arms =
            [6.0, -6.0].map(|y| line(fork, fork + DVec3::new(8.0, y, 0.0).normalize() * 10.0));
        let last = trunk.len() - 1;
        let [left, right] = arms;
        let y = Centerline {
            branches: vec![
                branch(None, trunk),
                branch(Some((0, last)), left),
                branch(Some((0, last)), right),
            ],
        };
        let found = y.tracts();
        let path = |p, arm| vec![(p, 0, 0, false), (p, 1, 1, true), (p, arm, 2, false)];
        assert_eq!(rows(&found), [path(0, 2), path(1, 3)].concat());
        for t in &found.tracts {
            let points = &found.paths[t.path];
            if t.blanking {
                // Arms at 37 degrees to the axis leave each other's tubes 1 mm / sin 74 on.
                let out = points[t.points.end].position_mm;
                assert!((out.distance(fork) - 1.0 / 0.96).abs() < 0.3, "{out}");
                // The sphere that touches that point has a radius of 1 mm; points are 0.25 mm apart.
                let start = points[t.points.start].position_mm;
                assert!((1.0..1.5).contains(&start.distance(out)), "{start}");
            }
        }
    }

    #[test]
    fn forks_that_overlap_are_one_bifurcation_and_a_trunk_that_goes_on_is_a_path() {
        let trunk = line(DVec3::ZERO, DVec3::X * 30.0);
        let up = |i: usize| line(trunk[i].position_mm, trunk[i].position_mm + DVec3::Y * 8.0);
        let down = |i: usize| line(trunk[i].position_mm, trunk[i].position_mm - DVec3::Y * 8.0);
        let branches = vec![
            branch(Some((0, 40)), up(40)),
            branch(Some((0, 43)), down(43)),
            branch(Some((0, 90)), up(90)),
        ];
        let all = [vec![branch(None, trunk.clone())], branches].concat();
        let found = Centerline { branches: all }.tracts();
        assert_eq!(found.paths.len(), 4);
        // The trunk: branch, both first forks, branch, the third, branch.
        let trunk: Vec<Row> = rows(&found).into_iter().filter(|r| r.0 == 0).collect();
        assert_eq!(
            trunk,
            [
                (0, 0, 0, false),
                (0, 1, 1, true),
                (0, 2, 2, false),
                (0, 3, 3, true),
                (0, 4, 4, false)
            ]
        );
        let second: Vec<Row> = rows(&found).into_iter().filter(|r| r.0 == 1).collect();
        assert_eq!(second, [(1, 0, 0, false), (1, 1, 1, true), (1, 5, 2, false)]);
        // Stretches follow each other and cover the path.
        for (p, points) in found.paths.iter().enumerate() {
            let of: Vec<&Tract> = found.tracts.iter().filter(|t| t.path == p).collect();
            assert_eq!((of[0].points.start, of[of.len() - 1].points.end), (0, points.len() - 1));
            assert!(of.windows(2).all(|w| w[0].points.end == w[1].points.start));
        }
    }

    #[test]
    fn a_path_without_forks_is_one_tract() {
        let one = Centerline { branches: vec![branch(None, line(DVec3::ZERO, DVec3::X))] };
        assert_eq!(rows(&one.tracts()), [(0, 0, 0, false)]);
        assert_eq!(Centerline::default().tracts(), Tracts::default());
    }
}
