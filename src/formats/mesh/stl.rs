//! STL: binary and text in, binary out. It has no shared vertices, so equal points become one.

use std::collections::HashMap;
use std::path::Path;

use glam::Vec3;

use super::{FormatError, Mesh, Raw, space_tag, vertex};
use crate::formats::atomic_file;

const HEADER: usize = 80;
/// Normal, three corners, two bytes of attributes.
const ROW: usize = 50;

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Raw, FormatError> {
    let truncated = |what, wanted| {
        let found = bytes.len() as u64;
        FormatError::Truncated { file: path.to_owned(), what, wanted, found }
    };
    let count = bytes.get(HEADER..HEADER + 4).map(|b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]));
    let size = |n: u32| (HEADER + 4) as u64 + u64::from(n) * ROW as u64;
    // Some programs begin binary files with `solid` too; the size tells them apart.
    let exact = count.is_some_and(|n| size(n) == bytes.len() as u64);
    if !exact && bytes.trim_ascii_start().starts_with(b"solid") {
        return text(path, bytes);
    }
    let count = count.ok_or_else(|| truncated("STL header", (HEADER + 4) as u64))?;
    if size(count) > bytes.len() as u64 {
        return Err(truncated("triangles", size(count)));
    }
    let mut welder = Welder::default();
    welder.raw.space = space_tag(&String::from_utf8_lossy(&bytes[..HEADER]));
    if !exact {
        welder.raw.warnings.push("bytes after the last triangle ignored".into());
    }
    for row in bytes[HEADER + 4..].chunks_exact(ROW).take(count as usize) {
        let c = |k: usize| {
            let b = &row[12 + 4 * k..][..4];
            f64::from(f32::from_le_bytes([b[0], b[1], b[2], b[3]]))
        };
        let corner = |k: usize| [c(3 * k), c(3 * k + 1), c(3 * k + 2)];
        welder.face(path, [corner(0), corner(1), corner(2)])?;
    }
    Ok(welder.raw)
}

fn text(path: &Path, bytes: &[u8]) -> Result<Raw, FormatError> {
    let text = String::from_utf8_lossy(bytes);
    let mut welder = Welder::default();
    welder.raw.space = text.lines().next().and_then(space_tag);
    let (mut corners, mut ended) = (Vec::new(), false);
    let bad =
        |number: usize, why: &str| FormatError::text(path, format!("line {}", number + 1), why);
    for (number, line) in text.lines().enumerate() {
        let words: Vec<&str> = line.split_ascii_whitespace().collect();
        match words[..] {
            ["vertex", ref xyz @ ..] => {
                let xyz: Vec<Option<f64>> = xyz.iter().map(|w| w.parse().ok()).collect();
                let [Some(x), Some(y), Some(z)] = xyz[..] else {
                    return Err(bad(number, "no vertex"));
                };
                corners.push([x, y, z]);
            }
            ["endloop"] => {
                if corners.len() < 3 {
                    return Err(bad(number, "a loop has three vertices or more"));
                }
                for k in 2..corners.len() {
                    welder.face(path, [corners[0], corners[k - 1], corners[k]])?;
                }
                corners.clear();
            }
            ["endsolid", ..] => ended = true,
            _ => {}
        }
    }
    if !ended || !corners.is_empty() {
        return Err(FormatError::text(path, "last line", "not endsolid: truncated"));
    }
    Ok(welder.raw)
}

/// Makes one vertex of equal points.
#[derive(Default)]
struct Welder {
    raw: Raw,
    known: HashMap<[u32; 3], u32>,
}

impl Welder {
    fn face(&mut self, path: &Path, corners: [[f64; 3]; 3]) -> Result<(), FormatError> {
        let mut face = [0; 3];
        for (slot, xyz) in face.iter_mut().zip(corners) {
            let next = self.raw.positions.len();
            // Adding zero makes of -0 the same point as +0.
            let v = vertex(path, next, xyz)? + Vec3::ZERO;
            *slot = *self.known.entry(v.to_array().map(f32::to_bits)).or_insert(next as u32);
            if *slot as usize == next {
                self.raw.positions.push(v);
            }
        }
        self.raw.faces.push(face);
        Ok(())
    }
}

pub(super) fn write(path: &Path, mesh: &Mesh) -> Result<(), FormatError> {
    atomic_file::write_atomic(path, |out| {
        // A header that begins with `solid` would pass for the text form.
        let mut header = [b' '; HEADER];
        let title = b"intima surface, units mm, SPACE=LPS";
        header[..title.len()].copy_from_slice(title);
        out.write_all(&header)?;
        out.write_all(&(mesh.faces.len() as u32).to_le_bytes())?;
        for &f in &mesh.faces {
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
