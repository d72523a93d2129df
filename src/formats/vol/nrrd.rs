//! NRRD in: `.nrrd`, and `.nhdr` with its data file.

use std::collections::{BTreeMap, HashMap};
use std::io::{BufRead, BufReader};
use std::path::Path;

use glam::{DMat3, DVec3};

use super::FormatError;
use super::affine::{RAS, grid_from_steps};
use super::info::SegmentInfo;
use super::layout::{Encoding, Layout, must_swap};
use super::segments::printable;
use super::source::{DataFile, prefix, sibling};
use super::text::{MAX_HEADER, field_value, mm_per, number, numbers};
use crate::volume::{Grid, Rescale, SampleType};

/// The fields that are read, lower case and without blanks. Others are passed over and take no
/// memory, however many there are.
const FIELDS: [&str; 19] = [
    "axismins",
    "byteskip",
    "centerings",
    "centers",
    "datafile",
    "dimension",
    "encoding",
    "endian",
    "kinds",
    "lineskip",
    "sizes",
    "space",
    "spacedimension",
    "spacedirections",
    "spaceorigin",
    "spaceunits",
    "spacings",
    "type",
    "units",
];

/// Largest number of a segment.
const MAX_SEGMENTS: usize = 1 << 16;

/// Segment of a segmentation, from the keys `Segment<N>_…` (3D Slicer's `.seg.nrrd`).
#[derive(Default)]
struct SegmentFields {
    name: String,
    label: Option<i64>,
    layer: Option<usize>,
}

/// The fields of a header that are read.
struct NrrdHeader<'a> {
    path: &'a Path,
    fields: HashMap<&'static str, String>,
    /// Segments by the number in their keys.
    segments: BTreeMap<usize, SegmentFields>,
    /// First byte behind the blank line; `None` where the header ends with the file.
    end: Option<u64>,
}

impl<'a> NrrdHeader<'a> {
    fn read(path: &'a Path) -> Result<Self, FormatError> {
        let bytes = prefix(path, MAX_HEADER)?;
        if !bytes.starts_with(b"NRRD000") {
            return Err(FormatError::text(path, "magic", "a NRRD file begins NRRD000"));
        }
        let mut fields = HashMap::new();
        let mut segments = BTreeMap::new();
        let mut end = None;
        let mut at = 0u64;
        for (n, line) in bytes.split_inclusive(|&b| b == b'\n').enumerate() {
            at += line.len() as u64;
            let line = String::from_utf8_lossy(line);
            let line = line.trim_end_matches(['\n', '\r']);
            if line.is_empty() {
                end = Some(at);
                break;
            }
            if n == 0 || line.starts_with('#') {
                continue;
            }
            match line.split_once(':') {
                // `key:=value` pairs are free text: only those of segments are looked at.
                Some((key, value)) if value.starts_with('=') => {
                    segment_key(&mut segments, key, &value[1..]);
                }
                Some((name, value)) => {
                    let name: String = name.split_whitespace().collect();
                    let name = name.to_ascii_lowercase();
                    // The names of the files stand in the lines that follow.
                    if name == "datafile" && value.trim_start().starts_with("LIST") {
                        let what = "`data file: LIST`, samples in several files";
                        return Err(FormatError::unsupported(path, what));
                    }
                    if let Some(known) = FIELDS.into_iter().find(|f| *f == name) {
                        fields.insert(known, field_value(path, known, value)?);
                    }
                }
                None => {
                    let why = "neither a field nor a comment";
                    return Err(FormatError::text(path, format!("line {}", n + 1), why));
                }
            }
        }
        Ok(Self { path, fields, segments, end })
    }

