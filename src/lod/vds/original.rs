//! The original surface as subdivision samples it.

use glam::{DVec3, Vec3};

use crate::geometry::{Mesh, MeshPoint, TriangleBvh, Vertex};
use crate::mesh::parameterization::RemovedVertex;
use crate::mesh::{Parameterization, Simplified};

/// A surface that is parameterised over a base mesh: every point of the base corresponds to a point
/// of it.
pub trait Original: Sync {
    /// The original at the point with barycentric `weights` in base face `face`. Results for points
    /// on an edge need agree between both faces only up to rounding.
    fn at(&self, face: u32, weights: [f64; 3]) -> Vertex;

    /// Whether [`Self::at`] gives points of the original.
    fn is_sampled(&self) -> bool {
        true
    }

    /// Number of vertices at which errors are measured.
    fn vertices(&self) -> u32;

    /// Base face and weights of such a vertex, and the vertex; `None` if it has none.
    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vertex)>;

    /// Faces of the original.
    fn faces(&self) -> u64;

    /// Distance of the nearest point of the original, mm.
    fn distance_mm(&self, p: DVec3) -> f64;
}

/// A mesh parameterised over the base that it was simplified to, by the record of its collapses.
pub struct ParameterizedOriginal<'a> {
    maps: &'a Parameterization,
    mesh: &'a Mesh,
    shading: &'a [Vertex],
    tree: &'a TriangleBvh,
    /// Half-edge face of each base face, and the inverse.
    slots: &'a [u32],
    faces: Vec<u32>,
    tuples: Vec<RemovedVertex>,
}

impl<'a> ParameterizedOriginal<'a> {
    /// `shading` are the vertices of `mesh` as drawn, one each, and `tree` is that of its faces;
    /// `base` is the result of simplifying `mesh` while `maps` recorded it.
    ///
    /// # Panics
    /// If `base` has more faces than `mesh`, or faces of another one.
    pub fn new(
        mesh: &'a Mesh,
        shading: &'a [Vertex],
        tree: &'a TriangleBvh,
        base: &'a Simplified,
        maps: &'a Parameterization,
    ) -> Self {
        let mut faces = vec![u32::MAX; mesh.faces.len()];
        for (face, slot) in base.face_ids.iter().enumerate() {
            faces[*slot as usize] = face as u32;
        }
        let (slots, tuples) = (&base.face_ids[..], maps.removed_vertices());
        Self { maps, mesh, shading, tree, slots, faces, tuples }
    }
}

impl Original for ParameterizedOriginal<'_> {
    /// Not finite for a point outside the recorded parameterisation.
    fn at(&self, face: u32, weights: [f64; 3]) -> Vertex {
        let place = MeshPoint { face: self.slots[face as usize], weights };
        let Ok(to) = self.maps.to_fine(place) else {
            return Vertex::new(Vec3::NAN, Vec3::ZERO, 0.0);
        };
        let corners = self.mesh.faces[to.at.face as usize].map(|v| self.shading[v as usize]);
        let sum = |of: &dyn Fn(&Vertex) -> Vec3| -> DVec3 {
            corners.iter().zip(to.at.weights).map(|(c, w)| w * of(c).as_dvec3()).sum()
        };
        let normal = sum(&Vertex::normal).normalize_or_zero().as_vec3();
        let curvature_tint = sum(&|v| Vec3::splat(v.w())).x as f32;
        Vertex::new(sum(&Vertex::position).as_vec3(), normal, curvature_tint)
    }

    /// The collapsed vertices; the others are corners of the base.
    fn vertices(&self) -> u32 {
        self.tuples.len() as u32
    }

    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vertex)> {
        let RemovedVertex { vertex, at } = self.tuples[vertex as usize];
        Some((self.faces[at.face as usize], at.weights, self.shading[vertex as usize]))
    }

    fn faces(&self) -> u64 {
        self.mesh.faces.len() as u64
    }

    fn distance_mm(&self, p: DVec3) -> f64 {
        self.tree.closest(p).map_or(f64::INFINITY, |c| c.distance_mm)
    }
}
