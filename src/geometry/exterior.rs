//! Exterior of a closed wall on a grid of cells, to tell boxes that the wall hides from an eye
//! inside.
//!
//! A bent organ passes the eye several times: half of the triangles in the frustum of a colon view
//! belong to other loops, behind centimetres of tissue. The grid divides space into cells and marks
//! as exterior those that no triangle touches and that a flood fill from the border of the grid
//! reaches. A line of sight that crosses the exterior has crossed the wall before it.

use glam::{DVec3, IVec3, UVec3, Vec3};

use super::Mesh;
use crate::fault;
use crate::task::checkpoint;

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
        let mut outside = this.reached_from_border(&this.touched(mesh));
        let inwards = this.chebyshev(&outside);
        outside.iter_mut().for_each(|o| *o = !*o);
        let mut outwards = this.chebyshev(&outside);
        if fault::hit(fault::Point::Occlusion) {
            outwards.iter_mut().filter(|d| **d > 0).for_each(|d| *d = MAX_DISTANCE);
        }
        let signed = |(out, inside): (u8, u8)| out.cast_signed() - inside.cast_signed();
        this.distance = outwards.into_iter().zip(inwards).map(signed).collect();
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
    fn touched(&self, mesh: &Mesh) -> Vec<bool> {
        let mut touched = vec![false; self.dims.as_usizevec3().element_product()];
        // Tolerance for rounding, so that no touched cell is missed.
        let hair = 1e-6 * (1.0 + self.cell_mm * self.dims.as_dvec3().max_element());
        for f in &mesh.faces {
            let [a, b, c] = f.map(|v| mesh.positions[v as usize]);
            let first = self.cell(a.min(b).min(c).as_dvec3() - hair);
            let last = self.cell(a.max(b).max(c).as_dvec3() + hair);
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    let row = self.index(IVec3::new(first.x, y, z));
                    touched[row..=row + (last.x - first.x) as usize].fill(true);
                }
            }
        }
        touched
    }

    /// Returns the untouched cells that a flood fill from the border reaches (6-connected), and the
    /// border.
    fn reached_from_border(&self, touched: &[bool]) -> Vec<bool> {
        let d = self.dims.as_usizevec3();
        let (row, layer) = (d.x, d.x * d.y);
        let rim = |k: usize, n: usize| k == 0 || k == n - 1;
        let mut reached = vec![false; touched.len()];
        for (k, own) in reached.chunks_exact_mut(row).enumerate() {
            if rim(k % d.y, d.y) || rim(k / d.y, d.z) {
                own.fill(true);
            }
            (own[0], own[row - 1]) = (true, true);
        }
        // Cells inside the border have all six neighbours in the grid.
        let neighbors = |i: usize| [i - 1, i + 1, i - row, i + row, i - layer, i + layer];
        let inner = |i: &usize| !reached[*i] && neighbors(*i).iter().any(|j| reached[*j]);
        let mut open: Vec<usize> = (0..touched.len()).filter(inner).collect();
        while let Some(i) = open.pop() {
            if !touched[i] && !std::mem::replace(&mut reached[i], true) {
                open.extend(neighbors(i).into_iter().filter(|j| !reached[*j]));
            }
        }
        reached
    }

    /// Computes the Chebyshev distance of each cell to the nearest one of `set`, in cells: a
    /// transform in two passes, exact for this metric (Borgefors 1986,
    /// doi:10.1016/S0734-189X(86)80047-0). Each cell takes the minimum of the neighbours that
    /// precede it in the scan direction, plus one.
    fn chebyshev(&self, set: &[bool]) -> Vec<u8> {
        let mut distance: Vec<u8> = set.iter().map(|s| if *s { 0 } else { MAX_DISTANCE }).collect();
        let [nx, ny, nz] = self.dims.to_array().map(|n| n as usize);
        let rows = ny * nz;
        let mut near = vec![0u8; nx];
        for forwards in [true, false] {
            for k in 0..rows {
                if k % 1024 == 0 {
                    checkpoint();
                }
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
                near.fill(MAX_DISTANCE);
                for first in others.into_iter().flatten() {
                    let row = &distance[first..first + nx];
                    near.iter_mut().zip(row).for_each(|(n, s)| *n = (*n).min(*s));
                }
                let own = &mut distance[at * nx..][..nx];
                let neighbors = |x: usize| near[x.saturating_sub(1)].min(near[(x + 1).min(nx - 1)]);
                (0..nx).for_each(|x| own[x] = own[x].min(near[x].min(neighbors(x)) + 1));
                let mut last = MAX_DISTANCE;
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
        distance
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
