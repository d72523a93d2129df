//! The wall as a smooth surface: zero of a cubic B-spline through a field of offsets.
//!
//! Between voxels a mesh has flat faces. The spline interpolates the offsets at voxel centres, has
//! continuous curvature, and its zero is the wall at any distance from the eye.
//!
//! The coefficients follow from the samples by a recursive filter with the pole √3 - 2 (Unser,
//! Aldroubi & Eden 1993, doi:10.1109/78.193221). Departure: the impulse response of the filter is cut
//! after six taps on each side, which leaves 0.05 % of an alternating field, so that a brick depends
//! on its neighbours alone. Each tile holds the coefficients that the cells of its brick need, those
//! of the rim twice, and can be read alone.

use glam::{DAffine3, DMat3, DVec3, IVec3, Vec3, Vec4};
use rayon::prelude::*;

use super::WallField;
use super::mesh_field::mesh_offsets;
use crate::geometry::Mesh;
use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, SIDE, near_offset};
use crate::volume::Grid;

/// Taps of the filter on each side.
const TAPS: usize = 6;
/// Coefficients along the side of a tile: one before its cells, and two after them.
const TILE_SIDE: usize = SIDE as usize + 3;
const TILE: usize = TILE_SIDE * TILE_SIDE * TILE_SIDE;
/// Samples along the side of a tile's surroundings. They lie in its brick and the 26 about it.
const WIDE: usize = TILE_SIDE + 2 * TAPS;
/// Voxels of the brick before a tile's that lie before the surroundings.
const TAPS_BEFORE: usize = SIDE as usize - 1 - TAPS;
/// Growth of the offset from a voxel that has one to the next that has no brick, voxels. A constant
/// field would ring.
const GROWTH_VOX: f32 = 0.6;
/// Largest size of an offset, largest spacings.
const MAX_OFFSET: f64 = 2.0;
/// Least size of an offset beside the wall, and of a voxel whose six neighbours are on its side, least
/// spacings.
pub(super) const MIN_OFFSET: f32 = 0.06;
const MIN_AWAY_OFFSET: f32 = 0.6;
/// Entry of the table for a brick without a tile.
const NONE: u32 = u32::MAX;

/// Offset at the zero, mm, that counts as on the wall.
const ON_WALL_MM: f32 = 5e-4;
/// Steps of the search for a zero by slope.
const MAX_STEPS: usize = 6;
/// Least slope of the field along a line on which the slope leads to a zero, mm per mm.
const MIN_SLOPE: f32 = 0.3;
/// Samples of a line on each side, where the slope does not lead to a zero.
const SEARCH_STEPS: i32 = 4;
const BISECTIONS: usize = 10;

/// Interpolating cubic B-spline of the offsets about a wall.
pub struct WallSpline {
    /// Brick of the first entry of the table.
    first: IVec3,
    dims: IVec3,
    table: Vec<u32>,
    tiles: Vec<[f32; TILE]>,
    voxel_from_world: DAffine3,
}

/// A line in voxels, by millimetres.
struct Line {
    start: DVec3,
    step: DVec3,
}

/// Place in a tile: number of the tile, cell in it, and share of the way to the next cell.
struct TilePlace {
    tile: usize,
    cell: [usize; 3],
    share: Vec3,
}

