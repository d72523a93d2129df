//! Atomic files: a file is written under a temporary name beside its place, synced and renamed, so
//! that it appears complete or not at all.
//!
//! A temporary file is locked by the process that writes it (an advisory lock of the system, which
//! ends with the process however it ends). The first file that a process writes into a folder
//! removes temporary files there whose lock is free: what a killed run left behind.

use std::collections::BTreeSet;
use std::fs::{File, OpenOptions};
use std::io::{self, BufWriter, Write};
use std::path::{Path, PathBuf};
use std::sync::{Mutex, MutexGuard, PoisonError};

use tempfile::TempPath;

use super::{FormatError, video};
use crate::fault;

/// Temporary files are called `.intima-RANDOM.tmp`, with this many characters in between.
const PREFIX: &str = ".intima-";
const SUFFIX: &str = ".tmp";
const RANDOM: usize = 12;

/// Temporary files of this process, and the folders it has searched.
struct Unfinished {
    /// Temporary files that exist.
    files: BTreeSet<PathBuf>,
    /// Folders already searched for temporary files of killed runs.
    swept: BTreeSet<PathBuf>,
}

static UNFINISHED: Mutex<Unfinished> =
    Mutex::new(Unfinished { files: BTreeSet::new(), swept: BTreeSet::new() });

/// Held while a temporary file is made, renamed or removed.
fn unfinished() -> MutexGuard<'static, Unfinished> {
    UNFINISHED.lock().unwrap_or_else(PoisonError::into_inner)
}

/// Ends encoders and removes every unfinished file, for a program about to be ended by a signal.
/// From here on a thread that starts or finishes a file waits for ever, so that nothing new can
/// appear and no failure of that thread overtakes the exit code of the signal.
pub fn discard_unfinished() {
    // Encoders first: one that has just started would make its file anew.
    video::end_encoders();
    let all = unfinished();
    for path in &all.files {
        let _ = std::fs::remove_file(path);
    }
    std::mem::forget(all);
}

/// A temporary file beside the place of an output, removed when dropped.
pub(super) struct TemporaryFile {
    /// Holds the lock that tells other processes that the file is in use.
    file: File,
    path: Option<TempPath>,
}

impl TemporaryFile {
    /// Makes a file in the folder of `beside`, with the mode that the user's umask gives it.
    pub fn create(beside: &Path) -> io::Result<Self> {
        let folder = folder_of(beside);
        let mut all = unfinished();
        // Elsewhere a lock would keep the encoder of a video out of its own file.
        let locks = cfg!(unix);
        if locks && all.swept.insert(std::path::absolute(folder)?) {
            remove_abandoned(folder);
        }
        loop {
            let named = tempfile::Builder::new()
                .prefix(PREFIX)
                .suffix(SUFFIX)
                .rand_bytes(RANDOM)
                .make_in(folder, |p| {
                OpenOptions::new().read(true).write(true).create_new(true).open(p)
            })?;
            let (file, path) = named.into_parts();
            // Without locks on this file system nobody takes the file for abandoned.
            if locks {
                let _ = file.lock();
            }
            // Another process may have found it between its making and its lock.
            if path.exists() {
                all.files.insert(path.to_path_buf());
                return Ok(Self { file, path: Some(path) });
            }
        }
    }

    /// Returns the path of the temporary file; empty once renamed.
    pub fn path(&self) -> &Path {
        self.path.as_deref().unwrap_or(Path::new(""))
    }

    /// Gives it the name `to`; the caller holds [`unfinished`].
    fn rename(&mut self, to: &Path, all: &mut Unfinished) -> io::Result<()> {
        if fault::hit(fault::Point::Rename) {
            return Err(io::ErrorKind::ReadOnlyFilesystem.into());
        }
        let Some(path) = self.path.take() else { return Ok(()) };
        let name = path.to_path_buf();
        // What fails to be renamed is removed with the path that the error holds.
        let renamed = path.persist(to).map_err(|e| e.error);
        all.files.remove(&name);
        renamed
    }
}

