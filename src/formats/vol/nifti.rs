//! NIfTI-1 in: `.nii`, `.nii.gz`, and `.hdr` with `.img`.
//!
//! The 348 header bytes are taken apart by the `nifti` crate; the samples are read by us, since
//! the crate takes memory for whatever the header promises.

use std::io::Read;
use std::path::{Path, PathBuf};

use ::nifti::{Endianness, NiftiHeader};
use flate2::read::MultiGzDecoder;
use glam::{DMat3, DQuat, DVec3};

use super::FormatError;
use super::affine::{RAS, grid, grid_from_steps};
use super::layout::{Encoding, Layout, must_swap};
use super::source::{DataFile, fill, is_within_folder, prefix};
use crate::volume::{Grid, Rescale, SampleType};

const HEADER: usize = 348;
/// Distance between corners by sform and by qform of which nothing is said, in sides of a voxel.
const MAX_OFF: f64 = 0.1;

pub(super) fn layout(path: &Path) -> Result<Layout, FormatError> {
    let (header_path, image_path) = pair(path);
    let bytes = header_bytes(&header_path)?;
    match bytes.get(..4) {
        Some([0x1c, 2, 0, 0] | [0, 0, 2, 0x1c]) => {
            return Err(FormatError::unsupported(path, "NIfTI-2; convert it to NIfTI-1"));
        }
        Some([0x5c, 1, 0, 0] | [0, 0, 1, 0x5c]) if bytes.len() >= HEADER => {}
        Some([0x5c, 1, 0, 0] | [0, 0, 1, 0x5c]) => {
            let (wanted, found) = (HEADER as u64, bytes.len() as u64);
            let file = path.to_owned();
            return Err(FormatError::Truncated { file, what: "header", wanted, found });
        }
        _ => {
            return Err(FormatError::text(path, "sizeof_hdr", "a NIfTI-1 file holds 348"));
        }
    }
    let h = NiftiHeader::from_reader(bytes.as_slice())
        .map_err(|_| FormatError::text(path, "header", "cannot be taken apart"))?;
    let single = match &h.magic {
        b"n+1\0" => true,
        b"ni1\0" => false,
        _ => {
            return Err(FormatError::text(path, "magic", "neither n+1 nor ni1"));
        }
    };
    let file = if single { header_path.clone() } else { image_path };
    if !single && !is_within_folder(&header_path, &file) && file.exists() {
        let why = "the image beside the header is a link out of its folder";
        return Err(FormatError::text(path, "image", why));
    }
    let start = offset(path, &h, single)?;
    let gz = prefix(&file, 2)? == [0x1f, 0x8b];
    let mut notes = Vec::new();
    let volumes = volumes(path, &h)?;
    Ok(Layout {
        format: "NIfTI-1",
        grid: geometry(path, &h, &mut notes)?,
        sample_type: sample_type(path, h.datatype)?,
        layers: 1,
        volumes,
        segments: Vec::new(),
        rescale: rescale(path, &h)?,
        path: file.clone(),
        file,
        offset: Some(if gz { 0 } else { start }),
        skip: if gz { start } else { 0 },
        encoding: if gz { Encoding::Gzip } else { Encoding::Raw },
        swap: must_swap(h.endianness == Endianness::Big),
        notes,
    })
}

/// Header and image of an `.hdr`/`.img` pair; a single file is both.
fn pair(path: &Path) -> (PathBuf, PathBuf) {
    let name = path.to_string_lossy();
    let lower = name.to_ascii_lowercase();
    for gz in ["", ".gz"] {
        for (own, other, is_header) in [(".hdr", ".img", true), (".img", ".hdr", false)] {
            let own = format!("{own}{gz}");
            if !lower.ends_with(&own) {
                continue;
            }
            let stem = &name[..name.len() - own.len()];
            // Either may be compressed, or both.
            let beside = |gz: &str| PathBuf::from(format!("{stem}{other}{gz}"));
            let other = [gz, "", ".gz"].map(beside).into_iter().find(|p| p.exists());
            let other = other.unwrap_or_else(|| beside(gz));
            let path = path.to_owned();
            return if is_header { (path, other) } else { (other, path) };
        }
    }
    (path.to_owned(), path.to_owned())
}

