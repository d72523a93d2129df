//! Files that appear whole or not at all: written beside their place, synced, renamed.

use std::collections::BTreeSet;
use std::fs::File;
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::Mutex;

use super::FormatError;
use crate::fault;

/// Temporary files that exist now: what an interrupted program must not leave behind.
static UNFINISHED: Mutex<BTreeSet<PathBuf>> = Mutex::new(BTreeSet::new());

/// Notes a temporary file until the note is dropped.
pub(super) struct Noted(PathBuf);

impl Noted {
    pub fn new(path: &Path) -> Self {
        if let Ok(mut all) = UNFINISHED.lock() {
            all.insert(path.to_owned());
        }
        Self(path.to_owned())
    }
}

impl Drop for Noted {
    fn drop(&mut self) {
        if let Ok(mut all) = UNFINISHED.lock() {
            all.remove(&self.0);
        }
    }
}

/// Removes every unfinished file; for a program about to be ended by Ctrl-C.
pub fn discard_unfinished() {
    if let Ok(all) = UNFINISHED.lock() {
        for path in all.iter() {
            let _ = std::fs::remove_file(path);
        }
    }
}

/// A file being written. It takes its name only at [`WholeFile::commit`]; dropped before that, it
/// leaves nothing behind.
pub struct WholeFile {
    path: PathBuf,
    out: BufWriter<Faulty>,
    temp: tempfile::TempPath,
    noted: Noted,
}

/// The file behind the buffer, where a full disk can be planted.
struct Faulty(File);

impl Write for Faulty {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        if fault::hit(fault::Point::Write) {
            return Err(io::Error::from(io::ErrorKind::StorageFull));
        }
        self.0.write(buf)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.0.flush()
    }
}

impl WholeFile {
    /// Starts a file that will stand at `path`.
    ///
    /// # Errors
    /// [`FormatError::Io`] if the folder cannot be written.
    pub fn create(path: &Path) -> Result<Self, FormatError> {
        let folder = match path.parent() {
            Some(p) if !p.as_os_str().is_empty() => p,
            _ => Path::new("."),
        };
        let (file, temp) = tempfile::Builder::new()
            .prefix(".intima-")
            .tempfile_in(folder)
            .map_err(|e| FormatError::io(path, e))?
            .into_parts();
        let out = BufWriter::with_capacity(1 << 18, Faulty(file));
        let noted = Noted::new(&temp);
        Ok(Self { path: path.to_owned(), out, temp, noted })
    }

    /// Syncs the bytes and gives the file its name.
    ///
    /// # Errors
    /// [`FormatError::Io`]; nothing is left behind then.
    pub fn commit(self) -> Result<(), FormatError> {
        let Self { path, out, temp, noted: _noted } = self;
        let finish = || -> io::Result<()> {
            let file = out.into_inner().map_err(|e| e.into_error())?.0;
            // Temporary files are private; an output has the mode any new file would have.
            #[cfg(unix)]
            {
                use std::os::unix::fs::PermissionsExt;
                file.set_permissions(std::fs::Permissions::from_mode(0o644))?;
            }
            file.sync_all()?;
            temp.persist(&path).map_err(|e| e.error)
        };
        finish().map_err(|e| FormatError::io(&path, e))
    }
}

impl Write for WholeFile {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        self.out.write(buf)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Writes a whole file through `fill`.
///
/// # Errors
/// [`FormatError::Io`], with nothing left behind.
pub fn write_whole(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), FormatError> {
    let mut file = WholeFile::create(path)?;
    fill(&mut file).map_err(|e| FormatError::io(path, e))?;
    file.commit()
}

/// Where what can be computed again is kept: `$XDG_CACHE_HOME/intima` or `~/.cache/intima`.
pub fn user_cache() -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    let base = set("XDG_CACHE_HOME").or_else(|| Some(set("HOME")?.join(".cache")))?;
    Some(base.join("intima"))
}
