//! MetaImage in: `.mha`, and `.mhd` with its data file.

use std::collections::HashMap;
use std::path::Path;

use glam::{DMat3, DVec3};

use super::FormatError;
use super::affine::grid;
use super::layout::{Encoding, Layout, must_swap};
use super::source::{prefix, sibling};
use super::text::{MAX_HEADER, field_value, mm_per, number, numbers};
use crate::volume::{Grid, Rescale, SampleType};

/// The fields that are read. Others are passed over and take no memory, however many there are.
const FIELDS: [&str; 22] = [
    "BinaryData",
    "BinaryDataByteOrderMSB",
    "CompressedData",
    "CompressedDataSize",
    "DimSize",
    "DistanceUnits",
    "ElementByteOrderMSB",
    "ElementDataFile",
    "ElementNumberOfChannels",
    "ElementSize",
    "ElementSpacing",
    "ElementToIntensityFunctionOffset",
    "ElementToIntensityFunctionSlope",
    "ElementType",
    "HeaderSize",
    "NDims",
    "Offset",
    "Orientation",
    "Origin",
    "Position",
    "Rotation",
    "TransformMatrix",
];

/// The fields of a header that are read.
struct MetaImageHeader<'a> {
    path: &'a Path,
    fields: HashMap<&'static str, String>,
    /// First byte behind the last line of the header.
    end: u64,
}

impl<'a> MetaImageHeader<'a> {
    fn read(path: &'a Path) -> Result<Self, FormatError> {
        let bytes = prefix(path, MAX_HEADER)?;
        let mut fields = HashMap::new();
        let mut end = 0u64;
        for (n, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
            end += line.len() as u64;
            let line = String::from_utf8_lossy(line);
            if line.trim().is_empty() {
                continue;
            }
            let Some((name, value)) = line.split_once('=') else {
                let field = format!("line {}", n + 1);
                return Err(FormatError::text(path, field, "expected `name = value`"));
            };
            let name = name.trim();
            if let Some(known) = FIELDS.into_iter().find(|f| *f == name) {
                fields.insert(known, field_value(path, known, value)?);
            }
            // This field closes the header; what follows may be samples.
            if name == "ElementDataFile" {
                return Ok(Self { path, fields, end });
            }
        }
        Err(FormatError::field(path, "ElementDataFile", "absent", "needed"))
    }

    /// The first of several names for the same field, with the name used.
    fn any<'n>(&self, names: &[&'n str]) -> Option<(&'n str, &str)> {
        names.iter().find_map(|n| Some((*n, self.get(n)?)))
    }

    fn get(&self, name: &str) -> Option<&str> {
        debug_assert!(FIELDS.contains(&name), "{name} is not kept");
        self.fields.get(name).map(String::as_str)
    }

    fn need(&self, name: &str) -> Result<&str, FormatError> {
        self.get(name).ok_or_else(|| FormatError::field(self.path, name, "absent", "needed"))
    }

    fn bad(&self, name: &str, why: &str) -> FormatError {
        FormatError::text(self.path, name, why)
    }

    fn yes(&self, names: &[&str]) -> Result<Option<bool>, FormatError> {
        match self.any(names) {
            None => Ok(None),
            Some((_, v)) if ["true", "1", "yes"].contains(&v.to_ascii_lowercase().as_str()) => {
                Ok(Some(true))
            }
            Some((_, v)) if ["false", "0", "no"].contains(&v.to_ascii_lowercase().as_str()) => {
                Ok(Some(false))
            }
            Some((name, _)) => Err(self.bad(name, "neither True nor False")),
        }
    }
}

pub(super) fn layout(path: &Path) -> Result<Layout, FormatError> {
    let h = MetaImageHeader::read(path)?;
    let mut notes = Vec::new();
    let channels = h.get("ElementNumberOfChannels").unwrap_or("1");
    if channels != "1" {
        let n: u32 = number(path, "ElementNumberOfChannels", channels)?;
        return Err(FormatError::unsupported(path, format!("{n} channels a voxel")));
    }
    let sample_type = sample_type(&h)?;
    let (file, start) = match h.need("ElementDataFile")? {
        "LOCAL" | "Local" | "local" => (path.to_owned(), h.end),
        name if name.starts_with("LIST") || name.contains('%') => {
            return Err(FormatError::unsupported(path, "ElementDataFile with several files"));
        }
        name => (sibling(path, "ElementDataFile", name)?, 0),
    };
    let packed = h.yes(&["CompressedData"])?.unwrap_or(false);
    let ascii = h.yes(&["BinaryData"])? == Some(false);
    let big = h.yes(&["BinaryDataByteOrderMSB", "ElementByteOrderMSB"])?.unwrap_or(false);
    let offset = match h.get("HeaderSize") {
        None | Some("0") => Some(start),
        Some("-1") if !packed && !ascii => None,
        Some(v) => {
            let n: u64 = number(path, "HeaderSize", v)?;
            let far = || h.bad("HeaderSize", "beyond the end of the file");
            Some(start.checked_add(n).ok_or_else(far)?)
        }
    };
    let encoding = match (packed, ascii) {
        (true, true) => return Err(h.bad("CompressedData", "True, where text is not compressed")),
        (true, false) if gzip_at(path, &file, offset)? => Encoding::Gzip,
        (true, false) => Encoding::Zlib,
        (false, true) => Encoding::Ascii,
        (false, false) => Encoding::Raw,
    };
    if let Some(v) = h.get("CompressedDataSize").filter(|_| packed) {
        let wanted: u64 = number(path, "CompressedDataSize", v)?;
        let len = super::source::DataFile::open(&file)?.len;
        let found = len.saturating_sub(offset.unwrap_or(0));
        if found < wanted {
            let (file, what) = (path.to_owned(), "compressed samples");
            return Err(FormatError::Truncated { file, what, wanted, found });
        }
    }
    Ok(Layout {
        format: "MetaImage",
        grid: geometry(&h, &mut notes)?,
        sample_type,
        layers: 1,
        volumes: 1,
        segments: Vec::new(),
        rescale: rescale(&h)?,
        path: path.to_owned(),
        file,
        offset,
        skip: 0,
        encoding,
        swap: must_swap(big),
        notes,
    })
}