    /// The named segments. Files of older versions of 3D Slicer have a layer of zeros and ones for
    /// each segment and say neither label nor layer.
    fn segments(&self, layers: usize) -> Vec<SegmentInfo> {
        let info = |(n, s): (&usize, &SegmentFields)| {
            let layer = s.layer.unwrap_or(if layers > 1 { *n } else { 0 });
            let label = s.label.unwrap_or(if layers > 1 { 1 } else { *n as i64 + 1 });
            SegmentInfo { name: s.name.clone(), label, layer }
        };
        self.segments.iter().filter(|(_, s)| !s.name.is_empty()).map(info).collect()
    }

    fn get(&self, name: &str) -> Option<&str> {
        let name = name.replace(' ', "");
        debug_assert!(FIELDS.contains(&&*name), "{name} is not kept");
        self.fields.get(&*name).map(String::as_str)
    }

    fn need(&self, name: &str) -> Result<&str, FormatError> {
        self.get(name).ok_or_else(|| FormatError::field(self.path, name, "absent", "needed"))
    }

    fn bad(&self, name: &str, why: &str) -> FormatError {
        FormatError::text(self.path, name, why)
    }
}

/// Takes a key `Segment<N>_Name`, `_LabelValue` or `_Layer`; others say nothing of the voxels.
fn segment_key(segments: &mut BTreeMap<usize, SegmentFields>, key: &str, value: &str) {
    let parts = key.trim().strip_prefix("Segment").and_then(|k| k.split_once('_'));
    let Some((number, what)) = parts else { return };
    let Some(number) = number.parse().ok().filter(|n| *n < MAX_SEGMENTS) else { return };
    if !["Name", "LabelValue", "Layer"].contains(&what) {
        return;
    }
    let (segment, value) = (segments.entry(number).or_default(), value.trim());
    match what {
        "Name" => segment.name = printable(value),
        "Layer" => segment.layer = value.parse().ok(),
        _ => segment.label = value.parse().ok(),
    }
}

pub(super) fn layout(path: &Path) -> Result<Layout, FormatError> {
    let h = NrrdHeader::read(path)?;
    let mut notes = Vec::new();
    let sample_type = sample_type(&h)?;
    let encoding = encoding(&h)?;
    let (grid, layers, volumes) = geometry(&h, &mut notes)?;
    let segments = h.segments(layers);
    let (file, start) = match h.get("data file") {
        Some(name) if name.contains('%') => {
            let what = "`data file` with a pattern, samples in several files";
            return Err(FormatError::unsupported(path, what));
        }
        Some(name) => (sibling(path, "data file", name)?, 0),
        None => (path.to_owned(), h.end.ok_or_else(|| no_end(path))?),
    };
    let (offset, skip) = offset(&h, &file, start, encoding)?;
    let swap = match h.get("endian").map(str::to_ascii_lowercase).as_deref() {
        Some("little") => must_swap(false),
        Some("big") => must_swap(true),
        Some(_) => return Err(h.bad("endian", "neither little nor big")),
        None if sample_type.size() == 1 || encoding == Encoding::Ascii => false,
        None => return Err(h.bad("endian", "absent, and a sample has several bytes")),
    };
    let (format, rescale) = ("NRRD", Rescale::IDENTITY);
    let path = path.to_owned();
    Ok(Layout {
        format,
        grid,
        sample_type,
        layers,
        volumes,
        segments,
        rescale,
        path,
        file,
        offset,
        skip,
        encoding,
        swap,
        notes,
    })
}

fn no_end(path: &Path) -> FormatError {
    FormatError::text(path, "header", "no blank line ends it and no data file is named")
}

