//! Errors of cohorts.

use std::path::PathBuf;

use crate::formats::{FormatError, shown};

/// Failure of a cohort as a whole; those of a case are in its status.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum CohortError {
    /// A file or folder.
    #[error(transparent)]
    Format(#[from] FormatError),
    /// No scan was found.
    #[error("{}: no case: {why}", shown(.folder))]
    NoCases {
        /// Folder that was searched.
        folder: PathBuf,
        /// Scans that were looked for.
        why: String,
    },
    /// A label that no case has.
    #[error("{}: no case of {kind} {label}", shown(.folder))]
    NoSuchLabel {
        /// Folder that was searched.
        folder: PathBuf,
        /// `participant`, `session` or `name`.
        kind: &'static str,
        /// Label that was asked for.
        label: String,
    },
    /// The folder of outputs is the input, or belongs to somebody else.
    #[error("{}: not a folder for outputs: {why}", shown(.folder))]
    Output {
        /// Folder of outputs.
        folder: PathBuf,
        /// Reason.
        why: String,
    },
    /// More entries than any dataset has.
    #[error("{}: more than {limit} files and folders", shown(.folder))]
    TooMany {
        /// Folder that was searched.
        folder: PathBuf,
        /// Most entries that are looked at.
        limit: usize,
    },
}
