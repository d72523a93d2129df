//! What subdivision asks of the original surface.

use glam::{DVec3, Vec3};

use crate::geometry::{Mesh, MeshPoint, Vertex};
use crate::mesh::parameterization::RemovedVertex;
use crate::mesh::{Parameterization, Simplified};

/// A mesh that a base mesh is parameterised over: every place of the base is a place on it.
pub trait Original: Sync {
    /// The original at a place of the base: `weights` of the corners of base face `face`. Places
    /// on an edge need agree from both sides only as far as rounding goes.
    fn at(&self, face: u32, weights: [f64; 3]) -> Vertex;

    /// Vertices of the original that are looked at when errors are measured.
    fn vertices(&self) -> u32;

    /// Where such a vertex lies on the base (face, weights) and in space; `None` if nowhere.
    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vec3)>;

    /// Faces of the original.
    fn faces(&self) -> u64;
}

/// A mesh over the base that it was simplified to, through the record of its collapses.
pub struct Recorded<'a> {
    maps: &'a Parameterization,
    mesh: &'a Mesh,
    shading: &'a [Vertex],
    /// Half-edge face of each base face, and the base face of each half-edge face.
    slots: &'a [u32],
    faces: Vec<u32>,
    tuples: Vec<RemovedVertex>,
}

impl<'a> Recorded<'a> {
    /// `shading` are the vertices of `mesh` as drawn, one each; `base` is what `mesh` was
    /// simplified to while `maps` heard of it.
    ///
    /// # Panics
    /// If `base` has more faces than `mesh`, or faces of another one.
    pub fn new(
        mesh: &'a Mesh,
        shading: &'a [Vertex],
        base: &'a Simplified,
        maps: &'a Parameterization,
    ) -> Self {
        let mut faces = vec![u32::MAX; mesh.faces.len()];
        for (face, slot) in base.face_ids.iter().enumerate() {
            faces[*slot as usize] = face as u32;
        }
        Self { maps, mesh, shading, slots: &base.face_ids, faces, tuples: maps.removed_vertices() }
    }
}

impl Original for Recorded<'_> {
    /// Not finite for a place that the record does not know.
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
        let relief = sum(&|v| Vec3::splat(v.w())).x as f32;
        Vertex::new(sum(&Vertex::position).as_vec3(), normal, relief)
    }

    /// Those that were collapsed; the others are corners of the base.
    fn vertices(&self) -> u32 {
        self.tuples.len() as u32
    }

    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vec3)> {
        let RemovedVertex { vertex, at } = self.tuples[vertex as usize];
        let position = self.mesh.positions[vertex as usize];
        Some((self.faces[at.face as usize], at.weights, position))
    }

    fn faces(&self) -> u64 {
        self.mesh.faces.len() as u64
    }
}
