//! A surface as VTK polygonal data.

use std::path::Path;

use super::polydata::{DataArray, PolyData};
use super::{FacedMesh, FormatError};
use crate::formats::atomic_file;

pub(super) fn write(path: &Path, faced: &FacedMesh<'_>) -> Result<(), FormatError> {
    let mesh = &*faced.whole();
    let flat = |v| bytemuck::cast_slice::<glam::Vec3, f32>(v);
    let offsets: Vec<i32> = (1..=mesh.faces.len() as i32).map(|k| 3 * k).collect();
    let caps: Vec<u8> = mesh.caps.iter().map(|&c| u8::from(c)).collect();
    let with_normals = !mesh.normals.is_empty();
    let data = PolyData {
        facing: faced.tag().unwrap_or_default(),
        points: DataArray::new("Points", 3, flat(&mesh.positions)),
        point_count: mesh.positions.len(),
        point_data: with_normals
            .then(|| DataArray::new("Normals", 3, flat(&mesh.normals)))
            .into_iter()
            .collect(),
        active: if with_normals { "Normals=\"Normals\"" } else { "" },
        cells: "Polys",
        cell_count: mesh.faces.len(),
        // Ids fit an i32: checked for every format.
        connectivity: DataArray::new(
            "connectivity",
            1,
            bytemuck::cast_slice::<[u32; 3], i32>(&mesh.faces),
        ),
        offsets: DataArray::new("offsets", 1, &offsets),
        cell_data: (!caps.is_empty())
            .then(|| DataArray::new("Cap", 1, &caps))
            .into_iter()
            .collect(),
    };
    atomic_file::write_atomic(path, |out| data.write(out))
}
