//! A centerline as VTK polylines: whole paths, or split into branches and bifurcations.
//!
//! Cell arrays are named as VMTK names them and hold 32-bit integers: with 64 bits VMTK's branch
//! clipper yields no groups.

use std::path::Path;

use super::tracts::{Tract, Tracts};
use super::{FormatError, atomic_file};
use crate::formats::mesh::polydata::{DataArray, PolyData};
use crate::geometry::{Centerline, CenterlinePoint};

/// A path from a root to each tip, a group of its own.
pub(super) fn write_paths(path: &Path, centerline: &Centerline) -> Result<(), FormatError> {
    let paths: Vec<_> = centerline.tips().map(|tip| centerline.path_to(tip)).collect();
    let whole = |(i, points): (usize, &Vec<_>)| Tract {
        path: i,
        group: i,
        tract: 0,
        blanking: false,
        points: 0..points.len().saturating_sub(1),
    };
    let tracts = paths.iter().enumerate().map(whole).collect();
    write(path, &Tracts { paths, tracts })
}

/// Writes the same paths as tracts of branches and, blanked, of bifurcations.
pub(super) fn write_tracts(path: &Path, centerline: &Centerline) -> Result<(), FormatError> {
    write(path, &centerline.tracts())
}

/// Most paths of which each point says whether it lies on each: the array grows with their square.
const MAX_OWNERS: usize = 32;

/// For each point a 1 for the path it lies on and 0 for the others, as SimVascular reads them;
/// `None` of too many paths.
fn path_of_points(paths: &[Vec<CenterlinePoint>], points: usize) -> Option<Vec<i32>> {
    let count = paths.len();
    if count > MAX_OWNERS {
        return None;
    }
    let mut owners = vec![0; points * count];
    let each = paths.iter().enumerate().flat_map(|(i, p)| std::iter::repeat_n(i, p.len()));
    each.enumerate().for_each(|(point, path)| owners[point * count + path] = 1);
    Some(owners)
}

fn write(path: &Path, Tracts { paths, tracts }: &Tracts) -> Result<(), FormatError> {
    let (mut points, mut radius, mut abscissa) = (Vec::new(), Vec::new(), Vec::new());
    let mut first = Vec::new();
    for p in paths {
        first.push(radius.len());
        points.extend(p.iter().flat_map(|p| p.position_mm.to_array()));
        radius.extend(p.iter().map(|p| p.radius_mm));
        abscissa.extend(p.iter().map(|p| p.abscissa_mm));
    }
    let owners = path_of_points(paths, radius.len());
    // Neighbouring tracts share a point: there are at most twice as many entries as points.
    if i32::try_from(2 * radius.len()).is_err() {
        return Err(FormatError::unsupported(path, "polylines of more than 2^30 points"));
    }
    let (mut connectivity, mut offsets) = (Vec::new(), Vec::new());
    for t in tracts {
        connectivity
            .extend(t.points.clone().chain([t.points.end]).map(|i| (first[t.path] + i) as i32));
        offsets.push(connectivity.len() as i32);
    }
    let of = |value: fn(&Tract) -> usize| tracts.iter().map(|t| value(t) as i32).collect();
    let ids: Vec<i32> = of(|t| t.path);
    let groups: Vec<i32> = of(|t| t.group);
    let numbers: Vec<i32> = of(|t| t.tract);
    let blanking: Vec<i32> = of(|t| usize::from(t.blanking));
    let data = PolyData {
        facing: "",
        points: DataArray::new("Points", 3, &points),
        point_count: radius.len(),
        // VMTK asks for the first name, Slicer for the second.
        point_data: [
            DataArray::new("MaximumInscribedSphereRadius", 1, &radius),
            DataArray::new("Radius", 1, &radius),
            DataArray::new("Abscissa", 1, &abscissa),
            // SimVascular asks for these two.
            DataArray::new("Path", 1, &abscissa),
        ]
        .into_iter()
        .chain(owners.as_ref().map(|own| DataArray::new("CenterlineId", paths.len(), own)))
        .collect(),
        active: "Scalars=\"Radius\"",
        cells: "Lines",
        cell_count: tracts.len(),
        connectivity: DataArray::new("connectivity", 1, &connectivity),
        offsets: DataArray::new("offsets", 1, &offsets),
        cell_data: vec![
            DataArray::new("CenterlineIds", 1, &ids),
            DataArray::new("GroupIds", 1, &groups),
            DataArray::new("TractIds", 1, &numbers),
            DataArray::new("Blanking", 1, &blanking),
        ],
    };
    atomic_file::write_atomic(path, |out| data.write(out))
}