impl Drop for TemporaryFile {
    fn drop(&mut self) {
        if let Some(path) = self.path.take() {
            let mut all = unfinished();
            all.files.remove(&*path);
            drop(path);
        }
    }
}

/// Removes temporary files of processes that are gone.
fn remove_abandoned(folder: &Path) {
    for (path, _locked) in abandoned(folder) {
        let _ = std::fs::remove_file(path);
    }
}

/// Temporary files of processes that are gone, each locked while its item lives. Only a lock that was
/// free shows that nobody writes any more; where locks are not to be had, there are none.
pub(super) fn abandoned(folder: &Path) -> impl Iterator<Item = (PathBuf, File)> {
    let entries = std::fs::read_dir(folder).into_iter().flatten().flatten();
    let ours = entries.filter(|entry| {
        let is_file = entry.file_type().is_ok_and(|t| t.is_file());
        is_file && entry.file_name().to_str().is_some_and(is_temporary)
    });
    ours.filter_map(|entry| {
        let file = OpenOptions::new().read(true).write(true).open(entry.path()).ok()?;
        file.try_lock().ok()?;
        Some((entry.path(), file))
    })
}

/// Whether a name is one that [`TemporaryFile::create`] gives.
fn is_temporary(name: &str) -> bool {
    let middle = name.strip_prefix(PREFIX).and_then(|n| n.strip_suffix(SUFFIX));
    middle.is_some_and(|m| m.len() == RANDOM && m.bytes().all(|b| b.is_ascii_alphanumeric()))
}

/// Folder of a file.
pub(super) fn folder_of(path: &Path) -> &Path {
    path.parent().filter(|p| !p.as_os_str().is_empty()).unwrap_or(Path::new("."))
}

/// Makes the names in a folder last through a loss of power.
fn sync_folder(path: &Path) -> io::Result<()> {
    if fault::hit(fault::Point::SyncFolder) {
        return Err(io::ErrorKind::StorageFull.into());
    }
    // Elsewhere a folder cannot be opened, and the rename lasts by itself.
    #[cfg(unix)]
    match File::open(folder_of(path)).and_then(|f| f.sync_all()) {
        // A folder that may be written and not read, and file systems that sync no folders.
        Err(e)
            if [
                io::ErrorKind::PermissionDenied,
                io::ErrorKind::InvalidInput,
                io::ErrorKind::Unsupported,
            ]
            .contains(&e.kind()) => {}
        other => return other,
    }
    Ok(())
}

/// A file being written. It takes its name only at [`AtomicFile::commit`]; dropped before that, it
/// leaves nothing behind.
pub struct AtomicFile {
    path: PathBuf,
    out: BufWriter<FaultyWriter>,
    temporary: TemporaryFile,
}

/// The file behind the buffer, where a full disk can be planted.
struct FaultyWriter(File);

impl Write for FaultyWriter {
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

impl AtomicFile {
    /// Starts a file that will stand at `path`.
    ///
    /// # Errors
    /// [`FormatError::Io`] if the folder cannot be written.
    pub fn create(path: &Path) -> Result<Self, FormatError> {
        let create = || {
            let temporary = TemporaryFile::create(path)?;
            let file = temporary.file.try_clone()?;
            let out = BufWriter::with_capacity(1 << 18, FaultyWriter(file));
            Ok(Self { path: path.to_owned(), out, temporary })
        };
        create().map_err(|e| FormatError::io(path, e))
    }

    /// Writes what is left in the buffer and syncs the bytes.
    fn sync(self) -> Result<(PathBuf, TemporaryFile), FormatError> {
        let Self { path, out, temporary } = self;
        let synced =
            out.into_inner().map_err(io::IntoInnerError::into_error).and_then(|f| f.0.sync_all());
        match synced {
            Ok(()) => Ok((path, temporary)),
            Err(e) => Err(FormatError::io(&path, e)),
        }
    }

