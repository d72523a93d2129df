//! PLY: text and both byte orders in, binary little-endian out.

mod header;

use std::path::Path;

use glam::Vec3;

use super::{FacedMesh, FormatError, RawMesh};
use crate::formats::atomic_file;
use header::{Body, Element, Property, header};

pub(super) fn read(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    let (elements, mut body, size) = header(path, bytes, raw)?;
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
            rows(path, element, &mut body, raw, size)?;
        }
    }
    if !elements.iter().any(|e| e.name == "face") && elements.iter().any(|e| e.name == "tristrips")
    {
        return Err(FormatError::unsupported(path, "PLY with triangle strips; faces are"));
    }
    Ok(())
}

fn least(p: &Property, body: &Body) -> u64 {
    match body {
        Body::Text(_) => 2,
        Body::Bytes { .. } => p.list.unwrap_or(p.kind).size() as u64,
    }
}

/// Reads the rows of one element: vertices and faces are kept, the rest is skipped.
fn rows(
    path: &Path,
    element: &Element,
    body: &mut Body,
    raw: &mut RawMesh,
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
    // The names of other elements are the file's own.
    let shown = ["vertex", "face"].into_iter().find(|n| *n == name).unwrap_or("other row");
    for i in 0..element.count as usize {
        let cut = || {
            let why = format!("missing or no number ({size} bytes of data)");
            FormatError::text(path, format!("{shown} {i} of {}", element.count), why)
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
                    format!("list length in {shown} {i}"),
                    count,
                    "no length",
                ));
            }
            raw.begin_polygon(None);
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
                    raw.polygon_vertex(v as u32);
                }
            }
        }
        if name == "vertex" {
            raw.push_vertex(path, [row[0], row[1], row[2]])?;
            if normals {
                raw.push_normal(Vec3::new(row[3] as f32, row[4] as f32, row[5] as f32));
            }
        }
    }
    Ok(())
}

pub(super) fn write(path: &Path, faced: &FacedMesh<'_>) -> Result<(), FormatError> {
    let mesh = faced.mesh;
    let with_normals = !mesh.normals.is_empty();
    atomic_file::write_atomic(path, |out| {
        writeln!(out, "ply\nformat binary_little_endian 1.0\ncomment SPACE=LPS\ncomment units mm")?;
        if let Some(facing) = faced.tag() {
            writeln!(out, "comment FACING={facing}")?;
        }
        writeln!(out, "element vertex {}", mesh.positions.len())?;
        let normal = if with_normals { &["nx", "ny", "nz"][..] } else { &[] };
        for name in ["x", "y", "z"].iter().chain(normal) {
            writeln!(out, "property float {name}")?;
        }
        writeln!(out, "element face {}", mesh.faces.len())?;
        writeln!(out, "property list uchar int vertex_indices\nend_header")?;
        let mut normals = faced.normals();
        for position in &mesh.positions {
            for vector in [Some(*position), normals.next()].into_iter().flatten() {
                vector.to_array().iter().try_for_each(|c| out.write_all(&c.to_le_bytes()))?;
            }
        }
        for f in faced.faces() {
            let mut row = [3; 13];
            for (bytes, v) in row[1..].chunks_exact_mut(4).zip(f) {
                bytes.copy_from_slice(&v.to_le_bytes());
            }
            out.write_all(&row)?;
        }
        Ok(())
    })
}
