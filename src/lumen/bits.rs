//! A mask over the whole grid, one bit a voxel. Rows are whole 64-bit words, so that eight x-voxels
//! are one byte of a brick. Memory is taken for eight rows of a slice when one of their voxels is
//! set first: of a thin tree in a large volume most never are.

use std::sync::Arc;

use glam::{IVec3, UVec3};
use rayon::prelude::*;

/// Rows of a slice that are allocated together: those of a brick.
const BLOCK_ROWS: usize = 8;

/// One bit a voxel, x fastest, rows padded to 64.
#[derive(Clone, Debug)]
pub struct BitVolume {
    dims: UVec3,
    row_words: usize,
    /// Blocks of rows along y.
    blocks_y: usize,
    /// Rows in (z, y) order, [`BLOCK_ROWS`] a block; `None` where no voxel was set.
    blocks: Vec<Option<Box<[u64]>>>,
    /// Row of no set voxel, for the blocks that are not there.
    blank: Arc<[u64]>,
}

/// Inclusive range of x-voxels.
pub type Run = (u32, u32);

impl BitVolume {
    /// All voxels clear.
    pub fn new(dims: UVec3) -> Self {
        let row_words = (dims.x as usize).div_ceil(64);
        let blocks_y = (dims.y as usize).div_ceil(BLOCK_ROWS);
        let blocks = vec![None; blocks_y * dims.z as usize];
        Self { dims, row_words, blocks_y, blocks, blank: vec![0; row_words].into() }
    }

    /// A mask whose rows a function fills: it gets y, z and a clear row.
    pub fn from_rows(dims: UVec3, fill: impl Fn(u32, u32, &mut [u64]) + Sync) -> Self {
        let mut out = Self::new(dims);
        let words = out.row_words;
        out.update(|y0, z, block| {
            for (row, y) in block.chunks_exact_mut(words).zip(y0..dims.y) {
                fill(y, z, row);
            }
        });
        out
    }

    /// Has a function change eight rows at a time: it gets the first one's y, z, and their words.
    /// Rows beyond the grid stay clear.
    pub(super) fn update(&mut self, change: impl Fn(u32, u32, &mut [u64]) + Sync) {
        let (len, blocks_y) = (BLOCK_ROWS * self.row_words, self.blocks_y);
        let scratch = || vec![0u64; len];
        let blocks = self.blocks.par_iter_mut().enumerate().with_min_len(16);
        blocks.for_each_init(scratch, |scratch, (i, block)| {
            let (y, z) = ((i % blocks_y * BLOCK_ROWS) as u32, (i / blocks_y) as u32);
            match block {
                Some(block) => change(y, z, block),
                None => {
                    change(y, z, scratch);
                    if scratch.iter().any(|w| *w != 0) {
                        *block = Some(scratch.clone().into());
                        scratch.fill(0);
                    }
                }
            }
        });
    }

    /// Takes over the slices of a mask with rows of the same number and length, as those from `z` on.
    pub(super) fn put_slices(&mut self, z: u32, slices: Self) {
        debug_assert_eq!(self.dims.truncate(), slices.dims.truncate());
        let at = self.blocks_y * z as usize;
        for (to, from) in self.blocks[at..].iter_mut().zip(slices.blocks) {
            *to = from;
        }
    }

    /// Voxels along each axis.
    pub fn dims(&self) -> UVec3 {
        self.dims
    }

    /// Words a row.
    pub fn row_words(&self) -> usize {
        self.row_words
    }

    /// Bytes of memory of the rows that are there.
    pub fn bytes(&self) -> u64 {
        let each = size_of::<Option<Box<[u64]>>>() as u64;
        let held = self.blocks.iter().flatten().count() as u64;
        each * self.blocks.len() as u64 + held * (8 * BLOCK_ROWS * self.row_words) as u64
    }

    #[inline]
    fn block_of(&self, y: u32, z: u32) -> usize {
        y as usize / BLOCK_ROWS + self.blocks_y * z as usize
    }

    /// Whether a voxel was set in the eight rows that hold one.
    #[inline]
    pub(super) fn has_block(&self, y: u32, z: u32) -> bool {
        self.blocks[self.block_of(y, z)].is_some()
    }

    /// The words of a row.
    #[inline]
    pub fn row(&self, y: u32, z: u32) -> &[u64] {
        match &self.blocks[self.block_of(y, z)] {
            Some(block) => {
                let s = y as usize % BLOCK_ROWS * self.row_words;
                &block[s..s + self.row_words]
            }
            None => &self.blank,
        }
    }

    /// The words of a row, to be changed.
    #[inline]
    pub(super) fn row_mut(&mut self, y: u32, z: u32) -> &mut [u64] {
        let (at, words) = (self.block_of(y, z), self.row_words);
        let new = || vec![0; BLOCK_ROWS * words].into();
        let s = y as usize % BLOCK_ROWS * words;
        &mut self.blocks[at].get_or_insert_with(new)[s..s + words]
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
        self.row(y, z)[(x >> 6) as usize] >> (x & 63) & 1 != 0
    }