impl WallSpline {
    /// Computes the coefficients near a mesh of the wall.
    ///
    /// * `grid`: grid of the field.
    /// * `volume`: first and last voxel that the volume has, on that grid.
    /// * `brick`: offsets of the voxels of a brick by its coordinates, mm, negative inside; `None` of
    ///   a brick that is not there.
    /// * `positions`: vertices of the mesh, LPS mm. The spline is known in the cells within a voxel
    ///   of them.
    pub fn new<'a>(
        grid: &Grid,
        volume: [IVec3; 2],
        brick: impl Fn(IVec3) -> Option<&'a [f32]> + Sync,
        positions: &[Vec3],
    ) -> Self {
        let voxel_from_world = grid.voxel_from_world();
        let voxel = |p: &Vec3| voxel_from_world.transform_point3(p.as_dvec3());
        let corners = |v: DVec3| {
            let at = |v: DVec3| v.floor().as_ivec3() >> 3i32;
            (at(v - 1.0), at(v + 1.0))
        };
        let near = positions.par_iter().filter(|p| p.is_finite()).map(|p| corners(voxel(p)));
        let empty = || (IVec3::MAX, IVec3::MIN);
        let (first, last) = near.reduce(empty, |a, b| (a.0.min(b.0), a.1.max(b.1)));
        if first.x > last.x {
            return Self {
                first: IVec3::ZERO,
                dims: IVec3::ZERO,
                table: Vec::new(),
                tiles: Vec::new(),
                voxel_from_world,
            };
        }
        let dims = last - first + 1;
        let mut table = vec![NONE; dims.as_usizevec3().element_product()];

        // 1. Bricks that hold a cell within a voxel of a vertex.
        for p in positions.iter().filter(|p| p.is_finite()) {
            let (lo, hi) = corners(voxel(p));
            for z in lo.z..=hi.z {
                for y in lo.y..=hi.y {
                    for x in lo.x..=hi.x {
                        table[entry(IVec3::new(x, y, z) - first, dims)] = 0;
                    }
                }
            }
        }
        let mut bricks = Vec::new();
        for (at, slot) in table.iter_mut().enumerate().filter(|(_, slot)| **slot == 0) {
            *slot = bricks.len() as u32;
            let (x, y) = (at as i32 % dims.x, at as i32 / dims.x % dims.y);
            bricks.push(first + IVec3::new(x, y, at as i32 / (dims.x * dims.y)));
        }

        // 2. Their coefficients.
        let limit = (MAX_OFFSET * grid.spacing_mm.max_element()) as f32;
        let surroundings = Surroundings {
            brick: &brick,
            volume,
            limit_mm: limit,
            growth_mm: GROWTH_VOX * grid.spacing_mm.as_vec3(),
        };
        let tiles = bricks.par_iter().with_min_len(4).map_init(Vec::new, |samples, at| {
            crate::task::checkpoint();
            surroundings.gather(*at, samples);
            coefficients(samples)
        });
        Self { first, dims, table, tiles: tiles.collect(), voxel_from_world }
    }

    /// Returns the offset from the wall at a point (LPS mm), mm, negative inside, and its gradient,
    /// LPS; `None` far from the wall.
    pub fn value_and_gradient(&self, p_mm: DVec3) -> Option<(f32, Vec3)> {
        let place = self.place(self.voxel_from_world.transform_point3(p_mm))?;
        let (value, gradient) = self.value_and_slopes(&place);
        let to_world: DMat3 = self.voxel_from_world.matrix3.transpose();
        Some((value, (to_world * gradient.as_dvec3()).as_vec3()))
    }

    /// Returns the offset from the wall at a point (LPS mm), mm, negative inside; `None` far from
    /// the wall.
    pub fn value(&self, p_mm: DVec3) -> Option<f32> {
        let place = self.place(self.voxel_from_world.transform_point3(p_mm))?;
        Some(self.value_at(&place))
    }

    /// Returns how far along a line the wall is, mm: a zero of the spline at most `reach_mm` away in
    /// both directions, where the line enters the lumen. `None` if there is none.
    ///
    /// * `from`: point on the line, LPS mm.
    /// * `way`: unit vector along the line into the lumen.
    pub fn root(&self, from: Vec3, way: Vec3, reach_mm: f32) -> Option<f32> {
        let start = self.voxel_from_world.transform_point3(from.as_dvec3());
        let line = Line { start, step: self.voxel_from_world.matrix3 * way.as_dvec3() };
        self.root_by_slope(&line, reach_mm).or_else(|| self.root_by_search(&line, reach_mm))
    }

    /// Returns about how far a point (LPS mm) is from the wall along a line, mm: Newton's step. `None`
    /// far from the wall, and where the line runs along it.
    pub fn off(&self, p: Vec3, way: Vec3) -> Option<f32> {
        let at = self.place(self.voxel_from_world.transform_point3(p.as_dvec3()))?;
        let (value, slopes) = self.value_and_slopes(&at);
        let slope = slopes.dot((self.voxel_from_world.matrix3 * way.as_dvec3()).as_vec3());
        (slope < -MIN_SLOPE).then(|| (value / slope).abs())
    }

    /// Finds a zero by Newton's step and then secants.
    fn root_by_slope(&self, line: &Line, reach_mm: f32) -> Option<f32> {
        let (mut before, slopes) = self.value_and_slopes(&self.place(line.start)?);
        if before.abs() < ON_WALL_MM {
            return Some(0.0);
        }
        let slope = slopes.dot(line.step.as_vec3());
        if slope > -MIN_SLOPE {
            return None;
        }
        let (mut t_before, mut t) = (0.0, (-before / slope).clamp(-reach_mm, reach_mm));
        for _ in 0..MAX_STEPS {
            let now = self.value_on(line, t)?;
            if now.abs() < ON_WALL_MM {
                return Some(t);
            }
            let slope = (now - before) / (t - t_before);
            if slope.is_nan() || slope > -MIN_SLOPE {
                return None;
            }
            (before, t_before) = (now, t);
            t -= now / slope;
            if t.abs() > reach_mm {
                return None;
            }
        }
        None
    }

    /// Finds the nearest zero between samples of the line, by bisection.
    fn root_by_search(&self, line: &Line, reach_mm: f32) -> Option<f32> {
        let at = |k: i32| reach_mm * k as f32 / SEARCH_STEPS as f32;
        let values =
            (-SEARCH_STEPS..=SEARCH_STEPS).map(|k| Some((at(k), self.value_on(line, at(k))?)));
        let values: Vec<(f32, f32)> = values.collect::<Option<_>>()?;
        // Along the line the offset falls where it enters the lumen.
        let enters = values.windows(2).filter(|v| v[0].1 >= 0.0 && v[1].1 < 0.0);
        let distance = |v: &&[(f32, f32)]| (v[0].0 + v[1].0).abs();
        let nearest = enters.min_by(|a, b| distance(a).total_cmp(&distance(b)))?;
        let (mut outside, mut inside) = (nearest[0].0, nearest[1].0);
        for _ in 0..BISECTIONS {
            let middle = 0.5 * (outside + inside);
            match self.value_on(line, middle)? < 0.0 {
                true => inside = middle,
                false => outside = middle,
            }
        }
        Some(0.5 * (outside + inside))
    }

    fn value_on(&self, line: &Line, t: f32) -> Option<f32> {
        Some(self.value_at(&self.place(line.start + f64::from(t) * line.step)?))
    }

    fn place(&self, voxel: DVec3) -> Option<TilePlace> {
        // Rounded down without a call, which baseline processors need for `floor`.
        let towards_zero = voxel.as_ivec3();
        let is_above = towards_zero.as_dvec3().cmpgt(voxel);
        let cell = towards_zero - IVec3::from(is_above);
        let share = (voxel - cell.as_dvec3()).as_vec3();
        let brick = (cell >> 3i32) - self.first;
        if brick.cmplt(IVec3::ZERO).any() || brick.cmpge(self.dims).any() {
            return None;
        }
        let tile = self.table[entry(brick, self.dims)];
        let cell = (cell & 7).to_array().map(|c| c as usize);
        (tile != NONE).then_some(TilePlace { tile: tile as usize, cell, share })
    }

    fn value_at(&self, place: &TilePlace) -> f32 {
        let [wx, wy, wz] = place.share.to_array().map(weights);
        let mut sum = Vec4::ZERO;
        for (z, weight) in wz.into_iter().enumerate() {
            sum += weight * weighted(self.rows(place, z), wy);
        }
        sum.dot(Vec4::from(wx))
    }

    /// Returns the value and its slopes, mm a voxel.
    fn value_and_slopes(&self, place: &TilePlace) -> (f32, Vec3) {
        let [wx, wy, wz] = place.share.to_array().map(weights);
        let [sx, sy, sz] = place.share.to_array().map(slopes);
        let [mut value, mut by_y, mut by_z] = [Vec4::ZERO; 3];
        for (z, (weight, slope)) in wz.into_iter().zip(sz).enumerate() {
            let rows = self.rows(place, z);
            let plane = weighted(rows, wy);
            value += weight * plane;
            by_y += weight * weighted(rows, sy);
            by_z += slope * plane;
        }
        let [wx, sx] = [wx, sx].map(Vec4::from);
        (value.dot(wx), Vec3::new(value.dot(sx), by_y.dot(wx), by_z.dot(wx)))
    }

    /// Four rows of four coefficients about a place: those of one of its four planes.
    #[inline]
    fn rows(&self, place: &TilePlace, plane: usize) -> [Vec4; 4] {
        let tile = &self.tiles[place.tile];
        let [x, y, z] = place.cell;
        std::array::from_fn(|row| {
            let first = x + TILE_SIDE * (y + row + TILE_SIDE * (z + plane));
            Vec4::from_slice(&tile[first..first + 4])
        })
    }
}

