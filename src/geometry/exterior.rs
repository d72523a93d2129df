//! Exterior of a closed wall on a grid of cells, to tell boxes that the wall hides from an eye
//! inside.
//!
//! A bent organ passes the eye several times: half of the triangles in the frustum of a colon view
//! belong to other loops, behind centimetres of tissue. The grid divides space into cells and marks
//! as exterior those that no triangle touches and that a flood fill from the border of the grid
//! reaches. A line of sight that crosses the exterior has crossed the wall before it.

use glam::{DVec3, IVec3, UVec3, Vec3};
use rayon::prelude::*;

use super::Mesh;
use super::cell_bits::CellBits;
use crate::fault;

/// Largest distance that is stored, in cells; larger ones are clamped to it.
const MAX_DISTANCE: u8 = 100;

/// Grid over the bounding box of a closed wall, with the distance of each cell to the border
/// between the exterior and the rest.
#[derive(Debug)]
pub struct ExteriorGrid {
    lo: DVec3,
    cell_mm: f64,
    dims: UVec3,
    /// Signed Chebyshev distance in cells: of an exterior cell to the nearest one that is not, and
    /// of another, negative, to the nearest exterior one.
    distance: Vec<i8>,
}

impl ExteriorGrid {
    /// Builds the grid of a wall (LPS mm), which must be closed and finite, with about `cells`
    /// cells of one byte.
    pub fn new(mesh: &Mesh, cells: usize) -> Self {
        let (lo, hi) = mesh.bounds().unwrap_or((Vec3::ZERO, Vec3::ZERO));
        let (size, lo) = ((hi - lo).as_dvec3(), lo.as_dvec3());
        let cell_mm = (size.element_product() / cells as f64).cbrt();
        // Flat walls would have more cells than asked for along the other axes.
        let cell_mm = cell_mm.max(size.max_element() / (4.0 * (cells as f64).cbrt())).max(1e-3);
        // One cell of margin on every side.
        let dims = ((size / cell_mm).floor() + 3.0).as_uvec3();
        let mut this = Self { lo: lo - cell_mm, cell_mm, dims, distance: Vec::new() };
        let outside = this.touched(mesh).inverted().reached_from_border();
        let mut distance = vec![0; dims.as_usizevec3().element_product()];
        let exaggerates = fault::hit(fault::Point::Occlusion);
        outside.each_distance(MAX_DISTANCE, |i, d| {
            distance[i] = if exaggerates { MAX_DISTANCE } else { d }.cast_signed();
        });
        outside.inverted().each_distance(MAX_DISTANCE, |i, d| distance[i] = -d.cast_signed());
        this.distance = distance;
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

    /// Returns the cells that the bounding box of some triangle meets.
    fn touched(&self, mesh: &Mesh) -> CellBits {
        // Tolerance for rounding, so that no touched cell is missed.
        let hair = 1e-6 * (1.0 + self.cell_mm * self.dims.as_dvec3().max_element());
        let touch = |mut touched: CellBits, f: &[u32; 3]| {
            let [a, b, c] = f.map(|v| mesh.positions[v as usize]);
            let first = self.cell(a.min(b).min(c).as_dvec3() - hair).as_usizevec3();
            let last = self.cell(a.max(b).max(c).as_dvec3() + hair).as_usizevec3();
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    touched.add_run(first.x, last.x, y, z);
                }
            }
            touched
        };
        let part = mesh.faces.len().div_ceil(rayon::current_num_threads()).max(1);
        mesh.faces
            .par_chunks(part)
            .map(|faces| faces.iter().fold(CellBits::new(self.dims, false), touch))
            .reduce_with(|mut a, b| {
                a.add(&b);
                a
            })
            .unwrap_or_else(|| CellBits::new(self.dims, false))
    }

    /// Whether a point lies in a cell that is not exterior.
    pub fn is_interior(&self, p: DVec3) -> bool {
        self.distance[self.index(self.cell(p))] < 0
    }

    /// Returns, in an exterior cell, a lower bound of the Chebyshev distance of a point to all
    /// others, mm; elsewhere, negative, of that to all exterior cells.
    fn clearance_mm(&self, p: DVec3) -> f64 {
        let distance = self.distance[self.index(self.cell(p))];
        f64::from(distance - distance.signum()) * self.cell_mm
    }

    /// Whether the wall hides a whole box from an eye inside it; `false` where that is not known.
    ///
    /// Every segment from the eye to a point of the box passes through each of the cubes between
    /// them: the box's own, scaled down towards the eye. If one of these cubes, widened by the
    /// margin, is exterior, every such segment has crossed the wall before it.
    ///
    /// * `centre`: of the box, LPS mm.
    /// * `reach_mm`: largest distance of a point of the box from its centre along an axis.
    /// * `margin_mm`: largest distance of any drawn surface from the wall.
    pub fn hides(&self, eye: DVec3, centre: DVec3, reach_mm: f64, margin_mm: f64) -> bool {
        let way = centre - eye;
        let length = way.abs().max_element();
        let reach = reach_mm * (1.0 + 1e-6) + 1e-6;
        let mut travelled = 0.0;
        while travelled < length - reach {
            let t = travelled / length;
            let needed = reach * t + margin_mm;
            let clearance = self.clearance_mm(eye + way * t);
            if clearance > needed {
                return true;
            }
            // Clearance changes by at most the distance travelled, but for whole cells.
            travelled += (needed - clearance).max(0.5 * self.cell_mm);
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
    fn grid_distance_is_the_signed_chebyshev_distance_to_the_nearest_cell_of_the_other_kind() {
        let grid = ExteriorGrid::new(&ring(60, 30), 100_000);
        let d = grid.dims.as_ivec3();
        let all = || {
            (0..d.z).flat_map(|z| {
                (0..d.y).flat_map(move |y| (0..d.x).map(move |x| IVec3::new(x, y, z)))
            })
        };
        let found = |c: IVec3| i32::from(grid.distance[grid.index(c)]);
        let (exterior, interior): (Vec<IVec3>, Vec<IVec3>) = all().partition(|c| found(*c) > 0);
        assert!(interior.len() > 1000 && exterior.len() > interior.len());
        for c in all().step_by(97) {
            let sign = found(c).signum();
            let others = if sign > 0 { &interior } else { &exterior };
            let nearest = others.iter().map(|n| (c - *n).abs().max_element()).min();
            assert_eq!(found(c), sign * nearest.unwrap_or(i32::MAX), "{c}");
        }
        // Of both kinds there are cells far from the other.
        let span = all().map(found).fold((0, 0), |(lo, hi), v| (lo.min(v), hi.max(v)));
        assert!(span.0 <= -4 && span.1 >= 4, "{span:?}");
    }
}