fn sample_type(h: &NrrdHeader) -> Result<SampleType, FormatError> {
    let name = h.need("type")?;
    let words: Vec<String> = name.split_whitespace().map(str::to_ascii_lowercase).collect();
    Ok(match words.join(" ").as_str() {
        "signed char" | "int8" | "int8_t" => SampleType::I8,
        "uchar" | "unsigned char" | "uint8" | "uint8_t" => SampleType::U8,
        "short" | "short int" | "signed short" | "signed short int" | "int16" | "int16_t" => {
            SampleType::I16
        }
        "ushort" | "unsigned short" | "unsigned short int" | "uint16" | "uint16_t" => {
            SampleType::U16
        }
        "int" | "signed int" | "int32" | "int32_t" => SampleType::I32,
        "uint" | "unsigned int" | "uint32" | "uint32_t" => SampleType::U32,
        "longlong"
        | "long long"
        | "long long int"
        | "signed long long"
        | "signed long long int"
        | "int64"
        | "int64_t" => SampleType::I64,
        "ulonglong" | "unsigned long long" | "unsigned long long int" | "uint64" | "uint64_t" => {
            SampleType::U64
        }
        "float" => SampleType::F32,
        "double" => SampleType::F64,
        "block" => return Err(FormatError::unsupported(h.path, "type `block`")),
        _ => return Err(h.bad("type", "not a NRRD sample type")),
    })
}

fn encoding(h: &NrrdHeader) -> Result<Encoding, FormatError> {
    let name = h.need("encoding")?;
    Ok(match name.to_ascii_lowercase().as_str() {
        "raw" => Encoding::Raw,
        "gzip" | "gz" => Encoding::Gzip,
        "ascii" | "text" | "txt" => Encoding::Ascii,
        "bzip2" | "bz2" => {
            return Err(FormatError::unsupported(h.path, "encoding bzip2; use gzip or raw"));
        }
        "hex" => return Err(FormatError::unsupported(h.path, "encoding hex; use gzip or raw")),
        _ => return Err(h.bad("encoding", "not a NRRD encoding")),
    })
}

/// First byte of the samples (`None`: they end with the file) and decoded bytes to pass over.
fn offset(
    h: &NrrdHeader,
    file: &Path,
    start: u64,
    encoding: Encoding,
) -> Result<(Option<u64>, u64), FormatError> {
    let lines: u64 = h.get("line skip").map_or(Ok(0), |v| number(h.path, "line skip", v))?;
    let bytes: i64 = h.get("byte skip").map_or(Ok(0), |v| number(h.path, "byte skip", v))?;
    let mut at = start;
    let mut input = BufReader::new(DataFile::open_at(file, start)?);
    for _ in 0..lines {
        let mut line = Vec::new();
        let n = input.read_until(b'\n', &mut line).map_err(|e| FormatError::io(h.path, e))?;
        if n == 0 {
            let why = "more lines than the file has";
            return Err(FormatError::field(h.path, "line skip", lines, why));
        }
        at += n as u64;
    }
    let bad = |why: &str| FormatError::field(h.path, "byte skip", bytes, why);
    match (encoding, u64::try_from(bytes)) {
        (Encoding::Raw, Err(_)) if bytes == -1 => Ok((None, 0)),
        (Encoding::Raw, Err(_)) => Err(bad("only -1 may be negative")),
        (_, Err(_)) => Err(bad("samples at the end of the file are of encoding raw alone")),
        (Encoding::Gzip, Ok(n)) => Ok((Some(at), n)),
        (_, Ok(n)) => {
            let too_far = || bad("beyond the end of the file");
            Ok((Some(at.checked_add(n).ok_or_else(too_far)?), 0))
        }
    }
}