    /// Syncs the bytes, gives the file its name and syncs the folder.
    ///
    /// # Errors
    /// [`FormatError::Io`]. Nothing is left behind then, save where the folder alone could not be
    /// synced: the file stands complete and may be gone after a loss of power.
    pub fn commit(self) -> Result<(), FormatError> {
        let (path, mut temporary) = self.sync()?;
        let renamed = temporary.rename(&path, &mut unfinished());
        renamed.and_then(|()| sync_folder(&path)).map_err(|e| FormatError::io(&path, e))
    }

    /// Gives this file, the header of `data`, and `data` their names as one step for every reader:
    /// an older header is taken away first and the new one comes last, so that no header ever
    /// stands beside samples that are not its own.
    ///
    /// # Errors
    /// As [`Self::commit`]; between the steps there may be no header, never a wrong one.
    pub fn commit_with_data(self, data: Self) -> Result<(), FormatError> {
        let (data_path, mut data) = data.sync()?;
        let (path, mut header) = self.sync()?;
        let mut all = unfinished();
        let mut steps = || {
            match std::fs::remove_file(&path) {
                Err(e) if e.kind() != io::ErrorKind::NotFound => return Err(e),
                _ => sync_folder(&path)?,
            }
            data.rename(&data_path, &mut all)?;
            sync_folder(&path)?;
            header.rename(&path, &mut all)?;
            sync_folder(&path)
        };
        let done = steps();
        // The temporary files take this lock when dropped.
        drop(all);
        done.map_err(|e| FormatError::io(&path, e))
    }
}

impl Write for AtomicFile {
    fn write(&mut self, buf: &[u8]) -> io::Result<usize> {
        self.out.write(buf)
    }
    fn flush(&mut self) -> io::Result<()> {
        self.out.flush()
    }
}

/// Writes a file through `fill`.
///
/// # Errors
/// [`FormatError::Io`], with nothing left behind.
pub fn write_atomic(
    path: &Path,
    fill: impl FnOnce(&mut dyn Write) -> io::Result<()>,
) -> Result<(), FormatError> {
    let mut file = AtomicFile::create(path)?;
    fill(&mut file).map_err(|e| FormatError::io(path, e))?;
    file.commit()
}

/// Returns the user's cache of recomputable files: `$XDG_CACHE_HOME/intima` or `~/.cache/intima`.
pub fn user_cache() -> Option<PathBuf> {
    user_folder("XDG_CACHE_HOME", ".cache")
}

/// Returns the folder of what a program keeps for its user from one start to the next:
/// `$XDG_STATE_HOME/intima` or `~/.local/state/intima`.
pub fn user_state() -> Option<PathBuf> {
    user_folder("XDG_STATE_HOME", ".local/state")
}

/// The program's folder in one that a variable names (XDG Base Directory Specification 0.8), or in
/// another below the user's home.
fn user_folder(variable: &str, below_home: &str) -> Option<PathBuf> {
    let set = |name| std::env::var_os(name).map(PathBuf::from).filter(|p| p.is_absolute());
    let base = set(variable).or_else(|| Some(set("HOME")?.join(below_home)))?;
    Some(base.join("intima"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_unlocked_files_of_our_naming_are_taken_for_abandoned() {
        let dir = tempfile::tempdir().unwrap();
        let at = |name: &str| dir.path().join(name);
        let ours = ".intima-abcDEF012345.tmp";
        let others =
            [".intima-abc.tmp", ".intima-abcDEF012345", ".intima-abcDEF01234_.tmp", "a.tmp"];
        for name in others.iter().chain(&[ours]) {
            std::fs::write(at(name), "x").unwrap();
        }
        std::fs::create_dir(at(".intima-aaaaaaaaaaaa.tmp")).unwrap();
        let held = TemporaryFile::create(&at("o")).unwrap();
        assert!(!at(ours).exists(), "an abandoned file stays");
        remove_abandoned(dir.path());
        assert!(held.path().exists(), "a file in use is removed");
        assert!(others.iter().all(|n| at(n).exists()) && at(".intima-aaaaaaaaaaaa.tmp").exists());
        let path = held.path().to_owned();
        drop(held);
        assert!(!path.exists());
    }
}
