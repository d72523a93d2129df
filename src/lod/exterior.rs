//! Exterior of a closed wall on a grid of two levels, for occlusion culling from inside the wall.
//!
//! A bent organ passes the eye several times: half of the triangles in the frustum of a colon view
//! belong to other loops, behind tissue, and of the eye's own loop folds occlude the most. Cells that
//! no triangle touches are exterior if a flood fill from the border of the grid reaches them. Cells
//! that a triangle touches are bricks of 4×4×4 fine cells, a bit each, and these are exterior by the
//! same rule, so that folds of a few voxels have an exterior too. A line of sight that crosses the
//! exterior has crossed the wall before it.

use std::sync::atomic::{AtomicU64, Ordering};

use glam::{DVec3, IVec3, USizeVec3, UVec3, Vec3};
use rayon::prelude::*;

use super::DepthMargin;
use super::cell_bits::{CellBits, RankedCells};
use crate::fault;
use crate::geometry::Mesh;
use crate::task::checkpoint;

/// Largest distance that is stored, in cells; larger ones are clamped to it.
const MAX_DISTANCE: u8 = 100;
/// Fine cells along the side of a brick.
const SIDE: i32 = 4;
/// Bits of the fine cells at the lower x side of a brick, and at the lower y side.
const LOWER_X: u64 = 0x1111_1111_1111_1111;
const LOWER_Y: u64 = 0x000F_000F_000F_000F;

/// Grid over the bounding box of a closed wall, with the distance of each cell to the border
/// between the exterior and the rest.
#[derive(Debug)]
pub struct ExteriorGrid {
    lo: DVec3,
    /// Side of a fine cell.
    fine_mm: f64,
    /// Number of cells, not of fine ones.
    dims: UVec3,
    /// Signed Chebyshev distance in cells: of an exterior cell to the nearest that is not exterior as
    /// a whole; of an interior cell, negative, to the nearest that is exterior at least in part; 0 of
    /// a brick that is exterior in part.
    distance: Vec<i8>,
    /// Cells that are bricks.
    bricks: RankedCells,
    /// Exterior fine cells of each brick: bit x + 4 y + 16 z.
    exterior: Vec<u64>,
}

/// Returns the bits of the fine cells of a brick from `lo` to `hi`, both in it.
fn box_bits(lo: IVec3, hi: IVec3) -> u64 {
    let x = 0xF << lo.x & 0xF >> (3 - hi.x);
    let y = 0xFFFF << (4 * lo.y) & 0xFFFF >> (4 * (3 - hi.y));
    let z = u64::MAX << (16 * lo.z) & u64::MAX >> (16 * (3 - hi.z));
    (x * LOWER_X) & (y * 0x0001_0001_0001_0001) & z
}

/// Flood fill within a brick.
fn flooded(mut seeds: u64, free: u64) -> u64 {
    loop {
        let up = seeds << 1 & !LOWER_X | seeds << 4 & !LOWER_Y | seeds << 16;
        let down = seeds >> 1 & !(LOWER_X << 3) | seeds >> 4 & !(LOWER_Y << 12) | seeds >> 16;
        let next = seeds | (up | down) & free;
        if next == seeds {
            return seeds;
        }
        seeds = next;
    }
}

