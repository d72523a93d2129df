//! Wavefront OBJ: vertices, normals and faces.

use std::path::Path;

use glam::Vec3;

use super::{FormatError, Mesh, Raw, push_fan, space_tag, vertex};
use crate::formats::atomic_file;

pub(super) fn read(path: &Path, bytes: &[u8]) -> Result<Raw, FormatError> {
    // Names in the file may be in any encoding; what is read here is ASCII.
    let text = String::from_utf8_lossy(bytes).replace("\\\r\n", " ").replace("\\\n", " ");
    let mut raw = Raw::default();
    let mut normals = Vec::new();
    let mut normal_of: Vec<Option<usize>> = Vec::new();
    let (mut several, mut polygon) = (false, Vec::new());
    for (number, line) in text.lines().enumerate() {
        let bad = |why: &str| FormatError::text(path, format!("line {}", number + 1), why);
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let xyz = three(&mut words).ok_or_else(|| bad("no vertex"))?;
                raw.positions.push(vertex(path, raw.positions.len(), xyz)?);
            }
            Some("vn") => {
                let n = three(&mut words).ok_or_else(|| bad("no normal"))?;
                normals.push(Vec3::from(n.map(|c| c as f32)));
            }
            Some("f") => {
                polygon.clear();
                normal_of.resize(raw.positions.len(), None);
                for word in words {
                    let mut parts = word.split('/');
                    let v = parts.next().and_then(|w| index(w, raw.positions.len()));
                    let v = v.ok_or_else(|| bad("names a vertex that is not there"))?;
                    if let Some(w) = parts.nth(1).filter(|w| !w.is_empty()) {
                        let n = index(w, normals.len())
                            .ok_or_else(|| bad("names a normal that is not there"))?;
                        several |= normal_of[v].is_some_and(|m| normals[m] != normals[n]);
                        normal_of[v] = Some(n);
                    }
                    polygon.push(v as u32);
                }
                if polygon.len() < 3 {
                    return Err(bad("a face has three vertices or more"));
                }
                push_fan(&mut raw, &polygon);
            }
            Some(w) if w.starts_with('#') => raw.space = raw.space.or(space_tag(line)),
            _ => {}
        }
    }
    if several {
        raw.warnings.push("vertices with several normals: all normals dropped".into());
    } else if !normals.is_empty() {
        normal_of.resize(raw.positions.len(), None);
        let named: Option<Vec<Vec3>> = normal_of.iter().map(|n| n.map(|n| normals[n])).collect();
        match named {
            Some(named) => raw.normals = named,
            None if normals.len() == raw.positions.len()
                && normal_of.iter().all(Option::is_none) =>
            {
                raw.normals = normals;
            }
            None => raw.warnings.push("vertices without a normal: all normals dropped".into()),
        }
    }
    Ok(raw)
}

fn three<'a>(words: &mut impl Iterator<Item = &'a str>) -> Option<[f64; 3]> {
    let mut next = || words.next()?.parse().ok();
    Some([next()?, next()?, next()?])
}

/// An OBJ index (from one, or back from the end) among `count` things.
fn index(word: &str, count: usize) -> Option<usize> {
    let i: i64 = word.parse().ok()?;
    let i = if i < 0 { i.checked_add(count as i64)? } else { i - 1 };
    usize::try_from(i).ok().filter(|&i| i < count)
}

pub(super) fn write(path: &Path, mesh: &Mesh) -> Result<(), FormatError> {
    atomic_file::write_atomic(path, |out| {
        writeln!(out, "# SPACE=LPS\n# units mm")?;
        for p in &mesh.positions {
            writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
        }
        for n in &mesh.normals {
            writeln!(out, "vn {} {} {}", n.x, n.y, n.z)?;
        }
        for f in &mesh.faces {
            let [a, b, c] = f.map(|v| v + 1);
            match mesh.normals.is_empty() {
                true => writeln!(out, "f {a} {b} {c}")?,
                false => writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?,
            }
        }
        Ok(())
    })
}
