//! Occlusion test: which patches the closed wall itself hides from an eye inside it.
//!
//! A bent organ passes the eye several times: half of the triangles in the frustum of a colon view
//! belong to other loops, behind centimetres of tissue, where neither frustum nor back-face culling
//! rejects them. The [`ExteriorGrid`] divides space into cells and marks as exterior those that no
//! triangle touches and that a flood fill from the border of the grid reaches. The
//! [`OcclusionTest`] is conservative: no ray from an eye inside the wall reaches a sphere that it
//! rejects.

use glam::{DVec3, IVec3, UVec3, Vec3};

use crate::fault;
use crate::geometry::{Mesh, Sphere};

/// Number of grid cells, about.
const CELL_COUNT: f64 = 262_144.0;
/// Larger distances are clamped to this, in cells.
const DISTANCE_MAX: u8 = 12;

/// Grid over the bounding box of a closed wall: which cells are exterior, and the Chebyshev
/// distance of each to the nearest cell that is not.
#[derive(Debug)]
pub struct ExteriorGrid {
    lo: DVec3,
    cell_mm: f64,
    dims: UVec3,
    /// Chebyshev distance from each cell to the nearest one that is not exterior, in cells; 0
    /// there.
    distance: Vec<u8>,
}

/// Conservative occlusion test against a closed wall.
#[derive(Debug)]
pub struct OcclusionTest {
    grid: ExteriorGrid,
    margin_mm: f64,
}

