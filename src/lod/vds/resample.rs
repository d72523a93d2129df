//! What subdivision asks of the original surface.

use glam::Vec3;

use crate::geometry::Vertex;

/// A mesh that a base mesh is parameterised over: every place of the base is a place on it.
pub trait Original: Sync {
    /// The original at a place of the base: `weights` of the corners of base face `face`. Places
    /// on an edge need agree from both sides only as far as rounding goes.
    fn at(&self, face: u32, weights: [f64; 3]) -> Vertex;

    /// Vertices of the original.
    fn vertices(&self) -> u32;

    /// Where a vertex of the original lies on the base (face, weights) and in space; `None` if it
    /// is not part of the surface.
    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vec3)>;

    /// Faces of the original.
    fn faces(&self) -> u64;
}
