//! Mesh as a reader finds it in a file, in the file's own coordinates.
//!
//! A reader goes through a file twice: the first time everything is checked and counted, the second
//! time it is kept. A file that is refused has then taken no memory beyond its own bytes, however
//! large the mesh is that a few of them stand for.

use std::path::Path;

use glam::Vec3;

use super::{FormatError, Space};
use crate::formats::error::FieldValue;

#[derive(Default)]
pub(super) struct RawMesh {
    pub positions: Vec<Vec3>,
    pub normals: Vec<Vec3>,
    pub faces: Vec<[u32; 3]>,
    /// Cap flags, one a face, or none.
    pub caps: Vec<bool>,
    pub space: Option<Space>,
    /// Warnings of what was assumed or left out; no text of the file.
    pub warnings: Vec<String>,
    /// Whether vertices and faces are kept, or only counted.
    keeps: bool,
    vertex_count: usize,
    normal_count: usize,
    face_count: usize,
    cap_count: usize,
    /// Largest vertex that a triangle names, and that triangle.
    highest: Option<(u32, usize)>,
    polygon: Polygon,
    /// First triangle and number of triangles of each polygon of four corners or more.
    pub polygons: Vec<(usize, usize)>,
}

/// The polygon that is being read, made a fan of triangles as its vertices come.
#[derive(Default)]
struct Polygon {
    vertices: usize,
    first: u32,
    last: u32,
    cap: Option<bool>,
}

impl RawMesh {
    /// Room for what was counted, to be filled in a second pass.
    ///
    /// # Errors
    /// [`FormatError::Field`] if a triangle names a vertex that is not there.
    pub fn keeping(path: &Path, counted: &Self) -> Result<Self, FormatError> {
        let count = counted.vertex_count;
        if let Some((v, i)) = counted.highest.filter(|h| h.0 as usize >= count) {
            let why = format!("there are {count} vertices");
            return Err(FormatError::field(path, format!("vertex of triangle {i}"), v, why));
        }
        Ok(Self {
            positions: Vec::with_capacity(count),
            normals: Vec::with_capacity(counted.normal_count),
            faces: Vec::with_capacity(counted.face_count),
            caps: Vec::with_capacity(counted.cap_count),
            keeps: true,
            ..Self::default()
        })
    }

    /// Whether this is the second pass.
    pub fn keeps(&self) -> bool {
        self.keeps
    }

    /// Vertices so far.
    pub fn vertex_count(&self) -> usize {
        self.vertex_count
    }

    /// Adds a vertex from a file's numbers.
    ///
    /// # Errors
    /// [`FormatError::Field`] if it is not finite.
    pub fn push_vertex(&mut self, path: &Path, xyz: [f64; 3]) -> Result<Vec3, FormatError> {
        let v = finite(path, self.vertex_count, xyz)?;
        self.vertex_count += 1;
        if self.keeps {
            self.positions.push(v);
        }
        Ok(v)
    }

    /// Adds a normal; the next vertex without one gets it.
    pub fn push_normal(&mut self, n: Vec3) {
        self.normal_count += 1;
        if self.keeps {
            self.normals.push(n);
        }
    }

    /// Adds a triangle, and whether it is a cap where the file says so of every face.
    pub fn push_face(&mut self, face: [u32; 3], cap: Option<bool>) {
        for v in face {
            if self.highest.is_none_or(|h| v > h.0) {
                self.highest = Some((v, self.face_count));
            }
        }
        self.face_count += 1;
        self.cap_count += usize::from(cap.is_some());
        if self.keeps {
            self.faces.push(face);
            self.caps.extend(cap);
        }
    }

    /// Begins a polygon.
    pub fn begin_polygon(&mut self, cap: Option<bool>) {
        self.polygon = Polygon { cap, ..Polygon::default() };
    }

    /// Adds a vertex to the polygon begun; how many it has now.
    pub fn polygon_vertex(&mut self, v: u32) -> usize {
        let Polygon { vertices, first, last, cap } = self.polygon;
        match vertices {
            0 => self.polygon.first = v,
            1 => {}
            _ => self.push_face([first, last, v], cap),
        }
        match vertices {
            3 if self.keeps => self.polygons.push((self.face_count - 2, 2)),
            4.. if self.keeps => self.polygons.last_mut().into_iter().for_each(|p| p.1 += 1),
            _ => {}
        }
        self.polygon.last = v;
        self.polygon.vertices = vertices + 1;
        vertices + 1
    }
}

/// A vertex from a file's numbers.
pub(super) fn finite(path: &Path, index: usize, xyz: [f64; 3]) -> Result<Vec3, FormatError> {
    let v = Vec3::from(xyz.map(|c| c as f32));
    if v.is_finite() {
        return Ok(v);
    }
    let value = FieldValue::numbers(&xyz);
    Err(FormatError::field(path, format!("vertex {index}"), value, "not finite"))
}