    /// Sets a voxel of the grid.
    #[inline]
    pub fn set(&mut self, x: u32, y: u32, z: u32) {
        self.row_mut(y, z)[(x >> 6) as usize] |= 1 << (x & 63);
    }

    /// Sets an inclusive run of x-voxels of a row.
    pub fn set_run(&mut self, (x0, x1): Run, y: u32, z: u32) {
        set_run(self.row_mut(y, z), (x0, x1));
    }

    /// Sets the voxels of a byte's bits: x to x + 7 of a row, x a multiple of 8. Bits beyond the grid
    /// are left out.
    pub fn set_byte(&mut self, x: i32, y: i32, z: i32, byte: u8) {
        let at = IVec3::new(x, y, z);
        if at.cmplt(IVec3::ZERO).any() || at.cmpge(self.dims.as_ivec3()).any() {
            return;
        }
        let valid = 0xff >> (8 - (self.dims.x - x as u32).min(8));
        if byte & valid != 0 {
            let word = u64::from(byte & valid) << (x & 63);
            self.row_mut(y as u32, z as u32)[x as usize >> 6] |= word;
        }
    }

    /// Keeps what another mask of the same size has too.
    pub fn keep(&mut self, other: &Self) {
        self.combine(other, |a, b| match b {
            Some(b) => a.iter_mut().zip(b).for_each(|(a, b)| *a &= b),
            None => a.fill(0),
        });
    }

    /// Adds what another mask of the same size has.
    pub fn add(&mut self, other: &Self) {
        self.combine(other, |a, b| {
            a.iter_mut().zip(b.into_iter().flatten()).for_each(|(a, b)| *a |= b);
        });
    }

    /// Takes away what another mask of the same size has.
    pub fn remove(&mut self, other: &Self) {
        self.combine(other, |a, b| {
            a.iter_mut().zip(b.into_iter().flatten()).for_each(|(a, b)| *a &= !b);
        });
    }

    fn combine(&mut self, other: &Self, op: impl Fn(&mut [u64], Option<&[u64]>) + Sync) {
        debug_assert_eq!(self.dims, other.dims);
        self.update(|y, z, block| op(block, other.blocks[other.block_of(y, z)].as_deref()));
    }

    /// All voxels of the grid that are not set.
    pub fn inverted(&self) -> Self {
        let spare = self.row_words as u32 * 64 - self.dims.x;
        Self::from_rows(self.dims, |y, z, row| {
            row.iter_mut().zip(self.row(y, z)).for_each(|(to, from)| *to = !from);
            if let Some(last) = row.last_mut() {
                *last &= !0 >> spare;
            }
        })
    }