fn header_bytes(path: &Path) -> Result<Vec<u8>, FormatError> {
    let mut source = DataFile::open(path)?;
    let mut bytes = vec![0; HEADER];
    let io = |e| FormatError::io(path, e);
    let mut found = fill(&mut source, &mut bytes).map_err(io)?;
    if bytes.starts_with(&[0x1f, 0x8b]) {
        let mut input = MultiGzDecoder::new(DataFile::open(path)?.take(1 << 20));
        let bad = |_: std::io::Error| FormatError::text(path, "gzip data", "damaged");
        found = fill(&mut input, &mut bytes).map_err(bad)?;
    }
    if found < HEADER {
        let (wanted, found) = (HEADER as u64, found as u64);
        let file = path.to_owned();
        return Err(FormatError::Truncated { file, what: "header", wanted, found });
    }
    Ok(bytes)
}

fn offset(path: &Path, h: &NiftiHeader, single: bool) -> Result<u64, FormatError> {
    let v = h.vox_offset;
    let least = if single { 352.0 } else { 0.0 };
    if v == 0.0 {
        return Ok(least as u64);
    }
    // Above 2^32 a 32-bit float no longer names single bytes, and no header is that long.
    if !(v >= least && v < 4.3e9 && v.fract() == 0.0) {
        return Err(FormatError::field(path, "vox_offset", v, "not a place behind the header"));
    }
    Ok(v as u64)
}

fn dims(path: &Path, h: &NiftiHeader) -> Result<[u64; 3], FormatError> {
    let n = usize::from(h.dim[0]);
    if !(2..=7).contains(&n) {
        return Err(FormatError::field(path, "dim[0]", n, "2 to 7 axes are possible"));
    }
    let side = |i: usize| if i <= n { u64::from(h.dim[i]) } else { 1 };
    Ok([side(1), side(2), side(3)])
}

/// The number of volumes along the axis of time.
fn volumes(path: &Path, h: &NiftiHeader) -> Result<usize, FormatError> {
    let n = usize::from(h.dim[0]);
    for i in 5..=n.min(7) {
        // Some writers leave zeros behind the last axis in use.
        if h.dim[i] > 1 {
            let what = format!("dim[{i}] = {}: more than one component", h.dim[i]);
            return Err(FormatError::unsupported(path, what));
        }
    }
    Ok(if n >= 4 { usize::from(h.dim[4]).max(1) } else { 1 })
}

fn geometry(path: &Path, h: &NiftiHeader, notes: &mut Vec<String>) -> Result<Grid, FormatError> {
    let dims = dims(path, h)?;
    let mm = match h.xyzt_units & 7 {
        0 | 2 => 1.0,
        1 => 1000.0,
        3 => 1e-3,
        other => {
            let why = "the unit of length is metre (1), mm (2) or micron (3)";
            return Err(FormatError::field(path, "xyzt_units", other, why));
        }
    };
    let side = |i: usize| f64::from(h.pixdim[i]);
    let mut spacing = DVec3::new(side(1), side(2), side(3));
    let is_flat = h.dim[0] == 2 && spacing.z == 0.0;
    if is_flat {
        spacing.z = 1.0 / mm;
    }
    let forms = GridForms { path, h, dims, spacing_mm: spacing * mm, mm };
    let (sform, qform) = (forms.sform(), forms.qform());
    if is_flat && !matches!(sform, Some(Ok(_))) {
        notes.push("one slice without a thickness; 1 mm is assumed".to_owned());
    }
    match (sform, qform) {
        (Some(Ok(sform)), Some(Ok(qform))) => {
            let off_mm = farthest_corners(&sform, &qform);
            if off_mm > MAX_OFF * sform.spacing_mm.min_element() {
                notes.push(format!(
                    "sform and qform disagree by up to {off_mm:.1} mm; the sform is taken"
                ));
            }
            Ok(sform)
        }
        (Some(Err(_)), Some(Ok(qform))) => {
            notes.push("the sform cannot be used; the qform is taken".to_owned());
            Ok(qform)
        }
        (Some(sform), _) => sform,
        (None, Some(qform)) => qform,
        (None, None) => {
            let note = "neither sform nor qform; axes are taken as right, anterior, superior";
            notes.push(note.to_owned());
            grid(path, dims, forms.spacing_mm, DVec3::ZERO, DMat3::from_diagonal(RAS))
        }
    }
}

/// The two forms in which a header says where its voxels lie.
struct GridForms<'a> {
    path: &'a Path,
    h: &'a NiftiHeader,
    dims: [u64; 3],
    spacing_mm: DVec3,
    /// Millimetres in the header's unit.
    mm: f64,
}

