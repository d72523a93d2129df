//! VTK XML polygonal data in: text arrays and arrays appended as raw bytes, not compressed.

use std::path::Path;
use std::str::SplitAsciiWhitespace;

use glam::Vec3;

use super::xml::{Event, attribute, events};
use super::{FormatError, RawMesh, Space};

/// No document of a surface holds more arrays; it bounds what a header takes.
const MAX_ARRAYS: usize = 1000;

/// A number type of VTK.
#[derive(Clone, Copy, PartialEq)]
enum Type {
    Signed(usize),
    Unsigned(usize),
    Float32,
    Float64,
}

impl Type {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "Int8" => Self::Signed(1),
            "Int16" => Self::Signed(2),
            "Int32" => Self::Signed(4),
            "Int64" => Self::Signed(8),
            "UInt8" => Self::Unsigned(1),
            "UInt16" => Self::Unsigned(2),
            "UInt32" => Self::Unsigned(4),
            "UInt64" => Self::Unsigned(8),
            "Float32" => Self::Float32,
            "Float64" => Self::Float64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::Signed(n) | Self::Unsigned(n) => n,
            Self::Float32 => 4,
            Self::Float64 => 8,
        }
    }

    /// The value of `size()` bytes; of integers beyond 2^53 the nearest.
    fn value(self, stored: &[u8], big_endian: bool) -> f64 {
        let mut b = [0; 8];
        b[..stored.len()].copy_from_slice(stored);
        if big_endian {
            b[..stored.len()].reverse();
        }
        let bits = u64::from_le_bytes(b);
        match self {
            Self::Signed(n) => {
                let unused = 64 - 8 * n as u32;
                ((bits << unused) as i64 >> unused) as f64
            }
            Self::Unsigned(_) => bits as f64,
            Self::Float32 => f64::from(f32::from_bits(bits as u32)),
            Self::Float64 => f64::from_bits(bits),
        }
    }
}

/// A `DataArray` element.
struct Array<'a> {
    section: &'a str,
    name: &'a str,
    kind: Option<Type>,
    components: usize,
    data: Data<'a>,
}

enum Data<'a> {
    Text(&'a str),
    /// Place in the appended data.
    Appended(u64),
    Other,
}

/// The numbers of an array.
enum Numbers<'a> {
    Text(SplitAsciiWhitespace<'a>),
    Bytes { bytes: &'a [u8], kind: Type, big_endian: bool },
}

impl Iterator for Numbers<'_> {
    /// `None` inside where a word is no number.
    type Item = Option<f64>;
    fn next(&mut self) -> Option<Option<f64>> {
        match self {
            Self::Text(words) => words.next().map(|w| w.parse().ok()),
            Self::Bytes { bytes, kind, big_endian } => {
                let (head, tail) = bytes.split_at_checked(kind.size())?;
                *bytes = tail;
                Some(Some(kind.value(head, *big_endian)))
            }
        }
    }
}

struct Document<'a> {
    path: &'a Path,
    arrays: Vec<Array<'a>>,
    /// Name of the active normals.
    normals: &'a str,
    space: Option<Space>,
    points: u64,
    appended: Option<&'a [u8]>,
    big_endian: bool,
    /// Bytes of the length before an appended block.
    length_bytes: usize,
}

pub(super) fn read(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    let doc = Document::parse(path, bytes)?;
    raw.space = doc.space;
    let points = doc.find("Points", |a| a.components == 3);
    let points = points.ok_or_else(|| FormatError::text(path, "Points", "no array of points"))?;
    let mut numbers = doc.numbers(points)?;
    while let Some(xyz) = three(path, "Points", &mut numbers)? {
        raw.push_vertex(path, xyz)?;
    }
    if raw.vertex_count() as u64 != doc.points {
        let why = format!("the array of points holds {}", raw.vertex_count());
        return Err(FormatError::field(path, "NumberOfPoints", doc.points, why));
    }
    let normals = doc.find("PointData", |a| a.components == 3 && a.name == doc.normals);
    if let Some(array) = normals {
        let (mut numbers, mut count) = (doc.numbers(array)?, 0);
        while let Some(n) = three(path, "Normals", &mut numbers)? {
            count += 1;
            raw.push_normal(Vec3::from(n.map(|c| c as f32)));
        }
        if count != raw.vertex_count() {
            let why = format!("there are {} points", raw.vertex_count());
            return Err(FormatError::field(path, "number of normals", count, why));
        }
    }
    doc.polygons(raw)
}

