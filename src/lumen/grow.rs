//! Region growing: the 6-component of a seed, by spans of bits. It visits what it fills and the
//! rows next to that: of the stored samples, 64 at a time are compared when first met.

use glam::UVec3;

use super::bits::Run;
use super::intensity_selection::{StoredSelection, check_seed};
use super::{BitVolume, IntensitySelection, LumenError};
use crate::volume::{Sample, Volume, with_samples};

/// The 6-connected component of `seed` in `selection`.
///
/// # Errors
/// [`LumenError::SeedOutside`], [`LumenError::SeedValue`].
pub fn grow(
    volume: &Volume,
    selection: &IntensitySelection,
    seed: UVec3,
) -> Result<BitVolume, LumenError> {
    check_seed(volume, selection, seed)?;
    let mut bits = BitVolume::new(volume.grid.dims);
    with_samples!(&volume.samples, |s| spans(&selection.stored(volume, s), s, seed, &mut bits));
    Ok(bits)
}

/// Row of voxels, by y and z.
type Row = (u32, u32);

/// Voxels in the selection, evaluated a word of 64 at a time on first access.
struct Allowed<'a, T> {
    selection: &'a StoredSelection<T>,
    samples: &'a [T],
    bits: BitVolume,
    /// Bit for each word of `bits`: whether the word has been evaluated.
    known: Vec<u64>,
}

impl<T: Sample> Allowed<'_, T> {
    /// Returns a word of a row, evaluating it on first access.
    #[inline]
    fn word(&mut self, (y, z): Row, w: usize) -> u64 {
        let (words, dims) = (self.bits.row_words(), self.bits.dims());
        let row = y as usize + dims.y as usize * z as usize;
        let at = row * words + w;
        let (block, bit) = (at >> 6, 1u64 << (at & 63));
        if self.known[block] & bit != 0 {
            return self.bits.row(y, z)[w];
        }
        self.known[block] |= bit;
        let nx = dims.x as usize;
        let from = row * nx + 64 * w;
        let n = 64.min(nx - 64 * w);
        let word = self.selection.word(&self.samples[from..from + n]);
        if word != 0 {
            self.bits.row_mut(y, z)[w] = word;
        }
        word
    }

    /// The run of allowed voxels around one, inclusive.
    fn run(&mut self, row: Row, x: u32) -> Run {
        let (mut w, bit) = ((x >> 6) as usize, x & 63);
        // Voxels not allowed at or below `bit`, then of lower words.
        let mut stop = !self.word(row, w) & (!0 >> (63 - bit));
        while stop == 0 && w > 0 {
            w -= 1;
            stop = !self.word(row, w);
        }
        let first = 64 * w as u32 + 64 - stop.leading_zeros();
        let (mut w, words) = ((x >> 6) as usize, self.bits.row_words());
        let mut stop = !self.word(row, w) & (!0 << bit);
        while stop == 0 && w + 1 < words {
            w += 1;
            stop = !self.word(row, w);
        }
        let end = 64 * w as u32 + stop.trailing_zeros();
        (first, end.min(self.bits.dims().x) - 1)
    }
}

fn spans<T: Sample>(
    selection: &StoredSelection<T>,
    samples: &[T],
    seed: UVec3,
    bits: &mut BitVolume,
) {
    let dims = bits.dims();
    let words = bits.row_words();
    let known = vec![0; (words * dims.y as usize * dims.z as usize).div_ceil(64)];
    let mut allowed = Allowed { selection, samples, bits: BitVolume::new(dims), known };
    let mut open = vec![(seed.x, seed.y, seed.z)];
    while let Some((x, y, z)) = open.pop() {
        if bits.at(x, y, z) {
            continue;
        }
        let (a, b) = allowed.run((y, z), x);
        bits.set_run((a, b), y, z);
        let mut visit_row = |y: u32, z: u32| {
            for w in (a >> 6) as usize..=(b >> 6) as usize {
                let from = 64 * w as u32;
                let span = !0u64 << a.saturating_sub(from) & !0 >> (63 - (b - from).min(63));
                let fresh = allowed.word((y, z), w) & !bits.row(y, z)[w] & span;
                let mut starts = fresh & !(fresh << 1);
                while starts != 0 {
                    open.push((from + starts.trailing_zeros(), y, z));
                    starts &= starts - 1;
                }
            }
        };
        if y > 0 {
            visit_row(y - 1, z);
        }
        if y + 1 < dims.y {
            visit_row(y + 1, z);
        }
        if z > 0 {
            visit_row(y, z - 1);
        }
        if z + 1 < dims.z {
            visit_row(y, z + 1);
        }
    }
}