impl ExteriorGrid {
    /// Builds the grid of a wall (LPS mm), which must be closed. About 262,144 cells of one byte.
    pub fn new(mesh: &Mesh) -> Self {
        let around = |(lo, hi): (Vec3, Vec3), p: &Vec3| (lo.min(*p), hi.max(*p));
        let (lo, hi) = mesh.positions.iter().fold((Vec3::INFINITY, Vec3::NEG_INFINITY), around);
        let size = if mesh.positions.is_empty() { DVec3::ZERO } else { (hi - lo).as_dvec3() };
        let lo = if mesh.positions.is_empty() { DVec3::ZERO } else { lo.as_dvec3() };
        let cell_mm = (size.element_product() / CELL_COUNT).cbrt().max(size.max_element() / 255.0);
        let cell_mm = cell_mm.max(1e-3);
        // One cell of margin on every side.
        let dims = ((size / cell_mm).floor() + 3.0).as_uvec3();
        let mut this = Self { lo: lo - cell_mm, cell_mm, dims, distance: Vec::new() };
        this.distance = vec![DISTANCE_MAX; dims.as_usizevec3().element_product()];
        for f in &mesh.faces {
            let [a, b, c] = f.map(|v| mesh.positions[v as usize]);
            // Tolerance for rounding, so that no touched cell is missed.
            let hair = 1e-6 * (1.0 + size.max_element());
            let first = this.cell(a.min(b).min(c).as_dvec3() - hair);
            let last = this.cell(a.max(b).max(c).as_dvec3() + hair);
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    let row = this.index(IVec3::new(first.x, y, z));
                    this.distance[row..=row + (last.x - first.x) as usize].fill(0);
                }
            }
        }
        this.flood_from_border();
        this.chebyshev_transform();
        if fault::hit(fault::Point::Occlusion) {
            this.distance.iter_mut().filter(|d| **d > 0).for_each(|d| *d = DISTANCE_MAX);
        }
        this
    }

    fn cell(&self, p: DVec3) -> IVec3 {
        // Truncation instead of floor: values below 0 become 0 either way.
        let c = ((p - self.lo) / self.cell_mm).as_ivec3();
        c.clamp(IVec3::ZERO, self.dims.as_ivec3() - 1)
    }

    fn index(&self, c: IVec3) -> usize {
        let [x, y, z] = c.as_uvec3().to_array().map(|v| v as usize);
        x + self.dims.x as usize * (y + self.dims.y as usize * z)
    }

    /// Keeps as exterior only the untouched cells that a flood fill from the border reaches
    /// (6-connected).
    fn flood_from_border(&mut self) {
        let d = self.dims.as_usizevec3();
        let (row, layer) = (d.x, d.x * d.y);
        let rim = |k: usize, n: usize| k == 0 || k == n - 1;
        let mut reached = vec![false; self.distance.len()];
        for (k, own) in reached.chunks_exact_mut(row).enumerate() {
            if rim(k % d.y, d.y) || rim(k / d.y, d.z) {
                own.fill(true);
            }
            (own[0], own[row - 1]) = (true, true);
        }
        // Cells inside the border have all six neighbours in the grid.
        let neighbors = |i: usize| [i - 1, i + 1, i - row, i + row, i - layer, i + layer];
        let inner = |i: &usize| !reached[*i] && neighbors(*i).iter().any(|j| reached[*j]);
        let mut open: Vec<usize> = (0..self.distance.len()).filter(inner).collect();
        while let Some(i) = open.pop() {
            if self.distance[i] > 0 && !std::mem::replace(&mut reached[i], true) {
                open.extend(neighbors(i).into_iter().filter(|j| !reached[*j]));
            }
        }
        self.distance.iter_mut().zip(reached).filter(|s| !s.1).for_each(|s| *s.0 = 0);
    }

    /// Chebyshev distance transform in two passes, exact for this metric (Borgefors 1986,
    /// doi:10.1016/S0734-189X(86)80047-0): each cell takes the minimum of the neighbours that
    /// precede it in the scan direction, plus one.
    fn chebyshev_transform(&mut self) {
        let [nx, ny, nz] = self.dims.to_array().map(|n| n as usize);
        let rows = ny * nz;
        let mut near = vec![0u8; nx];
        for forwards in [true, false] {
            for k in 0..rows {
                let at = if forwards { k } else { rows - 1 - k };
                let (y, z) = (at % ny, at / ny);
                // The three rows of the previous layer, and the previous row of this layer.
                let step =
                    |n: usize, by: isize| n.checked_add_signed(if forwards { by } else { -by });
                let others = [(-1, -1), (0, -1), (1, -1), (-1, 0)].map(|(dy, dz)| {
                    let y = step(y, dy).filter(|y| *y < ny)?;
                    let z = step(z, dz).filter(|z| *z < nz)?;
                    Some((y + ny * z) * nx)
                });
                near.fill(DISTANCE_MAX);
                for first in others.into_iter().flatten() {
                    let row = &self.distance[first..first + nx];
                    near.iter_mut().zip(row).for_each(|(n, s)| *n = (*n).min(*s));
                }
                let own = &mut self.distance[at * nx..][..nx];
                let neighbors = |x: usize| near[x.saturating_sub(1)].min(near[(x + 1).min(nx - 1)]);
                (0..nx).for_each(|x| own[x] = own[x].min(near[x].min(neighbors(x)) + 1));
                let mut last = DISTANCE_MAX;
                let mut along = |s: &mut u8| {
                    *s = (*s).min(last + 1);
                    last = *s;
                };
                if forwards {
                    own.iter_mut().for_each(&mut along);
                } else {
                    own.iter_mut().rev().for_each(&mut along);
                }
            }
        }
    }

    /// Lower bound of the distance of a point to every cell that is not exterior, mm.
    fn clearance_mm(&self, p: DVec3) -> f64 {
        let distance = self.distance[self.index(self.cell(p))];
        f64::from(distance.saturating_sub(1)) * self.cell_mm
    }
}

impl OcclusionTest {
    /// * `grid`: of the wall.
    /// * `margin_mm`: largest distance of any drawn surface from the wall, mm.
    pub fn new(grid: ExteriorGrid, margin_mm: f64) -> Self {
        Self { grid, margin_mm }
    }

