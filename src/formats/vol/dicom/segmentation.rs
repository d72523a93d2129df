//! Segmentations (DICOM SEG): frames that say of each pixel whether it belongs to a segment, or to
//! which (PS3.3 A.51). Slices without any segment are usually left away; they are empty.

use std::io::Read as _;
use std::path::Path;

use glam::{DMat3, DVec3};

use super::super::FormatError;
use super::super::affine::grid;
use super::super::layout::zeroed;
use super::super::segments::{chosen, overlapping};
use super::super::source::DataFile;
use super::codec::FrameSize;
use super::head::Head;
use super::pixels;
use super::stack::{plane, rounded_mm};
use super::syntax::{self, Codec};
use super::walk::{Pixels, inflate};
use crate::formats::error::FieldValue;
use crate::volume::{Grid, SampleType, Samples, Volume};

/// Most slices from the first to the last frame: a few frames could claim any number.
const MAX_SLICES: f64 = 8192.0;
/// Most voxels for each byte of the file: a frame has eight a byte, and between pieces of a segment
/// there are empty slices.
const MAX_GROWTH: u64 = 1024;
/// Largest miss of a frame's place against even steps, in steps.
const MAX_UNEVEN: f64 = 0.05;
/// Largest sideways drift of a frame, in pixels.
const MAX_DRIFT_PIXELS: f64 = 0.1;

/// Meaning of a pixel's value.
#[derive(Clone, Copy)]
enum SegmentCoding {
    /// One bit: whether it belongs to the frame's segment.
    Binary,
    /// Share of the pixel that belongs to the frame's segment, with the value that stands for all.
    Fractional(u16),
    /// The number of its segment.
    LabelMap,
}

/// A segmentation whose frames lie on a grid.
pub(super) struct Segmentation<'a> {
    pub grid: Grid,
    path: &'a Path,
    heads: &'a [Head],
    /// The slice of each frame.
    slices: Vec<usize>,
    coding: SegmentCoding,
    /// Bits of a pixel: 1, 8 or 16.
    bits: usize,
}

impl<'a> Segmentation<'a> {
    /// Judges the frames of a file.
    ///
    /// # Errors
    /// [`FormatError`] says what keeps them from being a label map.
    pub fn new(path: &'a Path, heads: &'a [Head]) -> Result<Self, FormatError> {
        let first = heads.first().ok_or_else(|| FormatError::unsupported(path, "no frames"))?;
        if heads.iter().any(|h| h.file != first.file) {
            let what = "several segmentations in one series; give the file of one";
            return Err(FormatError::unsupported(path, what));
        }
        let (coding, bits) = coding(first)?;
        let (grid, slices) = lattice(path, heads)?;
        let most = MAX_GROWTH * std::fs::metadata(&first.file).map_or(0, |m| m.len());
        if grid.len() as u64 > most {
            let what = format!("{} voxels, most of them in slices that are left away", grid.len());
            return Err(FormatError::unsupported(path, what));
        }
        Ok(Self { grid, path, heads, slices, coding, bits })
    }

    /// Type of the labels: one byte where the numbers of all segments fit.
    pub fn sample_type(&self) -> SampleType {
        let listed = self.heads[0].segments.iter().map(|s| s.label).max().unwrap_or(i64::MAX);
        let is_short = listed <= 255 && (self.bits < 16 || listed > 0);
        if is_short { SampleType::U8 } else { SampleType::U16 }
    }

    /// The label map: the number of each voxel's segment, or 1 in those with one of the names.
    pub fn read(&self, names: &[String]) -> Result<Volume, FormatError> {
        let chosen = chosen(self.path, &self.heads[0].segments, names)?;
        let mut chosen: Vec<i64> = chosen.iter().map(|s| s.label).collect();
        chosen.sort_unstable();
        let kind = if chosen.is_empty() { self.sample_type() } else { SampleType::U8 };
        let plain = self.plain_pixels()?;
        let mut samples = zeroed(self.path, kind, self.grid.len())?;
        match &mut samples {
            Samples::U16(out) => self.fill(out, plain.as_deref(), &chosen)?,
            Samples::U8(out) => self.fill(out, plain.as_deref(), &chosen)?,
            _ => {}
        }
        Ok(Volume::new(self.grid, samples))
    }

