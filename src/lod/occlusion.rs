//! Occlusion test: which patches the closed wall itself hides from an eye inside it.
//!
//! Neither frustum nor back-face culling rejects faces behind a fold or another loop of a bent organ.
//! The [`OcclusionTest`] does, by the cells outside the wall, and is conservative: no ray from an eye
//! inside the wall reaches a box or sphere that it rejects.

use std::sync::Arc;

use glam::Vec3;

use super::{DepthMargin, ExteriorGrid, HierarchicalZ, ViewFrustum};
use crate::geometry::Mesh;

/// Number of grid cells, about. A colon's are 3 mm wide, their fine cells 0.7.
const CELLS: usize = 1_048_576;

/// Conservative occlusion test against a closed wall.
#[derive(Debug)]
pub struct OcclusionTest {
    grid: Arc<ExteriorGrid>,
    finest_mm: f64,
    coarsest_mm: f64,
}

/// The grid that the test takes, of a closed wall (LPS mm).
pub fn occlusion_grid(mesh: &Mesh) -> ExteriorGrid {
    ExteriorGrid::new(mesh, CELLS)
}

/// The grid of a wall where drawn surfaces may be anywhere in some boxes, which thus hide nothing.
///
/// * `boxes`: smallest and largest corner of each.
pub fn occlusion_grid_around(mesh: &Mesh, boxes: &[[Vec3; 2]]) -> ExteriorGrid {
    let mut all =
        Mesh { positions: mesh.positions.clone(), faces: mesh.faces.clone(), ..Mesh::default() };
    for corners in boxes {
        let first = all.positions.len() as u32;
        all.positions.extend(corners);
        // The grid takes in the bounding box of each face.
        all.faces.push([first, first + 1, first + 1]);
    }
    occlusion_grid(&all)
}

impl OcclusionTest {
    /// * `grid`: of the wall.
    /// * `finest_mm`, `coarsest_mm`: largest distance of the finest surface drawn from the wall, and
    ///   of any, mm.
    pub fn new(grid: impl Into<Arc<ExteriorGrid>>, finest_mm: f64, coarsest_mm: f64) -> Self {
        Self { grid: grid.into(), finest_mm, coarsest_mm }
    }

    /// Test of the wall itself, drawn as it is.
    pub fn of_wall(grid: impl Into<Arc<ExteriorGrid>>) -> Self {
        Self::new(grid, 0.0, 0.0)
    }

    /// Returns the depths behind which any drawn surface hides, of a view from inside the wall.
    pub fn depths(&self, frustum: &ViewFrustum) -> HierarchicalZ {
        HierarchicalZ::new(frustum, &self.grid, DepthMargin::constant(self.coarsest_mm))
    }