impl WallSpline {
    /// Computes the spline of a wall field near a mesh of its wall (LPS mm). No voxel centre changes
    /// sides.
    pub fn of_field(lumen: &Lumen, field: &WallField, positions: &[Vec3]) -> Self {
        Self::of_offsets(lumen, &sided(lumen, field), positions)
    }

    /// Computes the spline of the offsets from a mesh with normals (LPS mm), where no field placed
    /// its wall: a moving average of the planes through the vertices.
    pub fn of_mesh(lumen: &Lumen, mesh: &Mesh) -> Self {
        Self::of_offsets(lumen, &mesh_offsets(lumen, mesh), &mesh.positions)
    }

    /// * `offsets`: in slot order, mm.
    fn of_offsets(lumen: &Lumen, offsets: &[f32], positions: &[Vec3]) -> Self {
        let last = lumen.volume_grid().dims.as_ivec3() - 1;
        let volume = [IVec3::ZERO, last].map(|v| lumen.own_voxel(v));
        let brick = |at: IVec3| {
            let slot = lumen.bricks.slot_of(SIDE * at)?;
            Some(&offsets[slot * BRICK..][..BRICK])
        };
        Self::new(&lumen.grid, volume, brick, positions)
    }
}

impl std::fmt::Debug for WallSpline {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.debug_struct("WallSpline").field("tiles", &self.tiles.len()).finish_non_exhaustive()
    }
}

