//! Errors of the formats room.

use std::path::{Path, PathBuf};

use crate::volume::GridError;

/// What is wrong with a file. Every message names the file and, where there is one, the field and
/// its value.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum FormatError {
    /// The system refused.
    #[error("{}: {source}", .file.display())]
    Io {
        /// Which file.
        file: PathBuf,
        /// The system's reason.
        source: std::io::Error,
    },
    /// A header field that cannot be right.
    #[error("{}: {field} is `{value}`: {why}", .file.display())]
    Field {
        /// Which file.
        file: PathBuf,
        /// Name of the header field or tag.
        field: String,
        /// What it holds.
        value: String,
        /// What is wrong with it.
        why: String,
    },
    /// The data ends before the header says it should.
    #[error("{}: truncated: the header promises {wanted} bytes of {what}, the file holds {found}", .file.display())]
    Truncated {
        /// Which file.
        file: PathBuf,
        /// Which part.
        what: &'static str,
        /// Bytes promised.
        wanted: u64,
        /// Bytes there.
        found: u64,
    },
    /// Readable, but not by this version.
    #[error("{}: not supported: {what}", .file.display())]
    Unsupported {
        /// Which file.
        file: PathBuf,
        /// What it asks for.
        what: String,
    },
    /// The geometry is unusable.
    #[error("{}: {source}", .file.display())]
    Grid {
        /// Which file.
        file: PathBuf,
        /// What is unusable.
        source: GridError,
    },
    /// Several series and none chosen, or the chosen one absent.
    #[error("{}: {why}; choose one with --series:{list}", .file.display())]
    Series {
        /// Which folder.
        file: PathBuf,
        /// What is wrong with the choice.
        why: String,
        /// One line a series.
        list: String,
    },
}

impl FormatError {
    /// Wraps a system error.
    pub fn io(file: &Path, source: std::io::Error) -> Self {
        Self::Io { file: file.to_owned(), source }
    }
    /// Names a bad header field.
    pub fn field(
        file: &Path,
        field: impl Into<String>,
        value: impl ToString,
        why: impl Into<String>,
    ) -> Self {
        let value = value.to_string().chars().filter(|c| !c.is_control()).take(80).collect();
        Self::Field { file: file.to_owned(), field: field.into(), value, why: why.into() }
    }
    /// Names something this version does not read or write.
    pub fn unsupported(file: &Path, what: impl Into<String>) -> Self {
        Self::Unsupported { file: file.to_owned(), what: what.into() }
    }
    /// Whether the input is at fault (exit 3) rather than the system (exit 1).
    pub fn is_bad_input(&self) -> bool {
        !matches!(self, Self::Io { source, .. } if source.kind() != std::io::ErrorKind::NotFound)
    }
}