/// Returns the fine cells of a brick that share a face with some of a neighbour's.
///
/// * `side`: at which the neighbour is: -x, +x, -y, +y, -z, +z.
fn beside(neighbour: u64, side: usize) -> u64 {
    match side {
        0 => neighbour >> 3 & LOWER_X,
        1 => (neighbour & LOWER_X) << 3,
        2 => neighbour >> 12 & LOWER_Y,
        3 => (neighbour & LOWER_Y) << 12,
        4 => neighbour >> 48,
        _ => neighbour << 48,
    }
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
        let mut this = Self {
            lo: lo - cell_mm,
            fine_mm: cell_mm / f64::from(SIDE),
            dims,
            distance: Vec::new(),
            bricks: RankedCells::new(CellBits::new(dims, false)),
            exterior: Vec::new(),
        };
        this.bricks = RankedCells::new(this.touched(mesh));
        let (outside, exterior) = this.filled(&this.free_bits(mesh));
        this.exterior = exterior;
        let mut any = outside.clone();
        this.bricks.cells().each(|cell| {
            if this.exterior_bits(cell) != Some(0) {
                any.insert(cell);
            }
        });
        let mut distance = vec![0; dims.as_usizevec3().element_product()];
        outside.each_distance(MAX_DISTANCE, |i, d| distance[i] = d.cast_signed());
        any.inverted().each_distance(MAX_DISTANCE, |i, d| distance[i] = -d.cast_signed());
        if fault::hit(fault::Point::Occlusion) {
            // The exterior reaches into the wall.
            let near = distance.iter_mut().filter(|d| **d >= -1);
            near.for_each(|d| *d = MAX_DISTANCE.cast_signed());
        }
        this.distance = distance;
        this
    }

    /// Returns the fine cell of a point; of one outside the grid, the nearest.
    fn fine_cell(&self, p: DVec3) -> IVec3 {
        self.clamped((p - self.lo) / self.fine_mm)
    }

    /// Returns the fine cell at coordinates that count fine cells.
    fn clamped(&self, fine: DVec3) -> IVec3 {
        // Truncation instead of floor: values below 0 become 0 either way.
        fine.as_ivec3().clamp(IVec3::ZERO, SIDE * self.dims.as_ivec3() - 1)
    }

    fn index(&self, c: USizeVec3) -> usize {
        c.x + self.dims.x as usize * (c.y + self.dims.y as usize * c.z)
    }

    /// Returns the exterior fine cells of a brick; `None` of a cell that is none.
    fn exterior_bits(&self, cell: USizeVec3) -> Option<u64> {
        self.bricks.number(cell).map(|brick| self.exterior[brick])
    }

    /// Returns the first and the last fine cell of the bounding box of each triangle of a part of
    /// the mesh.
    fn boxes<'a>(
        &'a self,
        mesh: &'a Mesh,
        faces: &'a [[u32; 3]],
    ) -> impl Iterator<Item = (IVec3, IVec3)> + 'a {
        // Tolerance for rounding, so that no touched cell is missed.
        let hair =
            1e-6 * (1.0 + self.fine_mm * f64::from(SIDE) * self.dims.as_dvec3().max_element());
        faces.iter().map(move |f| {
            let [a, b, c] = f.map(|v| mesh.positions[v as usize]);
            let first = self.fine_cell(a.min(b).min(c).as_dvec3() - hair);
            (first, self.fine_cell(a.max(b).max(c).as_dvec3() + hair))
        })
    }

    /// Returns the cells that the bounding box of some triangle meets.
    fn touched(&self, mesh: &Mesh) -> CellBits {
        let touch = |mut touched: CellBits, (first, last): (IVec3, IVec3)| {
            let (first, last) = ((first / SIDE).as_usizevec3(), (last / SIDE).as_usizevec3());
            for z in first.z..=last.z {
                for y in first.y..=last.y {
                    touched.add_run(first.x, last.x, y, z);
                }
            }
            touched
        };
        let part = mesh.faces.len().div_ceil(rayon::current_num_threads()).max(1);
        let none = || CellBits::new(self.dims, false);
        mesh.faces
            .par_chunks(part)
            .map(|faces| self.boxes(mesh, faces).fold(none(), touch))
            .reduce_with(|mut a, b| {
                a.add(&b);
                a
            })
            .unwrap_or_else(none)
    }

    /// Returns the fine cells of each brick that the bounding box of no triangle meets.
    fn free_bits(&self, mesh: &Mesh) -> Vec<u64> {
        let bits: Vec<AtomicU64> = (0..self.bricks.count()).map(|_| AtomicU64::new(0)).collect();
        mesh.faces.par_chunks(4096).for_each(|faces| {
            for (first, last) in self.boxes(mesh, faces) {
                let (from, to) = (first / SIDE, last / SIDE);
                for z in from.z..=to.z {
                    for y in from.y..=to.y {
                        for x in from.x..=to.x {
                            let cell = IVec3::new(x, y, z);
                            let lo = (first - SIDE * cell).max(IVec3::ZERO);
                            let hi = (last - SIDE * cell).min(IVec3::splat(SIDE - 1));
                            if let Some(brick) = self.bricks.number(cell.as_usizevec3()) {
                                bits[brick].fetch_or(box_bits(lo, hi), Ordering::Relaxed);
                            }
                        }
                    }
                }
            }
        });
        bits.into_iter().map(|touched| !touched.into_inner()).collect()
    }

    /// Flood fill from the border of the grid, through untouched cells and fine cells. Returns the
    /// cells that it reaches, without bricks, and the fine cells of each brick.
    ///
    /// * `free`: untouched fine cells of each brick.
    fn filled(&self, free: &[u64]) -> (CellBits, Vec<u64>) {
        let mut outside = self.bricks.cells().inverted().reached_from_border();
        // Rounding may put fine cells of the border into the bounding box of the wall.
        outside.remove_all(self.bricks.cells());
        let mut exterior = vec![0; free.len()];
        let dims = self.dims.as_usizevec3();
        let reached = |exterior: &[u64], outside: &CellBits, cell| match self.bricks.number(cell) {
            Some(brick) => exterior[brick],
            None if outside.contains(cell) => u64::MAX,
            None => 0,
        };
        // Cells whose neighbours have changed since they were filled.
        let mut open = Vec::new();
        self.bricks.cells().each(|cell| open.push(cell));
        let mut waits = self.bricks.cells().clone();
        while let Some(cell) = open.pop() {
            waits.remove(cell);
            let mut inflow = 0;
            let near: [Option<USizeVec3>; 6] = std::array::from_fn(|side| {
                let mut near = cell;
                if side % 2 == 0 {
                    near[side / 2] = near[side / 2].checked_sub(1)?;
                } else {
                    near[side / 2] += 1;
                    (near[side / 2] < dims[side / 2]).then_some(())?;
                }
                inflow |= beside(reached(&exterior, &outside, near), side);
                Some(near)
            });
            let changed = if let Some(brick) = self.bricks.number(cell) {
                let before = exterior[brick];
                exterior[brick] = flooded(before | inflow & free[brick], free[brick]);
                exterior[brick] != before
            } else {
                let enters = inflow != 0 && !outside.contains(cell);
                if enters {
                    outside.insert(cell);
                }
                enters
            };
            if changed {
                for near in near.into_iter().flatten() {
                    let is_filled = !self.bricks.cells().contains(near) && outside.contains(near);
                    if !is_filled && !waits.contains(near) {
                        waits.insert(near);
                        open.push(near);
                    }
                }
            }
        }
        checkpoint();
        (outside, exterior)
    }

    /// Whether a point lies in a fine cell that is not exterior.
    pub fn is_interior(&self, p: DVec3) -> bool {
        let fine = self.fine_cell(p);
        !self.is_exterior(fine, fine)
    }

    /// Whether all fine cells from `lo` to `hi` are exterior.
    fn is_exterior(&self, lo: IVec3, hi: IVec3) -> bool {
        let (from, to) = (lo / SIDE, hi / SIDE);
        (from.z..=to.z).all(|z| {
            (from.y..=to.y).all(|y| {
                (from.x..=to.x).all(|x| {
                    let cell = IVec3::new(x, y, z);
                    match self.distance[self.index(cell.as_usizevec3())] {
                        0 => {
                            let lo = (lo - SIDE * cell).max(IVec3::ZERO);
                            let hi = (hi - SIDE * cell).min(IVec3::splat(SIDE - 1));
                            let asked = box_bits(lo, hi);
                            self.exterior_bits(cell.as_usizevec3())
                                .is_some_and(|b| b & asked == asked)
                        }
                        distance => distance > 0,
                    }
                })
            })
        })
    }

    /// Returns a beam of rectangular cross-section from an eye.
    ///
    /// * `way`: of its axis, LPS, of depth 1.
    /// * `reach`: half extent, along the axes of LPS, of its cross-section at depth 1.
    /// * `margin`: by which the cross-section is widened.
    pub fn beam(&self, eye: DVec3, way: DVec3, reach: DVec3, margin: DepthMargin) -> Beam<'_> {
        let per_mm = self.fine_mm.recip();
        let (origin, way) = ((eye - self.lo) * per_mm, way * per_mm);
        let ends = f64::from(SIDE) * self.dims.as_dvec3();
        // Depths at which the axis leaves the grid along each axis, or NaN.
        let out = ((ends * way.signum() + ends) * 0.5 - origin) / way;
        let reach = reach * per_mm * (1.0 + 1e-6);
        Beam {
            grid: self,
            origin,
            way,
            reach,
            reach_range: [reach.min_element(), reach.max_element()],
            margin,
            per_mm,
            pace: way.abs().max_element().recip(),
            farthest: out.to_array().into_iter().fold(f64::INFINITY, f64::min),
        }
    }
}