/// Sum of rows by their weights.
#[inline]
fn weighted(rows: [Vec4; 4], weights: [f32; 4]) -> Vec4 {
    (weights[0] * rows[0] + weights[1] * rows[1]) + (weights[2] * rows[2] + weights[3] * rows[3])
}

/// Index in a table of these dimensions.
fn entry(at: IVec3, dims: IVec3) -> usize {
    let (at, dims) = (at.as_usizevec3(), dims.as_usizevec3());
    at.x + dims.x * (at.y + dims.y * at.z)
}

/// Weights of the cubic B-spline at the four samples about a place.
fn weights(t: f32) -> [f32; 4] {
    let u = 1.0 - t;
    let middle = |t: f32| 2.0 / 3.0 - t * t + 0.5 * t * t * t;
    [u * u * u / 6.0, middle(t), middle(u), t * t * t / 6.0]
}

/// Derivatives of [`weights`].
fn slopes(t: f32) -> [f32; 4] {
    let u = 1.0 - t;
    let middle = |t: f32| -2.0 * t + 1.5 * t * t;
    [-0.5 * u * u, middle(t), -middle(u), 0.5 * t * t]
}

/// Offsets about a brick.
struct Surroundings<'f, F> {
    brick: &'f F,
    volume: [IVec3; 2],
    limit_mm: f32,
    growth_mm: Vec3,
}

