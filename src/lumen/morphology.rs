//! Morphology of masks with balls of a radius in millimetres (Serra 1982), a word of 64 voxels at a
//! time.

use glam::DVec3;
use rayon::prelude::*;

use super::BitVolume;
use super::bits::set_run;

/// Rows of a ball: offsets in y and z, and half the width along x, voxels.
type BallRow = (i64, i64, u32);

/// The rows of a ball about a voxel, those of equal width together.
fn ball_rows(spacing_mm: DVec3, radius_mm: f64) -> Vec<BallRow> {
    // The slack keeps equal lengths equal.
    let reach = |axis: usize| ((radius_mm / spacing_mm[axis]) * (1.0 + 1e-9)).floor() as i64;
    let mut rows: Vec<BallRow> = Vec::new();
    for z in -reach(2)..=reach(2) {
        for y in -reach(1)..=reach(1) {
            let off = (y as f64 * spacing_mm.y).powi(2) + (z as f64 * spacing_mm.z).powi(2);
            let left = radius_mm * radius_mm * (1.0 + 1e-9) - off;
            if left >= 0.0 {
                rows.push((y, z, (left.sqrt() / spacing_mm.x * (1.0 + 1e-9)).floor() as u32));
            }
        }
    }
    rows.sort_unstable_by_key(|r| (r.2, r.1, r.0));
    rows
}

/// Every voxel whose centre lies within a radius of the centre of one that is set.
///
/// Rows of a ball are runs, so that a dilation is a union of rows dilated along x, one for each row
/// of the ball.
pub fn dilated(mask: &BitVolume, spacing_mm: DVec3, radius_mm: f64) -> BitVolume {
    let rows = ball_rows(spacing_mm, radius_mm);
    let mut out = BitVolume::new(mask.dims());
    for rows in rows.chunk_by(|a, b| a.2 == b.2) {
        add_shifted(&mut out, &widened(mask, rows[0].2), rows);
    }
    out
}

/// Every set voxel all of whose neighbours within a radius are set; beyond the grid counts as set.
pub fn eroded(mask: &BitVolume, spacing_mm: DVec3, radius_mm: f64) -> BitVolume {
    let rows = ball_rows(spacing_mm, radius_mm);
    let mut out = mask.clone();
    for rows in rows.chunk_by(|a, b| a.2 == b.2) {
        keep_shifted(&mut out, &narrowed(mask, rows[0].2), rows);
    }
    out
}

/// Dilated, then eroded: narrow gaps are filled.
pub fn closed(mask: &BitVolume, spacing_mm: DVec3, radius_mm: f64) -> BitVolume {
    eroded(&dilated(mask, spacing_mm, radius_mm), spacing_mm, radius_mm)
}

/// Eroded, then dilated: what is thinner than the ball goes.
pub fn opened(mask: &BitVolume, spacing_mm: DVec3, radius_mm: f64) -> BitVolume {
    dilated(&eroded(mask, spacing_mm, radius_mm), spacing_mm, radius_mm)
}

/// The mask and, in every slice across an axis, what it encloses there (4-connected background that
/// does not reach the edge of the slice).
pub fn holes_filled(mask: &BitVolume, across: usize) -> BitVolume {
    let dims = mask.dims();
    let (u, v) = [(1, 2), (0, 2), (0, 1)][across];
    let (nu, nv) = (dims[u] as usize, dims[v] as usize);
    let place = |s: u32, p: usize, q: usize| {
        let mut at = [0u32; 3];
        (at[across], at[u], at[v]) = (s, p as u32, q as u32);
        at
    };
    let slices: Vec<Vec<bool>> = (0..dims[across])
        .into_par_iter()
        .map(|s| {
            let set = |i: usize| {
                let [x, y, z] = place(s, i % nu, i / nu);
                mask.at(x, y, z)
            };
            open_background(nu, nv, set)
        })
        .collect();
    let mut out = BitVolume::new(dims);
    for (s, open) in slices.iter().enumerate() {
        for i in (0..open.len()).filter(|i| !open[*i]) {
            let [x, y, z] = place(s as u32, i % nu, i / nu);
            out.set(x, y, z);
        }
    }
    out
}

/// Pixels of a picture, row by row, that are not set and joined to its edge by such.
pub fn open_background(width: usize, height: usize, set: impl Fn(usize) -> bool) -> Vec<bool> {
    let mut open = vec![false; width * height];
    let mut stack = Vec::new();
    let mut visit = |i: usize, stack: &mut Vec<usize>| {
        if !open[i] && !set(i) {
            open[i] = true;
            stack.push(i);
        }
    };
    let sides = (0..height).flat_map(|q| [q * width, (q + 1) * width - 1]);
    for i in (0..width).chain((height - 1) * width..height * width).chain(sides) {
        visit(i, &mut stack);
    }
    while let Some(i) = stack.pop() {
        let (p, q) = (i % width, i / width);
        let near = [
            (p > 0).then(|| i - 1),
            (p + 1 < width).then(|| i + 1),
            (q > 0).then(|| i - width),
            (q + 1 < height).then(|| i + width),
        ];
        near.into_iter().flatten().for_each(|j| visit(j, &mut stack));
    }
    open
}

/// Every run longer by `half` voxels at both ends.
fn widened(mask: &BitVolume, half: u32) -> BitVolume {
    let last = mask.dims().x - 1;
    BitVolume::from_rows(mask.dims(), |y, z, to| {
        for (a, b) in mask.runs(y, z) {
            set_run(to, (a.saturating_sub(half), (b + half).min(last)));
        }
    })
}

