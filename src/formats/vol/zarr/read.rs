//! Samples of a box of a Zarr array, chunk by chunk.

use std::collections::HashMap;
use std::io::{self, ErrorKind};
use std::ops::Range;
use std::path::{Path, PathBuf};

use rayon::prelude::*;

use super::ZarrImage;
use super::array::{Keys, Shard, ZarrArray};
use super::codec::ByteCodec;
use crate::formats::FormatError;
use crate::formats::vol::layout::zeroed;
use crate::formats::vol::source::{DataFile, fill, is_within_folder};
use crate::volume::Samples;

/// Bytes of decoded chunks that are held at a time, at least one a thread.
const BATCH: usize = 64 << 20;
/// Most bytes of samples that a stored byte stands for. A constant chunk of 64³ samples takes some
/// 20 bytes, and what equals the fill value takes no chunk.
const MAX_SPARSE: u64 = 1 << 18;
/// Bytes of an entry of a shard's index, and the value that marks an absent chunk.
const ENTRY: usize = 16;
const ABSENT: u64 = u64::MAX;

/// A chunk to be read: its file and place there, and its place in the array.
struct StoredChunk {
    file: PathBuf,
    /// Bytes of the file; the whole file where it is one chunk.
    bytes: Option<Range<u64>>,
    /// First index along each axis.
    first: Vec<u64>,
}

/// A chunk with its samples, as they are stored.
struct DecodedChunk {
    first: Vec<u64>,
    bytes: Vec<u8>,
}

impl ZarrArray {
    /// The file of a chunk or shard, by its numbers.
    fn file(&self, at: &[u64]) -> PathBuf {
        let Keys { prefix, separator } = self.keys;
        let mut key = prefix.to_owned();
        for n in at {
            if !key.is_empty() {
                key.push(separator);
            }
            key += &n.to_string();
        }
        self.dir.join(key)
    }

    /// Calls `each` with the numbers of all chunks of a shape that a box meets, in C order.
    fn chunks_in(
        shape: &[u64],
        boxed: &[Range<u64>],
        each: &mut dyn FnMut(&[u64]) -> Result<bool, FormatError>,
    ) -> Result<(), FormatError> {
        let ends = |(r, s): (&Range<u64>, &u64)| r.start / s..r.end.div_ceil(*s);
        let ranges: Vec<_> = boxed.iter().zip(shape).map(ends).collect();
        let mut at: Vec<u64> = ranges.iter().map(|r| r.start).collect();
        loop {
            if !each(&at)? {
                return Ok(());
            }
            let Some(axis) = (0..at.len()).rev().find(|k| at[*k] + 1 < ranges[*k].end) else {
                return Ok(());
            };
            at[axis] += 1;
            at[axis + 1..].iter_mut().zip(&ranges[axis + 1..]).for_each(|(n, r)| *n = r.start);
        }
    }

    /// The whole array as a box.
    fn whole(&self) -> Vec<Range<u64>> {
        self.shape.iter().map(|n| 0..*n).collect()
    }

    /// Every file of samples that is there.
    pub fn files(&self) -> Result<Vec<PathBuf>, FormatError> {
        let mut files = Vec::new();
        Self::chunks_in(&self.file_shape, &self.whole(), &mut |at| {
            files.extend(Some(self.file(at)).filter(|file| file.exists()));
            Ok(true)
        })?;
        Ok(files)
    }

    /// Holds the bytes that the shape promises against those of the files.
    pub fn check_size(&self, path: &Path) -> Result<(), FormatError> {
        let size = self.sample_type.size() as u64;
        let wanted = self.shape.iter().fold(size, |n, s| n.saturating_mul(*s));
        let mut found = 0u64;
        Self::chunks_in(&self.file_shape, &self.whole(), &mut |at| {
            found += std::fs::metadata(self.file(at)).map_or(0, |m| m.len());
            Ok(found.saturating_mul(MAX_SPARSE) < wanted)
        })?;
        if found.saturating_mul(MAX_SPARSE) >= wanted {
            return Ok(());
        }
        let (file, what) = (path.to_owned(), "samples in chunks");
        Err(FormatError::Truncated { file, what, wanted, found })
    }

