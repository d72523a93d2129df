//! Volumes in and out.
use super::FormatError;
use crate::volume::Volume;
use std::path::{Path, PathBuf};
/// How to read an input.
#[derive(Clone, Debug, Default)]
pub struct ReadOptions {
    /// DICOM series: UID or index in the listing.
    pub series: Option<String>,
}
/// One DICOM series of a folder.
#[derive(Clone, Debug)]
pub struct SeriesInfo {}
/// What `intima info` shows.
#[derive(Clone, Debug)]
pub struct InputInfo {}
/// Describes an input.
pub fn inspect(_path: &Path) -> Result<InputInfo, FormatError> {
    todo!()
}
/// Reads any volume.
pub fn read_volume(_path: &Path, _options: &ReadOptions) -> Result<Volume, FormatError> {
    todo!()
}
/// Writes by extension.
pub fn write_volume(_path: &Path, _volume: &Volume) -> Result<(), FormatError> {
    let _: Option<PathBuf> = None;
    todo!()
}
