//! Distances of the wall from the path.

use glam::Vec3;
use rayon::prelude::*;

use super::{Centerline, Mesh, TriangleBvh};

/// Distances of a wall's vertices from a centerline.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct CenterlineDistances {
    /// One a vertex, mm.
    pub mm: Vec<f32>,
    /// Returns the end of a scale of colours, mm: all but the widest fiftieth are below.
    pub widest_mm: f64,
}

impl CenterlineDistances {
    /// Distance of each vertex from the nearest place of the line.
    pub fn new(wall: &Mesh, line: &Centerline) -> Self {
        // Segments as triangles without area: the hierarchy finds the nearest.
        let mut segments = Mesh::default();
        for branch in &line.branches {
            for w in branch.points.windows(2) {
                let first = segments.positions.len() as u32;
                segments.positions.extend(w.iter().map(|p| p.position_mm.as_vec3()));
                segments.faces.push([first, first + 1, first + 1]);
            }
        }
        let tree = TriangleBvh::new(&segments);
        let distance =
            |p: &Vec3| tree.closest(p.as_dvec3()).map_or(0.0, |near| near.distance_mm as f32);
        let mm: Vec<f32> = wall.positions.par_iter().with_min_len(1024).map(distance).collect();
        let mut sorted = mm.clone();
        sorted.sort_by(f32::total_cmp);
        let at = sorted.len().saturating_sub(1) * 49 / 50;
        let widest_mm = sorted.get(at).map_or(1.0, |r| f64::from(*r).max(1e-6));
        Self { mm, widest_mm }
    }
}

#[cfg(test)]
mod tests {
    use super::super::{Branch, CenterlinePoint};
    use super::*;
    use glam::DVec3;

    #[test]
    fn the_wall_of_a_tube_is_everywhere_as_far_as_its_radius() {
        let point =
            |x: f64| CenterlinePoint { position_mm: DVec3::X * x, radius_mm: 0.0, abscissa_mm: x };
        let branch = Branch { points: vec![point(0.0), point(50.0)], ..Branch::default() };
        let line = Centerline { branches: vec![branch] };
        let ring = |i: u32| {
            let a = i as f32;
            Vec3::new(i as f32 % 50.0, 4.0 * a.cos(), 4.0 * a.sin())
        };
        let wall = Mesh { positions: (0..300).map(ring).collect(), ..Mesh::default() };
        let distances = CenterlineDistances::new(&wall, &line);
        assert!(distances.mm.iter().all(|r| (r - 4.0).abs() < 1e-5));
        assert!((distances.widest_mm - 4.0).abs() < 1e-5);
        assert_eq!(CenterlineDistances::new(&Mesh::default(), &line).widest_mm, 1.0);
    }
}