    /// The chunks of a box that are stored.
    fn stored(&self, path: &Path, boxed: &[Range<u64>]) -> Result<Vec<StoredChunk>, FormatError> {
        let mut out = Vec::new();
        let mut indices: HashMap<PathBuf, Option<Vec<Range<u64>>>> = HashMap::new();
        let shape = &self.chunk.shape;
        let inner: Vec<u64> = self.file_shape.iter().zip(shape).map(|(f, c)| f / c).collect();
        Self::chunks_in(shape, boxed, &mut |at| {
            let first: Vec<u64> = at.iter().zip(shape).map(|(n, s)| n * s).collect();
            let numbers: Vec<u64> = at.iter().zip(&inner).map(|(n, i)| n / i).collect();
            let file = self.file(&numbers);
            let Some(shard) = &self.shard else {
                out.push(StoredChunk { file, bytes: None, first });
                return Ok(true);
            };
            if !indices.contains_key(&file) {
                let count = inner.iter().product::<u64>() as usize;
                let index = shard.read(&file, count).map_err(|e| named(path, e))?;
                indices.insert(file.clone(), index);
            }
            let place = at.iter().zip(&inner).fold(0, |p, (n, i)| p * i + n % i) as usize;
            let bytes = indices[&file].as_ref().map(|index| index[place].clone());
            if let Some(bytes) = bytes.filter(|b| b.start != ABSENT) {
                out.push(StoredChunk { file, bytes: Some(bytes), first });
            }
            Ok(true)
        })?;
        Ok(out)
    }

    /// The samples of a chunk; `None` where its file is not there.
    fn decoded(&self, stored: &StoredChunk) -> io::Result<Option<DecodedChunk>> {
        crate::task::checkpoint();
        let Some(bytes) = read_range(&stored.file, stored.bytes.clone())? else { return Ok(None) };
        let len = self.chunk.shape.iter().product::<u64>() as usize * self.sample_type.size();
        let bytes = ByteCodec::decode_all(&self.chunk.codecs, bytes, len)?;
        Ok(Some(DecodedChunk { first: stored.first.clone(), bytes }))
    }
}

impl Shard {
    /// Places of the chunks of a shard; `None` where its file is not there.
    fn read(&self, file: &Path, count: usize) -> io::Result<Option<Vec<Range<u64>>>> {
        let damaged = || io::Error::from(ErrorKind::InvalidData);
        let checks = self.codecs.iter().filter(|c| **c == ByteCodec::Crc32c).count();
        if checks != self.codecs.len() {
            return Err(io::Error::new(ErrorKind::Unsupported, "a compressed index of a shard"));
        }
        let len = (count * ENTRY + 4 * checks) as u64;
        let Ok(meta) = std::fs::metadata(file) else { return Ok(None) };
        let start = meta.len().checked_sub(len).ok_or_else(damaged)?;
        let start = if self.is_index_last { start } else { 0 };
        let Some(bytes) = read_range(file, Some(start..start + len))? else { return Ok(None) };
        let index = ByteCodec::decode_all(&self.codecs, bytes, count * ENTRY)?;
        let number = |b: &[u8]| b.iter().rev().fold(0u64, |n, b| n << 8 | u64::from(*b));
        let entry = |e: &[u8]| {
            let (at, n) = (number(&e[..8]), number(&e[8..]));
            let end = at.checked_add(n).filter(|end| *end <= meta.len());
            match (at, n) {
                (ABSENT, ABSENT) => Ok(ABSENT..ABSENT),
                _ => end.map(|end| at..end).ok_or_else(damaged),
            }
        };
        index.chunks_exact(ENTRY).map(entry).collect::<io::Result<_>>().map(Some)
    }
}

/// Bytes of a plain file; `None` where it is not there.
fn read_range(file: &Path, range: Option<Range<u64>>) -> io::Result<Option<Vec<u8>>> {
    let meta = match std::fs::symlink_metadata(file) {
        Ok(meta) => meta,
        Err(e) if e.kind() == ErrorKind::NotFound => return Ok(None),
        Err(e) => return Err(e),
    };
    if meta.is_symlink() && !is_within_folder(file, file) {
        return Err(io::Error::new(ErrorKind::Unsupported, "a chunk that is a link elsewhere"));
    }
    let open = |at| DataFile::open_at(file, at).map_err(|_| ErrorKind::Unsupported.into());
    let start = range.as_ref().map_or(0, |r| r.start);
    let mut source: DataFile = open(start).map_err(|e: io::Error| e)?;
    let len = range.map_or(source.len, |r| r.end - r.start);
    let mut bytes = vec![0; len as usize];
    let found = fill(&mut source, &mut bytes)?;
    if found < bytes.len() { Err(ErrorKind::UnexpectedEof.into()) } else { Ok(Some(bytes)) }
}

/// An error of a chunk as one of its array.
fn named(path: &Path, e: io::Error) -> FormatError {
    match e.kind() {
        ErrorKind::InvalidData | ErrorKind::InvalidInput => {
            FormatError::text(path, "a chunk", "damaged")
        }
        ErrorKind::UnexpectedEof => FormatError::text(path, "a chunk", "ends too soon"),
        ErrorKind::Unsupported => FormatError::unsupported(path, e.to_string()),
        _ => FormatError::io(path, e),
    }
}

