//! Stored pixels of a series into samples.

use std::collections::BTreeMap;
use std::io::Read as _;
use std::path::Path;

use rayon::prelude::*;

use super::super::FormatError;
use super::super::layout::{MAX_SHRINK, must_swap, zeroed};
use super::super::source::{DataFile, fill};
use super::codec::{self, FrameSize};
use super::fragments::Fragment;
use super::head::Head;
use super::stack::{Slice, Stack};
use super::syntax::{self, Codec};
use super::walk::{Pixels, inflate};
use crate::task::checkpoint;
use crate::volume::{Sample, SampleType, Samples, Volume, with_samples};

/// Place of a slice's pixels.
pub(super) enum SlicePixels {
    /// In the file, from an offset on.
    Plain(u64),
    /// In the inflated data set, from an offset on.
    Deflated(u64),
    /// In fragments that are decoded together.
    Compressed(Codec, Vec<Fragment>),
}

/// Format of stored pixels, the same for all slices of a series.
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
        let big_endian = *h.syntax == *syntax::EXPLICIT_BIG;
        // Decoders give samples from the lowest bit on.
        let is_compressed = Codec::of(&h.syntax).is_some();
        let shift = if is_compressed { 0 } else { (high + 1 - bits) as u32 };
        Ok(Self { kind, bits: bits as u32, shift, big_endian })
    }

    /// Holds the promised pixels against the element and the file; where they are.
    pub fn check_pixels(&self, h: &Head) -> Result<SlicePixels, FormatError> {
        let wanted = u64::from(h.rows) * u64::from(h.columns) * self.kind.size() as u64;
        // Frames follow each other without a gap.
        let before = wanted.saturating_mul(h.frame as u64);
        let truncated = |found| {
            let (file, what) = (h.file.to_path_buf(), "pixels");
            Err(FormatError::Truncated { file, what, wanted, found })
        };
        match h.pixels.as_deref() {
            None => Err(FormatError::unsupported(&h.file, "a slice without pixels")),
            Some(Pixels::Plain { .. }) if Codec::of(&h.syntax).is_some() => {
                let name = syntax::describe(&h.syntax);
                let why = format!("transfer syntax {name} has them in fragments");
                Err(FormatError::field(&h.file, "pixels", "plain", why))
            }
            Some(Pixels::Plain { offset, len }) if *h.syntax == *syntax::DEFLATED => {
                let most = DataFile::open(&h.file)?.len.saturating_mul(MAX_SHRINK);
                let found = (*len).min(most.saturating_sub(*offset)).saturating_sub(before);
                let at = offset.saturating_add(before);
                if found < wanted { truncated(found) } else { Ok(SlicePixels::Deflated(at)) }
            }
            Some(Pixels::Plain { offset, len }) => {
                let rest = DataFile::open(&h.file)?.len.saturating_sub(*offset);
                let found = (*len).min(rest).saturating_sub(before);
                let at = offset.saturating_add(before);
                if found < wanted { truncated(found) } else { Ok(SlicePixels::Plain(at)) }
            }
            Some(Pixels::Encapsulated { .. }) => match Codec::of(&h.syntax) {
                Some(codec) => {
                    codec::check_claim(codec, [h.columns, h.rows], fragments_len(&h.fragments))
                        .map_err(|why| FormatError::field(&h.file, "pixels", "damaged", why))?;
                    Ok(SlicePixels::Compressed(codec, h.fragments.clone()))
                }
                None => {
                    let why = "pixels in fragments, where the transfer syntax has none";
                    Err(FormatError::field(&h.file, "pixels", "encapsulated", why))
                }
            },
        }
    }

    /// The first and last value of padding, as the tidied samples have it: the elements' own VR
    /// does not tell the sign, and some writers leave it away.
    pub fn padding(&self, h: &Head) -> Option<[f64; 2]> {
        let sample = |element| {
            let raw = h.int(0x0028, element)?;
            let signed = matches!(self.kind, SampleType::I8 | SampleType::I16 | SampleType::I32);
            let wide = 1i64 << self.bits;
            let low = raw.rem_euclid(wide);
            Some(if signed && 2 * low >= wide { low - wide } else { low } as f64)
        };
        let value = sample(0x0120)?;
        let limit = sample(0x0121).unwrap_or(value);
        Some([value.min(limit), value.max(limit)])
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
        let is_computed = self.rescale_differs() || self.upright.is_some();
        if is_computed { SampleType::F32 } else { self.stored.kind }
    }

    /// Most memory that [`read`] takes beside the samples, bytes: a frame a thread while it is
    /// decoded, or the slices as they are stored and in real values while they are resampled.
    pub fn reading_bytes(&self) -> u64 {
        let [columns, rows] = match &self.upright {
            Some(upright) => upright.stored,
            None => [self.grid.dims.x, self.grid.dims.y],
        };
        let side = u64::from(columns) * u64::from(rows);
        let threads = rayon::current_num_threads().min(self.slices.len()) as u64;
        let frame = |s: &Slice| match &s.pixels {
            SlicePixels::Compressed(codec, fragments) => {
                fragments_len(fragments) + codec::bytes_a_pixel(*codec) * side
            }
            _ => 0,
        };
        let decoded = threads * self.slices.iter().map(frame).max().unwrap_or(0);
        let all = side * self.slices.len() as u64;
        let stored = all * self.stored.kind.size() as u64;
        let resampled = match (&self.upright, self.rescale_differs()) {
            (Some(_), _) => stored + all * SampleType::F32.size() as u64,
            (None, true) => stored,
            (None, false) => 0,
        };
        decoded.max(resampled)
    }
}