/// The grid, how many samples a voxel has, and how many volumes there are.
fn geometry(h: &NrrdHeader, notes: &mut Vec<String>) -> Result<(Grid, usize, usize), FormatError> {
    let axes: usize = number(h.path, "dimension", h.need("dimension")?)?;
    if !(1..=16).contains(&axes) {
        return Err(FormatError::field(h.path, "dimension", axes, "1 to 16 are possible"));
    }
    let sizes: Vec<u64> = numbers(h.path, "sizes", h.need("sizes")?, axes)?;
    let directions = h.get("space directions").map(|v| vectors(h, v, axes)).transpose()?;
    let (spatial, layers, volumes) = spatial_axes(h, &sizes, directions.as_deref())?;
    let (to_lps, described) = frame(h, notes)?;
    let pick = |v: &[f64]| DVec3::new(v[spatial[0]], v[spatial[1]], v[spatial[2]]);
    let (steps, unit) = if let Some(d) = &directions {
        let col = |i: usize| d[spatial[i]].unwrap_or(DVec3::ZERO);
        (DMat3::from_cols(col(0), col(1), col(2)), unit(h, "space units")?)
    } else if let Some(v) = h.get("spacings") {
        let spacings = numbers::<f64>(h.path, "spacings", v, axes)?;
        let s = pick(&spacings);
        if s.min_element() < 0.0 {
            return Err(h.bad("spacings", "negative; axes are turned by `space directions`"));
        }
        (DMat3::from_diagonal(s), unit(h, "units")?)
    } else {
        notes.push("the file gives no spacing; 1 mm is assumed".to_owned());
        (DMat3::IDENTITY, 1.0)
    };
    let origin = match (h.get("space origin"), h.get("axis mins")) {
        (Some(v), _) => vectors(h, v, 1)?[0].unwrap_or(DVec3::ZERO),
        (None, Some(v)) if !described => {
            let mins = numbers::<f64>(h.path, "axis mins", v, axes)?;
            // A cell's least place is its edge, a node's its middle.
            let edge = DVec3::from_array(std::array::from_fn(|k| {
                0.5 * f64::from(u8::from(!is_node(h, spatial[k]))) * steps.col(k)[k]
            }));
            let origin = pick(&mins) + edge;
            if origin.is_finite() { origin } else { DVec3::ZERO }
        }
        _ => DVec3::ZERO,
    };
    let dims = [sizes[spatial[0]], sizes[spatial[1]], sizes[spatial[2]]];
    Ok((grid_from_steps(h.path, dims, steps, origin, to_lps * unit)?, layers, volumes))
}

/// Whether samples along an axis lie at the ends of its range, not in the middle of cells.
fn is_node(h: &NrrdHeader, axis: usize) -> bool {
    let all = h.get("centers").or(h.get("centerings"));
    all.and_then(|all| all.split_whitespace().nth(axis)).is_some_and(|word| word == "node")
}

/// The three axes of space; the layers of a segmentation, its first axis beside those of space; and
/// the volumes along a last axis behind them. Every other axis must have size 1.
fn spatial_axes(
    h: &NrrdHeader,
    sizes: &[u64],
    directions: Option<&[Option<DVec3>]>,
) -> Result<([usize; 3], usize, usize), FormatError> {
    // Axes of vectors, colours and other values of one voxel.
    let values = ["domain", "space", "time", "none", "???", "stub"];
    let kinds: Vec<&str> = h.get("kinds").unwrap_or("").split_whitespace().collect();
    let of_values = |i: &usize| kinds.get(*i).is_some_and(|kind| !values.contains(kind));
    let last = sizes.len() - 1;
    let components = (0..sizes.len()).find(|i| of_values(i) && *i != last && sizes[*i] != 1);
    if let Some(axis) = components.filter(|_| h.segments.is_empty()) {
        let what = format!("vectors: axis {axis} holds {} values a voxel", sizes[axis]);
        return Err(FormatError::unsupported(h.path, what));
    }
    let mut spatial: Vec<usize> = match directions {
        Some(d) => (0..sizes.len()).filter(|&i| d[i].is_some()).collect(),
        None => (0..sizes.len()).collect(),
    };
    while directions.is_none() && spatial.len() > 3 {
        let one = spatial.iter().position(|&a| sizes[a] == 1);
        let is_apart = spatial.len() == 4 && (of_values(&last) || is_time(&kinds, last));
        let Some(i) = one.or(is_apart.then_some(3)) else { break };
        spatial.remove(i);
    }
    let extra = (0..sizes.len()).find(|i| !spatial.contains(i) && sizes[*i] != 1);
    match (<[usize; 3]>::try_from(spatial), extra) {
        (Ok(axes), None) => Ok((axes, 1, 1)),
        (Ok(axes @ [0, 1, 2]), Some(3)) => Ok((axes, 1, sizes[3] as usize)),
        (Ok(axes), Some(0))
            if !h.segments.is_empty() && (1..=MAX_SEGMENTS as u64).contains(&sizes[0]) =>
        {
            Ok((axes, sizes[0] as usize, 1))
        }
        (Ok(_), Some(axis)) => {
            let what = format!("axis {axis} holds {} values a voxel", sizes[axis]);
            Err(FormatError::unsupported(h.path, what))
        }
        (Err(axes), _) => {
            let what = format!("{} axes of space; a volume has 3", axes.len());
            Err(FormatError::unsupported(h.path, what))
        }
    }
}