    /// The mask with its x and y exchanged.
    pub fn transposed_xy(&self) -> Self {
        let UVec3 { x, y, z } = self.dims;
        let mut out = Self::new(UVec3::new(y, x, z));
        let words = out.row_words;
        // Eight rows of the result are a byte of each row here.
        out.update(|x0, z, rows| {
            for y0 in (0..y).step_by(BLOCK_ROWS) {
                let Some(block) = &self.blocks[self.block_of(y0, z)] else { continue };
                let from = block.iter().skip(x0 as usize >> 6).step_by(self.row_words);
                let byte = |word: &u64| (word >> (x0 & 63)) as u8;
                let mut bytes = [0; BLOCK_ROWS];
                bytes.iter_mut().zip(from).for_each(|(to, word)| *to = byte(word));
                let turned = transposed_8x8(u64::from_le_bytes(bytes)).to_le_bytes();
                let to = rows.iter_mut().skip(y0 as usize >> 6).step_by(words);
                to.zip(turned).for_each(|(to, byte)| *to |= u64::from(byte) << (y0 & 63));
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
        self.blocks.par_iter().with_min_len(64).flatten().map(|block| ones(block)).sum()
    }

    /// Whether no voxel is set.
    pub fn is_empty(&self) -> bool {
        self.blocks.iter().flatten().all(|block| block.iter().all(|w| *w == 0))
    }

    /// Runs of set voxels in a row, ascending.
    pub fn runs(&self, y: u32, z: u32) -> impl Iterator<Item = Run> + '_ {
        let row = if self.has_block(y, z) { self.row(y, z) } else { &[] };
        Runs { row, at: 0 }
    }

    /// Smallest box that holds all set voxels, inclusive corners.
    pub fn bounds(&self) -> Option<(UVec3, UVec3)> {
        let box_of = |i: usize, block: &[u64]| {
            let (y0, z) = (i % self.blocks_y * BLOCK_ROWS, i / self.blocks_y);
            let (mut lo, mut hi) = (UVec3::MAX, UVec3::ZERO);
            for (y, row) in block.chunks_exact(self.row_words).enumerate() {
                let Some(first) = row.iter().position(|w| *w != 0) else { continue };
                let last = row.iter().rposition(|w| *w != 0).unwrap_or(first);
                let x0 = first as u32 * 64 + row[first].trailing_zeros();
                let x1 = last as u32 * 64 + 63 - row[last].leading_zeros();
                lo = lo.min(UVec3::new(x0, (y0 + y) as u32, z as u32));
                hi = hi.max(UVec3::new(x1, (y0 + y) as u32, z as u32));
            }
            (lo, hi)
        };
        let (lo, hi) = self
            .blocks
            .par_iter()
            .enumerate()
            .with_min_len(64)
            .filter_map(|(i, block)| Some(box_of(i, block.as_ref()?)))
            .reduce(|| (UVec3::MAX, UVec3::ZERO), |a, b| (a.0.min(b.0), a.1.max(b.1)));
        (lo.x != u32::MAX).then_some((lo, hi))
    }
}

/// Sets an inclusive run of x-voxels in the words of a row.
pub(super) fn set_run(row: &mut [u64], (x0, x1): Run) {
    let (w0, w1) = ((x0 >> 6) as usize, (x1 >> 6) as usize);
    let (first, last) = (!0u64 << (x0 & 63), !0u64 >> (63 - (x1 & 63)));
    if w0 == w1 {
        row[w0] |= first & last;
    } else {
        row[w0] |= first;
        row[w0 + 1..w1].fill(!0);
        row[w1] |= last;
    }
}

/// A matrix of 8 × 8 bits, a row a byte, transposed by exchanging blocks of 1, 2 and 4 bits (Warren,
/// "Hacker's Delight", 2002, section 7-3).
fn transposed_8x8(mut m: u64) -> u64 {
    for (shift, mask) in
        [(7, 0x00aa_00aa_00aa_00aa), (14, 0x0000_cccc_0000_cccc), (28, 0x0000_0000_f0f0_f0f0)]
    {
        let t: u64 = (m ^ (m >> shift)) & mask;
        m ^= t ^ (t << shift);
    }
    m
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

    #[test]
    fn memory_follows_the_voxels_that_are_set() {
        let mut b = BitVolume::new(UVec3::new(4096, 4096, 4096));
        let empty = b.bytes();
        assert!(empty < 40 << 20, "{empty} bytes of 8 GiB");
        (0..4096).for_each(|z| b.set(z, 4095 - z, z));
        assert_eq!(b.bytes() - empty, 4096 * 8 * 512);
        assert_eq!((b.count(), b.bounds()), (4096, Some((UVec3::ZERO, UVec3::splat(4095)))));
    }

    #[test]
    fn masks_combine_word_by_word_where_one_of_them_has_no_rows() {
        let dims = UVec3::new(70, 19, 3);
        let of = |rows: &[(u32, u32)]| {
            let mut b = BitVolume::new(dims);
            rows.iter().for_each(|&(y, z)| b.set_run((3, 66), y, z));
            b
        };
        let (a, b) = (of(&[(0, 0), (9, 1), (18, 2)]), of(&[(9, 1), (17, 2), (1, 0)]));
        let after = |change: fn(&mut BitVolume, &BitVolume)| {
            let mut out = a.clone();
            change(&mut out, &b);
            out.voxels().collect::<Vec<_>>()
        };
        let voxels = |rows: &[(u32, u32)]| of(rows).voxels().collect::<Vec<_>>();
        assert_eq!(after(BitVolume::keep), voxels(&[(9, 1)]));
        assert_eq!(after(BitVolume::remove), voxels(&[(0, 0), (18, 2)]));
        assert_eq!(after(BitVolume::add), voxels(&[(0, 0), (1, 0), (9, 1), (17, 2), (18, 2)]));
        assert_eq!(a.inverted().count(), u64::from(dims.element_product()) - a.count());
    }

    #[test]
    fn a_transposed_mask_has_every_voxel_with_x_and_y_exchanged() {
        let dims = UVec3::new(131, 77, 5);
        let mut b = BitVolume::new(dims);
        let mut i = 0u32;
        for v in (0..dims.z).flat_map(|z| (0..dims.y).map(move |y| (y, z))) {
            for x in 0..dims.x {
                i = i.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
                if i >> 29 == 0 && v.0 / 8 != 3 {
                    b.set(x, v.0, v.1);
                }
            }
        }
        let turned = b.transposed_xy();
        assert_eq!((turned.dims(), turned.count()), (UVec3::new(77, 131, 5), b.count()));
        assert!(b.count() > 5000 && b.voxels().all(|v| turned.at(v.y, v.x, v.z)));
    }
}