impl<'a, F: Fn(IVec3) -> Option<&'a [f32]>> Surroundings<'_, F> {
    /// Copies the samples about a brick, clamped in size. A voxel beyond the volume has the offset
    /// of the nearest voxel in it; offsets grow into the bricks that are not there.
    fn gather(&self, brick: IVec3, samples: &mut Vec<f32>) {
        let from = SIDE * brick - (1 + TAPS as i32);
        let [first, last] = self.volume;
        let limit = self.limit_mm;
        samples.clear();
        samples.resize(WIDE * WIDE * WIDE, f32::INFINITY);

        // 1. Brick before, at or after this one, and place in it, of each sample along each axis.
        let along = |axis: usize| {
            let place = |k: usize| {
                let v = (from[axis] + k as i32).clamp(first[axis], last[axis]);
                (((v >> 3) - brick[axis] + 1).clamp(0, 2) as usize, (v & 7) as usize)
            };
            std::array::from_fn::<_, WIDE, _>(place)
        };
        let [xs, ys, zs] = [0, 1, 2].map(along);
        let near: [Option<&[f32]>; 27] = std::array::from_fn(|n| {
            let is_met = |(along, at): (&[(usize, usize)], usize)| along.iter().any(|a| a.0 == at);
            let bricks = [n % 3, n / 3 % 3, n / 9];
            let is_near = [&xs[..], &ys, &zs].into_iter().zip(bricks).all(is_met);
            is_near.then(|| (self.brick)(brick + near_offset(n))).flatten()
        });
        let bricks_of = |row: usize| {
            let ((by, _), (bz, _)) = (ys[row % WIDE], zs[row / WIDE]);
            [0, 1, 2].map(|bx| near[bx + 3 * by + 9 * bz])
        };

        // 2. Samples of the bricks that are there, row by row.
        let runs = [0..8 - TAPS_BEFORE, 8 - TAPS_BEFORE..16 - TAPS_BEFORE, 16 - TAPS_BEFORE..WIDE];
        let has_whole_runs = from.x >= first.x && from.x + WIDE as i32 - 1 <= last.x;
        for (i, row) in samples.chunks_exact_mut(WIDE).enumerate() {
            let at = 8 * ys[i % WIDE].1 + 64 * zs[i / WIDE].1;
            let bricks = bricks_of(i);
            if has_whole_runs {
                for (run, offsets) in runs.iter().zip(bricks) {
                    let Some(offsets) = offsets else { continue };
                    let offsets = &offsets[at + xs[run.start].1..][..run.len()];
                    let both = row[run.clone()].iter_mut().zip(offsets);
                    both.for_each(|(sample, offset)| *sample = offset.clamp(-limit, limit));
                }
            } else {
                for (sample, (bx, x)) in row.iter_mut().zip(xs) {
                    let offset = bricks[bx].map(|offsets| offsets[at + x].clamp(-limit, limit));
                    *sample = offset.unwrap_or(f32::INFINITY);
                }
            }
        }

        // 3. Growth into the bricks that are not there: along rows, from row to row, from plane to plane.
        if near.iter().all(Option::is_some) {
            return;
        }
        for (i, row) in samples.chunks_exact_mut(WIDE).enumerate() {
            let is_there = bricks_of(i).map(|b| b.is_some());
            if is_there.contains(&true) {
                grow(row, 1, self.growth_mm.x, |x| is_there[xs[x].0]);
            }
        }
        for (z, plane) in samples.chunks_exact_mut(WIDE * WIDE).enumerate() {
            let is_there = |y: usize| bricks_of(y + WIDE * z).iter().any(Option::is_some);
            grow(plane, WIDE, self.growth_mm.y, is_there);
        }
        let in_layer = |bz: usize| near[9 * bz..][..9].iter().any(Option::is_some);
        grow(samples, WIDE * WIDE, self.growth_mm.z, |z| in_layer(zs[z].0));
        samples.iter_mut().for_each(|s| *s = s.min(limit));
    }
}