/// Reads all slices straight into their place.
pub(super) fn read(path: &Path, stack: &Stack) -> Result<Volume, FormatError> {
    let side = match &stack.upright {
        Some(upright) => upright.stored,
        None => [stack.grid.dims.x, stack.grid.dims.y],
    };
    let pixels = side[0] as usize * side[1] as usize;
    let mut samples = zeroed(path, stack.stored.kind, pixels.saturating_mul(stack.slices.len()))?;
    // Frames of a deflated file are behind each other in one stream: it is inflated once.
    let mut deflated = BTreeMap::<&Path, Vec<(u64, &mut [u8])>>::new();
    let mut others = Vec::new();
    let places = samples.bytes_mut().chunks_exact_mut(pixels * stack.stored.kind.size());
    for (bytes, slice) in places.zip(&stack.slices) {
        match slice.pixels {
            SlicePixels::Deflated(at) => deflated.entry(&slice.file).or_default().push((at, bytes)),
            _ => others.push((bytes, slice)),
        }
    }
    let mut deflated: Vec<_> = deflated.into_iter().collect();
    deflated.par_iter_mut().try_for_each(|(file, frames)| read_deflated(file, frames))?;
    others.into_par_iter().try_for_each(|(bytes, slice)| {
        checkpoint();
        read_slice(bytes, slice, stack.stored.kind, side)
    })?;
    stack.stored.tidy(&mut samples);
    if let Some(upright) = &stack.upright {
        // The room of the box was not asked for yet.
        drop(zeroed(path, SampleType::F32, stack.grid.len())?);
        let rescale = stack.slices[0].rescale;
        let padding = stack.padding.map(|p| rescale.real(p[0]) as f32);
        let values = real_values(stack, &samples);
        drop(samples);
        let least = || values.iter().copied().fold(f32::INFINITY, f32::min);
        let outside = padding.unwrap_or_else(least);
        let samples = upright.sampled(&values, outside, padding);
        let padding = padding.map(|p| [f64::from(p); 2]);
        return Ok(Volume { padding, ..Volume::new(stack.grid, samples.into()) });
    }
    let samples = match stack.rescale_differs() {
        true => real_values(stack, &samples).into(),
        false => samples,
    };
    let mut volume = Volume::new(stack.grid, samples);
    volume.rescale = stack.shared_rescale();
    // Where slices have rescales of their own, padding has no one value.
    volume.padding = stack.padding.filter(|_| !stack.rescale_differs());
    Ok(volume)
}

