//! VTK XML polygonal data in: polygons and strips of one piece.

use std::path::Path;

use glam::Vec3;

use super::vtk_data::{
    AppendedData, VtkContent, VtkEncoding, VtkNumbers, VtkStorage, VtkType, content,
};
use super::xml::{Event, attribute, events};
use super::{FormatError, RawMesh, Space};

/// No document of a surface holds more arrays; it bounds what a header takes.
const MAX_ARRAYS: usize = 1000;

/// A `DataArray` element.
struct ArrayTag<'a> {
    section: &'a str,
    name: &'a str,
    kind: Option<VtkType>,
    components: usize,
    stored: VtkStorage<'a>,
}

/// An array decoded.
struct DecodedArray<'a> {
    content: VtkContent<'a>,
    kind: VtkType,
    big_endian: bool,
}

impl DecodedArray<'_> {
    fn numbers(&self) -> VtkNumbers<'_> {
        self.content.numbers(self.kind, self.big_endian)
    }
}

struct VtpDocument<'a> {
    path: &'a Path,
    arrays: Vec<ArrayTag<'a>>,
    /// Name of the active normals.
    normals: &'a str,
    points: u64,
    appended: Option<AppendedData<'a>>,
    coding: VtkEncoding,
}

pub(super) fn read(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    let doc = VtpDocument::parse(path, bytes)?;
    raw.space = match doc.find("FieldData", |a| a.name == "SPACE") {
        Some(array) => doc.decoded(array).ok().and_then(|array| space(array.numbers())),
        None => None,
    };
    let points = doc.find("Points", |a| a.components == 3);
    let points = points.ok_or_else(|| FormatError::text(path, "Points", "no array of points"))?;
    let points = doc.decoded(points)?;
    let mut numbers = points.numbers();
    while let Some(xyz) = three(path, "Points", &mut numbers)? {
        raw.push_vertex(path, xyz)?;
    }
    if raw.vertex_count() as u64 != doc.points {
        let why = format!("the array of points holds {}", raw.vertex_count());
        return Err(FormatError::field(path, "NumberOfPoints", doc.points, why));
    }
    let normals = doc.find("PointData", |a| a.components == 3 && a.name == doc.normals);
    if let Some(array) = normals {
        let array = doc.decoded(array)?;
        let (mut numbers, mut count) = (array.numbers(), 0);
        while let Some(n) = three(path, "Normals", &mut numbers)? {
            count += 1;
            raw.push_normal(Vec3::from(n.map(|c| c as f32)));
        }
        if count != raw.vertex_count() {
            let why = format!("there are {} points", raw.vertex_count());
            return Err(FormatError::field(path, "number of normals", count, why));
        }
    }
    doc.cells(raw)
}

