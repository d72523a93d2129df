//! The surfaces that a group is measured between: the original, the fine faces, one in between.

use glam::{DVec3, Vec3};

use super::cluster_builder::ClusterBuilder;
use super::distance_bound::TargetSurface;
use super::partition::{self, NO_FACE};
use crate::geometry::Vertex;

/// The original surface, to measure to.
pub struct OriginalSurface<'a> {
    /// Faces of the original and the search structures over them.
    pub target: TargetSurface<'a>,
}

impl OriginalSurface<'_> {
    /// A vertex at `p` with normal and curvature tint of the nearest point of the original,
    /// interpolated between `vertices`; and the face of that point. `from`: a face near it.
    pub fn vertex(&self, p: Vec3, from: u32, vertices: &[Vertex]) -> (Vertex, u32) {
        let (face, near) = self.target.walk_to_point(from, p.as_dvec3());
        let w = near.weights.map(|w| w as f32);
        let [a, b, c] = self.target.faces[face as usize].map(|v| vertices[v as usize]);
        let normal = a.normal() * w[0] + b.normal() * w[1] + c.normal() * w[2];
        let relief = a.w() * w[0] + b.w() * w[1] + c.w() * w[2];
        (Vertex::new(p, normal.try_normalize().unwrap_or(a.normal()), relief), face)
    }

    /// Corners of a face, mm.
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        self.target.faces[face as usize].map(|v| self.target.positions[v as usize].as_dvec3())
    }
}

/// Per-vertex data of all levels; vertices of the original come first.
pub struct VertexTable {
    /// Positions, LPS mm.
    pub positions: Vec<Vec3>,
    /// Unit normals.
    pub normals: Vec<Vec3>,
    /// A face of the original at or near each vertex.
    pub face_at: Vec<u32>,
    /// The vertex that each moved vertex replaces; else [`NO_FACE`].
    pub predecessor: Vec<u32>,
}

/// The fine faces of a group, as the path from the coarse faces back to the original.
pub struct FineSurface<'a> {
    /// The faces, with the vertex ids of the coarse ones; the search tree is not used.
    pub target: TargetSurface<'a>,
    /// One-sided distance bound of each face to the original, mm.
    pub to_original_mm: Vec<f32>,
    /// One of the faces at each vertex.
    pub face_at: Vec<u32>,
    /// Vertex ids.
    pub ids: &'a [u32],
    /// Vertices of all levels.
    pub places: &'a VertexTable,
    /// A surface to measure to before the original.
    pub intermediate: Option<&'a IntermediateSurface>,
    /// A coarse face near each vertex.
    pub coarse_at: Vec<u32>,
}

/// A surface between the original and the fine one: three levels below the coarse one, or the
/// first.
pub struct IntermediateSurface {
    /// Faces, by vertex ids of all levels.
    pub faces: Vec<[u32; 3]>,
    /// Face across each edge.
    pub face_neighbors: Vec<[u32; 3]>,
    /// One-sided distance bound of each face to the original, mm.
    pub to_original_mm: Vec<f32>,
    /// An incident face of each of its vertices.
    pub face_at: Vec<u32>,
}

impl FineSurface<'_> {
    /// Position of a vertex, mm.
    pub fn at(&self, v: u32) -> DVec3 {
        self.target.positions[v as usize].as_dvec3()
    }
}

impl IntermediateSurface {
    /// The surface of the live clusters; `vertices`: number of vertices of all levels.
    pub fn new<'a>(
        live: impl Iterator<Item = &'a ClusterBuilder> + Clone,
        vertices: usize,
    ) -> Self {
        let faces: Vec<[u32; 3]> = live.clone().flat_map(ClusterBuilder::faces).collect();
        let mut face_at = vec![NO_FACE; vertices];
        for (f, i) in faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        crate::task::checkpoint();
        let face_neighbors = partition::face_neighbors(&faces, vertices);
        crate::task::checkpoint();
        Self {
            face_neighbors,
            to_original_mm: live.flat_map(|d| d.to_original_mm.iter().copied()).collect(),
            faces,
            face_at,
        }
    }
}
