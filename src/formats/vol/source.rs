//! Opening and reading input files.

use std::fs::File;
use std::io::{self, Read, Seek, SeekFrom};
use std::path::{Component, Path, PathBuf};

use super::FormatError;
use crate::fault;

/// An open regular file and its size. Reading can be made to end early by a planted fault.
pub(super) struct DataFile {
    file: File,
    /// Size in bytes when opened.
    pub len: u64,
}

impl DataFile {
    /// Opens a regular file.
    pub fn open(path: &Path) -> Result<Self, FormatError> {
        let file = open_plain(path)?;
        let len = file.metadata().map_err(|e| FormatError::io(path, e))?.len();
        Ok(Self { file, len })
    }

    /// Reads at an offset, whatever was read before: from several threads at once.
    pub fn read_at(&self, buf: &mut [u8], at: u64) -> io::Result<usize> {
        if fault::hit(fault::Point::Read) {
            return Ok(0);
        }
        #[cfg(unix)]
        return std::os::unix::fs::FileExt::read_at(&self.file, buf, at);
        #[cfg(windows)]
        return std::os::windows::fs::FileExt::seek_read(&self.file, buf, at);
    }

    /// Opens at an offset.
    pub fn open_at(path: &Path, offset: u64) -> Result<Self, FormatError> {
        let mut source = Self::open(path)?;
        source.seek(SeekFrom::Start(offset)).map_err(|e| FormatError::io(path, e))?;
        Ok(source)
    }
}

impl Read for DataFile {
    fn read(&mut self, buf: &mut [u8]) -> io::Result<usize> {
        if fault::hit(fault::Point::Read) {
            return Ok(0);
        }
        self.file.read(buf)
    }
}

impl Seek for DataFile {
    fn seek(&mut self, to: SeekFrom) -> io::Result<u64> {
        self.file.seek(to)
    }
}

/// Opens a regular file to read: a pipe would block, and a device has no end.
///
/// # Errors
/// [`FormatError`]: it is not there, cannot be read, or is something else.
pub fn open_plain(path: &Path) -> Result<File, FormatError> {
    let io = |e| FormatError::io(path, e);
    if !std::fs::metadata(path).map_err(io)?.is_file() {
        return Err(FormatError::unsupported(path, "an input that is not a plain file"));
    }
    File::open(path).map_err(io)
}

/// The first bytes of a regular file, at most `most` of them.
///
/// # Errors
/// As [`open_plain`].
pub fn read_plain(path: &Path, most: u64) -> Result<Vec<u8>, FormatError> {
    let mut bytes = Vec::new();
    let file = open_plain(path)?;
    file.take(most).read_to_end(&mut bytes).map_err(|e| FormatError::io(path, e))?;
    Ok(bytes)
}

/// Reads the first bytes of a file through [`DataFile`], whose reading can be made to end early.
pub(super) fn prefix(path: &Path, most: u64) -> Result<Vec<u8>, FormatError> {
    let mut bytes = Vec::new();
    DataFile::open(path)?
        .take(most)
        .read_to_end(&mut bytes)
        .map_err(|e| FormatError::io(path, e))?;
    Ok(bytes)
}

/// Reads until `buf` is full or the input ends; the number of bytes read.
pub(super) fn fill(input: &mut dyn Read, buf: &mut [u8]) -> io::Result<usize> {
    /// Decoders are handed this much at a time: their counters may be 32 bits wide.
    const STEP: usize = 1 << 26;
    let mut done = 0;
    while done < buf.len() {
        let end = buf.len().min(done + STEP);
        match input.read(&mut buf[done..end]) {
            Ok(0) => break,
            Ok(n) => done += n,
            Err(e) if e.kind() == io::ErrorKind::Interrupted => {}
            // A decoder's word for an input that ends too soon.
            Err(e) if e.kind() == io::ErrorKind::UnexpectedEof => break,
            Err(e) => return Err(e),
        }
    }
    Ok(done)
}

/// A data file named by a header. It must lie in the header's folder or below it: a header from
/// elsewhere shall not pick files of the reader's machine.
pub(super) fn sibling(header: &Path, field: &str, name: &str) -> Result<PathBuf, FormatError> {
    let relative = Path::new(name);
    let inside =
        relative.components().all(|c| matches!(c, Component::Normal(_) | Component::CurDir));
    if name.is_empty() || !inside {
        let why = "must be a relative path without `..`, inside the header's folder";
        return Err(FormatError::text(header, field, why));
    }
    let path = header.parent().unwrap_or(Path::new("")).join(relative);
    // Its name is text of the header, so it is the field that is named where it cannot be read.
    if !std::fs::metadata(&path).is_ok_and(|m| m.is_file()) {
        return Err(FormatError::text(header, field, "the file it names is not there"));
    }
    if !is_within_folder(header, &path) {
        let why = "the file it names is a link out of the header's folder";
        return Err(FormatError::text(header, field, why));
    }
    Ok(path)
}

/// Whether a file, all links followed, lies in the folder of a header or below it.
pub(super) fn is_within_folder(header: &Path, file: &Path) -> bool {
    let folder = header.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."));
    match (folder.canonicalize(), file.canonicalize()) {
        (Ok(folder), Ok(file)) => file.starts_with(folder),
        _ => false,
    }
}
