//! A centerline as VTK polylines, root to tip.

use std::path::Path;

use super::{FormatError, atomic_file};
use crate::formats::mesh::polydata::{Array, PolyData};
use crate::geometry::Centerline;

pub(super) fn write(path: &Path, line: &Centerline) -> Result<(), FormatError> {
    let parents: Vec<usize> = line.branches.iter().filter_map(|b| b.parent()).collect();
    let leaves: Vec<usize> = (0..line.branches.len()).filter(|b| !parents.contains(b)).collect();
    let (mut points, mut radius, mut abscissa) = (Vec::new(), Vec::new(), Vec::new());
    let mut offsets: Vec<i32> = Vec::new();
    for &leaf in &leaves {
        for p in line.path_to(leaf) {
            points.extend(p.position_mm.to_array());
            radius.push(p.radius_mm);
            abscissa.push(p.abscissa_mm);
        }
        let Ok(end) = i32::try_from(radius.len()) else {
            return Err(FormatError::unsupported(path, "polylines of more than 2^31 points"));
        };
        offsets.push(end);
    }
    let connectivity: Vec<i32> = (0..radius.len() as i32).collect();
    let ids: Vec<i32> = (0..leaves.len() as i32).collect();
    let groups: Vec<i32> = leaves.iter().map(|&l| l as i32).collect();
    let zeros = vec![0; leaves.len()];
    let data = PolyData {
        points: Array::new("Points", 3, &points),
        point_count: radius.len(),
        // VMTK asks for the first name, Slicer for the second.
        point_data: vec![
            Array::new("MaximumInscribedSphereRadius", 1, &radius),
            Array::new("Radius", 1, &radius),
            Array::new("Abscissa", 1, &abscissa),
        ],
        active: "Scalars=\"Radius\"",
        cells: "Lines",
        cell_count: leaves.len(),
        connectivity: Array::new("connectivity", 1, &connectivity),
        offsets: Array::new("offsets", 1, &offsets),
        cell_data: vec![
            Array::new("CenterlineIds", 1, &ids),
            Array::new("GroupIds", 1, &groups),
            Array::new("TractIds", 1, &zeros),
            Array::new("Blanking", 1, &zeros),
        ],
    };
    atomic_file::write_atomic(path, |out| data.write(out))
}
