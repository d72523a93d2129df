//! Layout of a volume's samples in a file, checked and then read in one pass.

use std::collections::TryReserveError;
use std::io::{self, BufRead, BufReader, Read, Seek};
use std::path::{Path, PathBuf};
use std::str::FromStr;

use flate2::bufread::{MultiGzDecoder, ZlibDecoder};
use rayon::prelude::*;

use super::FormatError;
use super::info::SegmentInfo;
use super::source::{DataFile, fill};
use crate::task::checkpoint;
use crate::volume::{
    Grid, Rescale, Sample, SampleBuffer, SampleType, Samples, Volume, with_samples,
};

/// Bytes of raw samples that are read by one thread at a time.
const RAW_PART: usize = 4 << 20;

/// Encoding of the stored samples.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Encoding {
    Raw,
    Gzip,
    Zlib,
    Ascii,
}

/// A header's whole promise: geometry, type, and where the bytes are.
#[derive(Debug)]
pub(super) struct Layout {
    pub format: &'static str,
    pub grid: Grid,
    pub sample_type: SampleType,
    /// Samples of a voxel, one after the other: the layers of a segmentation; else 1.
    pub layers: usize,
    /// Number of volumes, one after the other.
    pub volumes: usize,
    /// Named segments; empty where the file names none.
    pub segments: Vec<SegmentInfo>,
    pub rescale: Rescale,
    /// Path for errors: the file that was asked for. A header's name of its data file is text.
    pub path: PathBuf,
    /// The file that holds the samples.
    pub file: PathBuf,
    /// First byte of the (encoded) samples in that file; `None` if they end with the file.
    pub offset: Option<u64>,
    /// Decoded bytes to pass over before the first sample.
    pub skip: u64,
    pub encoding: Encoding,
    /// Whether the file's byte order is not this machine's.
    pub swap: bool,
    /// Assumptions of the reader.
    pub notes: Vec<String>,
}

/// Deflate stands for at most 258 bytes by two bits (RFC 1951, 3.2.5): no stream shrinks by more.
pub(in crate::formats) const MAX_SHRINK: u64 = 1032;
/// Bytes of samples that memory is taken for before a compressed stream has given any. Beyond that
/// and twice the stream's own length, memory grows as samples arrive: never past twice what came.
const FIRST_BYTES: u64 = 4 << 20;
/// Bytes that are cleared and then decoded into at a time; few enough to stay in the cache.
const STEP_BYTES: usize = 1 << 20;

impl Layout {
    /// Samples of all layers.
    fn len(&self) -> usize {
        self.grid.len().saturating_mul(self.layers)
    }

    /// Bytes of all samples once decoded.
    fn promised(&self) -> u64 {
        (self.len() as u64).saturating_mul(self.sample_type.size() as u64)
    }

    /// Words for the choice of one of several volumes.
    pub fn choice(&self) -> String {
        let n = self.volumes;
        format!("{n} volumes one after the other; --volume 0 to {} takes one", n - 1)
    }

    /// The layout of one of the volumes.
    ///
    /// # Errors
    /// [`FormatError::Unsupported`] where one has to be chosen, [`FormatError::Field`] for one that is
    /// not there.
    pub fn at_volume(mut self, volume: Option<usize>) -> Result<Self, FormatError> {
        let Some(volume) = volume.or((self.volumes == 1).then_some(0)) else {
            return Err(FormatError::unsupported(&self.path, self.choice()));
        };
        if volume >= self.volumes {
            let why = format!("the file holds {}, counted from 0", self.volumes);
            return Err(FormatError::field(&self.path, "volume", volume, why));
        }
        let before = self.promised().saturating_mul(volume as u64);
        match (self.encoding, self.offset) {
            _ if self.volumes == 1 => {}
            (Encoding::Ascii, _) => {
                let what = "several volumes as text";
                return Err(FormatError::unsupported(&self.path, what));
            }
            (Encoding::Raw, Some(offset)) => self.offset = Some(offset.saturating_add(before)),
            // They end with the file.
            (Encoding::Raw, None) => {
                let after = self.promised().saturating_mul((self.volumes - volume) as u64);
                self.offset = Some(DataFile::open(&self.file)?.len.saturating_sub(after));
            }
            _ => self.skip = self.skip.saturating_add(before),
        }
        Ok(self)
    }

