//! PNG.
use super::FormatError;
use std::path::Path;
/// Writes 8-bit RGB.
pub fn write_png(_path: &Path, _width: u32, _height: u32, _rgb: &[u8]) -> Result<(), FormatError> {
    todo!()
}
