//! Wavefront OBJ: vertices, normals and faces.

use std::borrow::Cow;
use std::path::Path;

use glam::Vec3;

use super::{FacedMesh, FormatError, RawMesh, space_tag};
use crate::formats::atomic_file;

pub(super) fn read(path: &Path, bytes: &[u8], raw: &mut RawMesh) -> Result<(), FormatError> {
    let mut normals = Vec::new();
    let mut normal_of: Vec<Option<u32>> = Vec::new();
    let (mut several, mut absent, mut normal_count) = (false, false, 0);
    for (number, line) in lines(bytes) {
        // Names in the file may be in any encoding; what is read here is ASCII.
        let Ok(line) = std::str::from_utf8(&line) else { continue };
        let bad = |why: &str| FormatError::text(path, format!("line {number}"), why);
        let mut words = line.split_ascii_whitespace();
        match words.next() {
            Some("v") => {
                let xyz = three(&mut words).ok_or_else(|| bad("no vertex"))?;
                raw.push_vertex(path, xyz)?;
            }
            Some("vn") => {
                let n = three(&mut words).ok_or_else(|| bad("no normal"))?;
                normal_count += 1;
                if raw.keeps() {
                    normals.push(Vec3::from(n.map(|c| c as f32)));
                }
            }
            Some("f") => {
                raw.begin_polygon(None);
                let mut corners = 0;
                if raw.keeps() {
                    normal_of.resize(raw.vertex_count(), None);
                }
                for word in words {
                    let mut parts = word.split('/');
                    let v = parts.next().and_then(|w| index(w, raw.vertex_count()));
                    let v = v.ok_or_else(|| bad("names a vertex that is not there"))?;
                    if let Some(w) = parts.nth(1).filter(|w| !w.is_empty()) {
                        match index(w, normal_count) {
                            // Normals are computed anyway.
                            None => absent = true,
                            Some(n) if raw.keeps() => {
                                several |=
                                    normal_of[v].is_some_and(|m| normals[m as usize] != normals[n]);
                                normal_of[v] = Some(n as u32);
                            }
                            Some(_) => {}
                        }
                    }
                    corners = raw.polygon_vertex(v as u32);
                }
                if corners < 3 {
                    return Err(bad("a face has three vertices or more"));
                }
            }
            Some(w) if w.starts_with('#') => raw.space = raw.space.or(space_tag(line)),
            _ => {}
        }
    }
    if !raw.keeps() {
        return Ok(());
    }
    if absent {
        raw.warnings.push("faces name normals that are not there: all normals dropped".into());
    } else if several {
        raw.warnings.push("vertices with several normals: all normals dropped".into());
    } else if !normals.is_empty() {
        normal_of.resize(raw.vertex_count(), None);
        let one_each = normals.len() == raw.vertex_count() && normal_of.iter().all(Option::is_none);
        if one_each {
            raw.normals = normals;
        } else if normal_of.iter().all(Option::is_some) {
            raw.normals = normal_of.iter().flatten().map(|n| normals[*n as usize]).collect();
        } else {
            raw.warnings.push("vertices without a normal: all normals dropped".into());
        }
    }
    Ok(())
}

/// The lines of a file with the number of each, from 1; one that ends in a backslash goes on in the
/// next.
fn lines(bytes: &[u8]) -> impl Iterator<Item = (usize, Cow<'_, [u8]>)> {
    let mut rest = bytes.split(|b| *b == b'\n').enumerate();
    std::iter::from_fn(move || {
        let (at, line) = rest.next()?;
        let mut line = Cow::Borrowed(line);
        while let Some(head) = line.trim_ascii_end().strip_suffix(b"\\") {
            let head = head.len();
            let Some((_, next)) = rest.next() else { break };
            let joined = line.to_mut();
            joined.truncate(head);
            joined.push(b' ');
            joined.extend_from_slice(next);
        }
        Some((at + 1, line))
    })
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

pub(super) fn write(path: &Path, faced: &FacedMesh<'_>) -> Result<(), FormatError> {
    let mesh = faced.mesh;
    atomic_file::write_atomic(path, |out| {
        writeln!(out, "# SPACE=LPS\n# units mm")?;
        if let Some(facing) = faced.tag() {
            writeln!(out, "# FACING={facing}")?;
        }
        for p in &mesh.positions {
            writeln!(out, "v {} {} {}", p.x, p.y, p.z)?;
        }
        for n in faced.normals() {
            writeln!(out, "vn {} {} {}", n.x, n.y, n.z)?;
        }
        for f in faced.faces() {
            let [a, b, c] = f.map(|v| v + 1);
            match mesh.normals.is_empty() {
                true => writeln!(out, "f {a} {b} {c}")?,
                false => writeln!(out, "f {a}//{a} {b}//{b} {c}//{c}")?,
            }
        }
        Ok(())
    })
}
