//! Stored pixels of a series into samples.

use std::path::Path;

use rayon::prelude::*;

use super::super::FormatError;
use super::super::layout::{must_swap, zeroed};
use super::super::source::{Source, fill};
use super::head::Head;
use super::stack::{Slice, Stack};
use super::syntax;
use crate::volume::{Sample, SampleType, Samples, Volume, with_samples};

/// How pixels are stored, the same for all slices of a series.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Stored {
    pub kind: SampleType,
    /// Bits in use, and the number of bits below them.
    bits: u32,
    shift: u32,
    big_endian: bool,
}

impl Stored {
    /// Reads the pixel module of a slice.
    pub fn of(h: &Head) -> Result<Self, FormatError> {
        let get = |element, name: &str| {
            h.int(0x0028, element)
                .ok_or_else(|| FormatError::field(&h.file, name, "absent", "needed"))
        };
        let allocated = get(0x0100, "BitsAllocated")?;
        let signed = h.int(0x0028, 0x0103).unwrap_or(0);
        let kind = match (allocated, signed) {
            (8, 0) => SampleType::U8,
            (8, 1) => SampleType::I8,
            (16, 0) => SampleType::U16,
            (16, 1) => SampleType::I16,
            (32, 0) => SampleType::U32,
            (32, 1) => SampleType::I32,
            (8 | 16 | 32, other) => {
                let why = "0 (unsigned) or 1 (signed) are possible";
                return Err(FormatError::field(&h.file, "PixelRepresentation", other, why));
            }
            (n, _) => return Err(FormatError::unsupported(&h.file, format!("{n} bits a pixel"))),
        };
        let bits = h.int(0x0028, 0x0101).unwrap_or(allocated);
        if !(1..=allocated).contains(&bits) {
            let why = format!("1 to {allocated} are possible");
            return Err(FormatError::field(&h.file, "BitsStored", bits, why));
        }
        let high = h.int(0x0028, 0x0102).unwrap_or(bits - 1);
        if !(bits - 1..allocated).contains(&high) {
            let why = format!("{} to {} are possible", bits - 1, allocated - 1);
            return Err(FormatError::field(&h.file, "HighBit", high, why));
        }
        let big_endian = h.syntax == syntax::EXPLICIT_BIG;
        Ok(Self { kind, bits: bits as u32, shift: (high + 1 - bits) as u32, big_endian })
    }

    /// Holds the promised pixels against the element and the file; the offset of the first.
    pub fn check_pixels(&self, h: &Head) -> Result<u64, FormatError> {
        let Some(pixels) = h.pixels else {
            return Err(FormatError::unsupported(&h.file, "a slice without pixels"));
        };
        let wanted = u64::from(h.rows) * u64::from(h.columns) * self.kind.size() as u64;
        let rest = Source::open(&h.file)?.len.saturating_sub(pixels.offset);
        let found = pixels.len.unwrap_or(0).min(rest);
        if found < wanted {
            let (file, what) = (h.file.clone(), "pixels");
            return Err(FormatError::Truncated { file, what, wanted, found });
        }
        Ok(pixels.offset)
    }

    /// Brings the samples as stored to plain numbers: byte order, then the unused bits.
    fn tidy(&self, samples: &mut Samples) {
        if must_swap(self.big_endian) {
            samples.swap_bytes();
        }
        let all = 8 * self.kind.size() as u32;
        if self.bits == all {
            return;
        }
        // Shifting up and back down drops the unused bits and repeats the sign where there is one.
        let (up, down) = (all - self.bits - self.shift, all - self.bits);
        match samples {
            Samples::U8(s) => s.par_iter_mut().for_each(|v| *v = (*v << up) >> down),
            Samples::I8(s) => s.par_iter_mut().for_each(|v| *v = (*v << up) >> down),
            Samples::U16(s) => s.par_iter_mut().for_each(|v| *v = (*v << up) >> down),
            Samples::I16(s) => s.par_iter_mut().for_each(|v| *v = (*v << up) >> down),
            Samples::U32(s) => s.par_iter_mut().for_each(|v| *v = (*v << up) >> down),
            Samples::I32(s) => s.par_iter_mut().for_each(|v| *v = (*v << up) >> down),
            _ => {}
        }
    }
}

impl Stack {
    /// Type of the samples that [`read`] makes.
    pub fn sample_type(&self) -> SampleType {
        if self.rescale_differs() { SampleType::F32 } else { self.stored.kind }
    }
}

/// Reads all slices straight into their place.
pub(super) fn read(path: &Path, stack: &Stack) -> Result<Volume, FormatError> {
    let mut samples = zeroed(path, stack.stored.kind, stack.grid.len())?;
    let slice_bytes = samples.bytes().len() / stack.slices.len();
    samples
        .bytes_mut()
        .par_chunks_exact_mut(slice_bytes)
        .zip(&stack.slices)
        .try_for_each(|(bytes, slice)| read_slice(bytes, slice))?;
    stack.stored.tidy(&mut samples);
    let samples = if stack.rescale_differs() { rescaled(stack, &samples) } else { samples };
    let mut volume = Volume::new(stack.grid, samples);
    volume.rescale = stack.shared_rescale();
    Ok(volume)
}

fn read_slice(bytes: &mut [u8], slice: &Slice) -> Result<(), FormatError> {
    let mut source = Source::open_at(&slice.file, slice.offset)?;
    let found = fill(&mut source, bytes).map_err(|e| FormatError::io(&slice.file, e))? as u64;
    let wanted = bytes.len() as u64;
    if found < wanted {
        let (file, what) = (slice.file.clone(), "pixels");
        return Err(FormatError::Truncated { file, what, wanted, found });
    }
    Ok(())
}

/// Slices with their own rescale, as PET has them, become real values.
fn rescaled(stack: &Stack, samples: &Samples) -> Samples {
    fn over<T: Sample>(s: &[T], slices: &[Slice]) -> Vec<f32> {
        let per = s.len() / slices.len();
        s.chunks_exact(per)
            .zip(slices)
            .flat_map(|(chunk, slice)| chunk.iter().map(|v| slice.rescale.real(v.to_f64()) as f32))
            .collect()
    }
    with_samples!(samples, |s| over(s, &stack.slices)).into()
}
