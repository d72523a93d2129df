//! Morphology of masks with balls of a radius in millimetres (Serra 1982), a word of 64 voxels at a
//! time.

use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::BitVolume;

/// Every voxel whose centre lies within a radius of the centre of one that is set.
///
/// Rows of a ball are runs, so that a dilation is a union of rows dilated along x, one for each row
/// of the ball.
pub fn dilated(mask: &BitVolume, spacing_mm: DVec3, radius_mm: f64) -> BitVolume {
    let dims = mask.dims();
    // Half width of the ball's row at (y, z), voxels; the slack keeps equal lengths equal.
    let reach = |axis: usize| ((radius_mm / spacing_mm[axis]) * (1.0 + 1e-9)).floor() as i64;
    let mut rows: Vec<(i64, i64, u32)> = Vec::new();
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
    let mut out = BitVolume::new(dims);
    let mut done = 0;
    while done < rows.len() {
        let half = rows[done].2;
        let end = rows.partition_point(|r| r.2 <= half);
        let wide = widened(mask, half);
        add_shifted(&mut out, &wide, &rows[done..end]);
        done = end;
    }
    out
}

/// Every set voxel all of whose neighbours within a radius are set; beyond the grid counts as set.
pub fn eroded(mask: &BitVolume, spacing_mm: DVec3, radius_mm: f64) -> BitVolume {
    dilated(&mask.inverted(), spacing_mm, radius_mm).inverted()
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
    if half == 0 {
        return mask.clone();
    }
    let UVec3 { x: nx, y: ny, .. } = mask.dims();
    let mut out = BitVolume::new(mask.dims());
    let words = mask.row_words();
    out.words_mut().par_chunks_mut(words).enumerate().with_min_len(64).for_each(|(row, to)| {
        for (a, b) in mask.runs(row as u32 % ny, row as u32 / ny) {
            set(to, a.saturating_sub(half), (b + half).min(nx - 1));
        }
    });
    out
}

fn set(row: &mut [u64], a: u32, b: u32) {
    let (w0, w1) = ((a >> 6) as usize, (b >> 6) as usize);
    let (first, last) = (!0u64 << (a & 63), !0u64 >> (63 - (b & 63)));
    if w0 == w1 {
        row[w0] |= first & last;
    } else {
        row[w0] |= first;
        row[w0 + 1..w1].fill(!0);
        row[w1] |= last;
    }
}

/// Adds to each row of `out` the rows of `mask` that lie at the offsets (y, z).
fn add_shifted(out: &mut BitVolume, mask: &BitVolume, offsets: &[(i64, i64, u32)]) {
    let UVec3 { y: ny, z: nz, .. } = mask.dims();
    let words = mask.row_words();
    out.words_mut().par_chunks_mut(words).enumerate().with_min_len(64).for_each(|(row, to)| {
        let (y, z) = ((row as u32 % ny) as i64, (row as u32 / ny) as i64);
        for (dy, dz, _) in offsets {
            let (y, z) = (y + dy, z + dz);
            if (0..i64::from(ny)).contains(&y) && (0..i64::from(nz)).contains(&z) {
                let from = mask.row(y as u32, z as u32);
                to.iter_mut().zip(from).for_each(|(a, b)| *a |= b);
            }
        }
    });
}

#[cfg(test)]
mod tests {
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
