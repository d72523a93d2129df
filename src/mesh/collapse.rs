//! Interface between a simplifier and a recorder of its collapses.

use glam::DVec3;

/// A half-edge collapse u → v: `u` and the faces at both sides of the edge are removed, and the
/// other faces of `u` get `v` in its place.
#[derive(Clone, Copy, Debug)]
pub struct Collapse<'a> {
    /// The vertex that is removed.
    pub from: u32,
    /// The vertex that stays where it is.
    pub to: u32,
    /// Neighbours of `from` counter-clockwise seen along −normal (the order of the faces), the
    /// first being `to`. K of them; for a vertex on a boundary the first and the last lie on the
    /// boundary, and `to` is one of those two.
    pub ring: &'a [u32],
    /// Faces of `from`: face i holds `from`, `ring[i]`, `ring[i + 1]`. K of them for an inner
    /// vertex (the last one closes the ring), K − 1 on a boundary. The faces that hold `to` are
    /// removed; every other one keeps its id, with `from` replaced by `to`.
    pub faces: &'a [u32],
    /// Position of `from`, mm.
    pub from_at: DVec3,
    /// Position of each vertex of the ring, mm.
    pub ring_at: &'a [DVec3],
    /// Whether `from` lies on a boundary.
    pub boundary: bool,
}

/// Receives every collapse in a part of a mesh before it is made.
pub trait Log: Default + Send {
    /// Records the collapse and returns true, or vetoes it by returning false.
    fn record(&mut self, collapse: &Collapse<'_>) -> bool;

    /// Whether [`Self::record`] does nothing and need not be called.
    fn is_noop(&self) -> bool {
        false
    }
}

/// Receives every collapse of a simplification.
pub trait Recorder {
    /// Log of one part of the mesh; the parts are simplified in parallel.
    type Log: Log;

    /// Appends a log. The collapses of logs merged earlier were made before those of this one, or
    /// are independent of them.
    fn merge(&mut self, log: Self::Log);
}

/// Records nothing, vetoes nothing.
impl Log for () {
    fn record(&mut self, _: &Collapse<'_>) -> bool {
        true
    }

    fn is_noop(&self) -> bool {
        true
    }
}

/// Records nothing, vetoes nothing.
impl Recorder for () {
    type Log = ();

    fn merge(&mut self, (): ()) {}
}