impl<'a> Document<'a> {
    fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self, FormatError> {
        let bad = |field: &str, why: &str| Err(FormatError::text(path, field, why));
        let mark = b"<AppendedData";
        let end = bytes.windows(mark.len()).position(|w| w == mark).unwrap_or(bytes.len());
        let Ok(text) = std::str::from_utf8(&bytes[..end]) else {
            return bad("document", "not text");
        };
        let mut doc = Document {
            path,
            arrays: Vec::new(),
            normals: "Normals",
            space: None,
            points: 0,
            appended: None,
            big_endian: false,
            length_bytes: 4,
        };
        let (mut section, mut in_array, mut pieces, mut tag) = ("", false, 0, false);
        for event in events(text) {
            match event {
                Event::Open { name: "VTKFile", attributes, .. } => doc.file(attributes)?,
                Event::Open { name: "Piece", attributes, .. } => {
                    pieces += 1;
                    let count =
                        attribute(attributes, "NumberOfPoints").and_then(|n| n.parse().ok());
                    let Some(count) = count else { return bad("NumberOfPoints", "no number") };
                    doc.points = count;
                    let strips = attribute(attributes, "NumberOfStrips").unwrap_or("0");
                    if strips.trim() != "0" {
                        let what = "triangle strips; polygons are";
                        return Err(FormatError::unsupported(path, what));
                    }
                }
                Event::Open { name: name @ ("DataArray" | "Array"), attributes, empty } => {
                    if doc.arrays.len() == MAX_ARRAYS {
                        return bad("DataArray", "more arrays than any surface has");
                    }
                    tag = name == "Array" && attribute(attributes, "Name") == Some("SPACE");
                    in_array = !empty;
                    doc.arrays.push(array(section, attributes));
                }
                Event::Open { name, attributes, empty } if !empty => {
                    section = name;
                    if name == "PointData" {
                        doc.normals = attribute(attributes, "Normals").unwrap_or("Normals");
                    }
                }
                Event::Text(text) if in_array => {
                    if tag {
                        doc.space = space(text);
                    }
                    if let Some(Array { data: data @ Data::Text(_), .. }) = doc.arrays.last_mut() {
                        *data = Data::Text(text);
                    }
                }
                Event::Close("DataArray" | "Array") => in_array = false,
                _ => {}
            }
        }
        if pieces != 1 {
            let what = format!("polygonal data in {pieces} pieces; one is");
            return Err(FormatError::unsupported(path, what));
        }
        if end < bytes.len() {
            doc.appended = Some(raw_data(path, &bytes[end..])?);
        }
        Ok(doc)
    }

    /// What the outermost tag says of all arrays.
    fn file(&mut self, attributes: &str) -> Result<(), FormatError> {
        if attribute(attributes, "type") != Some("PolyData") {
            return Err(FormatError::unsupported(self.path, "VTK data that is not polygonal"));
        }
        if attribute(attributes, "compressor").is_some() {
            let what = "compressed VTK arrays; write them as raw or text without a compressor";
            return Err(FormatError::unsupported(self.path, what));
        }
        self.big_endian = attribute(attributes, "byte_order") == Some("BigEndian");
        self.length_bytes =
            if attribute(attributes, "header_type") == Some("UInt64") { 8 } else { 4 };
        Ok(())
    }