    /// Returns the depths behind which a surface hides that is as fine as the tolerance asks in the
    /// image, or the finest.
    ///
    /// A point of such a surface at view depth z is at most `pixels` z / F from the wall, F pixels a
    /// radian, or else at most the finest surface's distance. So there is none in a cross-section
    /// that is exterior by more than that margin, and no need for that of the coarsest surface.
    pub fn depths_within(&self, frustum: &ViewFrustum, pixels: f64) -> HierarchicalZ {
        let slope = pixels / frustum.focal_px();
        let (least_mm, most_mm) = (self.finest_mm, self.coarsest_mm);
        HierarchicalZ::new(frustum, &self.grid, DepthMargin { slope, least_mm, most_mm })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DVec3;

    use crate::geometry::shapes::closed_lattice;
    use crate::geometry::{Camera, Lens, Pose, Sphere};

    const MAJOR: f64 = 30.0;
    const MINOR: f64 = 8.0;

    /// A torus about z; faces look inwards.
    fn ring(around: u32, across: u32) -> Mesh {
        closed_lattice(around, across, |u, v| {
            let out = Vec3::new(u.cos() * v.cos(), u.sin() * v.cos(), v.sin());
            let middle = Vec3::new(u.cos(), u.sin(), 0.0);
            (MAJOR as f32 * middle + MINOR as f32 * out, -out)
        })
    }

    /// Signed distance from the torus, positive outside.
    fn beyond(p: DVec3) -> f64 {
        DVec3::new(p.truncate().length() - MAJOR, p.z, 0.0).length() - MINOR
    }

    /// A view from an eye to a point.
    fn view(eye: DVec3, to: Vec3) -> ViewFrustum {
        let lens = Lens { fov_y_rad: 1.2, aspect: 1.5, near_mm: 0.01 };
        let pose = Pose::looking(eye.as_vec3(), to + 0.01 * Vec3::X, Vec3::Z);
        ViewFrustum::new(&Camera { pose, lens, height_px: 100 })
    }

    #[test]
    fn occluded_spheres_in_a_torus_are_reached_by_no_ray_and_most_of_the_far_side_is_occluded() {
        let test = OcclusionTest::new(occlusion_grid(&ring(300, 90)), 0.1, 0.1);
        let mut seed = 3u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / (1u64 << 24) as f64
        };
        let (mut hidden, mut far, mut seen) = (0, 0, 0);
        for _ in 0..4000 {
            let eye = DVec3::new(MAJOR + 5.0 * (2.0 * noise() - 1.0), 0.0, 4.0 * noise());
            let u = std::f64::consts::TAU * noise();
            let centre = DVec3::new(MAJOR * u.cos(), MAJOR * u.sin(), 3.0 * noise()).as_vec3();
            let s = Sphere { centre, radius: (3.0 * noise()) as f32 };
            let opposite = u.cos() < -0.7;
            far += usize::from(opposite);
            let view = view(eye, centre + 8.0 * Vec3::new(0.0, noise() as f32, noise() as f32));
            if !test.depths(&view).hides_sphere(&s) {
                continue;
            }
            hidden += usize::from(opposite);
            let eye = view.position();
            for _ in 0..20 {
                let at = DVec3::new(noise(), noise(), noise()) * 2.0 - 1.0;
                let p = centre.as_dvec3() + at.clamp_length_max(1.0) * f64::from(s.radius);
                if !view.contains(p - eye) {
                    continue;
                }
                seen += 1;
                let most = (0..400).map(|k| beyond(eye.lerp(p, f64::from(k) / 400.0)));
                assert!(most.fold(f64::NEG_INFINITY, f64::max) > 0.1, "{p} is seen from {eye}");
            }
        }
        assert!(far > 500 && hidden > far * 9 / 10, "{hidden} of {far} on the far side are hidden");
        assert!(seen > 10_000, "{seen} points in the image");
    }

    #[test]
    fn coarse_grids_and_empty_meshes_occlude_nothing() {
        for mesh in [Mesh::default(), ring(12, 5)] {
            let test = OcclusionTest::new(occlusion_grid(&mesh), 100.0, 100.0);
            let s = Sphere { centre: Vec3::new(-30.0, 0.0, 0.0), radius: 1.0 };
            let view = view(DVec3::new(30.0, 0.0, 0.0), s.centre);
            assert!(!test.depths(&view).hides_sphere(&s));
        }
    }

    #[test]
    fn an_enclosed_cavity_is_not_exterior() {
        // The far side of a ring inside a larger closed box: the space between them is not
        // reachable from the border.
        let mut mesh = ring(300, 90);
        let first = mesh.positions.len() as u32;
        let corner = |k: u32| Vec3::new(k as f32, (k >> 1) as f32, (k >> 2) as f32) % 2.0;
        mesh.positions.extend((0..8).map(|k| (corner(k) - 0.5) * 90.0));
        let sides =
            [[0, 1, 3, 2], [4, 6, 7, 5], [0, 4, 5, 1], [2, 3, 7, 6], [0, 2, 6, 4], [1, 5, 7, 3]];
        for s in sides {
            let [a, b, c, d] = s.map(|k: u32| first + k);
            mesh.faces.extend([[a, b, c], [a, c, d]]);
        }
        let test = OcclusionTest::new(occlusion_grid(&mesh), 0.1, 0.1);
        let s = Sphere { centre: Vec3::new(-30.0, 0.0, 0.0), radius: 1.0 };
        let view = view(DVec3::new(30.0, 0.0, 0.0), s.centre);
        assert!(!test.depths(&view).hides_sphere(&s));
    }
}
