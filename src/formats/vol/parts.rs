//! A volume that is read in parts: any box of voxels, without the rest.

use std::io::{Seek, SeekFrom};
use std::path::Path;

use glam::UVec3;

use super::layout::{Encoding, Layout, zeroed};
use super::source::fill;
use super::zarr::ZarrImage;
use super::{FileKind, FormatError, ReadOptions, kind, layout_of, warn};
use crate::volume::{Grid, Rescale, SampleType, Samples, canonical_samples};

/// A volume on disk of which any box can be read: OME-Zarr, and uncompressed NRRD, MetaImage and
/// NIfTI.
pub struct VolumeParts {
    grid: Grid,
    sample_type: SampleType,
    rescale: Rescale,
    format: &'static str,
    notes: Vec<String>,
    source: PartSource,
}

enum PartSource {
    Zarr(Box<ZarrImage>),
    /// Layout of raw samples, and the offset of the first one.
    Raw(Box<Layout>, u64),
}

impl VolumeParts {
    /// Opens a volume; `None` where its format has to be read as a whole.
    ///
    /// # Errors
    /// As [`super::read_volume`], save what only the samples can show.
    pub fn open(path: &Path, options: &ReadOptions) -> Result<Option<Self>, FormatError> {
        if !options.segments.is_empty() {
            return Ok(None);
        }
        match kind(path)? {
            FileKind::Dicom => Ok(None),
            FileKind::Zarr => {
                let image = ZarrImage::open(path)?;
                Ok(Some(Self {
                    grid: image.grid,
                    sample_type: image.sample_type(),
                    rescale: Rescale::IDENTITY,
                    format: image.format,
                    notes: image.notes.clone(),
                    source: PartSource::Zarr(Box::new(image)),
                }))
            }
            k => {
                let layout = layout_of(path, k, options.volume)?;
                if layout.encoding != Encoding::Raw || layout.layers != 1 {
                    return Ok(None);
                }
                let offset = layout.open()?.stream_position();
                let offset = offset.map_err(|e| FormatError::io(path, e))?;
                Ok(Some(Self {
                    grid: layout.grid,
                    sample_type: layout.sample_type,
                    rescale: layout.rescale,
                    format: layout.format,
                    notes: layout.notes.clone(),
                    source: PartSource::Raw(Box::new(layout), offset),
                }))
            }
        }
    }

    /// Returns the same volume with the axes nearest to left, posterior and superior.
    #[must_use]
    pub fn canonical(mut self) -> Self {
        self.grid = self.grid.canonical();
        self
    }

    /// Says what was assumed of the file, as reading it whole does.
    pub fn warn(&self) {
        warn(self.format, &self.notes);
    }

    /// Grid of the whole volume.
    pub fn grid(&self) -> &Grid {
        &self.grid
    }

    /// Stored type of the samples.
    pub fn sample_type(&self) -> SampleType {
        self.sample_type
    }

    /// Map from stored to real values.
    pub fn rescale(&self) -> Rescale {
        self.rescale
    }

    /// Bytes of all samples.
    pub fn bytes(&self) -> u64 {
        self.grid.len() as u64 * self.sample_type.size() as u64
    }

    /// Most memory that reading takes beside the samples, bytes.
    pub fn reading_bytes(&self) -> u64 {
        match &self.source {
            PartSource::Zarr(image) => image.reading_bytes(),
            PartSource::Raw(..) => 0,
        }
    }

    /// Shape of the boxes, from the first voxel on, that cost least to read: chunks, or rows.
    pub fn block(&self) -> UVec3 {
        match &self.source {
            PartSource::Zarr(image) => self.grid.order.canonical(image.block()).into(),
            PartSource::Raw(..) => {
                let dims = self.grid.as_stored().dims;
                let block = UVec3::new(dims.x, 8, 8).min(dims);
                self.grid.order.canonical(block.to_array()).into()
            }
        }
    }

    /// Samples of a box, x fastest.
    ///
    /// * `lo`, `hi`: first voxel, and the one behind the last.
    ///
    /// # Errors
    /// [`FormatError`] of a file that is damaged, cut short since it was opened, or unreadable.
    ///
    /// # Panics
    /// If the box is empty or not in the grid.
    pub fn read(&self, lo: UVec3, hi: UVec3) -> Result<Samples, FormatError> {
        assert!(lo.cmplt(hi).all() && hi.cmple(self.grid.dims).all(), "a box of the grid");
        // The same box in the file.
        let stored = |v: UVec3| self.grid.stored_voxel(v.as_ivec3());
        let (a, b) = (stored(lo), stored(hi - 1));
        let (first, end) = (a.min(b).as_uvec3(), (a.max(b) + 1).as_uvec3());
        let samples = match &self.source {
            PartSource::Zarr(image) => image.read(first.to_array(), end.to_array())?,
            PartSource::Raw(layout, offset) => read_raw(layout, *offset, first, end)?,
        };
        Ok(canonical_samples(samples, hi - lo, self.grid.order))
    }
}

/// Reads a box of raw samples, in pieces that lie together in the file.
fn read_raw(layout: &Layout, offset: u64, lo: UVec3, hi: UVec3) -> Result<Samples, FormatError> {
    let (dims, size) = (layout.grid.dims, layout.sample_type.size());
    let extent = (hi - lo).as_usizevec3();
    let mut samples = zeroed(&layout.path, layout.sample_type, extent.element_product())?;
    let io = |e| FormatError::io(&layout.path, e);
    let mut file = layout.open()?;
    // Whole rows follow each other, and so do whole slices.
    let (wide, high) = (hi.x - lo.x == dims.x, hi.y - lo.y == dims.y);
    let rows = if wide { extent.y } else { 1 };
    let slices = if wide && high { extent.z } else { 1 };
    let piece = (extent.x * rows * slices * size).max(1);
    for (i, out) in samples.bytes_mut().chunks_mut(piece).enumerate() {
        let row = i * rows * slices;
        let (y, z) = (row % extent.y, row / extent.y);
        let v = lo + UVec3::new(0, y as u32, z as u32);
        file.seek(SeekFrom::Start(offset + (layout.grid.index(v) * size) as u64)).map_err(io)?;
        let found = fill(&mut file, out).map_err(io)?;
        if found < out.len() {
            let (file, what) = (layout.path.clone(), "samples");
            let (wanted, found) = (out.len() as u64, found as u64);
            return Err(FormatError::Truncated { file, what, wanted, found });
        }
    }
    if layout.swap {
        samples.swap_bytes();
    }
    Ok(samples)
}