    /// Opens the samples' file at their first byte, after holding the promise against its size.
    pub fn open(&self) -> Result<DataFile, FormatError> {
        let len = DataFile::open(&self.file)?.len;
        let wanted = self.promised();
        let offset = self.offset.unwrap_or(len.saturating_sub(wanted));
        let found = len.saturating_sub(offset);
        let (fits, what) = match self.encoding {
            Encoding::Raw => (found >= wanted, "samples"),
            // A digit and a blank each, the last blank missing.
            Encoding::Ascii => (found / 2 + 1 >= self.len() as u64, "samples"),
            Encoding::Gzip | Encoding::Zlib => {
                let most = found.saturating_mul(MAX_SHRINK);
                (most >= wanted.saturating_add(self.skip), "compressed samples")
            }
        };
        if !fits {
            return Err(FormatError::Truncated { file: self.path.clone(), what, wanted, found });
        }
        DataFile::open_at(&self.file, offset)
    }

    /// Reads the one layer of a volume straight into its final place.
    pub fn load(self) -> Result<Volume, FormatError> {
        let mut volume = Volume::new(self.grid, self.samples()?);
        volume.rescale = self.rescale;
        Ok(volume)
    }

    /// Reads the samples of all layers.
    pub fn samples(&self) -> Result<Samples, FormatError> {
        let source = self.open()?;
        let packed = source.len;
        let mut samples = match self.encoding {
            Encoding::Raw => self.read_raw(source)?,
            Encoding::Gzip => self.decode(MultiGzDecoder::new(buffered(source)), packed)?,
            Encoding::Zlib => self.decode(ZlibDecoder::new(buffered(source)), packed)?,
            Encoding::Ascii => self.read_ascii(source)?,
        };
        if self.swap && self.encoding != Encoding::Ascii {
            samples.swap_bytes();
        }
        Ok(samples)
    }

    /// Samples as they lie in the file. It is long enough for them, so they are allocated at once,
    /// and read in parts side by side: most of the time goes into fresh pages of memory.
    fn read_raw(&self, mut source: DataFile) -> Result<Samples, FormatError> {
        let mut samples = zeroed(&self.path, self.sample_type, self.len())?;
        let start = source.stream_position().map_err(|e| self.decode_error(e))?;
        let parts = samples.bytes_mut().par_chunks_mut(RAW_PART).enumerate();
        let found: Vec<(usize, usize)> = parts
            .map(|(i, part)| {
                checkpoint();
                let at = start + (i * RAW_PART) as u64;
                let found = fill(&mut ReadAt { source: &source, at }, part)?;
                Ok((found, part.len()))
            })
            .collect::<io::Result<_>>()
            .map_err(|e| self.decode_error(e))?;
        // Bytes are counted up to the end of the first part that ends early.
        let whole = found.iter().take_while(|(found, len)| found == len).count();
        match found.get(whole) {
            Some((some, _)) => Err(self.truncated("samples", (whole * RAW_PART + some) as u64)),
            None => Ok(samples),
        }
    }

    /// Samples of a compressed stream in a file of `packed` bytes.
    fn decode(&self, mut input: impl Read, packed: u64) -> Result<Samples, FormatError> {
        let fail = |e| self.decode_error(e);
        let passed = io::copy(&mut (&mut input).take(self.skip), &mut io::sink());
        let passed = match passed {
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => 0,
            other => other.map_err(fail)?,
        };
        if passed < self.skip {
            return Err(self.truncated("samples", 0));
        }
        let first = FIRST_BYTES.saturating_add(packed.saturating_mul(2));
        let mut samples = Samples::zeroed(self.sample_type, 0);
        let len = self.len();
        let found = with_samples!(&mut samples, |s| fill_growing(&mut input, s, len, first)
            .map_err(fail)?);
        if found < self.promised() {
            return Err(self.truncated("samples", found));
        }
        // The checksum stands behind the last byte and is only looked at on reading on.
        match input.read(&mut [0u8]) {
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => {
                Err(self.truncated("samples with their checksum", found))
            }
            other => other.map(|_| samples).map_err(fail),
        }
    }

    fn truncated(&self, what: &'static str, found: u64) -> FormatError {
        FormatError::Truncated { file: self.path.clone(), what, wanted: self.promised(), found }
    }