/// Lowers each chunk that is not there to the chunk before or after it plus a step, whichever is less,
/// as far as the chunks reach.
///
/// * `size`: samples of a chunk.
/// * `is_there`: whether a chunk is there, by its number.
fn grow(samples: &mut [f32], size: usize, step: f32, is_there: impl Fn(usize) -> bool) {
    let lower = |to: &mut [f32], from: &[f32]| {
        to.iter_mut().zip(from).for_each(|(to, from)| *to = to.min(from + step));
    };
    let chunks = samples.len() / size;
    for chunk in (1..chunks).filter(|chunk| !is_there(*chunk)) {
        let (before, own) = samples.split_at_mut(chunk * size);
        lower(&mut own[..size], &before[(chunk - 1) * size..]);
    }
    for chunk in (0..chunks - 1).rev().filter(|chunk| !is_there(*chunk)) {
        let (own, after) = samples.split_at_mut((chunk + 1) * size);
        lower(&mut own[chunk * size..], &after[..size]);
    }
}

/// Offsets of a field, as large as the sides of the wall ask: a branch may have been cut off, a cavity
/// filled, and a spline through small offsets of noise far from the wall would cross zero.
fn sided(lumen: &Lumen, field: &WallField) -> Vec<f32> {
    let least = lumen.grid.spacing_mm.min_element() as f32;
    let steps = [IVec3::X, IVec3::Y, IVec3::Z];
    let mut sided = field.offset_mm.clone();
    sided.par_chunks_exact_mut(BRICK).enumerate().with_min_len(16).for_each(|(slot, offsets)| {
        for (i, offset) in offsets.iter_mut().enumerate() {
            let element = slot * BRICK + i;
            let is_inside = lumen.is_inside(element);
            let side = if is_inside { -1.0 } else { 1.0 };
            let size = side * *offset;
            if size >= MIN_AWAY_OFFSET * least {
                continue;
            }
            let v = lumen.bricks.voxel(element);
            let near = steps.into_iter().flat_map(|d| [v - d, v + d]);
            let is_at_wall = near.into_iter().any(|n| lumen.holds(n) != is_inside);
            let enough = if is_at_wall { MIN_OFFSET } else { MIN_AWAY_OFFSET };
            *offset = side * size.max(enough * least);
        }
    });
    sided
}

/// Coefficients of a tile from the samples about it: the filter along z, y and x, the longest rows
/// first.
fn coefficients(samples: &[f32]) -> [f32; TILE] {
    let taps = taps();
    let filter = |out: &mut [f32], samples: &[f32], stride: usize| {
        for (t, tap) in taps.iter().enumerate() {
            out.iter_mut().zip(&samples[t * stride..]).for_each(|(out, s)| *out += tap * s);
        }
    };
    let (n, w) = (TILE_SIDE, WIDE);
    let mut by_z = [0.0; TILE_SIDE * WIDE * WIDE];
    filter(&mut by_z, samples, w * w);
    let mut by_y = [0.0; TILE_SIDE * TILE_SIDE * WIDE];
    let planes = by_y.chunks_exact_mut(n * w).zip(by_z.chunks_exact(w * w));
    planes.for_each(|(out, plane)| filter(out, plane, w));
    let mut tile = [0.0; TILE];
    let rows = tile.chunks_exact_mut(n).zip(by_y.chunks_exact(w));
    rows.for_each(|(out, row)| filter(out, row, 1));
    tile
}

