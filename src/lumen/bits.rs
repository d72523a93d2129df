//! A mask over the whole grid, one bit a voxel. Rows are whole 64-bit words, so that eight x-voxels
//! are one byte of a brick. Memory is taken zeroed from the system: rows never touched cost none.

use glam::{IVec3, UVec3};
use rayon::prelude::*;

/// One bit a voxel, x fastest, rows padded to 64.
#[derive(Clone, Debug)]
pub struct BitVolume {
    dims: UVec3,
    row_words: usize,
    words: Vec<u64>,
}

/// Inclusive range of x-voxels.
pub type Run = (u32, u32);

impl BitVolume {
    /// All voxels clear.
    pub fn new(dims: UVec3) -> Self {
        let row_words = (dims.x as usize).div_ceil(64);
        let words = vec![0; row_words * dims.y as usize * dims.z as usize];
        Self { dims, row_words, words }
    }

    /// Voxels along each axis.
    pub fn dims(&self) -> UVec3 {
        self.dims
    }

    /// Words a row.
    pub fn row_words(&self) -> usize {
        self.row_words
    }

    /// All words, rows in (z, y) order.
    pub fn words_mut(&mut self) -> &mut [u64] {
        &mut self.words
    }

    #[inline]
    fn row_start(&self, y: u32, z: u32) -> usize {
        self.row_words * (y as usize + self.dims.y as usize * z as usize)
    }

    /// The words of a row.
    #[inline]
    pub fn row(&self, y: u32, z: u32) -> &[u64] {
        let s = self.row_start(y, z);
        &self.words[s..s + self.row_words]
    }

    /// Whether a voxel is set; outside the grid nothing is.
    #[inline]
    pub fn get(&self, v: IVec3) -> bool {
        v.cmpge(IVec3::ZERO).all()
            && v.cmplt(self.dims.as_ivec3()).all()
            && self.at(v.x as u32, v.y as u32, v.z as u32)
    }

    /// Whether a voxel of the grid is set.
    #[inline]
    pub fn at(&self, x: u32, y: u32, z: u32) -> bool {
        self.words[self.row_start(y, z) + (x >> 6) as usize] >> (x & 63) & 1 != 0
    }

    /// Sets a voxel of the grid.
    #[inline]
    pub fn set(&mut self, x: u32, y: u32, z: u32) {
        let s = self.row_start(y, z);
        self.words[s + (x >> 6) as usize] |= 1 << (x & 63);
    }

    /// Sets an inclusive run of x-voxels of a row.
    pub fn set_run(&mut self, (x0, x1): Run, y: u32, z: u32) {
        let s = self.row_start(y, z);
        let (w0, w1) = ((x0 >> 6) as usize, (x1 >> 6) as usize);
        let (first, last) = (!0u64 << (x0 & 63), !0u64 >> (63 - (x1 & 63)));
        if w0 == w1 {
            self.words[s + w0] |= first & last;
        } else {
            self.words[s + w0] |= first;
            self.words[s + w0 + 1..s + w1].fill(!0);
            self.words[s + w1] |= last;
        }
    }

    /// Sets the voxels of a byte's bits: x to x + 7 of a row, x a multiple of 8. Bits beyond the grid
    /// are left out.
    pub fn set_byte(&mut self, x: i32, y: i32, z: i32, byte: u8) {
        let at = IVec3::new(x, y, z);
        if at.cmplt(IVec3::ZERO).any() || at.cmpge(self.dims.as_ivec3()).any() {
            return;
        }
        let valid = 0xff >> (8 - (self.dims.x - x as u32).min(8));
        let s = self.row_start(y as u32, z as u32);
        self.words[s + (x as usize >> 6)] |= u64::from(byte & valid) << (x & 63);
    }

    /// Keeps what another mask of the same size has too.
    pub fn keep(&mut self, other: &Self) {
        self.combine(other, |a, b| a & b);
    }

    /// Adds what another mask of the same size has.
    pub fn add(&mut self, other: &Self) {
        self.combine(other, |a, b| a | b);
    }

    /// Takes away what another mask of the same size has.
    pub fn remove(&mut self, other: &Self) {
        self.combine(other, |a, b| a & !b);
    }

    fn combine(&mut self, other: &Self, op: impl Fn(u64, u64) -> u64 + Sync) {
        debug_assert_eq!(self.dims, other.dims);
        let pairs = self.words.par_iter_mut().zip(&other.words);
        pairs.with_min_len(1 << 14).for_each(|(a, b)| *a = op(*a, *b));
    }