    fn read_ascii(&self, source: DataFile) -> Result<Samples, FormatError> {
        let mut samples = zeroed(&self.path, self.sample_type, self.len())?;
        with_samples!(&mut samples, |s| parse_all(&self.path, buffered(source), s))?;
        Ok(samples)
    }

    /// A decoder's complaint is about the file; anything else is the system's.
    fn decode_error(&self, e: io::Error) -> FormatError {
        match e.kind() {
            io::ErrorKind::InvalidInput | io::ErrorKind::InvalidData => {
                FormatError::text(&self.path, "sample data", "damaged")
            }
            _ => FormatError::io(&self.path, e),
        }
    }
}

/// Fills `out` with `len` samples, its memory growing as they arrive from `first` bytes on; the
/// number of bytes read.
fn fill_growing<T: Sample>(
    input: &mut dyn Read,
    out: &mut SampleBuffer<T>,
    len: usize,
    first: u64,
) -> io::Result<u64> {
    let size = size_of::<T>();
    let no_room = |e: TryReserveError| io::Error::new(io::ErrorKind::OutOfMemory, e);
    let mut samples = Vec::<T>::new();
    let mut room = usize::try_from(first).map_or(len, |bytes| len.min(bytes / size));
    while samples.len() < len {
        samples.try_reserve_exact(room - samples.len()).map_err(no_room)?;
        while samples.len() < room {
            checkpoint();
            let from = samples.len();
            samples.resize(room.min(from + STEP_BYTES / size), T::zeroed());
            let step = bytemuck::cast_slice_mut(&mut samples[from..]);
            let found = fill(input, step)?;
            if found < step.len() {
                return Ok((from * size + found) as u64);
            }
        }
        room = len.min(room.saturating_mul(2));
    }
    *out = samples.into();
    Ok((len * size) as u64)
}

/// Reading of a file from an offset on.
struct ReadAt<'a> {
    source: &'a DataFile,
    at: u64,
}

impl Read for ReadAt<'_> {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        let found = self.source.read_at(buf, self.at)?;
        self.at += found as u64;
        Ok(found)
    }
}

fn buffered(source: DataFile) -> BufReader<DataFile> {
    BufReader::with_capacity(1 << 18, source)
}

/// Numbers between blanks, commas and line ends, as many as `out` holds; read as they come, so that
/// no text of the file is kept.
fn parse_all<T: FromStr>(
    path: &Path,
    input: impl BufRead,
    out: &mut [T],
) -> Result<(), FormatError> {
    /// No number is longer.
    const MAX_DIGITS: usize = 64;
    let (mut token, mut found) = (Vec::with_capacity(MAX_DIGITS), 0);
    let wanted = out.len();
    let bad = |i: usize| FormatError::text(path, format!("sample {i}"), "no number of this type");
    let ends = |b: u8| b" \t\n\r,".contains(&b);
    for byte in input.bytes().chain([Ok(b'\n')]) {
        let byte = byte.map_err(|e| FormatError::io(path, e))?;
        if !ends(byte) {
            if token.len() == MAX_DIGITS {
                return Err(bad(found));
            }
            token.push(byte);
        } else if !token.is_empty() {
            let value = std::str::from_utf8(&token).ok().and_then(|t| t.parse().ok());
            out[found] = value.ok_or_else(|| bad(found))?;
            found += 1;
            if found == wanted {
                return Ok(());
            }
            token.clear();
        }
    }
    if found < wanted {
        let (file, what) = (path.to_owned(), "sample numbers");
        let (wanted, found) = (wanted as u64, found as u64);
        return Err(FormatError::Truncated { file, what, wanted, found });
    }
    Ok(())
}

/// Zeroed samples, or an error where the memory is not to be had. The pages are taken as they are
/// written to, so a file that ends early costs little.
pub(super) fn zeroed(file: &Path, t: SampleType, len: usize) -> Result<Samples, FormatError> {
    let mut probe = Vec::<u8>::new();
    let bytes = len.saturating_mul(t.size());
    if probe.try_reserve_exact(bytes).is_err() {
        let why = format!("{bytes} bytes of memory for the samples");
        return Err(FormatError::io(file, io::Error::new(io::ErrorKind::OutOfMemory, why)));
    }
    drop(probe);
    Ok(Samples::zeroed(t, len))
}

/// Whether data of this byte order must be swapped here.
pub(super) fn must_swap(big_endian: bool) -> bool {
    big_endian != cfg!(target_endian = "big")
}