/// Some writers put a gzip stream where a zlib stream belongs; the library's own reader takes both.
fn gzip_at(path: &Path, file: &Path, offset: Option<u64>) -> Result<bool, FormatError> {
    let mut source = super::source::DataFile::open_at(file, offset.unwrap_or(0))?;
    let mut magic = [0; 2];
    super::source::fill(&mut source, &mut magic).map_err(|e| FormatError::io(path, e))?;
    Ok(magic == [0x1f, 0x8b])
}

fn sample_type(h: &MetaImageHeader) -> Result<SampleType, FormatError> {
    let name = h.need("ElementType")?;
    Ok(match name {
        "MET_CHAR" | "MET_ASCII_CHAR" => SampleType::I8,
        "MET_UCHAR" => SampleType::U8,
        "MET_SHORT" => SampleType::I16,
        "MET_USHORT" => SampleType::U16,
        // Four bytes by MetaIO's own table, whatever the writer's `long` was.
        "MET_INT" | "MET_LONG" => SampleType::I32,
        "MET_UINT" | "MET_ULONG" => SampleType::U32,
        "MET_LONG_LONG" => SampleType::I64,
        "MET_ULONG_LONG" => SampleType::U64,
        "MET_FLOAT" => SampleType::F32,
        "MET_DOUBLE" => SampleType::F64,
        other if other.starts_with("MET_") && other.ends_with("_ARRAY") => {
            let what = "ElementType of an array, several values a voxel";
            return Err(FormatError::unsupported(h.path, what));
        }
        _ => return Err(h.bad("ElementType", "not a MetaImage sample type")),
    })
}

fn geometry(h: &MetaImageHeader, notes: &mut Vec<String>) -> Result<Grid, FormatError> {
    let n: usize = number(h.path, "NDims", h.need("NDims")?)?;
    if !(3..=4).contains(&n) {
        return Err(FormatError::unsupported(h.path, format!("NDims = {n}; a volume has 3")));
    }
    let dims: Vec<u64> = numbers(h.path, "DimSize", h.need("DimSize")?, n)?;
    if n == 4 && dims[3] != 1 {
        let what = format!("DimSize with {} frames", dims[3]);
        return Err(FormatError::unsupported(h.path, what));
    }
    let read = |(name, value): (&str, &str), count| numbers::<f64>(h.path, name, value, count);
    let first3 = |v: Vec<f64>| DVec3::new(v[0], v[1], v[2]);
    let spacing = match h.any(&["ElementSpacing", "ElementSize"]) {
        Some(field) => first3(read(field, n)?),
        None => {
            notes.push("the file gives no spacing; 1 mm is assumed".to_owned());
            DVec3::ONE
        }
    };
    let origin = match h.any(&["Offset", "Position", "Origin"]) {
        Some(field) => first3(read(field, n)?),
        None => DVec3::ZERO,
    };
    let direction = match h.any(&["TransformMatrix", "Rotation", "Orientation"]) {
        Some(field) => {
            let m = read(field, n * n)?;
            let row = |i: usize| DVec3::new(m[i * n], m[i * n + 1], m[i * n + 2]);
            DMat3::from_cols(row(0), row(1), row(2))
        }
        None => DMat3::IDENTITY,
    };
    let unit = match h.get("DistanceUnits") {
        None | Some("?" | "") => 1.0,
        Some(v) => mm_per(v).ok_or_else(|| h.bad("DistanceUnits", "not a unit of length"))?,
    };
    let dims = [dims[0], dims[1], dims[2]];
    grid(h.path, dims, spacing * unit, origin * unit, direction)
}

fn rescale(h: &MetaImageHeader) -> Result<Rescale, FormatError> {
    let read = |name: &str, none: f64| {
        let v = h.get(name).map_or(Ok(none), |v| number(h.path, name, v))?;
        if v.is_finite() { Ok(v) } else { Err(FormatError::field(h.path, name, v, "not finite")) }
    };
    let slope = read("ElementToIntensityFunctionSlope", 1.0)?;
    let intercept = read("ElementToIntensityFunctionOffset", 0.0)?;
    if slope == 0.0 {
        let (name, why) = ("ElementToIntensityFunctionSlope", "every value would be the same");
        return Err(FormatError::field(h.path, name, slope, why));
    }
    Ok(Rescale { slope, intercept })
}
