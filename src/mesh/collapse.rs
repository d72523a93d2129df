//! What a simplifier tells a recorder about each collapse, and places on a mesh.

use glam::DVec3;

/// A half-edge collapse u → v: `u` and the faces at both sides of the edge go, the other faces of
/// `u` take `v` in its place.
#[derive(Clone, Copy, Debug)]
pub struct Collapse<'a> {
    /// The vertex that goes.
    pub from: u32,
    /// The vertex that stays where it is.
    pub to: u32,
    /// Neighbours of `from` counter-clockwise seen along −normal (the order of the faces), the
    /// first being `to`. K of them; for a vertex on a boundary the first and the last lie on the
    /// boundary, and `to` is one of those two.
    pub ring: &'a [u32],
    /// Faces of `from`: face i holds `from`, `ring[i]`, `ring[i + 1]`. K of them for an inner
    /// vertex (the last one closes the ring), K − 1 on a boundary. The faces that hold `to` go;
    /// every other one survives under its id with `from` replaced by `to`.
    pub faces: &'a [u32],
    /// Whether `from` lies on a boundary.
    pub boundary: bool,
}

/// Hears of every collapse before it happens.
pub trait Recorder {
    /// Takes the collapse down, or refuses it. `position` gives where each vertex lies.
    fn record(&mut self, collapse: &Collapse<'_>, position: &dyn Fn(u32) -> DVec3) -> bool;
}

/// Records nothing, refuses nothing.
impl Recorder for () {
    fn record(&mut self, _: &Collapse<'_>, _: &dyn Fn(u32) -> DVec3) -> bool {
        true
    }
}

/// A place on a mesh: a face and weights of its three vertices, which sum to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnMesh {
    /// Face id.
    pub face: u32,
    /// Weights in the order of the face's vertices.
    pub weights: [f64; 3],
}
