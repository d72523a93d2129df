//! Bit set of the cells of a grid, with flood fill and Chebyshev distance transform, 64 cells at a
//! time.

use glam::{USizeVec3, UVec3};
use rayon::prelude::*;

use crate::task::checkpoint;

/// Cells of a grid. Rows along x are whole words; bits padding the end of a row mean nothing.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct CellBits {
    dims: USizeVec3,
    row_words: usize,
    words: Vec<u64>,
}

impl CellBits {
    /// Returns the set without cells, or with every cell.
    pub fn new(dims: UVec3, all: bool) -> Self {
        let dims = dims.as_usizevec3();
        let row_words = dims.x.div_ceil(64);
        let words = vec![if all { u64::MAX } else { 0 }; row_words * dims.y * dims.z];
        Self { dims, row_words, words }
    }

    /// Adds cells `first` to `last` of a row.
    pub fn add_run(&mut self, first: usize, last: usize, y: usize, z: usize) {
        let row = self.row(y + self.dims.y * z);
        let row = &mut self.words[row];
        for (w, word) in row.iter_mut().enumerate().take(last / 64 + 1).skip(first / 64) {
            let low = u64::MAX << first.saturating_sub(64 * w).min(63);
            let high = u64::MAX >> (63 - (last - 64 * w).min(63));
            *word |= low & high;
        }
    }

    /// Adds a cell.
    pub fn insert(&mut self, cell: USizeVec3) {
        self.add_run(cell.x, cell.x, cell.y, cell.z);
    }

    /// Removes a cell.
    pub fn remove(&mut self, cell: USizeVec3) {
        let (word, bit) = self.place(cell);
        self.words[word] &= !(1 << bit);
    }

    /// Removes the cells of another set.
    pub fn remove_all(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a &= !b);
    }

    /// Whether a cell is in the set.
    pub fn contains(&self, cell: USizeVec3) -> bool {
        let (word, bit) = self.place(cell);
        self.words[word] >> bit & 1 != 0
    }

    /// Returns the word of a cell and its bit there.
    fn place(&self, cell: USizeVec3) -> (usize, usize) {
        let row = cell.y + self.dims.y * cell.z;
        (row * self.row_words + cell.x / 64, cell.x % 64)
    }

    /// Calls `visit` with each cell of the set, row by row.
    pub fn each(&self, mut visit: impl FnMut(USizeVec3)) {
        for (w, word) in self.words.iter().enumerate() {
            let (row, mut left) = (w / self.row_words, *word);
            while left != 0 {
                let x = w % self.row_words * 64 + left.trailing_zeros() as usize;
                visit(USizeVec3::new(x, row % self.dims.y, row / self.dims.y));
                left &= left - 1;
            }
        }
    }

    /// Adds the cells of another set.
    pub fn add(&mut self, other: &Self) {
        self.words.iter_mut().zip(&other.words).for_each(|(a, b)| *a |= b);
    }

    /// Returns the cells that are not in the set.
    pub fn inverted(&self) -> Self {
        Self { words: self.words.iter().map(|w| !w).collect(), ..*self }
    }

    fn row(&self, row: usize) -> std::ops::Range<usize> {
        row * self.row_words..(row + 1) * self.row_words
    }

    /// Returns the cells of the set that 6-connected paths through it reach from the border of the
    /// grid, and the border.
    pub fn reached_from_border(&self) -> Self {
        let USizeVec3 { x: nx, y: ny, z: nz } = self.dims;
        let mut reached = Self { words: vec![0; self.words.len()], ..*self };
        for row in 0..ny * nz {
            let (y, z) = (row % ny, row / ny);
            if [0, ny - 1].contains(&y) || [0, nz - 1].contains(&z) {
                reached.add_run(0, nx - 1, y, z);
            } else {
                reached.add_run(0, 0, y, z);
                reached.add_run(nx - 1, nx - 1, y, z);
            }
        }
        // Rows whose neighbours have changed since they were filled.
        let mut open: Vec<usize> = (0..ny * nz).rev().collect();
        let mut waits = vec![true; ny * nz];
        let mut filled = vec![0u64; self.row_words];
        while let Some(row) = open.pop() {
            waits[row] = false;
            let (y, z) = (row % ny, row / ny);
            let near = [
                (y > 0).then(|| row - 1),
                (y + 1 < ny).then(|| row + 1),
                (z > 0).then(|| row - ny),
                (z + 1 < nz).then(|| row + ny),
            ];
            let (own, free) = (self.row(row), &self.words[self.row(row)]);
            filled.copy_from_slice(&reached.words[own.clone()]);
            for near in near.into_iter().flatten() {
                let from = &reached.words[self.row(near)];
                filled.iter_mut().zip(from).zip(free).for_each(|((w, n), f)| *w |= n & f);
            }
            spread(&mut filled, free);
            if filled[..] == reached.words[own.clone()] {
                continue;
            }
            reached.words[own].copy_from_slice(&filled);
            for near in near.into_iter().flatten() {
                if !std::mem::replace(&mut waits[near], true) {
                    open.push(near);
                }
            }
        }
        reached
    }

    /// Calls `put` with each cell of the set and its Chebyshev distance, in cells, to the nearest
    /// cell of the grid that is not in it, at most `most`: the number of times that the set can be
    /// eroded by a cube of three cells until the cell is gone.
    pub fn each_distance(&self, most: u8, mut put: impl FnMut(usize, u8)) {
        let USizeVec3 { x: nx, y: ny, .. } = self.dims;
        let (words, layer) = (self.row_words, self.row_words * ny);
        let mut set = self.words.clone();
        let [mut narrow, mut flat] = [set.clone(), set.clone()];
        // Padding bits at the end of a row are set: no distance is measured to outside the grid.
        let padding = u64::MAX.checked_shl(nx as u32 - 64 * (words as u32 - 1)).unwrap_or(0);
        set.iter_mut().skip(words - 1).step_by(words).for_each(|w| *w |= padding);
        for distance in 1..=most {
            checkpoint();
            narrow
                .par_chunks_exact_mut(words)
                .zip(set.par_chunks_exact(words))
                .with_min_len(256)
                .for_each(|(to, row)| {
                    for w in 0..words {
                        let before = w.checked_sub(1).map_or(1, |b| row[b] >> 63);
                        let after = row.get(w + 1).map_or(1, |n| n & 1);
                        to[w] = row[w] & (row[w] << 1 | before) & (row[w] >> 1 | after << 63);
                    }
                });
            eroded_along(&narrow, &mut flat, words, ny);
            let mut next = std::mem::take(&mut narrow);
            eroded_along(&flat, &mut next, layer, self.dims.z);
            let last = distance == most;
            let mut left = 0;
            for (w, (set, next)) in set.iter().zip(&next).enumerate() {
                let in_row = w % words;
                let mut gone = if last { *set } else { set & !next };
                if in_row == words - 1 {
                    gone &= !padding;
                }
                let first = w / words * nx + 64 * in_row;
                while gone != 0 {
                    put(first + gone.trailing_zeros() as usize, distance);
                    gone &= gone - 1;
                }
                left |= if in_row == words - 1 { next & !padding } else { *next };
            }
            narrow = std::mem::replace(&mut set, next);
            if left == 0 {
                break;
            }
        }
    }
}