    fn fill<T>(
        &self,
        out: &mut [T],
        plain: Option<&[u8]>,
        chosen: &[i64],
    ) -> Result<(), FormatError>
    where
        T: Copy + Default + PartialEq + TryFrom<i64>,
    {
        let side = self.grid.dims.x as usize * self.grid.dims.y as usize;
        let mut pixels = vec![0u16; side];
        for (head, slice) in self.heads.iter().zip(&self.slices) {
            crate::task::checkpoint();
            let own = match self.coding {
                SegmentCoding::LabelMap => None,
                _ => Some(segment_of(head)?),
            };
            if own.is_some_and(|own| !chosen.is_empty() && chosen.binary_search(&own).is_err()) {
                continue;
            }
            self.frame(head, plain, &mut pixels)?;
            let out = &mut out[slice * side..][..side];
            for (to, pixel) in out.iter_mut().zip(&pixels) {
                let number = match (self.coding, own) {
                    (SegmentCoding::Fractional(most), Some(own))
                        if 2 * u32::from(*pixel) >= most.into() =>
                    {
                        own
                    }
                    (SegmentCoding::Binary, Some(own)) if *pixel > 0 => own,
                    (SegmentCoding::LabelMap, _) => i64::from(*pixel),
                    _ => 0,
                };
                let label = match chosen.is_empty() {
                    true => number,
                    false => i64::from(chosen.binary_search(&number).is_ok()),
                };
                if label == 0 {
                    continue;
                }
                let label = T::try_from(label).map_err(|_| {
                    let why = "a segment that the file does not list";
                    FormatError::field(&head.file, "segment number", label, why)
                })?;
                if *to != T::default() && *to != label {
                    return Err(overlapping(self.path, head.segments.len()));
                }
                *to = label;
            }
        }
        Ok(())
    }

    /// The bytes of all frames where they are not compressed.
    fn plain_pixels(&self) -> Result<Option<Vec<u8>>, FormatError> {
        let head = &self.heads[0];
        let side = self.grid.dims.x as usize * self.grid.dims.y as usize;
        let Some(Pixels::Plain { offset, len }) = head.pixels.as_deref() else { return Ok(None) };
        let bits = (side as u64).saturating_mul(self.bits as u64);
        let wanted = bits.saturating_mul(self.heads.len() as u64).div_ceil(8);
        let cut = |found| {
            let (file, what) = (head.file.to_path_buf(), "pixels");
            FormatError::Truncated { file, what, wanted, found }
        };
        if *len < wanted {
            return Err(cut(*len));
        }
        let mut bytes = Vec::new();
        if *head.syntax == *syntax::DEFLATED {
            let mut all = inflate(&head.file)?;
            let own = all.skip_to(*offset).and_then(|()| all.take(wanted).read_to_end(&mut bytes));
            own.map_err(|_| cut(bytes.len() as u64))?;
        } else {
            let source = DataFile::open_at(&head.file, *offset)?;
            let io = |e| FormatError::io(&head.file, e);
            source.take(wanted).read_to_end(&mut bytes).map_err(io)?;
        }
        match bytes.len() as u64 == wanted {
            true => Ok(Some(bytes)),
            false => Err(cut(bytes.len() as u64)),
        }
    }

    /// The pixels of a frame as they are stored.
    fn frame(&self, head: &Head, plain: Option<&[u8]>, out: &mut [u16]) -> Result<(), FormatError> {
        let first = head.frame * out.len();
        match (plain, self.bits) {
            // Bits run on from frame to frame, the lowest of a byte first.
            (Some(bytes), 1) => {
                for (i, to) in (first..).zip(out) {
                    *to = u16::from(bytes[i / 8] >> (i % 8) & 1);
                }
            }
            (Some(bytes), 8) => {
                out.iter_mut().zip(&bytes[first..]).for_each(|(to, b)| *to = u16::from(*b));
            }
            (Some(bytes), _) => {
                let word = match *head.syntax == *syntax::EXPLICIT_BIG {
                    true => u16::from_be_bytes,
                    false => u16::from_le_bytes,
                };
                let words = bytes[2 * first..].chunks_exact(2);
                out.iter_mut().zip(words).for_each(|(to, b)| *to = word([b[0], b[1]]));
            }
            (None, bits) => {
                let codec = Codec::of(&head.syntax).filter(|_| bits > 1).ok_or_else(|| {
                    let name = syntax::describe(&head.syntax);
                    let what = format!("{bits}-bit compressed pixels, transfer syntax {name}");
                    FormatError::unsupported(&head.file, what)
                })?;
                let (rows, columns) = (head.rows, head.columns);
                let size = FrameSize { rows, columns, bits_allocated: bits as u32 };
                let samples = pixels::decode(&head.file, codec, &head.fragments, size)?;
                out.iter_mut().zip(samples).for_each(|(to, s)| *to = s as u16);
            }
        }
        Ok(())
    }
}