    fn find(&self, section: &str, is: impl Fn(&Array) -> bool) -> Option<&Array<'a>> {
        self.arrays.iter().find(|a| a.section == section && is(a))
    }

    fn numbers(&self, array: &Array<'a>) -> Result<Numbers<'a>, FormatError> {
        let Some(kind) = array.kind else {
            return Err(FormatError::text(self.path, "DataArray", "a type that is not known"));
        };
        match (&array.data, self.appended) {
            (Data::Text(text), _) => Ok(Numbers::Text(text.split_ascii_whitespace())),
            (Data::Appended(at), Some(all)) => {
                let bytes = self.block(*at, all)?;
                if bytes.len() % kind.size() != 0 {
                    let why = "not a whole number of values";
                    return Err(FormatError::field(
                        self.path,
                        "bytes of an array",
                        bytes.len(),
                        why,
                    ));
                }
                Ok(Numbers::Bytes { bytes, kind, big_endian: self.big_endian })
            }
            _ => {
                let what = "this encoding of VTK arrays; raw appended data and text are";
                Err(FormatError::unsupported(self.path, what))
            }
        }
    }

    /// An appended block: its length, then its bytes.
    fn block(&self, at: u64, all: &'a [u8]) -> Result<&'a [u8], FormatError> {
        let found = all.len() as u64;
        let cut = |wanted: u64| {
            let file = self.path.to_owned();
            FormatError::Truncated { file, what: "appended data", wanted, found }
        };
        let start = at.saturating_add(self.length_bytes as u64);
        let rest = usize::try_from(at).ok().and_then(|at| all.get(at..));
        let (length, rest) =
            rest.and_then(|r| r.split_at_checked(self.length_bytes)).ok_or_else(|| cut(start))?;
        let mut b = [0; 8];
        b[..length.len()].copy_from_slice(length);
        if self.big_endian {
            b[..length.len()].reverse();
        }
        let length = u64::from_le_bytes(b);
        let bytes = usize::try_from(length).ok().and_then(|n| rest.get(..n));
        bytes.ok_or_else(|| cut(start.saturating_add(length)))
    }

    fn polygons(&self, raw: &mut RawMesh) -> Result<(), FormatError> {
        let part = |name: &str| self.find("Polys", |a| a.name == name);
        let (Some(corners), Some(offsets)) = (part("connectivity"), part("offsets")) else {
            return Ok(());
        };
        let bad = |what: &str, i: usize, why: &str| {
            FormatError::text(self.path, format!("{what} of polygon {i}"), why)
        };
        let caps = self.find("CellData", |a| a.name == "Cap" && a.components == 1);
        let polygons = self.numbers(offsets)?.count();
        let caps = match caps {
            // Where there are other cells too, theirs come among them.
            Some(c) if self.numbers(c)?.count() == polygons => Some(self.numbers(c)?),
            _ => None,
        };
        let (mut corners, mut caps, mut done) = (self.numbers(corners)?, caps, 0.0);
        for (i, end) in self.numbers(offsets)?.enumerate() {
            let end = end.filter(|e| *e >= done && e.fract() == 0.0);
            let end = end.ok_or_else(|| bad("offset", i, "not behind the one before"))?;
            let cap = match &mut caps {
                Some(c) => c.next().flatten().map(|c| c != 0.0).or(Some(false)),
                None => None,
            };
            raw.begin_polygon(cap);
            let mut count = 0;
            while done < end {
                let v = corners.next().flatten();
                let fits = |v: &f64| *v >= 0.0 && *v < f64::from(u32::MAX) && v.fract() == 0.0;
                let v = v.filter(fits).ok_or_else(|| bad("vertex", i, "missing or no vertex"))?;
                count = raw.polygon_vertex(v as u32);
                done += 1.0;
            }
            if count < 3 {
                return Err(bad("offset", i, "a polygon has three vertices or more"));
            }
        }
        Ok(())
    }
}

fn array<'a>(section: &'a str, attributes: &'a str) -> Array<'a> {
    let get = |name| attribute(attributes, name);
    let offset = get("offset").and_then(|o| o.trim().parse().ok());
    let data = match (get("format"), offset) {
        (Some("appended"), Some(at)) => Data::Appended(at),
        (Some("ascii"), _) => Data::Text(""),
        _ => Data::Other,
    };
    let components = get("NumberOfComponents").and_then(|n| n.trim().parse().ok()).unwrap_or(1);
    let kind = get("type").and_then(Type::parse);
    Array { section, name: get("Name").unwrap_or(""), kind, components, data }
}

/// The bytes of raw appended data, without the mark before the first.
fn raw_data<'a>(path: &Path, tail: &'a [u8]) -> Result<&'a [u8], FormatError> {
    let tag = tail.iter().position(|&b| b == b'>').unwrap_or(0);
    let name = std::str::from_utf8(&tail[..tag]).unwrap_or("");
    if name.split_once(' ').is_none_or(|(_, a)| attribute(a, "encoding") != Some("raw")) {
        let what = "appended data that is not raw";
        return Err(FormatError::unsupported(path, what));
    }
    let after = &tail[tag + 1..];
    let blanks = after.iter().take_while(|b| b.is_ascii_whitespace()).count();
    match after[blanks..].split_first() {
        Some((b'_', data)) => Ok(data),
        _ => Err(FormatError::text(path, "AppendedData", "does not begin with `_`")),
    }
}

/// The next three numbers of an array, if there are any more.
fn three(path: &Path, what: &str, numbers: &mut Numbers) -> Result<Option<[f64; 3]>, FormatError> {
    let bad = || FormatError::text(path, what, "missing or no numbers");
    let Some(x) = numbers.next() else { return Ok(None) };
    let mut rest = || numbers.next().flatten().ok_or_else(bad);
    Ok(Some([x.ok_or_else(bad)?, rest()?, rest()?]))
}

/// The space that a string array names: its character codes, closed by a zero.
fn space(codes: &str) -> Option<Space> {
    let mut words = codes.split_ascii_whitespace().map(|w| w.parse().ok());
    let mut name = [0u8; 3];
    for c in &mut name {
        *c = words.next()??;
    }
    let ended = matches!(words.next(), None | Some(Some(0)));
    std::str::from_utf8(&name).ok().filter(|_| ended)?.parse().ok()
}