/// Impulse response of the filter, scaled so that a constant stays as it is.
fn taps() -> [f32; 2 * TAPS + 1] {
    let pole = 3f64.sqrt() - 2.0;
    let at = |t: usize| pole.powi(t.abs_diff(TAPS) as i32);
    let sum: f64 = (0..=2 * TAPS).map(at).sum();
    std::array::from_fn(|t| (at(t) / sum) as f32)
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A field on the bricks within `bricks` of the origin, its spline about a point, and the voxel
    /// to which the field belongs.
    fn spline(
        grid: &Grid,
        has: impl Fn(IVec3) -> bool + Sync,
        field: impl Fn(DVec3) -> f64,
        about: Vec3,
    ) -> WallSpline {
        let world = grid.world_from_voxel();
        let side = 4;
        let all: Vec<Vec<f32>> = (0..side * side * side)
            .map(|b| {
                let brick = IVec3::new(b % side, b / side % side, b / (side * side));
                let at = |l: i32| 8 * brick + IVec3::new(l & 7, l >> 3 & 7, l >> 6);
                let value = |l: i32| field(world.transform_point3(at(l).as_dvec3())) as f32;
                (0..512).map(value).collect()
            })
            .collect();
        let brick = |b: IVec3| {
            let inside = b.cmpge(IVec3::ZERO).all() && b.cmplt(IVec3::splat(side)).all();
            (inside && has(b)).then(|| &all[(b.x + side * (b.y + side * b.z)) as usize][..])
        };
        WallSpline::new(grid, [IVec3::ZERO, grid.dims.as_ivec3() - 1], brick, &[about])
    }

    #[test]
    fn a_quadratic_field_is_reproduced_with_its_gradient() {
        let grid = Grid::axis_aligned([32; 3], [0.7, 0.8, 1.3]);
        let middle = DVec3::new(11.3, 12.7, 20.4);
        let field = |p: DVec3| {
            let d = p - middle;
            0.05 * d.x - 0.1 * d.y + 0.06 * d.z + 0.004 * (d.x * d.x - d.y * d.z)
        };
        let s = spline(&grid, |_| true, field, middle.as_vec3());
        for k in 0..200 {
            let turn = f64::from(k);
            let p = middle + 0.6 * DVec3::new(turn.sin(), (1.7 * turn).cos(), (0.3 * turn).sin());
            let (value, gradient) = s.value_and_gradient(p).unwrap();
            let d = p - middle;
            let slope = DVec3::new(0.05 + 0.008 * d.x, -0.1 - 0.004 * d.z, 0.06 - 0.004 * d.y);
            assert!((f64::from(value) - field(p)).abs() < 1e-4, "{value} {}", field(p));
            assert!(gradient.as_dvec3().distance(slope) < 1e-3, "{gradient} {slope}");
            assert_eq!(s.value(p), Some(value));
        }
        assert_eq!(s.value(DVec3::splat(-40.0)), None);
    }

    #[test]
    fn a_zero_is_found_within_reach_and_only_there() {
        let grid = Grid::axis_aligned([32; 3], [1.0; 3]);
        let middle = DVec3::splat(15.2);
        let field = |p: DVec3| p.distance(middle) - 8.0;
        let wall = middle + DVec3::new(0.0, 8.0, 0.0);
        let s = spline(&grid, |_| true, field, wall.as_vec3());
        let inwards = Vec3::NEG_Y;
        for off in [-0.6f32, -0.2, 0.0, 0.3, 0.7] {
            let from = wall.as_vec3() - off * inwards;
            let t = s.root(from, inwards, 1.0).unwrap();
            // Interpolation of a sphere of eight voxels is within 0.01 voxel.
            assert!((t - off).abs() < 0.01, "{t} {off}");
        }
        assert_eq!(s.root(wall.as_vec3() - 0.7 * inwards, inwards, 0.5), None);
    }

    #[test]
    fn missing_bricks_do_not_move_the_wall_beside_them() {
        let grid = Grid::axis_aligned([32; 3], [1.0; 3]);
        // A plane two voxels before the last brick that is there.
        let field = |p: DVec3| p.x - 13.6;
        let about = Vec3::new(13.6, 12.0, 12.0);
        let s = spline(&grid, |b| b.x < 2, field, about);
        let t = s.root(about, Vec3::NEG_X, 1.0).unwrap();
        assert!(t.abs() < 0.02, "{t}");
    }

    #[test]
    fn the_field_goes_on_beyond_the_edge_of_the_volume() {
        let grid = Grid::axis_aligned([32, 32, 12], [1.0; 3]);
        let field = |p: DVec3| (p.truncate() - 16.0).length() - 6.0;
        let about = Vec3::new(22.0, 16.0, 11.4);
        let s = spline(&grid, |_| true, field, about);
        let t = s.root(about, Vec3::NEG_X, 1.0).unwrap();
        assert!(t.abs() < 0.02, "{t}");
    }
}