/// The pixels of a slice as they are stored.
pub(super) fn read_slice(
    bytes: &mut [u8],
    slice: &Slice,
    kind: SampleType,
    [columns, rows]: [u32; 2],
) -> Result<(), FormatError> {
    match &slice.pixels {
        SlicePixels::Plain(offset) => {
            let mut source = DataFile::open_at(&slice.file, *offset)?;
            let io = |e| FormatError::io(&slice.file, e);
            let found = fill(&mut source, bytes).map_err(io)? as u64;
            let wanted = bytes.len() as u64;
            if found < wanted {
                let (file, what) = (slice.file.to_path_buf(), "pixels");
                return Err(FormatError::Truncated { file, what, wanted, found });
            }
        }
        SlicePixels::Deflated(offset) => {
            read_deflated(&slice.file, &mut [(*offset, bytes)])?;
        }
        SlicePixels::Compressed(codec, fragments) => {
            let bits_allocated = 8 * kind.size() as u32;
            let size = FrameSize { rows, columns, bits_allocated };
            let samples = decode(&slice.file, *codec, fragments, size)?;
            // As they would be stored: little endian, the lowest bits.
            for (to, sample) in bytes.chunks_exact_mut(kind.size()).zip(samples) {
                to.copy_from_slice(&sample.to_le_bytes()[..kind.size()]);
            }
        }
    }
    Ok(())
}

/// Fills each piece from its place in the inflated data set of a file.
fn read_deflated(file: &Path, pieces: &mut [(u64, &mut [u8])]) -> Result<(), FormatError> {
    pieces.sort_by_key(|piece| piece.0);
    let mut input = inflate(file)?;
    for (at, bytes) in pieces {
        crate::task::checkpoint();
        let read = input.skip_to(*at).and_then(|()| input.read_exact(bytes));
        let why = "they are cut off, or cannot be inflated";
        read.map_err(|_| FormatError::field(file, "pixels", "damaged", why))?;
    }
    Ok(())
}

fn fragments_len(fragments: &[Fragment]) -> u64 {
    fragments.iter().map(|f| u64::from(f.1)).sum()
}

/// The samples of a frame whose fragments lie in a file.
pub(super) fn decode(
    file: &Path,
    codec: Codec,
    fragments: &[Fragment],
    size: FrameSize,
) -> Result<Vec<i32>, FormatError> {
    let mut stream = Vec::new();
    for (offset, len) in fragments {
        let source = DataFile::open_at(file, *offset)?;
        let io = |e| FormatError::io(file, e);
        source.take(u64::from(*len)).read_to_end(&mut stream).map_err(io)?;
    }
    if let Some(feature) = codec::missing_feature(codec, &stream) {
        let what = format!("compressed pixels whose decoder is the feature `{feature}`");
        return Err(FormatError::unsupported(file, format!("{what}, which this build lacks")));
    }
    let damaged = |why| FormatError::field(file, "pixels", "damaged", why);
    codec::decode(codec, &stream, size).map_err(damaged)
}

/// Real values of all slices, each by its own rescale, as PET has them.
fn real_values(stack: &Stack, samples: &Samples) -> Vec<f32> {
    fn over<T: Sample>(s: &[T], slices: &[Slice]) -> Vec<f32> {
        let per = s.len() / slices.len();
        s.chunks_exact(per)
            .zip(slices)
            .flat_map(|(chunk, slice)| chunk.iter().map(|v| slice.rescale.real(v.to_f64()) as f32))
            .collect()
    }
    with_samples!(samples, |s| over(s, &stack.slices))
}
