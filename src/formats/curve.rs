//! Centerlines out.
use super::FormatError;
use crate::geometry::Centerline;
use std::path::Path;
/// Writes by extension.
pub fn write_centerline(_path: &Path, _line: &Centerline) -> Result<(), FormatError> {
    todo!()
}