/// Cells of a set, numbered row by row (rank; Jacobson 1989, doi:10.1109/SFCS.1989.63533).
#[derive(Debug)]
pub(super) struct RankedCells {
    cells: CellBits,
    /// Number of cells before each word.
    before: Vec<u32>,
    count: usize,
}

impl RankedCells {
    /// Numbers the cells of a set, whose padding bits must be clear.
    pub fn new(cells: CellBits) -> Self {
        let mut count = 0;
        let before = cells.words.iter().map(|w| {
            count += w.count_ones();
            count - w.count_ones()
        });
        let before = before.collect();
        Self { cells, before, count: count as usize }
    }

    /// Returns the cells.
    pub fn cells(&self) -> &CellBits {
        &self.cells
    }

    /// Returns the number of cells.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Returns the number of a cell; `None` of one that is not in the set.
    pub fn number(&self, cell: USizeVec3) -> Option<usize> {
        let (word, bit) = self.cells.place(cell);
        let bits = self.cells.words[word];
        let below = bits & !(u64::MAX << bit);
        (bits >> bit & 1 != 0).then(|| self.before[word] as usize + below.count_ones() as usize)
    }
}

/// Flood fill of a row: extends the filled cells through adjacent free ones, in both directions.
fn spread(filled: &mut [u64], free: &[u64]) {
    let mut carry = 0;
    for (w, f) in filled.iter_mut().zip(free) {
        let seeds = *w | carry & f;
        *w = seeds | upwards(seeds, *f);
        carry = *w >> 63;
    }
    let mut carry = 0;
    for (w, f) in filled.iter_mut().zip(free).rev() {
        let seeds = *w | carry << 63 & f;
        *w = seeds | upwards(seeds.reverse_bits(), f.reverse_bits()).reverse_bits();
        carry = *w & 1;
    }
}

/// Flood fill of a word towards its high bits, by doubling: the seeds and the runs of free cells above
/// them.
fn upwards(seeds: u64, free: u64) -> u64 {
    let (mut filled, mut free) = (seeds, free);
    for step in [1, 2, 4, 8, 16, 32] {
        filled |= free & filled << step;
        free &= free << step;
    }
    filled
}

