//! Centerlines out: VTK polylines, tables, a Slicer curve.

mod csv;
mod mrk;
mod swc;
mod tracts;
mod vtp;

use std::path::Path;

use super::error::FieldValue;
use super::{FormatError, atomic_file};
use crate::geometry::Centerline;

/// Writes a centerline by extension; coordinates are LPS mm, radius and abscissa mm.
///
/// - `.vtp`: a polyline from the root to every tip; arrays named as VMTK and Slicer look for.
/// - `.csv`: a header, then `x,y,z,radius,abscissa,branch,parent`, one point a row; the root's
///   parent is -1.
/// - `.swc`: a tree of points, each with the one that it follows; loops are open.
/// - `.mrk.json`: a Slicer curve for every branch, the radius as a measurement.
///
/// # Errors
/// [`FormatError::Field`] if a number is not finite or a parent does not come before its child,
/// [`FormatError::Unsupported`] for another extension, [`FormatError::Io`]; nothing is left behind
/// then.
pub fn write_centerline(path: &Path, line: &Centerline) -> Result<(), FormatError> {
    check(path, line)?;
    let name = path.file_name().unwrap_or_default().to_string_lossy().to_ascii_lowercase();
    if name.ends_with(".vtp") {
        vtp::write_paths(path, line)
    } else if name.ends_with(".csv") {
        atomic_file::write_atomic(path, |out| csv::write(out, line))
    } else if name.ends_with(".swc") {
        atomic_file::write_atomic(path, |out| swc::write(out, line))
    } else if name.ends_with(".mrk.json") {
        atomic_file::write_atomic(path, |out| mrk::write(out, line))
    } else {
        let what = "a centerline with this extension; there are .vtp, .csv, .swc and .mrk.json";
        Err(FormatError::unsupported(path, what))
    }
}

/// Writes the paths to all tips as `.vtp`, split into branches and, blanked, bifurcations: what
/// VMTK's branch extractor makes of whole paths ([`Centerline::tracts`]).
///
/// # Errors
/// As [`write_centerline`].
pub fn write_branches(path: &Path, line: &Centerline) -> Result<(), FormatError> {
    check(path, line)?;
    vtp::write_tracts(path, line)
}

fn check(path: &Path, line: &Centerline) -> Result<(), FormatError> {
    line.check_attachments().map_err(|e| {
        let field = format!("attachment of branch {}", e.branch);
        FormatError::field(path, field, e.to.branch, "is no point of an earlier branch")
    })?;
    for (b, branch) in line.branches.iter().enumerate() {
        for (i, p) in branch.points.iter().enumerate() {
            let finite = p.radius_mm.is_finite() && p.abscissa_mm.is_finite();
            if !(finite && p.position_mm.is_finite()) {
                let field = format!("point {i} of branch {b}");
                let [x, y, z] = p.position_mm.to_array();
                let value = FieldValue::numbers(&[x, y, z, p.radius_mm, p.abscissa_mm]);
                return Err(FormatError::field(path, field, value, "not finite"));
            }
        }
    }
    Ok(())
}