/// A beam through the cells. Depths are millimetres, other lengths fine cells.
pub struct Beam<'a> {
    grid: &'a ExteriorGrid,
    origin: DVec3,
    way: DVec3,
    reach: DVec3,
    /// Least and largest component of `reach`.
    reach_range: [f64; 2],
    margin: DepthMargin,
    /// Fine cells a millimetre.
    per_mm: f64,
    /// Depth in which the axis travels a Chebyshev distance of one.
    pace: f64,
    /// Depth at which the axis leaves the grid; there is no wall beyond.
    farthest: f64,
}

impl Beam<'_> {
    /// Returns the place of the axis at a depth, and the stored distance of its cell.
    fn at(&self, depth: f64) -> (DVec3, i8) {
        let at = self.origin + depth * self.way;
        let cell = self.grid.clamped(at) / SIDE;
        (at, self.grid.distance[self.grid.index(cell.as_usizevec3())])
    }

    /// Returns a depth from `depth` on up to which the whole beam is in cells that have no exterior.
    pub fn inside_to(&self, mut depth: f64) -> f64 {
        let (reach, side) = (self.reach_range[1], f64::from(SIDE));
        let pace = (self.pace.recip() + reach).recip();
        loop {
            let distance = f64::from(self.at(depth).1);
            // Without the margin: a cross-section is hidden if all of it is exterior.
            let free = side * (-distance - 1.0) - reach * depth;
            if free < 0.5 * side || depth > self.farthest {
                return depth;
            }
            depth += free * pace;
        }
    }

    /// Returns a depth from `depth` on at which the whole cross-section is exterior; infinite if none
    /// is found.
    pub fn hidden_from(&self, mut depth: f64) -> f32 {
        let side = f64::from(SIDE);
        while depth < self.farthest {
            let (at, distance) = self.at(depth);
            let distance = f64::from(distance);
            let margin = self.margin.at(depth) * self.per_mm + 1e-6;
            let [least, most] = self.reach_range.map(|reach| reach * depth + margin);
            // Wide cross-sections need no fine cells: the distance alone, its lower bound, tells.
            let clear = most - side * (distance - 1.0);
            let is_wide = most > 3.0 * side;
            // Upper bound of that distance; it changes by the distance travelled.
            let off = if is_wide { clear } else { least - side * (distance + 1.0) };
            if off < 0.0 {
                let half = self.reach * depth + margin;
                let [lo, hi] = [at - half, at + half].map(|p| self.grid.clamped(p));
                if clear < 0.0 || self.grid.is_exterior(lo, hi) {
                    return depth as f32;
                }
            }
            depth += off.max(1.0) * self.pace;
        }
        f32::INFINITY
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

    /// Places of a grid, row by row.
    fn places(dims: IVec3) -> impl Iterator<Item = IVec3> {
        (0..dims.z).flat_map(move |z| {
            (0..dims.y).flat_map(move |y| (0..dims.x).map(move |x| IVec3::new(x, y, z)))
        })
    }

    #[test]
    fn fine_cells_are_exterior_where_a_queue_reaches_them_from_the_border() {
        let mesh = ring(60, 30);
        let grid = ExteriorGrid::new(&mesh, 4_000);
        let dims = SIDE * grid.dims.as_ivec3();
        let at = |c: IVec3| (c.x + dims.x * (c.y + dims.y * c.z)) as usize;
        let mut free = vec![true; dims.as_usizevec3().element_product()];
        for (lo, hi) in grid.boxes(&mesh, &mesh.faces) {
            places(hi - lo + 1).for_each(|c| free[at(lo + c)] = false);
        }
        let mut open = vec![IVec3::ZERO];
        let mut reached = vec![false; free.len()];
        while let Some(c) = open.pop() {
            if !std::mem::replace(&mut reached[at(c)], true) {
                let steps = [IVec3::X, IVec3::Y, IVec3::Z].into_iter().flat_map(|s| [c - s, c + s]);
                open.extend(
                    steps.filter(|n| {
                        n.cmpge(IVec3::ZERO).all() && n.cmplt(dims).all() && free[at(*n)]
                    }),
                );
            }
        }
        let found: Vec<bool> = places(dims).map(|c| grid.is_exterior(c, c)).collect();
        assert!(found == reached);
        let of = |brick: u64| brick.count_ones() as usize;
        let in_bricks: usize = grid.exterior.iter().map(|b| of(*b)).sum();
        assert!(in_bricks > 10_000, "{in_bricks} exterior fine cells of bricks");
        // Boxes are exterior where all their cells are.
        for lo in places(dims - 7).step_by(1009) {
            let size = IVec3::new(lo.x % 7, lo.y % 6, lo.z % 5);
            let all = places(size + 1).all(|c| reached[at(lo + c)]);
            assert_eq!(grid.is_exterior(lo, lo + size), all, "{lo} {size}");
        }
    }

    #[test]
    fn grid_distance_is_the_signed_chebyshev_distance_to_the_nearest_cell_of_the_other_kind() {
        let grid = ExteriorGrid::new(&ring(60, 30), 20_000);
        let all = || places(grid.dims.as_ivec3());
        let found = |c: IVec3| i32::from(grid.distance[grid.index(c.as_usizevec3())]);
        let exterior_bits = |c: IVec3| {
            let fine = |k: IVec3| SIDE * c + k;
            places(IVec3::splat(SIDE)).filter(|k| grid.is_exterior(fine(*k), fine(*k))).count()
        };
        let whole: Vec<IVec3> = all().filter(|c| exterior_bits(*c) < 64).collect();
        let any: Vec<IVec3> = all().filter(|c| exterior_bits(*c) > 0).collect();
        assert!(whole.len() > 1000 && any.len() > 1000);
        for c in all().step_by(97) {
            let others = if found(c) > 0 { &whole } else { &any };
            let nearest = others.iter().map(|n| (c - *n).abs().max_element()).min();
            assert_eq!(found(c).abs(), nearest.unwrap_or(i32::MAX), "{c}");
        }
        // Of all kinds there are cells, some far from the others.
        let span = all().map(found).fold((0, 0), |(lo, hi), v| (lo.min(v), hi.max(v)));
        assert!(span.0 <= -2 && span.1 >= 3, "{span:?}");
        assert!(all().any(|c| found(c) == 0));
    }

    #[test]
    fn bits_of_a_box_and_of_neighbours_are_those_of_their_fine_cells() {
        let bit = |c: IVec3| 1u64 << (c.x + 4 * c.y + 16 * c.z);
        let side = || places(IVec3::splat(SIDE));
        for (lo, hi) in side().flat_map(|lo| side().map(move |hi| (lo, hi))) {
            if lo.cmple(hi).all() {
                let inside = side().filter(|c| c.cmpge(lo).all() && c.cmple(hi).all());
                assert_eq!(box_bits(lo, hi), inside.map(bit).sum::<u64>(), "{lo} {hi}");
            }
        }
        for (k, step) in [IVec3::X, IVec3::Y, IVec3::Z].into_iter().enumerate() {
            for c in side() {
                let [below, above] = [c + step - SIDE * step, c - step + SIDE * step];
                let is_lower = c[k] == 0;
                let is_upper = c[k] == SIDE - 1;
                assert_eq!(beside(bit(c), 2 * k), if is_upper { bit(below) } else { 0 }, "{c}");
                assert_eq!(beside(bit(c), 2 * k + 1), if is_lower { bit(above) } else { 0 }, "{c}");
            }
        }
        assert_eq!(flooded(1, u64::MAX), u64::MAX);
        // A bent tunnel, and a cell that touches it by an edge alone.
        let tunnel = [[0, 0, 0], [1, 0, 0], [2, 0, 0], [2, 1, 0], [2, 1, 1], [2, 1, 2], [3, 1, 2]];
        let tunnel: u64 = tunnel.map(|c| bit(IVec3::from(c))).iter().sum();
        let apart = bit(IVec3::new(1, 2, 2));
        assert_eq!(flooded(1, tunnel | apart), tunnel);
        assert_eq!(flooded(bit(IVec3::new(3, 1, 2)), tunnel | apart), tunnel);
    }
}