    /// Whether the wall hides the whole sphere from an eye inside it.
    ///
    /// Every segment from the eye to a point of the sphere passes through each of the balls between
    /// them: the sphere scaled down towards the eye. If one of these balls, widened by the margin,
    /// is exterior, every such segment has crossed the wall before it.
    pub fn is_occluded(&self, eye: DVec3, s: &Sphere) -> bool {
        let to_sphere = s.centre.as_dvec3() - eye;
        let length = to_sphere.length();
        let radius = f64::from(s.radius) * (1.0 + 1e-6) + 1e-6;
        let mut travelled = 0.0;
        while travelled < length - radius {
            let t = travelled / length;
            let needed = radius * t + self.margin_mm;
            let clearance = self.grid.clearance_mm(eye + to_sphere * t);
            if clearance > needed {
                return true;
            }
            // Clearance changes by at most the distance travelled, but for whole cells.
            travelled += (needed - clearance).max(0.5 * self.grid.cell_mm);
        }
        false
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::shapes::closed_lattice;

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

    #[test]
    fn grid_distance_is_the_chebyshev_distance_to_the_nearest_interior_cell() {
        let grid = ExteriorGrid::new(&ring(60, 30));
        let d = grid.dims.as_ivec3();
        let all = || {
            (0..d.z).flat_map(|z| {
                (0..d.y).flat_map(move |y| (0..d.x).map(move |x| IVec3::new(x, y, z)))
            })
        };
        let none: Vec<IVec3> = all().filter(|c| grid.distance[grid.index(*c)] == 0).collect();
        for c in all().step_by(97) {
            let distance =
                none.iter().map(|n| (c - *n).abs().max_element()).min().unwrap_or(i32::MAX);
            let found = i32::from(grid.distance[grid.index(c)]);
            assert_eq!(found, distance.min(i32::from(DISTANCE_MAX)), "{c}");
        }
    }

    /// Signed distance from the torus, positive outside.
    fn beyond(p: DVec3) -> f64 {
        DVec3::new(p.truncate().length() - MAJOR, p.z, 0.0).length() - MINOR
    }

    #[test]
    fn occluded_spheres_in_a_torus_are_reached_by_no_ray_and_most_of_the_far_side_is_occluded() {
        let test = OcclusionTest::new(ExteriorGrid::new(&ring(300, 90)), 0.1);
        let mut seed = 3u64;
        let mut noise = || {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 40) as f64 / (1u64 << 24) as f64
        };
        let (mut hidden, mut far) = (0, 0);
        for _ in 0..4000 {
            let eye = DVec3::new(MAJOR + 5.0 * (2.0 * noise() - 1.0), 0.0, 4.0 * noise());
            let u = std::f64::consts::TAU * noise();
            let centre = DVec3::new(MAJOR * u.cos(), MAJOR * u.sin(), 3.0 * noise()).as_vec3();
            let s = Sphere { centre, radius: (3.0 * noise()) as f32 };
            let opposite = u.cos() < -0.7;
            far += usize::from(opposite);
            if !test.is_occluded(eye, &s) {
                continue;
            }
            hidden += usize::from(opposite);
            for _ in 0..20 {
                let at = DVec3::new(noise(), noise(), noise()) * 2.0 - 1.0;
                let p = centre.as_dvec3() + at.clamp_length_max(1.0) * f64::from(s.radius);
                let most = (0..400).map(|k| beyond(eye.lerp(p, f64::from(k) / 400.0)));
                assert!(most.fold(f64::NEG_INFINITY, f64::max) > 0.1, "{p} is seen from {eye}");
            }
        }
        assert!(far > 500 && hidden > far * 9 / 10, "{hidden} of {far} on the far side are hidden");
    }

    #[test]
    fn coarse_grids_and_empty_meshes_occlude_nothing() {
        for mesh in [Mesh::default(), ring(12, 5)] {
            let test = OcclusionTest::new(ExteriorGrid::new(&mesh), 100.0);
            let s = Sphere { centre: Vec3::new(-30.0, 0.0, 0.0), radius: 1.0 };
            assert!(!test.is_occluded(DVec3::new(30.0, 0.0, 0.0), &s));
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
        let test = OcclusionTest::new(ExteriorGrid::new(&mesh), 0.1);
        let s = Sphere { centre: Vec3::new(-30.0, 0.0, 0.0), radius: 1.0 };
        assert!(!test.is_occluded(DVec3::new(30.0, 0.0, 0.0), &s));
    }
}
