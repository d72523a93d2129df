//! Folders that a run writes into, each locked so that no second run mixes its files in.
//!
//! The lock is an advisory one of the system on the folder itself: it leaves no file behind and ends
//! with the process, however that ends. Where the system or the file system locks no folders,
//! nothing is refused.

use std::fs::{File, TryLockError};
use std::path::{Path, PathBuf};

use super::SessionError;

/// Locks held, by the folder's real place.
#[derive(Default)]
pub(super) struct FolderLocks(Vec<(PathBuf, File)>);

impl FolderLocks {
    /// Locks a folder; one that is not there yet or that these locks hold already is passed over.
    ///
    /// # Errors
    /// [`SessionError::FolderInUse`].
    pub fn claim(&mut self, folder: &Path) -> Result<(), SessionError> {
        let Ok(real) = folder.canonicalize() else { return Ok(()) };
        if self.0.iter().any(|(held, _)| *held == real) {
            return Ok(());
        }
        // One that cannot be opened is named when a file in it is written.
        let Ok(file) = File::open(&real) else { return Ok(()) };
        match file.try_lock() {
            Ok(()) => self.0.push((real, file)),
            Err(TryLockError::WouldBlock) => {
                return Err(SessionError::FolderInUse { folder: folder.to_owned() });
            }
            Err(TryLockError::Error(e)) => tracing::debug!("the folder cannot be locked: {e}"),
        }
        Ok(())
    }
}