impl ZarrImage {
    /// Most memory that reading takes beside the samples, bytes: chunks as they are decoded.
    pub fn reading_bytes(&self) -> u64 {
        let size = self.array.sample_type.size() as u64;
        let chunk = self.array.chunk.shape.iter().product::<u64>() * size;
        let batch = (BATCH as u64).max(chunk * rayon::current_num_threads() as u64);
        batch.min(self.grid.len() as u64 * size)
    }

    /// Samples of a box of voxels, x fastest.
    ///
    /// * `lo`, `hi`: first voxel, and the one behind the last.
    ///
    /// # Errors
    /// [`FormatError`] of a chunk that is damaged or cannot be read.
    pub fn read(&self, lo: [u32; 3], hi: [u32; 3]) -> Result<Samples, FormatError> {
        let array = &self.array;
        let mut boxed: Vec<Range<u64>> = array.shape.iter().map(|_| 0..1).collect();
        for k in 0..3 {
            boxed[self.axes[k]] = u64::from(lo[k])..u64::from(hi[k]);
        }
        let dims = [0, 1, 2].map(|k| (hi[k] - lo[k]) as usize);
        let mut samples = zeroed(&self.path, array.sample_type, dims.iter().product())?;
        if array.fill.iter().any(|b| *b != 0) {
            let size = array.fill.len();
            samples.bytes_mut().chunks_exact_mut(size).for_each(|s| s.copy_from_slice(&array.fill));
            if array.chunk.swap {
                samples.swap_bytes(); // turned back below, with what the chunks hold
            }
        }
        let stored = array.stored(&self.path, &boxed)?;
        let bytes = array.chunk.shape.iter().product::<u64>() as usize * array.sample_type.size();
        let batch = (BATCH / bytes.max(1)).max(rayon::current_num_threads());
        for stored in stored.chunks(batch) {
            let decoded = stored.par_iter().map(|s| array.decoded(s));
            let decoded: io::Result<Vec<_>> = decoded.filter_map(Result::transpose).collect();
            let decoded = decoded.map_err(|e| named(&self.path, e))?;
            self.place(&decoded, lo, dims, samples.bytes_mut());
        }
        if array.chunk.swap {
            samples.swap_bytes();
        }
        Ok(samples)
    }

    /// Copies chunks to their places in a box, slices side by side.
    fn place(&self, chunks: &[DecodedChunk], lo: [u32; 3], dims: [usize; 3], out: &mut [u8]) {
        let size = self.array.sample_type.size();
        let shape = &self.array.chunk.shape;
        // Bytes between neighbours along each axis of the array.
        let mut strides = vec![0usize; shape.len()];
        let mut stride = size;
        for axis in self.array.chunk.order.iter().rev() {
            strides[*axis] = stride;
            stride *= shape[*axis] as usize;
        }
        let [sx, sy, sz] = self.axes.map(|a| strides[a]);
        // Along axis k: range of the box that the chunk covers, and the chunk's first place there.
        let span = |chunk: &DecodedChunk, k: usize| {
            let first = chunk.first[self.axes[k]] as i64 - i64::from(lo[k]);
            let end = first + shape[self.axes[k]] as i64;
            (first.max(0) as usize..(end.max(0) as usize).min(dims[k]), first)
        };
        out.par_chunks_exact_mut(dims[0] * dims[1] * size).enumerate().for_each(|(z, slice)| {
            for chunk in chunks {
                let ((xs, x0), (ys, y0), (zs, z0)) =
                    (span(chunk, 0), span(chunk, 1), span(chunk, 2));
                if !zs.contains(&z) {
                    continue;
                }
                for y in ys {
                    let from = (z as i64 - z0) as usize * sz
                        + (y as i64 - y0) as usize * sy
                        + (xs.start as i64 - x0) as usize * sx;
                    let row = (y * dims[0] + xs.start) * size..(y * dims[0] + xs.end) * size;
                    copy_row(&chunk.bytes[from..], sx, size, &mut slice[row]);
                }
            }
        });
    }
}

/// Copies samples that lie `stride` bytes apart.
fn copy_row(from: &[u8], stride: usize, size: usize, out: &mut [u8]) {
    if stride == size {
        out.copy_from_slice(&from[..out.len()]);
        return;
    }
    for (i, out) in out.chunks_exact_mut(size).enumerate() {
        out.copy_from_slice(&from[i * stride..][..size]);
    }
}
