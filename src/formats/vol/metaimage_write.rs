//! MetaImage out: `.mha` compressed, `.mhd` with plain `.raw`.

use std::io::{self, Write};
use std::path::{Path, PathBuf};

use flate2::Compression;
use flate2::write::ZlibEncoder;
use glam::DVec3;

use super::rescale::real_samples;
use super::source::prefix;
use super::text::MAX_HEADER;
use super::{FormatError, lower_name};
use crate::formats::atomic_file::{AtomicFile, abandoned, folder_of, write_atomic};
use crate::formats::shown;
use crate::volume::{Grid, SampleType, Volume};

/// Writes by extension; real values.
pub(super) fn write(path: &Path, volume: &Volume) -> Result<(), FormatError> {
    let samples = real_samples(volume);
    let head = header(&volume.grid, samples.sample_type());
    if lower_name(path).ends_with(".mha") {
        // The header states the compressed size, so the samples are compressed first.
        let mut packed = ZlibEncoder::new(Vec::new(), Compression::fast());
        let io = |e| FormatError::io(path, e);
        packed.write_all(samples.bytes()).map_err(io)?;
        let packed = packed.finish().map_err(io)?;
        return write_atomic(path, |out| {
            out.write_all(head.as_bytes())?;
            let size = packed.len();
            writeln!(out, "CompressedData = True\nCompressedDataSize = {size}")?;
            writeln!(out, "ElementDataFile = LOCAL")?;
            out.write_all(&packed)
        });
    }
    let (raw, name) = data_file(path);
    if name.is_empty() || name.trim() != name || name.contains(|c: char| c.is_control() || c == '%')
    {
        let what = "a name that a MetaImage header cannot hold; use .mha";
        return Err(FormatError::unsupported(path, what));
    }
    check_data_file(path)?;
    let io = |e| FormatError::io(path, e);
    let mut data = AtomicFile::create(&raw)?;
    data.write_all(samples.bytes()).map_err(io)?;
    let mut out = AtomicFile::create(path)?;
    out.write_all(head.as_bytes()).map_err(io)?;
    writeln!(out, "CompressedData = False\nElementDataFile = {name}").map_err(io)?;
    out.commit_with_data(data)
}

/// The file of samples that a `.mhd` is written with, and its name.
fn data_file(header: &Path) -> (PathBuf, String) {
    let raw = header.with_extension("raw");
    let name = raw.file_name().and_then(|n| n.to_str()).unwrap_or_default().to_owned();
    (raw, name)
}

/// Refuses to write a `.mhd` whose file of samples is there and not its own: another header's
/// samples, or a file of any other kind, that nobody has asked to replace.
///
/// # Errors
/// [`FormatError::Io`] that names the file.
pub fn check_data_file(header: &Path) -> Result<(), FormatError> {
    let (raw, name) = data_file(header);
    let is_written_apart = lower_name(header).ends_with(".mhd");
    if !is_written_apart || raw.symlink_metadata().is_err() || names_data(header, &name) {
        return Ok(());
    }
    if is_left_by_killed_run(header, &raw, &name) {
        return std::fs::remove_file(&raw).map_err(|e| FormatError::io(&raw, e));
    }
    let why = format!(
        "it is there and {} does not name it; remove it or choose another name",
        shown(header)
    );
    Err(FormatError::io(&raw, io::Error::new(io::ErrorKind::AlreadyExists, why)))
}

/// Whether samples were given their name by a run that was killed before it named their header: its
/// temporary file is there, names them, and is younger.
fn is_left_by_killed_run(header: &Path, raw: &Path, name: &str) -> bool {
    let modified = |path: &Path| path.symlink_metadata().and_then(|m| m.modified());
    let Ok(written) = modified(raw) else { return false };
    abandoned(folder_of(header)).any(|(temporary, _locked)| {
        modified(&temporary).is_ok_and(|t| t >= written) && names_data(&temporary, name)
    })
}

/// Whether a header is there and its data file has this name.
fn names_data(header: &Path, name: &str) -> bool {
    let Ok(bytes) = prefix(header, MAX_HEADER) else { return false };
    let text = String::from_utf8_lossy(&bytes);
    let mut fields = text.lines().filter_map(|line| line.split_once('='));
    fields.any(|(key, value)| key.trim() == "ElementDataFile" && value.trim() == name)
}

fn header(grid: &Grid, sample_type: SampleType) -> String {
    let vector = |v: DVec3| format!("{} {} {}", v.x, v.y, v.z);
    let d = grid.direction;
    let msb = if cfg!(target_endian = "big") { "True" } else { "False" };
    let name = match sample_type {
        SampleType::I8 => "MET_CHAR",
        SampleType::U8 => "MET_UCHAR",
        SampleType::I16 => "MET_SHORT",
        SampleType::U16 => "MET_USHORT",
        SampleType::I32 => "MET_INT",
        SampleType::U32 => "MET_UINT",
        SampleType::I64 => "MET_LONG_LONG",
        SampleType::U64 => "MET_ULONG_LONG",
        SampleType::F32 => "MET_FLOAT",
        SampleType::F64 => "MET_DOUBLE",
    };
    format!(
        "ObjectType = Image\n\
         NDims = 3\n\
         BinaryData = True\n\
         BinaryDataByteOrderMSB = {msb}\n\
         TransformMatrix = {} {} {}\n\
         Offset = {}\n\
         ElementSpacing = {}\n\
         DimSize = {} {} {}\n\
         ElementType = {name}\n",
        vector(d.x_axis),
        vector(d.y_axis),
        vector(d.z_axis),
        vector(grid.origin_mm),
        vector(grid.spacing_mm),
        grid.dims.x,
        grid.dims.y,
        grid.dims.z,
    )
}