impl GridForms<'_> {
    /// The grid of the affine, where the header has one.
    fn sform(&self) -> Option<Result<Grid, FormatError>> {
        let h = self.h;
        let rows = [h.srow_x, h.srow_y, h.srow_z].map(|r| r.map(f64::from));
        let col = |j: usize| DVec3::new(rows[0][j], rows[1][j], rows[2][j]);
        let steps = DMat3::from_cols(col(0), col(1), col(2));
        let made = || {
            let mut found = grid_from_steps(self.path, self.dims, steps, col(3), RAS * self.mm)?;
            // The lengths of 32-bit columns carry noise that would make an isotropic volume look
            // anisotropic; where pixdim says the same without it, pixdim is taken.
            if (found.spacing_mm / self.spacing_mm - 1.0).abs().max_element() < 1e-5 {
                found.spacing_mm = self.spacing_mm;
            }
            Ok(found)
        };
        (h.sform_code > 0).then(made)
    }

    /// The grid of the quaternion, where the header has one.
    fn qform(&self) -> Option<Result<Grid, FormatError>> {
        let h = self.h;
        let made = || {
            let rotation = quaternion(self.path, h)?;
            let handed = if h.pixdim[0] < 0.0 { -1.0 } else { 1.0 };
            let place = [h.quatern_x, h.quatern_y, h.quatern_z].map(f64::from);
            let axes = DMat3::from_cols(rotation.x_axis, rotation.y_axis, rotation.z_axis * handed);
            let origin_mm = DVec3::from(place) * RAS * self.mm;
            let direction = DMat3::from_diagonal(RAS) * axes;
            grid(self.path, self.dims, self.spacing_mm, origin_mm, direction)
        };
        (h.qform_code > 0).then(made)
    }
}

/// Largest distance between the same corner of two grids, mm.
fn farthest_corners(a: &Grid, b: &Grid) -> f64 {
    let last = a.dims.as_dvec3() - 1.0;
    let corner = |k: u32| last * DVec3::new((k & 1).into(), (k >> 1 & 1).into(), (k >> 2).into());
    let off = |v: DVec3| {
        let [p, q] = [a, b].map(|grid| grid.world_from_voxel().transform_point3(v));
        p.distance(q)
    };
    (0..8).map(|k| off(corner(k))).fold(0.0, f64::max)
}

/// Rotation of the qform, its first component recovered as the standard says.
fn quaternion(path: &Path, h: &NiftiHeader) -> Result<DMat3, FormatError> {
    let v = DVec3::from([h.quatern_b, h.quatern_c, h.quatern_d].map(f64::from));
    if !v.is_finite() || v.length_squared() > 1.01 {
        return Err(FormatError::field(path, "quatern_b..d", v, "not part of a unit quaternion"));
    }
    let rest = 1.0 - v.length_squared();
    let q = if rest < 1e-7 {
        let u = v.normalize();
        DQuat::from_xyzw(u.x, u.y, u.z, 0.0)
    } else {
        DQuat::from_xyzw(v.x, v.y, v.z, rest.sqrt())
    };
    Ok(DMat3::from_quat(q))
}

fn sample_type(path: &Path, code: i16) -> Result<SampleType, FormatError> {
    use SampleType::*;
    let refused = match code {
        2 => return Ok(U8),
        4 => return Ok(I16),
        8 => return Ok(I32),
        16 => return Ok(F32),
        64 => return Ok(F64),
        256 => return Ok(I8),
        512 => return Ok(U16),
        768 => return Ok(U32),
        1024 => return Ok(I64),
        1280 => return Ok(U64),
        1 => "binary, one bit a voxel",
        32 | 1792 | 2048 => "complex numbers",
        128 | 2304 => "RGB colours",
        1536 => "128-bit floats",
        _ => {
            return Err(FormatError::field(path, "datatype", code, "not a NIfTI-1 type code"));
        }
    };
    Err(FormatError::unsupported(path, format!("datatype {code}: {refused}")))
}

/// A slope of zero means none; some writers put NaN there with the same meaning.
fn rescale(path: &Path, h: &NiftiHeader) -> Result<Rescale, FormatError> {
    let (slope, intercept) = (f64::from(h.scl_slope), f64::from(h.scl_inter));
    if slope == 0.0 || slope.is_nan() {
        return Ok(Rescale::IDENTITY);
    }
    if !slope.is_finite() {
        return Err(FormatError::field(path, "scl_slope", slope, "not finite"));
    }
    if !intercept.is_finite() {
        return Err(FormatError::field(path, "scl_inter", intercept, "not finite"));
    }
    Ok(Rescale { slope, intercept })
}
