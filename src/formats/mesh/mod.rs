//! Meshes: PLY, STL and OBJ in and out, VTP and glTF out.

mod glb;
mod obj;
mod ply;
pub(super) mod polydata;
mod stl;
mod vtp;

use std::path::Path;
use std::str::FromStr;

use glam::Vec3;

use super::FormatError;
use super::error::FieldValue;
use crate::geometry::Mesh;

/// The patient coordinates a file is in, where it does not say so itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// +x left, +y back, +z head.
    Lps,
    /// +x right, +y front, +z head.
    Ras,
}

impl FromStr for Space {
    type Err = String;
    fn from_str(s: &str) -> Result<Self, String> {
        match s.to_ascii_uppercase().as_str() {
            "LPS" => Ok(Self::Lps),
            "RAS" => Ok(Self::Ras),
            _ => Err(format!("`{s}` is not a space; there are LPS and RAS")),
        }
    }
}

/// What a reader found in a file, in the file's own coordinates.
#[derive(Default)]
struct Raw {
    positions: Vec<Vec3>,
    normals: Vec<Vec3>,
    faces: Vec<[u32; 3]>,
    space: Option<Space>,
    warnings: Vec<String>,
}

/// Reads a surface (.ply, .stl, .obj) into LPS; lengths are taken as millimetres. Polygons become
/// fans of triangles, faces with a repeated vertex are dropped, and an STL's equal points become
/// one vertex. The `SPACE=` tag in the file's comments says where x and y point; without one,
/// `space` does; without either, LPS is assumed and a warning says so.
///
/// The warnings hold no text of the file.
///
/// # Errors
/// [`FormatError`]: unreadable, truncated, a vertex that is not finite, a face that names a vertex
/// that is not there, an unknown format.
pub fn read_mesh(path: &Path, space: Option<Space>) -> Result<(Mesh, Vec<String>), FormatError> {
    let read = match extension(path).as_str() {
        "ply" => ply::read,
        "stl" => stl::read,
        "obj" => obj::read,
        other => return Err(FormatError::unsupported(path, unknown(other, "ply, stl and obj"))),
    };
    let bytes = std::fs::read(path).map_err(|e| FormatError::io(path, e))?;
    finish(path, read(path, &bytes)?, space)
}

/// Writes a surface by extension: .ply, .stl, .obj, .vtp or .glb. Coordinates are LPS mm in each;
/// a .glb turns them to metres with y up in its node. Normals are written where the mesh has them,
/// and the format does.
///
/// # Errors
/// [`FormatError::Field`] for a mesh whose parts do not fit together, [`FormatError::Unsupported`]
/// for an unknown extension or a mesh too large for the format, [`FormatError::Io`]; nothing is
/// left behind then.
pub fn write_mesh(path: &Path, mesh: &Mesh) -> Result<(), FormatError> {
    let write = match extension(path).as_str() {
        "ply" => ply::write,
        "stl" => stl::write,
        "obj" => obj::write,
        "vtp" => vtp::write,
        "glb" => glb::write,
        other => {
            let what = unknown(other, "ply, stl, obj, vtp and glb");
            return Err(FormatError::unsupported(path, what));
        }
    };
    check(path, mesh)?;
    write(path, mesh)
}

fn extension(path: &Path) -> String {
    path.extension().map(|e| e.to_string_lossy().to_ascii_lowercase()).unwrap_or_default()
}

fn unknown(extension: &str, known: &str) -> String {
    let extension: String =
        extension.chars().filter(|c| c.is_ascii_alphanumeric()).take(8).collect();
    format!("a mesh as `.{extension}`; there are {known}")
}

/// The space that a comment names.
fn space_tag(text: &str) -> Option<Space> {
    [("SPACE=LPS", Space::Lps), ("SPACE=RAS", Space::Ras)]
        .into_iter()
        .find_map(|(tag, space)| text.contains(tag).then_some(space))
}

/// A vertex from a file's numbers.
fn vertex(path: &Path, index: usize, xyz: [f64; 3]) -> Result<Vec3, FormatError> {
    let v = Vec3::from(xyz.map(|c| c as f32));
    if v.is_finite() {
        return Ok(v);
    }
    let value = FieldValue::numbers(&xyz);
    Err(FormatError::field(path, format!("vertex {index}"), value, "not finite"))
}

/// Adds a polygon as a fan.
fn push_fan(raw: &mut Raw, polygon: &[u32]) {
    for k in 2..polygon.len() {
        raw.faces.push([polygon[0], polygon[k - 1], polygon[k]]);
    }
}

/// What all readers have in common: space, degenerate faces, normals.
fn finish(path: &Path, raw: Raw, space: Option<Space>) -> Result<(Mesh, Vec<String>), FormatError> {
    let Raw { mut positions, mut normals, mut faces, space: tag, mut warnings } = raw;
    let count = positions.len() as u64;
    let out = faces
        .iter()
        .enumerate()
        .find_map(|(i, f)| f.iter().find(|&&v| u64::from(v) >= count).map(|v| (i, *v)));
    if let Some((i, v)) = out {
        let why = format!("there are {count} vertices");
        return Err(FormatError::field(path, format!("vertex of triangle {i}"), v, why));
    }
    let before = faces.len();
    faces.retain(|&[a, b, c]| a != b && b != c && c != a);
    if faces.len() < before {
        warnings.push(format!("{} faces with a repeated vertex dropped", before - faces.len()));
    }
    if faces.is_empty() {
        warnings.push("the mesh has no faces".into());
    }
    if normals.iter().any(|n| !(n.length() > 1e-6 && n.is_finite())) {
        warnings.push("normals that are zero or not finite: all normals dropped".into());
        normals.clear();
    }
    for n in normals.iter_mut().filter(|n| (n.length() - 1.0).abs() > 1e-3) {
        *n = n.normalize();
    }
    let space = tag.or(space).unwrap_or_else(|| {
        warnings.push("the mesh does not say its space; LPS assumed".into());
        Space::Lps
    });
    if space == Space::Ras {
        // Half a turn about z: no face changes its side. Zero stays +0.
        for v in positions.iter_mut().chain(&mut normals) {
            *v = Vec3::new(0.0 - v.x, 0.0 - v.y, v.z);
        }
    }
    Ok((Mesh { positions, normals, faces, caps: Vec::new() }, warnings))
}

/// Refuses a mesh whose parts do not fit together.
fn check(path: &Path, mesh: &Mesh) -> Result<(), FormatError> {
    let n = mesh.positions.len();
    let sizes = [("normals", mesh.normals.len(), n), ("caps", mesh.caps.len(), mesh.faces.len())];
    for (what, found, wanted) in sizes {
        if found != 0 && found != wanted {
            return Err(FormatError::field(path, what, found, format!("{wanted} wanted")));
        }
    }
    if let Some(v) = mesh.faces.iter().flatten().find(|&&v| v as usize >= n) {
        return Err(FormatError::field(path, "vertex of a face", *v, format!("there are {n}")));
    }
    if let Some(i) = mesh.positions.iter().position(|p| !p.is_finite()) {
        let value = mesh.positions[i];
        return Err(FormatError::field(path, format!("vertex {i}"), value, "not finite"));
    }
    if n > i32::MAX as usize || mesh.faces.len() > i32::MAX as usize / 3 {
        return Err(FormatError::unsupported(path, "a mesh of more than 700 million faces"));
    }
    Ok(())
}