/// Returns the coding of the pixels, and the bits of each.
fn coding(h: &Head) -> Result<(SegmentCoding, usize), FormatError> {
    let refuse = |what: String| Err(FormatError::unsupported(&h.file, what));
    let kind = h.text(0x0062, 0x0001);
    let bits = h.int(0x0028, 0x0100).unwrap_or(0);
    if h.int(0x0028, 0x0002).unwrap_or(1) != 1 {
        return refuse("a segmentation with several samples a pixel".into());
    }
    match (kind.as_str(), bits) {
        ("BINARY", 1) => Ok((SegmentCoding::Binary, 1)),
        ("FRACTIONAL", 8) => {
            let most = h.int(0x0062, 0x000e).and_then(|n| u16::try_from(n).ok());
            Ok((SegmentCoding::Fractional(most.unwrap_or(255).max(1)), 8))
        }
        ("LABELMAP", 8 | 16) => Ok((SegmentCoding::LabelMap, bits as usize)),
        ("BINARY" | "FRACTIONAL" | "LABELMAP", bits) => {
            refuse(format!("a segmentation of {bits} bits a pixel"))
        }
        _ => refuse("a segmentation that is neither binary, fractional nor a label map".into()),
    }
}

/// The segment of a frame.
fn segment_of(h: &Head) -> Result<i64, FormatError> {
    let absent = || {
        let name = format!("ReferencedSegmentNumber of frame {}", h.frame + 1);
        FormatError::field(&h.file, name, "absent", "needed")
    };
    h.int(0x0062, 0x000b).filter(|n| *n > 0).ok_or_else(absent)
}

/// The grid on which all frames lie, and the slice of each.
fn lattice(path: &Path, heads: &[Head]) -> Result<(Grid, Vec<usize>), FormatError> {
    let first = &heads[0];
    let own = plane(first)?;
    let normal = own.normal();
    let mut positions = Vec::with_capacity(heads.len());
    for h in heads {
        let name = "ImagePositionPatient";
        let missing = || FormatError::field(&h.file, name, "absent", "needed");
        let position: [f64; 3] = h.decimals(0x0020, 0x0032, name)?.ok_or_else(missing)?;
        let other = plane(h)?;
        let turned = (other.along_row - own.along_row).length()
            + (other.along_column - own.along_column).length();
        if turned > 2e-3 {
            let what = "frames of several orientations in one segmentation";
            return Err(FormatError::unsupported(&h.file, what));
        }
        positions.push(DVec3::from(position));
    }
    let places: Vec<f64> = positions.iter().map(|p| p.dot(normal)).collect();
    let lowest = (0..places.len()).min_by(|a, b| places[*a].total_cmp(&places[*b])).unwrap_or(0);
    let origin = positions[lowest];
    let mm = step(first, &places)?;
    let mut slices = Vec::with_capacity(heads.len());
    for ((h, p), place) in heads.iter().zip(&positions).zip(&places) {
        let at = (place - places[lowest]) / mm;
        let run = *p - origin;
        let drift = (run - normal * run.dot(normal)).length();
        if (at - at.round()).abs() > MAX_UNEVEN || drift > MAX_DRIFT_PIXELS * own.pixel_mm[0] {
            let value = FieldValue::numbers(&p.to_array());
            let why = format!("the frames of a segmentation lie {mm:.3} mm apart, in line");
            return Err(FormatError::field(&h.file, "ImagePositionPatient", value, why));
        }
        if at > MAX_SLICES {
            let why = format!("more than {MAX_SLICES} slices from the first frame");
            return Err(FormatError::field(&h.file, "ImagePositionPatient", at, why));
        }
        slices.push(at.round() as usize);
    }
    let depth = slices.iter().max().map_or(1, |k| k + 1);
    let dims = [u64::from(first.columns), u64::from(first.rows), depth as u64];
    let spacing = DVec3::new(own.pixel_mm[0], own.pixel_mm[1], mm);
    let axes = DMat3::from_cols(own.along_row, own.along_column, normal);
    Ok((grid(path, dims, spacing, origin, axes)?, slices))
}

/// The step between slices: as the file says if its frames agree, else about the smallest between
/// two of them; the mean over all frames, as their places are rounded decimals.
fn step(first: &Head, places: &[f64]) -> Result<f64, FormatError> {
    let mm = |element, name| -> Result<Option<f64>, FormatError> {
        let value = first.decimals::<1>(0x0018, element, name)?.map(|[mm]| mm);
        Ok(value.filter(|mm| *mm > 1e-3))
    };
    let mut sorted = places.to_vec();
    sorted.sort_by(f64::total_cmp);
    let steps = sorted.windows(2).map(|w| w[1] - w[0]);
    let least = steps.filter(|s| *s > 1e-3).reduce(f64::min);
    let said = mm(0x0088, "SpacingBetweenSlices")?;
    let even = |mm: &f64| {
        let off = |p: &f64| ((p - sorted[0]) / mm - ((p - sorted[0]) / mm).round()).abs();
        sorted.iter().all(|p| off(p) <= MAX_UNEVEN)
    };
    let thickness = mm(0x0050, "SliceThickness")?;
    let about = said.filter(even).or(least).or(said).or(thickness).unwrap_or(1.0);
    let run = sorted[sorted.len() - 1] - sorted[0];
    let mean = run / (run / about).round();
    Ok(if mean.is_finite() { rounded_mm(mean) } else { about })
}