impl<'a> VtpDocument<'a> {
    fn parse(path: &'a Path, bytes: &'a [u8]) -> Result<Self, FormatError> {
        let bad = |field: &str, why: &str| Err(FormatError::text(path, field, why));
        let mark = b"<AppendedData";
        let end = bytes.windows(mark.len()).position(|w| w == mark).unwrap_or(bytes.len());
        let Ok(text) = std::str::from_utf8(&bytes[..end]) else {
            return bad("document", "not text");
        };
        let mut doc = VtpDocument {
            path,
            arrays: Vec::new(),
            normals: "Normals",
            points: 0,
            appended: None,
            coding: VtkEncoding { big_endian: false, word_bytes: 4, is_compressed: false },
        };
        let (mut section, mut in_array, mut in_key, mut pieces) = ("", false, false, 0);
        for event in events(text) {
            match event {
                Event::Open { name: "VTKFile", attributes, .. } => doc.file(attributes)?,
                Event::Open { name: "Piece", attributes, .. } => {
                    pieces += 1;
                    let count =
                        attribute(attributes, "NumberOfPoints").and_then(|n| n.parse().ok());
                    let Some(count) = count else { return bad("NumberOfPoints", "no number") };
                    doc.points = count;
                }
                // What a writer says of an array, such as its range, stands among its numbers.
                Event::Open { name: "InformationKey", empty, .. } => in_key = !empty,
                Event::Close("InformationKey") => in_key = false,
                _ if in_key => {}
                Event::Open { name: "DataArray" | "Array", attributes, empty } => {
                    if doc.arrays.len() == MAX_ARRAYS {
                        return bad("DataArray", "more arrays than any surface has");
                    }
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
                    let stored = doc.arrays.last_mut().map(|array| &mut array.stored);
                    if let Some(VtkStorage::Text(own) | VtkStorage::Inline(own)) = stored {
                        *own = text;
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
            doc.appended = Some(appended(path, &bytes[end..])?);
        }
        Ok(doc)
    }

    /// Reads the attributes of the outermost tag, which hold for all arrays.
    fn file(&mut self, attributes: &str) -> Result<(), FormatError> {
        if attribute(attributes, "type") != Some("PolyData") {
            return Err(FormatError::unsupported(self.path, "VTK data that is not polygonal"));
        }
        self.coding = VtkEncoding {
            big_endian: attribute(attributes, "byte_order") == Some("BigEndian"),
            word_bytes: match attribute(attributes, "header_type") {
                Some("UInt64") => 8,
                _ => 4,
            },
            is_compressed: match attribute(attributes, "compressor") {
                None | Some("") => false,
                Some("vtkZLibDataCompressor") => true,
                Some(other) => {
                    let known = ["vtkLZ4DataCompressor", "vtkLZMADataCompressor"];
                    let name = known.into_iter().find(|k| *k == other).unwrap_or("unknown");
                    let what = format!("VTK arrays of the compressor {name}; zlib's are read");
                    return Err(FormatError::unsupported(self.path, what));
                }
            },
        };
        Ok(())
    }

    fn find(&self, section: &str, is: impl Fn(&ArrayTag) -> bool) -> Option<&ArrayTag<'a>> {
        self.arrays.iter().find(|a| a.section == section && is(a))
    }

    fn decoded(&self, array: &ArrayTag<'a>) -> Result<DecodedArray<'a>, FormatError> {
        let unknown = || FormatError::text(self.path, "DataArray", "a type that is not known");
        let kind = array.kind.ok_or_else(unknown)?;
        let content = content(self.path, self.coding, kind, array.stored, self.appended)?;
        Ok(DecodedArray { content, kind, big_endian: self.coding.big_endian })
    }

    /// Polygons, then strips.
    fn cells(&self, raw: &mut RawMesh) -> Result<(), FormatError> {
        for section in ["Polys", "Strips"] {
            let part = |name: &str| self.find(section, |a| a.name == name);
            let (Some(corners), Some(offsets)) = (part("connectivity"), part("offsets")) else {
                continue;
            };
            let (corners, offsets) = (self.decoded(corners)?, self.decoded(offsets)?);
            let caps = self.find("CellData", |a| a.name == "Cap" && a.components == 1);
            let caps = caps.filter(|_| section == "Polys").map(|c| self.decoded(c)).transpose()?;
            // Where there are other cells too, theirs come among them.
            let caps = caps.filter(|c| c.numbers().count() == offsets.numbers().count());
            self.section(section, &corners, &offsets, caps.as_ref(), raw)?;
        }
        Ok(())
    }

    fn section(
        &self,
        section: &str,
        corners: &DecodedArray,
        offsets: &DecodedArray,
        caps: Option<&DecodedArray>,
        raw: &mut RawMesh,
    ) -> Result<(), FormatError> {
        let (is_strips, cell) = match section {
            "Strips" => (true, "strip"),
            _ => (false, "polygon"),
        };
        let bad = |what: &str, i: usize, why: &str| {
            FormatError::text(self.path, format!("{what} of {cell} {i}"), why)
        };
        let (mut corners, mut done) = (corners.numbers(), 0.0);
        let mut caps = caps.map(DecodedArray::numbers);
        for (i, end) in offsets.numbers().enumerate() {
            let end = end.filter(|e| *e >= done && e.fract() == 0.0);
            let end = end.ok_or_else(|| bad("offset", i, "not behind the one before"))?;
            let cap = match &mut caps {
                Some(c) => c.next().flatten().map(|c| c != 0.0).or(Some(false)),
                None => None,
            };
            raw.begin_polygon(cap);
            let (mut count, mut last) = (0, [0; 2]);
            while done < end {
                let v = corners.next().flatten();
                let fits = |v: &f64| *v >= 0.0 && *v < f64::from(u32::MAX) && v.fract() == 0.0;
                let v = v.filter(fits).ok_or_else(|| bad("vertex", i, "missing or no vertex"))?;
                let v = v as u32;
                if is_strips {
                    // Every other triangle of a strip is turned over.
                    match count {
                        0 | 1 => {}
                        n if n % 2 == 0 => raw.push_face([last[0], last[1], v], None),
                        _ => raw.push_face([last[1], last[0], v], None),
                    }
                    (count, last) = (count + 1, [last[1], v]);
                } else {
                    count = raw.polygon_vertex(v);
                }
                done += 1.0;
            }
            if count < 3 {
                let why = format!("a {cell} has three vertices or more");
                return Err(bad("offset", i, &why));
            }
        }
        Ok(())
    }
}

fn array<'a>(section: &'a str, attributes: &'a str) -> ArrayTag<'a> {
    let get = |name| attribute(attributes, name);
    let offset = get("offset").and_then(|o| o.trim().parse().ok());
    let stored = match (get("format"), offset) {
        (Some("appended"), Some(at)) => VtkStorage::AppendedData(at),
        (Some("ascii"), _) => VtkStorage::Text(""),
        (Some("binary"), _) => VtkStorage::Inline(""),
        _ => VtkStorage::Other,
    };
    let components = get("NumberOfComponents").and_then(|n| n.trim().parse().ok()).unwrap_or(1);
    let kind = get("type").and_then(VtkType::parse);
    ArrayTag { section, name: get("Name").unwrap_or(""), kind, components, stored }
}

/// Appended data without the mark before its first byte.
fn appended<'a>(path: &Path, tail: &'a [u8]) -> Result<AppendedData<'a>, FormatError> {
    let tag = tail.iter().position(|&b| b == b'>').unwrap_or(0);
    let name = std::str::from_utf8(&tail[..tag]).unwrap_or("");
    let encoding = name.split_once(' ').and_then(|(_, a)| attribute(a, "encoding"));
    let after = &tail[tag + 1..];
    let blanks = after.iter().take_while(|b| b.is_ascii_whitespace()).count();
    match (encoding, after[blanks..].split_first()) {
        (Some("raw"), Some((b'_', data))) => Ok(AppendedData::Raw(data)),
        (Some("base64"), Some((b'_', data))) => Ok(AppendedData::Base64(data)),
        (Some("raw" | "base64"), _) => {
            Err(FormatError::text(path, "AppendedData", "does not begin with `_`"))
        }
        _ => Err(FormatError::unsupported(path, "appended data that is neither raw nor base64")),
    }
}

/// The next three numbers of an array, if there are any more.
fn three(
    path: &Path,
    what: &str,
    numbers: &mut VtkNumbers,
) -> Result<Option<[f64; 3]>, FormatError> {
    let bad = || FormatError::text(path, what, "missing or no numbers");
    let Some(x) = numbers.next() else { return Ok(None) };
    let mut rest = || numbers.next().flatten().ok_or_else(bad);
    Ok(Some([x.ok_or_else(bad)?, rest()?, rest()?]))
}

/// The space that a string array names: its character codes, closed by a zero.
fn space(mut codes: VtkNumbers) -> Option<Space> {
    let mut name = [0u8; 3];
    for c in &mut name {
        *c = codes.next()?.map(|code| code as u8)?;
    }
    let ended = matches!(codes.next(), None | Some(Some(0.0)));
    std::str::from_utf8(&name).ok().filter(|_| ended)?.parse().ok()
}
