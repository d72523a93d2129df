//! Plain triangle mesh, and points on it.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

/// An indexed triangle mesh in LPS mm.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Mesh {
    /// Vertex positions, LPS mm.
    pub positions: Vec<Vec3>,
    /// Unit vertex normals pointing into the lumen; empty or one a vertex.
    pub normals: Vec<Vec3>,
    /// Vertex ids of each triangle, counter-clockwise seen from inside the lumen, so that the face
    /// normal by the right-hand rule points into the lumen too.
    pub faces: Vec<[u32; 3]>,
    /// Whether a face closes the lumen at the volume's edge: one flag a face, or empty.
    pub caps: Vec<bool>,
}

impl Mesh {
    /// Returns twice the area of a face times its unit normal.
    pub fn face_cross(&self, f: [u32; 3]) -> Vec3 {
        let [a, b, c] = f.map(|v| self.positions[v as usize]);
        (b - a).cross(c - a)
    }

    /// Returns the smallest and largest corner of the box around all vertices, or `None` for an
    /// empty mesh.
    pub fn bounds(&self) -> Option<(Vec3, Vec3)> {
        let first = *self.positions.first()?;
        Some(self.positions.iter().fold((first, first), |(lo, hi), &p| (lo.min(p), hi.max(p))))
    }

    /// Returns the total area, mm².
    pub fn area_mm2(&self) -> f64 {
        let area = |f: &[u32; 3]| 0.5 * f64::from(self.face_cross(*f).length());
        // Sums of fixed parts: the same for any number of threads.
        let parts = self.faces.par_chunks(1 << 16).map(|part| part.iter().map(area).sum());
        parts.collect::<Vec<f64>>().iter().sum()
    }

    /// Returns the enclosed volume, mm³; positive when normals point inwards. Meaningful for closed
    /// meshes.
    pub fn volume_mm3(&self) -> f64 {
        let p = |v: u32| DVec3::from(self.positions[v as usize]);
        -self.faces.iter().map(|&[a, b, c]| p(a).dot(p(b).cross(p(c)))).sum::<f64>() / 6.0
    }
}

/// A point on a mesh: a face and barycentric weights, which sum to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MeshPoint {
    /// Face id.
    pub face: u32,
    /// Weights in the order of the face's vertices.
    pub weights: [f64; 3],
}
