//! PLY: text and both byte orders in, binary little-endian out.

use std::path::Path;
use std::str::SplitAsciiWhitespace;

use glam::Vec3;

use super::{FormatError, Mesh, Raw, push_fan, space_tag, vertex};
use crate::formats::whole;

#[derive(Clone, Copy, Debug, PartialEq)]
enum Type {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Type {
    fn parse(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value of `size()` little-endian bytes, padded to eight.
    fn value(self, b: [u8; 8]) -> f64 {
        let low = u32::from_le_bytes([b[0], b[1], b[2], b[3]]);
        match self {
            Self::I8 => f64::from(low as i8),
            Self::U8 => f64::from(low as u8),
            Self::I16 => f64::from(low as i16),
            Self::U16 => f64::from(low as u16),
            Self::I32 => f64::from(low as i32),
            Self::U32 => f64::from(low),
            Self::F32 => f64::from(f32::from_bits(low)),
            Self::F64 => f64::from_le_bytes(b),
        }
    }
}

struct Property {
    name: String,
    /// Type of the count, for a list.
    list: Option<Type>,
    kind: Type,
}

struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

enum Body<'a> {
    Text(SplitAsciiWhitespace<'a>),
    Bytes { rest: &'a [u8], big_endian: bool },
}

impl Body<'_> {
    fn next(&mut self, kind: Type) -> Option<f64> {
        match self {
            Self::Text(words) => words.next()?.parse().ok(),
            Self::Bytes { rest, big_endian } => {
                let (head, tail) = rest.split_at_checked(kind.size())?;
                *rest = tail;
                let mut b = [0; 8];
                b[..head.len()].copy_from_slice(head);
                if *big_endian {
                    b[..head.len()].reverse();
                }
                Some(kind.value(b))
            }
        }
    }
}

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Raw, FormatError> {
    let mut raw = Raw::default();
    let (elements, mut body, size) = header(path, bytes, &mut raw)?;
    for element in &elements {
        // The least a row can take: a character and a separator a word, or the fixed bytes.
        let least: u64 = element.properties.iter().map(|p| least(p, &body)).sum();
        let wanted = element.count.saturating_mul(least);
        if wanted > size + 1 {
            let what = if element.name == "face" { "faces" } else { "vertices or other elements" };
            return Err(FormatError::Truncated {
                file: path.to_owned(),
                what,
                wanted,
                found: size,
            });
        }
        if least > 0 {
            rows(path, element, &mut body, &mut raw, size)?;
        }
    }
    if !elements.iter().any(|e| e.name == "face") && elements.iter().any(|e| e.name == "tristrips")
    {
        return Err(FormatError::unsupported(path, "PLY with triangle strips; faces are"));
    }
    Ok(raw)
}

fn least(p: &Property, body: &Body) -> u64 {
    match body {
        Body::Text(_) => 2,
        Body::Bytes { .. } => p.list.unwrap_or(p.kind).size() as u64,
    }
}

fn header<'a>(
    path: &Path,
    bytes: &'a [u8],
    raw: &mut Raw,
) -> Result<(Vec<Element>, Body<'a>, u64), FormatError> {
    let bad =
        |field: &str, value: &str, why: &str| Err(FormatError::field(path, field, value, why));
    let (mut rest, mut format, mut elements) = (bytes, String::new(), Vec::<Element>::new());
    for number in 0.. {
        let Some(end) = rest.iter().take(1 << 16).position(|&b| b == b'\n') else {
            return bad("header", "end_header", "not found");
        };
        let line = String::from_utf8_lossy(&rest[..end]);
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if number == 0 {
            if words != ["ply"] {
                return bad("first line", &line, "a PLY file starts with `ply`");
            }
            continue;
        }
        match words[..] {
            ["end_header"] => break,
            ["format", name, _] => format = name.to_owned(),
            ["comment" | "obj_info", ..] => raw.space = raw.space.or(space_tag(&line)),
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return bad("element count", count, "no count");
                };
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref kind @ .., name] => {
                let types: Option<Vec<Type>> =
                    kind.iter().skip_while(|&&k| k == "list").map(|k| Type::parse(k)).collect();
                let (list, kind) = match (kind.first(), types.as_deref()) {
                    (Some(&"list"), Some(&[count, kind])) => (Some(count), kind),
                    (Some(&first), Some(&[kind])) if first != "list" => (None, kind),
                    _ => return bad("property", &line, "its type is unknown"),
                };
                let Some(element) = elements.last_mut() else {
                    return bad("property", &line, "stands before any element");
                };
                element.properties.push(Property { name: name.to_owned(), list, kind });
            }
            [] => {}
            _ => return bad("header line", &line, "not understood"),
        }
    }
    let body = match format.as_str() {
        "ascii" => match std::str::from_utf8(rest) {
            Ok(text) => Body::Text(text.split_ascii_whitespace()),
            Err(_) => return bad("format", "ascii", "but the data is not text"),
        },
        "binary_little_endian" => Body::Bytes { rest, big_endian: false },
        "binary_big_endian" => Body::Bytes { rest, big_endian: true },
        _ => return bad("format", &format, "not ascii, binary_little_endian or binary_big_endian"),
    };
    Ok((elements, body, rest.len() as u64))
}