/// Every run shorter by `half` voxels at both ends but those at the edge of the grid.
fn narrowed(mask: &BitVolume, half: u32) -> BitVolume {
    let last = mask.dims().x - 1;
    BitVolume::from_rows(mask.dims(), |y, z, to| {
        for (a, b) in mask.runs(y, z) {
            let start = if a == 0 { 0 } else { a + half };
            let end = if b == last { last + 1 } else { (b + 1).saturating_sub(half) };
            if start < end {
                set_run(to, (start, end - 1));
            }
        }
    })
}

/// Adds to each row of `out` the rows of `mask` that lie at the offsets.
fn add_shifted(out: &mut BitVolume, mask: &BitVolume, rows: &[BallRow]) {
    let words = mask.row_words();
    let held = RowReach::new(mask, rows);
    out.update(|y0, z, block| {
        if !held.meets(y0, z) {
            return;
        }
        for (to, y) in block.chunks_exact_mut(words).zip(y0..mask.dims().y) {
            for (y, z) in held.rows_about(y, z).filter(|(y, z)| mask.has_block(*y, *z)) {
                to.iter_mut().zip(mask.row(y, z)).for_each(|(a, b)| *a |= b);
            }
        }
    });
}

/// Keeps in each row of `out` what all rows of `mask` have that lie at the offsets in the grid.
fn keep_shifted(out: &mut BitVolume, mask: &BitVolume, rows: &[BallRow]) {
    let words = mask.row_words();
    let held = RowReach::new(mask, rows);
    out.update(|y0, z, block| {
        for (to, y) in block.chunks_exact_mut(words).zip(y0..mask.dims().y) {
            if to.iter().any(|w| *w != 0) {
                for (y, z) in held.rows_about(y, z) {
                    to.iter_mut().zip(mask.row(y, z)).for_each(|(a, b)| *a &= b);
                }
            }
        }
    });
}

/// Rows of a mask at offsets from another row.
struct RowReach<'a> {
    mask: &'a BitVolume,
    rows: &'a [BallRow],
    /// Farthest offset along y and z.
    far: (i64, i64),
}

impl<'a> RowReach<'a> {
    fn new(mask: &'a BitVolume, rows: &'a [BallRow]) -> Self {
        let far = |of: fn(&BallRow) -> i64| rows.iter().map(|r| of(r).abs()).max().unwrap_or(0);
        Self { mask, rows, far: (far(|r| r.0), far(|r| r.1)) }
    }

    /// The rows at the offsets that lie in the grid.
    fn rows_about(&self, y: u32, z: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        let inside = |v: i64, n: u32| u32::try_from(v).ok().filter(|v| *v < n);
        let dims = self.mask.dims();
        self.rows.iter().filter_map(move |(dy, dz, _)| {
            Some((inside(i64::from(y) + dy, dims.y)?, inside(i64::from(z) + dz, dims.z)?))
        })
    }

    /// Whether the mask has rows that eight rows reach.
    fn meets(&self, y0: u32, z: u32) -> bool {
        let dims = self.mask.dims();
        let span = |v: u32, more: u32, far: i64, n: u32| {
            let far = far as u32;
            v.saturating_sub(far)..=(v + more).saturating_add(far).min(n - 1)
        };
        let ys = span(y0, 7, self.far.0, dims.y);
        let mut zs = span(z, 0, self.far.1, dims.z);
        zs.any(|z| (ys.start() / 8..=ys.end() / 8).any(|block| self.mask.has_block(8 * block, z)))
    }
}

#[cfg(test)]
mod tests {
    use glam::UVec3;

    use super::*;

    fn random(dims: [u32; 3], share: u64) -> BitVolume {
        let mut s = 5u64;
        let mut out = BitVolume::new(UVec3::from(dims));
        for z in 0..dims[2] {
            for y in 0..dims[1] {
                for x in 0..dims[0] {
                    s = s.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    if (s >> 33) % 1000 < share {
                        out.set(x, y, z);
                    }
                }
            }
        }
        out
    }

    #[test]
    fn a_dilation_holds_what_lies_within_the_radius_and_an_erosion_is_its_opposite() {
        let mask = random([70, 9, 8], 12);
        let h = DVec3::new(0.7, 1.0, 2.5);
        for radius in [0.0, 0.7, 1.3, 2.5, 5.1] {
            let (grown, shrunk) = (dilated(&mask, h, radius), eroded(&mask.inverted(), h, radius));
            let set: Vec<DVec3> = mask.voxels().map(|v| v.as_dvec3() * h).collect();
            for v in BitVolume::new(mask.dims()).inverted().voxels() {
                let near = set.iter().any(|s| s.distance(v.as_dvec3() * h) <= radius + 1e-9);
                assert_eq!(grown.get(v.as_ivec3()), near, "{v} {radius}");
                assert_eq!(shrunk.get(v.as_ivec3()), !near, "{v} {radius}");
            }
        }
    }

    #[test]
    fn a_closing_adds_and_an_opening_takes_away() {
        let mask = random([66, 12, 12], 300);
        let contains = |a: &BitVolume, b: &BitVolume| b.voxels().all(|v| a.get(v.as_ivec3()));
        let (more, less) = (closed(&mask, DVec3::ONE, 1.5), opened(&mask, DVec3::ONE, 1.0));
        assert!(contains(&more, &mask) && contains(&mask, &less));
        assert!(more.count() > mask.count() && less.count() < mask.count());
    }

    #[test]
    fn holes_of_a_slice_are_filled_across_each_axis() {
        let mut ring = BitVolume::new(UVec3::new(9, 9, 3));
        for (x, y) in (2..7).flat_map(|x| (2..7).map(move |y| (x, y))) {
            if x == 2 || x == 6 || y == 2 || y == 6 {
                ring.set(x, y, 1);
            }
        }
        assert_eq!(holes_filled(&ring, 2).count(), 25);
        assert_eq!(holes_filled(&ring, 0).count(), ring.count());
    }
}
