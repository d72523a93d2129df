//! STL: binary and text in, binary out. It has no shared vertices, so equal points become one.

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;

use super::raw_mesh::finite;
use super::{FacedMesh, FormatError, RawMesh, space_tag};
use crate::formats::atomic_file;

const HEADER: usize = 80;
/// Normal, three corners, two bytes of attributes.
const ROW: usize = 50;

pub(super) fn read(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    let truncated = |what, wanted| {
        let found = bytes.len() as u64;
        FormatError::Truncated { file: path.to_owned(), what, wanted, found }
    };
    let count = bytes.get(HEADER..HEADER + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let size = |n: u32| (HEADER + 4) as u64 + u64::from(n) * ROW as u64;
    // Some programs begin binary files with `solid` too; the size tells them apart.
    let exact = count.is_some_and(|n| size(n) == bytes.len() as u64);
    let start = bytes.trim_ascii_start();
    let is_solid = start.get(..5).is_some_and(|word| word.eq_ignore_ascii_case(b"solid"));
    if !exact && is_solid {
        return text(path, bytes, raw);
    }
    let count = count.ok_or_else(|| truncated("STL header", (HEADER + 4) as u64))?;
    if size(count) > bytes.len() as u64 {
        return Err(truncated("triangles", size(count)));
    }
    raw.space = space_tag(&String::from_utf8_lossy(&bytes[..HEADER]));
    if !exact {
        raw.warnings.push("bytes after the last triangle ignored".into());
    }
    let mut welder = Welder::new(raw);
    for row in bytes[HEADER + 4..].chunks_exact(ROW).take(count as usize) {
        let c = |k: usize| {
            let b = &row[12 + 4 * k..][..4];
            f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        };
        let corner = |k: usize| [c(3 * k), c(3 * k + 1), c(3 * k + 2)];
        welder.face(path, [corner(0), corner(1), corner(2)])?;
    }
    Ok(())
}

fn text(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    // Names in the file may be in any encoding; a line that is read is ASCII.
    let lines = || bytes.split(|b| *b == b'\n').map(|l| std::str::from_utf8(l).unwrap_or(""));
    raw.space = lines().next().and_then(space_tag);
    let mut welder = Welder::new(raw);
    let (mut corner, mut ended) = (0usize, false);
    let (mut first, mut last) = ([0.0; 3], [0.0; 3]);
    let bad =
        |number: usize, why: &str| FormatError::text(path, format!("line {}", number + 1), why);
    for (number, line) in lines().enumerate() {
        let mut words = line.split_ascii_whitespace();
        match words.next().map(str::to_ascii_lowercase).as_deref() {
            Some("vertex") => {
                let mut next = || words.next().and_then(|w| w.parse().ok());
                let (Some(x), Some(y), Some(z)) = (next(), next(), next()) else {
                    return Err(bad(number, "no vertex"));
                };
                let v = [x, y, z];
                match corner {
                    0 => first = v,
                    1 => {}
                    _ => welder.face(path, [first, last, v])?,
                }
                (last, corner) = (v, corner + 1);
            }
            Some("endloop") => {
                if corner < 3 {
                    return Err(bad(number, "a loop has three vertices or more"));
                }
                corner = 0;
            }
            Some("endsolid") => ended = true,
            _ => {}
        }
    }
    if !ended || corner > 0 {
        return Err(FormatError::text(path, "last line", "not endsolid: truncated"));
    }
    Ok(())
}

/// Makes one vertex of equal points.
struct Welder<'a> {
    raw: &'a mut RawMesh,
    known: HashMap<[u32; 3], u32>,
}

impl<'a> Welder<'a> {
    fn new(raw: &'a mut RawMesh) -> Self {
        Self { raw, known: HashMap::new() }
    }

    fn face(&mut self, path: &Path, corners: [[f64; 3]; 3]) -> Result<(), FormatError> {
        let mut face = [0; 3];
        for (slot, xyz) in face.iter_mut().zip(corners) {
            let next = self.raw.vertex_count();
            // Adding zero makes of -0 the same point as +0.
            let v = finite(path, next, xyz)? + Vec3::ZERO;
            // Which points are equal matters only to a mesh that is kept.
            if !self.raw.keeps() {
                continue;
            }
            *slot = *self.known.entry(v.to_array().map(f32::to_bits)).or_insert(next as u32);
            if *slot as usize == next {
                self.raw.push_vertex(path, v.to_array().map(f64::from))?;
            }
        }
        if self.raw.keeps() {
            self.raw.push_face(face, None);
        }
        Ok(())
    }
}

pub(super) fn write(path: &Path, faced: &FacedMesh<'_>) -> Result<(), FormatError> {
    let mesh = faced.mesh;
    atomic_file::write_atomic(path, |out| {
        // A header that begins with `solid` would pass for the text form.
        let mut header = [b' '; HEADER];
        let facing = faced.tag().map_or_else(String::new, |tag| format!(", FACING={tag}"));
        let title = format!("intima surface, units mm, SPACE=LPS{facing}");
        header[..title.len()].copy_from_slice(title.as_bytes());
        out.write_all(&header)?;
        out.write_all(&(mesh.faces.len() as u32).to_le_bytes())?;
        for f in faced.faces() {
            let normal = mesh.face_cross(f).normalize_or_zero();
            let [a, b, c] = f.map(|v| mesh.positions[v as usize]);
            let mut row = [0; ROW];
            let numbers = [normal, a, b, c].into_iter().flat_map(|v| v.to_array());
            for (bytes, value) in row.chunks_exact_mut(4).zip(numbers) {
                bytes.copy_from_slice(&value.to_le_bytes());
            }
            out.write_all(&row)?;
        }
        Ok(())
    })
}