    /// All voxels of the grid that are not set.
    pub fn inverted(&self) -> Self {
        let mut out = self.clone();
        let spare = self.row_words as u32 * 64 - self.dims.x;
        out.words.par_chunks_mut(self.row_words).with_min_len(256).for_each(|row| {
            row.iter_mut().for_each(|w| *w = !*w);
            if let Some(last) = row.last_mut() {
                *last &= !0 >> spare;
            }
        });
        out
    }

    /// Every set voxel, in z, y, x order.
    pub fn voxels(&self) -> impl Iterator<Item = UVec3> + '_ {
        let rows = (0..self.dims.z).flat_map(|z| (0..self.dims.y).map(move |y| (y, z)));
        rows.flat_map(move |(y, z)| {
            self.runs(y, z).flat_map(move |(a, b)| (a..=b).map(move |x| UVec3::new(x, y, z)))
        })
    }

    /// Number of set voxels.
    pub fn count(&self) -> u64 {
        self.words.par_chunks(1 << 14).map(ones).sum()
    }

    /// Whether no voxel is set.
    pub fn is_empty(&self) -> bool {
        self.words.iter().all(|w| *w == 0)
    }

    /// Runs of set voxels in a row, ascending.
    pub fn runs(&self, y: u32, z: u32) -> impl Iterator<Item = Run> + '_ {
        Runs { row: self.row(y, z), at: 0 }
    }

    /// Smallest box that holds all set voxels, inclusive corners.
    pub fn bounds(&self) -> Option<(UVec3, UVec3)> {
        let slice = self.row_words * self.dims.y as usize;
        let box_of = |z: usize, words: &[u64]| {
            let (mut lo, mut hi) = (UVec3::MAX, UVec3::ZERO);
            for (y, row) in words.chunks_exact(self.row_words).enumerate() {
                let Some(first) = row.iter().position(|w| *w != 0) else { continue };
                let last = row.iter().rposition(|w| *w != 0).unwrap_or(first);
                let x0 = first as u32 * 64 + row[first].trailing_zeros();
                let x1 = last as u32 * 64 + 63 - row[last].leading_zeros();
                lo = lo.min(UVec3::new(x0, y as u32, z as u32));
                hi = hi.max(UVec3::new(x1, y as u32, z as u32));
            }
            (lo, hi)
        };
        let (lo, hi) = self
            .words
            .par_chunks_exact(slice.max(1))
            .enumerate()
            .with_min_len(8)
            .map(|(z, words)| box_of(z, words))
            .reduce(|| (UVec3::MAX, UVec3::ZERO), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        (lo.x != u32::MAX).then_some((lo, hi))
    }
}

fn ones(words: &[u64]) -> u64 {
    words.iter().map(|w| u64::from(w.count_ones())).sum()
}

struct Runs<'a> {
    row: &'a [u64],
    at: u32,
}

impl Runs<'_> {
    /// First position from `self.at` whose bit equals `value`.
    fn next_bit(&self, value: bool) -> Option<u32> {
        let mut w = (self.at >> 6) as usize;
        let flip = if value { 0 } else { !0 };
        let mut bits = (self.row.get(w)? ^ flip) & (!0u64 << (self.at & 63));
        while bits == 0 {
            w += 1;
            bits = self.row.get(w)? ^ flip;
        }
        Some(w as u32 * 64 + bits.trailing_zeros())
    }
}

impl Iterator for Runs<'_> {
    type Item = Run;
    fn next(&mut self) -> Option<Run> {
        let x0 = self.next_bit(true)?;
        self.at = x0;
        let end = self.next_bit(false).unwrap_or(self.row.len() as u32 * 64);
        self.at = end;
        Some((x0, end - 1))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn runs_cross_words_and_end_at_the_row() {
        let mut b = BitVolume::new(UVec3::new(130, 2, 1));
        for run in [(0, 0), (62, 65), (100, 129)] {
            b.set_run(run, 1, 0);
        }
        assert_eq!(b.runs(1, 0).collect::<Vec<_>>(), [(0, 0), (62, 65), (100, 129)]);
        assert_eq!(b.runs(0, 0).count(), 0);
        assert_eq!(b.count(), 35);
        assert_eq!(b.bounds(), Some((UVec3::new(0, 1, 0), UVec3::new(129, 1, 0))));
        assert!(b.at(63, 1, 0) && !b.at(66, 1, 0) && !b.get(IVec3::new(-1, 0, 0)));
    }
}
