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
    /// Where `from` is, mm.
    pub from_at: DVec3,
    /// Where each vertex of the ring is, mm.
    pub ring_at: &'a [DVec3],
    /// Whether `from` lies on a boundary.
    pub boundary: bool,
}

/// Hears of every collapse in a part of a mesh before it happens.
pub trait Log: Default + Send {
    /// Takes the collapse down, or refuses it.
    fn record(&mut self, collapse: &Collapse<'_>) -> bool;

    /// Whether it agrees to everything and need not be asked.
    fn is_deaf(&self) -> bool {
        false
    }
}

/// Hears of every collapse.
pub trait Recorder {
    /// Hears of those in one part of the mesh, beside those in other parts.
    type Log: Log;

    /// Takes a log up. The collapses of logs taken up earlier came before those of this one, or
    /// have nothing to do with them.
    fn take_up(&mut self, log: Self::Log);
}

/// Records nothing, refuses nothing.
impl Log for () {
    fn record(&mut self, _: &Collapse<'_>) -> bool {
        true
    }

    fn is_deaf(&self) -> bool {
        true
    }
}

/// Records nothing, refuses nothing.
impl Recorder for () {
    type Log = ();

    fn take_up(&mut self, (): ()) {}
}

/// A place on a mesh: a face and weights of its three vertices, which sum to 1.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct OnMesh {
    /// Face id.
    pub face: u32,
    /// Weights in the order of the face's vertices.
    pub weights: [f64; 3],
}
