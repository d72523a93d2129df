//! The patient's body, roughly: what tells a lumen from the air around the patient.
//!
//! Everything that was not selected counts as tissue. It is looked at in cells of a few millimetres
//! of which no voxel was selected, so that sheets, a table's plates and clothes vanish; the largest
//! 6-component of such cells is the body. In each slice across the patient the convex hull of the
//! body is what lies in it: a lumen that a side face cuts has tissue on both sides of the cut and
//! stays inside, air in front of, beside and below the patient does not.

use glam::{IVec2, IVec3, UVec3};

use super::BitVolume;
use super::bits::Run;
use super::components::largest;
use crate::volume::Grid;

/// Longest side of a cell, mm: thicker than a plate of a table, thinner than a wall of a body.
const CELL_MM: f64 = 6.0;
/// Fewest cells across a volume: less would not show the wall of a small one.
const CELLS: f64 = 32.0;

/// Cells in the convex hull of the body, slice by slice.
pub(super) struct BodyHull {
    /// Voxels of a cell.
    cell: UVec3,
    hull: BitVolume,
    last: UVec3,
    /// The index axis that runs most nearly from the feet to the head.
    through: usize,
}

impl BodyHull {
    /// The body around what was selected.
    pub fn of(selected: &BitVolume, grid: &Grid) -> Self {
        let dims = grid.dims;
        let through = (0..3)
            .max_by(|&a, &b| {
                let along = |axis: usize| grid.direction.col(axis).z.abs();
                along(a).total_cmp(&along(b)).then(a.cmp(&b))
            })
            .unwrap_or(2);
        let extent_mm = (dims.as_dvec3() * grid.spacing_mm).to_array();
        let sides = (0..3).filter(|&axis| axis != through);
        let least = sides.map(|axis| extent_mm[axis]).fold(f64::INFINITY, f64::min);
        let side_mm = CELL_MM.min(least / CELLS);
        let cell = (side_mm / grid.spacing_mm).round().as_uvec3().max(UVec3::ONE);
        let cells = (dims + cell - 1) / cell;

        let mut air = BitVolume::new(cells);
        for z in 0..dims.z {
            for y in 0..dims.y {
                for (a, b) in selected.runs(y, z) {
                    air.set_run((a / cell.x, b / cell.x), y / cell.y, z / cell.z);
                }
            }
        }
        let mut tissue = BitVolume::new(cells);
        for z in 0..cells.z {
            for y in 0..cells.y {
                let mut from = 0;
                for (a, b) in air.runs(y, z).chain([(cells.x, cells.x)]) {
                    if a > from {
                        tissue.set_run((from, a - 1), y, z);
                    }
                    from = b + 1;
                }
            }
        }
        let hull = largest(&tissue).map_or_else(|| tissue, |body| hulls(&body, through));
        Self { cell, hull, last: dims - 1, through }
    }

    /// Voxels of a run that lie in the body.
    pub fn count(&self, (a, b): Run, y: u32, z: u32) -> u64 {
        let (cy, cz, w) = (y / self.cell.y, z / self.cell.z, self.cell.x);
        let inside = |cx: u32| (b.min(cx * w + w - 1) - a.max(cx * w) + 1) * self.at(cx, cy, cz);
        (a / w..=b / w).map(|cx| u64::from(inside(cx))).sum()
    }

    fn at(&self, x: u32, y: u32, z: u32) -> u32 {
        u32::from(self.hull.at(x, y, z))
    }

    /// Whether a run touches a face of the volume at the patient's front, back, left or right.
    pub fn touches_side(&self, (a, b): Run, y: u32, z: u32) -> bool {
        let ends =
            [a == 0 || b == self.last.x, y == 0 || y == self.last.y, z == 0 || z == self.last.z];
        (0..3).any(|axis| axis != self.through && ends[axis])
    }
}

/// The convex hull of every slice across an axis.
fn hulls(body: &BitVolume, through: usize) -> BitVolume {
    let cells = body.dims();
    let (u, v) = [(1, 2), (0, 2), (0, 1)][through];
    let mut out = BitVolume::new(cells);
    for slice in 0..cells[through] {
        let place = |p: IVec2| {
            let mut cell = IVec3::ZERO;
            (cell[through], cell[u], cell[v]) = (slice as i32, p.x, p.y);
            cell
        };
        let (nu, nv) = (cells[u] as i32, cells[v] as i32);
        // Of each row the ends are enough; points come in order of rows, then along them.
        let mut points = Vec::new();
        for q in 0..nv {
            let mut row = (0..nu).map(|p| IVec2::new(p, q)).filter(|p| body.get(place(*p)));
            points.extend(row.next().into_iter().chain(row.next_back()));
        }
        let polygon = convex_hull(&points);
        let inside = |p: IVec2| {
            let edges = polygon.iter().zip(polygon.iter().cycle().skip(1));
            edges.into_iter().all(|(a, b)| (*b - *a).perp_dot(p - *a) >= 0)
        };
        let Some((low, high)) = bounds(&polygon) else { continue };
        for q in low.y..=high.y {
            for p in (low.x..=high.x).map(|p| IVec2::new(p, q)).filter(|p| inside(*p)) {
                let c = place(p).as_uvec3();
                out.set(c.x, c.y, c.z);
            }
        }
    }
    out
}

fn bounds(points: &[IVec2]) -> Option<(IVec2, IVec2)> {
    let low = points.iter().copied().reduce(IVec2::min)?;
    Some((low, points.iter().copied().reduce(IVec2::max)?))
}

/// Corners of the convex hull, anticlockwise, of points in order of y, then x (Andrew's monotone
/// chain, Information Processing Letters 9 (1979) 216–219, doi:10.1016/0020-0190(79)90072-3).
fn convex_hull(points: &[IVec2]) -> Vec<IVec2> {
    fn chain(points: impl Iterator<Item = IVec2>) -> Vec<IVec2> {
        let mut out: Vec<IVec2> = Vec::new();
        for p in points {
            while let [.., a, b] = out[..]
                && (b - a).perp_dot(p - b) <= 0
            {
                out.pop();
            }
            out.push(p);
        }
        // The other chain begins with the last one.
        out.pop();
        out
    }
    let mut hull = chain(points.iter().copied());
    hull.extend(chain(points.iter().rev().copied()));
    if hull.is_empty() { points.iter().copied().take(1).collect() } else { hull }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_convex_hull_holds_its_points_and_turns_left_at_every_corner() {
        let mut s = 7u64;
        let mut next = || {
            s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (s >> 60) as i32
        };
        for n in [1, 2, 3, 9, 60] {
            let mut points: Vec<_> = (0..n).map(|_| IVec2::new(next(), next())).collect();
            points.sort_by_key(|p| (p.y, p.x));
            points.dedup();
            let hull = convex_hull(&points);
            let at = |i: usize| hull[i % hull.len()];
            for i in 0..hull.len() {
                assert!(points.contains(&at(i)));
                let turn = (at(i + 1) - at(i)).perp_dot(at(i + 2) - at(i + 1));
                assert!(turn > 0 || hull.len() < 3, "{hull:?}");
                for p in &points {
                    assert!((at(i + 1) - at(i)).perp_dot(*p - at(i)) >= 0, "{p} {hull:?}");
                }
            }
        }
    }
}