/// Reads the rows of one element: vertices and faces are kept, the rest is skipped.
fn rows(
    path: &Path,
    element: &Element,
    body: &mut Body,
    raw: &mut Raw,
    size: u64,
) -> Result<(), FormatError> {
    let name = element.name.as_str();
    // Where each property goes: a slot of the row, or nowhere.
    let slots: Vec<Option<usize>> = element
        .properties
        .iter()
        .map(|p| match p.list {
            None if name == "vertex" => {
                ["x", "y", "z", "nx", "ny", "nz"].iter().position(|s| *s == p.name)
            }
            Some(_) if name == "face" => {
                ["vertex_indices", "vertex_index"].contains(&&*p.name).then_some(0)
            }
            _ => None,
        })
        .collect();
    let has = |slot| slots.contains(&Some(slot));
    if name == "vertex" && element.count > 0 && !(has(0) && has(1) && has(2)) {
        return Err(FormatError::field(path, "element", "vertex", "lacks x, y or z"));
    }
    if name == "face" && element.count > 0 && !has(0) {
        return Err(FormatError::field(path, "element", "face", "lacks a list vertex_indices"));
    }
    let normals = has(3) && has(4) && has(5);
    let mut polygon = Vec::new();
    for i in 0..element.count as usize {
        let cut = || {
            let value = format!("{name} {i} of {}", element.count);
            FormatError::field(
                path,
                "row",
                value,
                format!("missing or no number ({size} bytes of data)"),
            )
        };
        let mut row = [0.0; 6];
        for (p, slot) in element.properties.iter().zip(&slots) {
            let Some(count) = p.list else {
                let value = body.next(p.kind).ok_or_else(cut)?;
                if let Some(slot) = slot {
                    row[*slot] = value;
                }
                continue;
            };
            let count = body.next(count).ok_or_else(cut)?;
            if !(count >= 0.0 && count.fract() == 0.0 && count <= size as f64) {
                return Err(FormatError::field(
                    path,
                    format!("list length in {name} {i}"),
                    count,
                    "no length",
                ));
            }
            polygon.clear();
            for _ in 0..count as u64 {
                let v = body.next(p.kind).ok_or_else(cut)?;
                if slot.is_some() {
                    if !(v >= 0.0 && v < f64::from(u32::MAX) && v.fract() == 0.0) {
                        return Err(FormatError::field(
                            path,
                            format!("vertex of face {i}"),
                            v,
                            "no vertex",
                        ));
                    }
                    polygon.push(v as u32);
                }
            }
            if slot.is_some() {
                push_fan(raw, &polygon);
            }
        }
        if name == "vertex" {
            raw.positions.push(vertex(path, i, [row[0], row[1], row[2]])?);
            if normals {
                raw.normals.push(Vec3::new(row[3] as f32, row[4] as f32, row[5] as f32));
            }
        }
    }
    Ok(())
}

pub(super) fn write(path: &Path, mesh: &Mesh) -> Result<(), FormatError> {
    let with_normals = !mesh.normals.is_empty();
    whole::write_whole(path, |out| {
        writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment SPACE=LPS\ncomment units mm")?;
        writeln!(out, "element vertex {}", mesh.positions.len())?;
        let normal = if with_normals { &["nx", "ny", "nz"][..] } else { &[] };
        for name in ["x", "y", "z"].iter().chain(normal) {
            writeln!(out, "property float {name}")?;
        }
        writeln!(out, "element face {}", mesh.faces.len())?;
        writeln!(out, "property list uchar int vertex_indices\nend_header")?;
        for (i, p) in mesh.positions.iter().enumerate() {
            for c in
                p.to_array().iter().chain(mesh.normals.get(i).map_or(&[0.0; 0][..], |n| n.as_ref()))
            {
                out.write_all(&c.to_le_bytes())?;
            }
        }
        for f in &mesh.faces {
            let mut row = [3; 13];
            for (bytes, v) in row[1..].chunks_exact_mut(4).zip(f) {
                bytes.copy_from_slice(&v.to_le_bytes());
            }
            out.write_all(&row)?;
        }
        Ok(())
    })
}