/// Erosion along y or z: the intersection of each group of `stride` words with both its neighbours;
/// `count` groups are a line, and the grid's ends do not erode.
fn eroded_along(from: &[u64], to: &mut [u64], stride: usize, count: usize) {
    let groups = to.par_chunks_exact_mut(stride).enumerate();
    groups.with_min_len((4096 / stride).max(1)).for_each(|(i, to)| {
        let own = &from[i * stride..][..stride];
        let at = i % count;
        let below = if at > 0 { &from[(i - 1) * stride..][..stride] } else { own };
        let above = if at + 1 < count { &from[(i + 1) * stride..][..stride] } else { own };
        for (w, to) in to.iter_mut().enumerate() {
            *to = own[w] & below[w] & above[w];
        }
    });
}

#[cfg(test)]
mod tests {
    use std::collections::VecDeque;

    use super::*;

    /// Random cells, mostly set.
    fn noise(dims: UVec3, seed: &mut u64, share: f64) -> (CellBits, Vec<bool>) {
        let mut set = CellBits::new(dims, false);
        let mut plain = Vec::new();
        for z in 0..dims.z as usize {
            for y in 0..dims.y as usize {
                for x in 0..dims.x as usize {
                    *seed =
                        seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                    let is_set = (*seed >> 40) as f64 / (1u64 << 24) as f64 <= share;
                    plain.push(is_set);
                    if is_set {
                        set.add_run(x, x, y, z);
                    }
                }
            }
        }
        (set, plain)
    }

    fn plain(set: &CellBits) -> Vec<bool> {
        let USizeVec3 { x: nx, y: ny, z: nz } = set.dims;
        (0..nx * ny * nz)
            .map(|i| set.words[i / nx * set.row_words + i % nx / 64] >> (i % nx % 64) & 1 != 0)
            .collect()
    }

    const SIZES: [UVec3; 5] = [
        UVec3::new(3, 3, 3),
        UVec3::new(64, 5, 4),
        UVec3::new(65, 7, 6),
        UVec3::new(130, 9, 11),
        UVec3::new(20, 31, 17),
    ];

    #[test]
    fn a_flood_by_words_reaches_the_cells_that_a_queue_reaches() {
        let mut seed = 3;
        for (dims, share) in SIZES.into_iter().flat_map(|d| [0.35, 0.5, 0.9].map(|s| (d, s))) {
            let (set, free) = noise(dims, &mut seed, share);
            let d = dims.as_usizevec3();
            let place = |i: usize| USizeVec3::new(i % d.x, i / d.x % d.y, i / (d.x * d.y));
            let border = |i: usize| (place(i).cmpeq(USizeVec3::ZERO) | place(i).cmpeq(d - 1)).any();
            let mut reached: Vec<bool> = (0..free.len()).map(border).collect();
            let mut open: VecDeque<usize> = (0..free.len()).filter(|i| border(*i)).collect();
            while let Some(i) = open.pop_front() {
                for (axis, step) in [1, d.x, d.x * d.y].into_iter().enumerate() {
                    let below = (place(i)[axis] > 0).then(|| i - step);
                    let above = (place(i)[axis] + 1 < d[axis]).then(|| i + step);
                    for j in below.into_iter().chain(above) {
                        if free[j] && !std::mem::replace(&mut reached[j], true) {
                            open.push_back(j);
                        }
                    }
                }
            }
            assert_eq!(plain(&set.reached_from_border()), reached, "{dims} {share}");
        }
    }

    #[test]
    fn distances_by_erosion_are_those_to_the_nearest_other_cell_of_the_grid() {
        let mut seed = 5;
        for (dims, share) in SIZES.into_iter().flat_map(|d| [0.5, 0.99, 1.0].map(|s| (d, s))) {
            let (set, free) = noise(dims, &mut seed, share);
            let d = dims.as_ivec3();
            let place = |i: usize| {
                let i = i as i32;
                glam::IVec3::new(i % d.x, i / d.x % d.y, i / (d.x * d.y))
            };
            let others: Vec<_> = (0..free.len()).filter(|i| !free[*i]).map(place).collect();
            let mut found = vec![0; free.len()];
            set.each_distance(6, |i, distance| {
                assert_eq!(std::mem::replace(&mut found[i], distance), 0, "put twice");
            });
            for (i, found) in found.into_iter().enumerate() {
                let nearest = others.iter().map(|o| (place(i) - *o).abs().max_element()).min();
                assert_eq!(i32::from(found), nearest.unwrap_or(6).min(6), "{dims} {share} {i}");
            }
        }
    }
}
