//! Meshes: PLY, STL, OBJ and VTP in and out, glTF out.

mod glb;
mod obj;
mod ply;
pub(super) mod polydata;
mod polygons;
mod raw_mesh;
mod stl;
mod vtk_data;
mod vtp;
mod vtp_read;
mod xml;

use std::borrow::Cow;
use std::path::Path;
use std::str::FromStr;

use glam::Vec3;

use super::{FormatError, read_plain};
use crate::geometry::Mesh;
use raw_mesh::RawMesh;

/// The patient coordinates a file is in, where it does not say so itself.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Space {
    /// +x left, +y back, +z head.
    Lps,
    /// +x right, +y front, +z head.
    Ras,
}

/// Side of an organ's wall to which the faces and normals of a mesh look.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, serde::Deserialize)]
#[serde(rename_all = "kebab-case")]
#[cfg_attr(feature = "cli", derive(clap::ValueEnum))]
pub enum Facing {
    /// Into the lumen, as our own meshes do
    In,
    /// Away from the lumen, as programs expect of a solid
    #[default]
    Out,
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

/// Reads a surface (.ply, .stl, .obj, .vtp) into LPS; lengths are taken as millimetres. Polygons
/// become triangles, faces with a repeated vertex are dropped, and an STL's equal points become one
/// vertex. The file's `SPACE` tag (a comment, VTK field data) says where x and y point; without one,
/// `space` does; without either, LPS is assumed and a warning says so. Of a .vtp the caps come
/// back too.
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
        "vtp" => vtp_read::read,
        other => {
            let what = unknown(other, "ply, stl, obj and vtp");
            return Err(FormatError::unsupported(path, what));
        }
    };
    let bytes = read_plain(path, u64::MAX)?;
    let mut counted = RawMesh::default();
    read(path, &bytes, &mut counted)?;
    let mut raw = RawMesh::keeping(path, &counted)?;
    read(path, &bytes, &mut raw)?;
    raw.cut_concave();
    Ok(finish(raw, space))
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
    write_faced(path, &FacedMesh { mesh, facing: None })
}

/// Writes a wall whose faces and normals look into the lumen, turned over where they are to look
/// out, with `FACING` = `IN` or `OUT` beside `SPACE`.
///
/// # Errors
/// As [`write_mesh`].
pub fn write_wall(path: &Path, wall: &Mesh, facing: Facing) -> Result<(), FormatError> {
    write_faced(path, &FacedMesh { mesh: wall, facing: Some(facing) })
}

fn write_faced(path: &Path, mesh: &FacedMesh<'_>) -> Result<(), FormatError> {
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
    check(path, mesh.mesh)?;
    write(path, mesh)
}

/// A mesh on its way into a file: turned over as it is written where its faces are to look out, so
/// that a large wall is not copied.
struct FacedMesh<'a> {
    mesh: &'a Mesh,
    /// Side the faces look to in the file; `None` leaves them as they are.
    facing: Option<Facing>,
}

impl<'a> FacedMesh<'a> {
    /// Returns the value of the file's `FACING` tag; a file without one has none.
    fn tag(&self) -> Option<&'static str> {
        self.facing.map(|facing| match facing {
            Facing::In => "IN",
            Facing::Out => "OUT",
        })
    }

    fn normals(&self) -> impl Iterator<Item = Vec3> + use<'a> {
        let out = self.facing == Some(Facing::Out);
        self.mesh.normals.iter().map(move |n| if out { Vec3::ZERO - *n } else { *n })
    }

    fn faces(&self) -> impl Iterator<Item = [u32; 3]> + use<'a> {
        let out = self.facing == Some(Facing::Out);
        self.mesh.faces.iter().map(move |&[a, b, c]| if out { [a, c, b] } else { [a, b, c] })
    }

    /// Returns the mesh as a whole, for formats that hold its parts as blocks.
    fn whole(&self) -> Cow<'a, Mesh> {
        if self.facing != Some(Facing::Out) {
            return Cow::Borrowed(self.mesh);
        }
        Cow::Owned(Mesh {
            positions: self.mesh.positions.clone(),
            normals: self.normals().collect(),
            faces: self.faces().collect(),
            caps: self.mesh.caps.clone(),
        })
    }
}

/// Whether a file has the extension of a mesh. A `.glb` is one, though [`read_mesh`] refuses it.
pub fn is_mesh(path: &Path) -> bool {
    ["ply", "stl", "obj", "vtp", "glb"].contains(&extension(path).as_str())
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

/// Least and greatest distance between the corners of a mesh's box that an organ may have, mm.
const PLAUSIBLE_MM: std::ops::RangeInclusive<f32> = 1.2..=3000.0;

/// Asks about the unit of a mesh that is no size of an organ.
fn doubt_of_size(positions: &[Vec3]) -> Option<String> {
    let low = positions.iter().copied().reduce(Vec3::min)?;
    let high = positions.iter().copied().reduce(Vec3::max)?;
    let mm = low.distance(high);
    let is_organ = mm == 0.0 || PLAUSIBLE_MM.contains(&mm);
    (!is_organ).then(|| {
        format!("the mesh is {mm:.3} mm across: lengths are taken as millimetres; are they?")
    })
}

/// Makes a mesh in LPS of a raw one, without degenerate faces or unusable normals.
fn finish(raw: RawMesh, space: Option<Space>) -> (Mesh, Vec<String>) {
    let RawMesh {
        mut positions, mut normals, mut faces, mut caps, space: tag, mut warnings, ..
    } = raw;
    if caps.len() != faces.len() {
        caps.clear();
    }
    let before = faces.len();
    let spans = |&[a, b, c]: &[u32; 3]| a != b && b != c && c != a;
    let mut kept = faces.iter().map(spans);
    caps.retain(|_| kept.next() == Some(true));
    faces.retain(spans);
    if faces.len() < before {
        warnings.push(format!("{} faces with a repeated vertex dropped", before - faces.len()));
    }
    if faces.is_empty() {
        warnings.push("the mesh has no faces".into());
    }
    if !normals.is_empty() && normals.len() != positions.len() {
        warnings.push("vertices without a normal: all normals dropped".into());
        normals.clear();
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
    warnings.extend(doubt_of_size(&positions));
    (Mesh { positions, normals, faces, caps }, warnings)
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
