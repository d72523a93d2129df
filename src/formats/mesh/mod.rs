//! Meshes in and out.
use super::FormatError;
use crate::geometry::Mesh;
use std::path::Path;
/// Reads PLY, STL or OBJ.
pub fn read_mesh(_path: &Path) -> Result<Mesh, FormatError> {
    todo!()
}
/// Writes by extension.
pub fn write_mesh(_path: &Path, _mesh: &Mesh) -> Result<(), FormatError> {
    todo!()
}
