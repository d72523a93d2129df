//! Places of a centerline by position, and whether a cross-section is one across it.

use glam::DVec3;

use super::CrossSection;
use crate::geometry::{Attachment, Branch, Centerline, Mesh, TriangleBvh, nearest_on_segment};

/// Largest share of a cross-section's area that may belong to another stretch of the centerline.
pub const MAX_ASTRAY: f64 = 0.2;

/// Parts of an outline that are looked at, at most: it may have thousands of points.
const MAX_PARTS: usize = 200;

/// A place of a centerline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CenterlinePlace {
    /// Branch, and the point at which its segment begins.
    pub at: Attachment,
    /// Position, LPS mm.
    pub position_mm: DVec3,
    /// Unit direction of the segment.
    pub direction: DVec3,
    /// Distance of what it is the nearest place of, mm.
    pub distance_mm: f64,
}

/// Segments of a centerline by position.
#[derive(Clone, Debug)]
pub struct CenterlinePlaces {
    /// Segments as triangles without area.
    tree: TriangleBvh,
    segments: Vec<(Attachment, DVec3)>,
    /// Points of each branch.
    branches: Vec<Vec<DVec3>>,
}

impl CenterlinePlaces {
    /// Sorts the segments of a centerline.
    pub fn new(line: &Centerline) -> Self {
        let (mut mesh, mut segments) = (Mesh::default(), Vec::new());
        for (branch, b) in line.branches.iter().enumerate() {
            for (point, w) in b.points.windows(2).enumerate() {
                let along = w[1].position_mm - w[0].position_mm;
                let Some(direction) = along.try_normalize() else { continue };
                let first = mesh.positions.len() as u32;
                mesh.positions.extend(w.iter().map(|p| p.position_mm.as_vec3()));
                mesh.faces.push([first, first + 1, first + 1]);
                segments.push((Attachment { branch, point }, direction));
            }
        }
        let places = |b: &Branch| b.points.iter().map(|p| p.position_mm).collect();
        let branches = line.branches.iter().map(places).collect();
        Self { tree: TriangleBvh::new(&mesh), segments, branches }
    }

    /// Returns the place nearest to a point; `None` of a centerline without segments.
    pub fn nearest(&self, p_mm: DVec3) -> Option<CenterlinePlace> {
        let near = self.tree.closest(p_mm)?;
        let (at, direction) = self.segments[near.at.face as usize];
        let (position_mm, distance_mm) = (near.point, near.distance_mm);
        Some(CenterlinePlace { at, position_mm, direction, distance_mm })
    }

    /// Returns the segment and the distance to a point, mm, where the distance along a branch is
    /// least about a segment: that of the same stretch, however near another one comes.
    pub fn nearest_about(&self, p_mm: DVec3, start: Attachment) -> (Attachment, f64) {
        let points = &self.branches[start.branch];
        let distance = |i: usize| {
            let (a, b) = (points[i], points[i + 1]);
            p_mm.distance(nearest_on_segment(p_mm, a, b))
        };
        let (mut at, mut least) = (start.point, distance(start.point));
        let last = points.len().saturating_sub(2);
        while let Some(next) = [at.saturating_sub(1), (at + 1).min(last)]
            .into_iter()
            .find(|i| *i != at && distance(*i) < least)
        {
            (at, least) = (next, distance(next));
        }
        (Attachment { branch: start.branch, point: at }, least)
    }

    /// Returns the share of a cross-section's area that is astray: beside another stretch of the
    /// centerline than the place the section is of. A part of the outline is astray if its nearest
    /// place of the centerline is farther along than the outline is off it, so that the plane
    /// meets the lumen there at more than 45°.
    pub fn astray(&self, section: &CrossSection, at_mm: DVec3) -> f64 {
        self.astray_shares(section, at_mm).iter().sum()
    }

    /// Returns the share of a cross-section's area that is astray on the branch that the section is
    /// of, and that on other branches.
    pub fn astray_shares(&self, section: &CrossSection, at_mm: DVec3) -> [f64; 2] {
        let Some(of) = self.nearest(at_mm) else { return [0.0; 2] };
        // 1 astray on the same branch, 2 on another one.
        let kind = |p: DVec3| match self.nearest(p) {
            Some(n) if n.position_mm.distance(of.position_mm) > n.distance_mm => {
                1 + u8::from(n.at.branch != of.at.branch)
            }
            _ => 0,
        };
        let step = section.outline.len().div_ceil(MAX_PARTS).max(1);
        let outline: Vec<DVec3> = section.outline.iter().step_by(step).copied().collect();
        let kinds: Vec<u8> = outline.iter().map(|p| kind(*p)).collect();
        let (mut all, mut astray) = (0.0, [0.0; 2]);
        for (i, a) in outline.iter().enumerate() {
            let j = (i + 1) % outline.len();
            let area = 0.5 * (*a - at_mm).cross(outline[j] - at_mm).length();
            all += area;
            for kind in [kinds[i], kinds[j]].into_iter().filter(|k| *k > 0) {
                astray[usize::from(kind) - 1] += 0.5 * area;
            }
        }
        if all > 0.0 { astray.map(|a| a / all) } else { [0.0; 2] }
    }
}

#[cfg(test)]
mod tests {
    use std::f64::consts::{PI, TAU};

    use super::super::cross_section;
    use super::*;
    use crate::geometry::CenterlinePoint;
    use crate::geometry::shapes::torus;

    /// The axis of a torus of radius 10 mm.
    fn ring() -> Centerline {
        let point = |i: u32| {
            let a = TAU * f64::from(i) / 90.0;
            let position_mm = 10.0 * DVec3::new(a.cos(), a.sin(), 0.0);
            CenterlinePoint { position_mm, radius_mm: 3.0, abscissa_mm: 10.0 * a }
        };
        let points = (0..=90).map(point).collect();
        Centerline { branches: vec![Branch { points, ..Branch::default() }] }
    }

    #[test]
    fn a_plane_along_a_bent_tube_is_astray_and_one_across_it_is_not() {
        let wall = torus(120, 48);
        let (tree, places) = (TriangleBvh::new(&wall), CenterlinePlaces::new(&ring()));
        let at = DVec3::new(10.0, 0.0, 0.0);
        let of = |normal: DVec3| {
            let section = cross_section(&wall, &tree, at, normal.normalize()).unwrap();
            (section.area_mm2, places.astray(&section, at))
        };
        let (across, share) = of(DVec3::Y);
        assert!((across / (9.0 * PI) - 1.0).abs() < 0.01 && share == 0.0, "{across} {share}");
        let (tilted, share) = of(DVec3::new(0.0, 1.0, 0.2));
        assert!((tilted / across - 1.0).abs() < 0.05 && share < MAX_ASTRAY, "{tilted} {share}");
        // In the plane of the ring, and touching its axis.
        for (normal, least) in [(DVec3::Z, 8.0), (DVec3::X, 1.8)] {
            let (along, share) = of(normal);
            assert!(along > least * across && share > 2.0 * MAX_ASTRAY, "{along} {share}");
        }
    }
}
