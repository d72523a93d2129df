//! The header of a PLY file, and its numbers.

use std::path::Path;
use std::str::SplitAsciiWhitespace;

use super::super::{FormatError, RawMesh, space_tag};

/// No surface declares more elements and properties; it bounds what a header takes.
const MAX_DECLARATIONS: usize = 1000;

/// A number type of PLY.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) enum Type {
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

    pub fn size(self) -> usize {
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

/// A column of an element.
pub(super) struct Property {
    pub name: String,
    /// Type of the count, for a list.
    pub list: Option<Type>,
    pub kind: Type,
}

/// A table of the file.
pub(super) struct Element {
    pub name: String,
    pub count: u64,
    pub properties: Vec<Property>,
}

/// Data after the header.
pub(super) enum Body<'a> {
    Text(SplitAsciiWhitespace<'a>),
    Bytes { rest: &'a [u8], big_endian: bool },
}

impl Body<'_> {
    /// The next number, if there is one.
    pub fn next(&mut self, kind: Type) -> Option<f64> {
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

/// Reads the header: elements, the data after it and its bytes. A tag of the comments goes to `raw`.
pub(super) fn header<'a>(
    path: &Path,
    bytes: &'a [u8],
    raw: &mut RawMesh,
) -> Result<(Vec<Element>, Body<'a>, u64), FormatError> {
    let bad = |field: &str, why: &str| Err(FormatError::text(path, field, why));
    let (mut rest, mut format, mut elements) = (bytes, String::new(), Vec::<Element>::new());
    let mut declarations = 0;
    for number in 0.. {
        let Some(end) = rest.iter().take(1 << 16).position(|&b| b == b'\n') else {
            return bad("header", "no end_header");
        };
        let line = String::from_utf8_lossy(&rest[..end]);
        rest = &rest[end + 1..];
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        if number == 0 {
            if words != ["ply"] {
                return bad("first line", "a PLY file starts with `ply`");
            }
            continue;
        }
        let place = format!("header line {}", number + 1);
        declarations += usize::from(matches!(words.first(), Some(&("element" | "property"))));
        if declarations > MAX_DECLARATIONS {
            return bad(&place, "more elements and properties than any surface has");
        }
        match words[..] {
            ["end_header"] => break,
            ["format", name, _] => format = name.to_owned(),
            ["comment" | "obj_info", ..] => raw.space = raw.space.or(space_tag(&line)),
            ["element", name, count] => {
                let Ok(count) = count.parse() else {
                    return bad("element count", "no count");
                };
                elements.push(Element { name: name.to_owned(), count, properties: Vec::new() });
            }
            ["property", ref kind @ .., name] => {
                let types: Option<Vec<Type>> =
                    kind.iter().skip_while(|&&k| k == "list").map(|k| Type::parse(k)).collect();
                let (list, kind) = match (kind.first(), types.as_deref()) {
                    (Some(&"list"), Some(&[count, kind])) => (Some(count), kind),
                    (Some(&first), Some(&[kind])) if first != "list" => (None, kind),
                    _ => return bad(&place, "its type is unknown"),
                };
                let Some(element) = elements.last_mut() else {
                    return bad(&place, "stands before any element");
                };
                element.properties.push(Property { name: name.to_owned(), list, kind });
            }
            [] => {}
            _ => return bad(&place, "not understood"),
        }
    }
    let body = match format.as_str() {
        "ascii" => match std::str::from_utf8(rest) {
            Ok(text) => Body::Text(text.split_ascii_whitespace()),
            Err(_) => return bad("format", "ascii, but the data is not text"),
        },
        "binary_little_endian" => Body::Bytes { rest, big_endian: false },
        "binary_big_endian" => Body::Bytes { rest, big_endian: true },
        _ => return bad("format", "not ascii, binary_little_endian or binary_big_endian"),
    };
    Ok((elements, body, rest.len() as u64))
}