/// Whether an axis is one of time.
fn is_time(kinds: &[&str], axis: usize) -> bool {
    kinds.get(axis).is_some_and(|kind| *kind == "time")
}

/// Signs from the file's space to LPS, and whether the file names a space at all.
fn frame(h: &NrrdHeader, notes: &mut Vec<String>) -> Result<(DVec3, bool), FormatError> {
    let Some(name) = h.get("space") else {
        if h.get("space dimension").is_some_and(|n| n != "3") {
            return Err(h.bad("space dimension", "a volume lies in 3"));
        }
        notes.push("the file gives no space; LPS is assumed".to_owned());
        return Ok((DVec3::ONE, h.get("space dimension").is_some()));
    };
    let signs = match name.to_ascii_lowercase().as_str() {
        "left-posterior-superior" | "lps" => DVec3::ONE,
        "right-anterior-superior" | "ras" => RAS,
        "left-anterior-superior" | "las" => DVec3::new(1.0, -1.0, 1.0),
        "scanner-xyz" | "3d-right-handed" => {
            notes.push("the space names no patient axes; LPS is assumed".to_owned());
            DVec3::ONE
        }
        "3d-left-handed" => {
            // Taken as LPS it would mirror the patient; LAS is the left-handed space with a name.
            notes.push("the space names no patient axes; LAS is assumed".to_owned());
            DVec3::new(1.0, -1.0, 1.0)
        }
        _ => return Err(h.bad("space", "not a space of three axes that is known")),
    };
    Ok((signs, true))
}

/// Millimetres in the file's unit; without one it is mm.
fn unit(h: &NrrdHeader, field: &str) -> Result<f64, FormatError> {
    let Some(value) = h.get(field) else { return Ok(1.0) };
    let mut found = None;
    for name in value.split(['"', ' ']).filter(|n| !n.is_empty() && *n != "none" && *n != "???") {
        let mm = mm_per(name).ok_or_else(|| h.bad(field, "not a unit of length"))?;
        if *found.get_or_insert(mm) != mm {
            return Err(h.bad(field, "the axes differ in unit"));
        }
    }
    Ok(found.unwrap_or(1.0))
}

/// `(x,y,z)` or `none`, `n` times.
fn vectors(h: &NrrdHeader, text: &str, n: usize) -> Result<Vec<Option<DVec3>>, FormatError> {
    let bad = || h.bad("space directions or origin", "expected vectors (x,y,z) or none");
    let mut out = Vec::new();
    let mut rest = text.trim();
    while !rest.is_empty() && out.len() <= n {
        if let Some(tail) = rest.strip_prefix("none") {
            out.push(None);
            rest = tail.trim_start();
            continue;
        }
        let (inner, tail) =
            rest.strip_prefix('(').and_then(|r| r.split_once(')')).ok_or_else(bad)?;
        let parts: Result<Vec<f64>, _> = inner.split(',').map(|p| p.trim().parse()).collect();
        match parts.as_deref() {
            Ok(&[x, y, z]) => out.push(Some(DVec3::new(x, y, z))),
            _ => return Err(bad()),
        }
        rest = tail.trim_start();
    }
    if out.len() == n { Ok(out) } else { Err(bad()) }
}
