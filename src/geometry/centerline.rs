//! A centerline: rooted branches of points with radius.

use glam::DVec3;

/// A point of a centerline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CenterlinePoint {
    /// LPS mm.
    pub position_mm: DVec3,
    /// Distance to the wall (maximum inscribed sphere), mm.
    pub radius_mm: f64,
    /// Arc length from the root, mm.
    pub abscissa_mm: f64,
}

/// One branch. The first point of a branch that has a parent is the attachment point and lies on
/// the parent.
#[derive(Clone, Debug, PartialEq)]
pub struct Branch {
    /// Index of the parent branch, `None` for the root.
    pub parent: Option<usize>,
    /// Points from the attachment to the tip.
    pub points: Vec<CenterlinePoint>,
}

/// A tree of branches; `branches[0]` is the root, parents come before children.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Centerline {
    /// The branches. A single path has one.
    pub branches: Vec<Branch>,
}

impl Centerline {
    /// Points of all branches.
    pub fn point_count(&self) -> usize {
        self.branches.iter().map(|b| b.points.len()).sum()
    }

    /// Summed length of all branches, mm.
    pub fn length_mm(&self) -> f64 {
        self.branches
            .iter()
            .flat_map(|b| b.points.windows(2))
            .map(|w| w[0].position_mm.distance(w[1].position_mm))
            .sum()
    }

    /// The polyline from the root to the tip of `branch`, attachment points once.
    pub fn path_to(&self, branch: usize) -> Vec<CenterlinePoint> {
        let b = &self.branches[branch];
        let Some(parent) = b.parent else { return b.points.clone() };
        let mut path = self.path_to(parent);
        if let Some(attach) = b.points.first() {
            // The attachment point is the parent's point nearest to the branch's start.
            let near = |p: &CenterlinePoint| p.position_mm.distance_squared(attach.position_mm);
            let at = (0..path.len()).min_by(|&i, &j| near(&path[i]).total_cmp(&near(&path[j])));
            path.truncate(at.map_or(0, |i| i + 1));
            let skip = usize::from(path.last().is_some_and(|p| near(p) < 1e-12));
            path.extend_from_slice(&b.points[skip..]);
        }
        path
    }
}
