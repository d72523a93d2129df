//! A centerline as VTK polylines, split into tracts as VMTK's branch extractor splits them.
//!
//! Every line from the root to a tip is a run of cells with one `CenterlineIds`; `TractIds` counts
//! them from the root. Lines that share a stretch share its `GroupIds`, and each stretch between
//! two forks is a group of its own. `Blanking` is 0 everywhere: VMTK blanks the stretch inside a
//! bifurcation, whose extent it takes from the spheres of both branches; a tree of curves knows the
//! point of a fork alone. (Antiga and Steinman 2004, Robust and objective decomposition and mapping
//! of bifurcating vessels, IEEE Transactions on Medical Imaging 23(6), 704-713,
//! doi:10.1109/TMI.2004.826946.)

use std::collections::{BTreeMap, BTreeSet};
use std::path::Path;

use super::{FormatError, atomic_file};
use crate::formats::mesh::polydata::{Array, PolyData};
use crate::geometry::{Attachment, Centerline};

/// A point by the bits of its coordinates.
type PointBits = [u64; 3];

/// The cells: their arrays, one entry each, and the points that each goes through.
#[derive(Default)]
struct Tracts {
    connectivity: Vec<i32>,
    offsets: Vec<i32>,
    centerlines: Vec<i32>,
    groups: Vec<i32>,
    tracts: Vec<i32>,
}

impl Tracts {
    /// Splits lines, given as the points of each by their bits. Two lines that share a point and
    /// go on differently fork there.
    fn new(lines: &[Vec<PointBits>]) -> Self {
        // Next points of every point that has been passed; a fork has several, or a tip.
        let mut next: BTreeMap<(usize, PointBits), BTreeSet<Option<PointBits>>> = BTreeMap::new();
        for line in lines {
            for (i, p) in line.iter().enumerate() {
                next.entry((i, *p)).or_default().insert(line.get(i + 1).copied());
            }
        }
        let mut tracts = Self::default();
        let mut groups = BTreeMap::new();
        let mut start = 0;
        for (c, line) in lines.iter().enumerate() {
            let last = line.len().saturating_sub(1);
            let (mut from, mut tract) = (0, 0);
            for (i, p) in line.iter().enumerate() {
                let forks = i > 0 && next[&(i, *p)].len() > 1;
                if !forks && i != last {
                    continue;
                }
                // A stretch is told by its ends and its second point: lines part at forks alone.
                let key = (from, line[from], line[(from + 1).min(last)], i);
                let count = groups.len() as i32;
                tracts.groups.push(*groups.entry(key).or_insert(count));
                tracts.connectivity.extend((from..=i).map(|k| (start + k) as i32));
                tracts.offsets.push(tracts.connectivity.len() as i32);
                tracts.centerlines.push(c as i32);
                tracts.tracts.push(tract);
                tract += 1;
                from = i;
            }
            start += line.len();
        }
        tracts
    }
}

/// Whether a line ends where this branch does: no other branch leaves its last point.
fn has_tip(centerline: &Centerline, branch: usize) -> bool {
    let last = centerline.branches[branch].points.len().saturating_sub(1);
    let end = Attachment { branch, point: last };
    !centerline.branches.iter().any(|child| child.start == Some(end))
}

pub(super) fn write(path: &Path, centerline: &Centerline) -> Result<(), FormatError> {
    let leaves = (0..centerline.branches.len()).filter(|b| has_tip(centerline, *b));
    let (mut points, mut radius, mut abscissa) = (Vec::new(), Vec::new(), Vec::new());
    let mut lines = Vec::new();
    for leaf in leaves {
        let mut line = Vec::new();
        for p in centerline.path_to(leaf) {
            line.push(p.position_mm.to_array().map(f64::to_bits));
            points.extend(p.position_mm.to_array());
            radius.push(p.radius_mm);
            abscissa.push(p.abscissa_mm);
        }
        lines.push(line);
    }
    // Forks are in two cells: there are at most twice as many entries as points.
    if i32::try_from(2 * radius.len()).is_err() {
        return Err(FormatError::unsupported(path, "polylines of more than 2^30 points"));
    }
    let tracts = Tracts::new(&lines);
    let blanking = vec![0; tracts.groups.len()];
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
        cell_count: tracts.groups.len(),
        connectivity: Array::new("connectivity", 1, &tracts.connectivity),
        offsets: Array::new("offsets", 1, &tracts.offsets),
        cell_data: vec![
            Array::new("CenterlineIds", 1, &tracts.centerlines),
            Array::new("GroupIds", 1, &tracts.groups),
            Array::new("TractIds", 1, &tracts.tracts),
            Array::new("Blanking", 1, &blanking),
        ],
    };
    atomic_file::write_atomic(path, |out| data.write(out))
}
