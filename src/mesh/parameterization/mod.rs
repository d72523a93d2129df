//! MAPS: the bijection between a mesh and its simplification.
//!
//! Each half-edge collapse u → v replaces the faces around u by fewer faces over the same polygon.
//! Flattened, that is a piecewise linear bijection; a point is mapped by its barycentric weights.
//! [`Parameterization`] records every collapse with its flattened polygon. A triangle gets a new id
//! whenever it changes, so each is made by at most one collapse and replaced by at most one, and
//! mapping a point from the original to the base or back is a walk along these two links.
//!
//! After Lee, Sweldens, Schröder, Cowsar, Dobkin: MAPS, 1998, doi:10.1145/280814.280828, and
//! Khodakovsky, Litke, Schröder 2003, doi:10.1145/882262.882275. Ours: the sequence of collapses
//! is replayed, where they keep a 4-tuple of every removed vertex up to date; a 4-tuple places
//! vertices only, and the surface between them straddles base edges. No re-triangulation: a
//! collapse whose flattened polygon would fold is refused.

mod flatten;
mod replay;
#[cfg(test)]
mod tests;

use super::{Collapse, Log, Recorder};
use crate::geometry::{Mesh, MeshPoint};
use flatten::{FanPlace, Flat, FlatRing, Spoke, flatten};

/// Index where there is no record, triangle or face.
const NONE: u32 = u32::MAX;

/// Reasons why a parameterisation cannot be used.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ParameterizationError {
    /// A face that does not exist.
    #[error("face {face} is not a face of the {mesh} mesh")]
    NoFace {
        /// Number of the face.
        face: u32,
        /// Name of the mesh: `original` or `base`.
        mesh: &'static str,
    },
    /// More vertices or faces than ids can count.
    #[error("mesh of {vertices} vertices and {faces} faces is too large for a parameterisation")]
    TooLarge {
        /// Number of vertices.
        vertices: usize,
        /// Number of faces.
        faces: usize,
    },
}

/// A point mapped to the other mesh.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MappedPoint {
    /// Point on the other mesh.
    pub at: MeshPoint,
    /// Number of collapses it was mapped over.
    pub hops: u32,
}

/// Position of a removed vertex on the base mesh: the paper's 4-tuple.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RemovedVertex {
    /// Original id of the vertex.
    pub vertex: u32,
    /// Base face and the weights of its vertices.
    pub at: MeshPoint,
}

/// One collapse.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Record {
    /// The vertex that is removed.
    from: u32,
    /// Index of the first ring entry; the entries end where those of the next record start.
    start: u32,
    /// Id of the first triangle that the collapse makes.
    first_post: u32,
    /// Arrangement of the fans.
    kind: FanPlace,
}

/// One ring vertex of a collapse.
#[derive(Clone, Copy, Debug, PartialEq)]
struct RingEntry {
    /// The vertex.
    vertex: u32,
    /// Triangle between this and the next ring vertex before the collapse; `NONE` after the last on
    /// a boundary.
    pre: u32,
    /// Position in the plane.
    flat: [f32; 2],
}

impl Flat for RingEntry {
    fn flat(&self) -> [f64; 2] {
        self.flat.map(f64::from)
    }
}

/// One triangle that exists at some time between original and base.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
struct Triangle {
    /// Vertices of the triangle in the order of its weights.
    vertices: [u32; 3],
    /// Record that replaces the triangle, or `NONE` for a triangle of the base.
    pre: u32,
    /// Record that makes the triangle, or `NONE` for a triangle of the original.
    post: u32,
    /// Half-edge face that the triangle is stored in.
    slot: u32,
}

/// The bijection between an original mesh and its base mesh.
///
/// Faces of the original go by their index, faces of the base by the index of the original face
/// that they replace (the simplifier's half-edge face). A base face keeps the order of its
/// vertices: where a collapse replaces a corner, the new vertex has the index of the old one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Parameterization {
    /// Number of vertices of the original.
    vertices: u32,
    /// Number of faces of the original.
    faces: u32,
    triangles: Vec<Triangle>,
    records: Vec<Record>,
    entries: Vec<RingEntry>,
    /// Triangle in each half-edge face now, or `NONE`.
    current: Vec<u32>,
    /// Number of collapses refused.
    refused: u32,
}

impl Parameterization {
    /// Creates the identity on a mesh, to which collapses can be added.
    ///
    /// # Errors
    /// [`ParameterizationError::TooLarge`] for a mesh whose ids could overflow: each collapse takes a vertex and
    /// a face at least, and makes fewer than 32 ring entries and triangles.
    pub fn new(mesh: &Mesh) -> Result<Self, ParameterizationError> {
        let (vertices, faces) = (mesh.positions.len(), mesh.faces.len());
        if vertices.max(faces) > (NONE / 32) as usize {
            return Err(ParameterizationError::TooLarge { vertices, faces });
        }
        let triangle = |(slot, &vertices): (usize, &[u32; 3])| Triangle {
            vertices,
            pre: NONE,
            post: NONE,
            slot: slot as u32,
        };
        Ok(Self {
            vertices: vertices as u32,
            faces: faces as u32,
            triangles: mesh.faces.iter().enumerate().map(triangle).collect(),
            current: (0..faces as u32).collect(),
            ..Self::default()
        })
    }

    /// Number of collapses recorded.
    pub fn collapses(&self) -> usize {
        self.records.len()
    }

    /// Number of collapses refused because the flattened polygon would fold.
    pub fn refused(&self) -> u32 {
        self.refused
    }

    /// Memory held, bytes, without spare capacity.
    pub fn memory_bytes(&self) -> usize {
        size_of_val(&self.triangles[..])
            + size_of_val(&self.records[..])
            + size_of_val(&self.entries[..])
            + size_of_val(&self.current[..])
    }

    /// Faces of the base: half-edge face, and original vertex ids in the order of the weights.
    pub fn base_faces(&self) -> impl Iterator<Item = (u32, [u32; 3])> + '_ {
        let alive = self.current.iter().enumerate().filter(|(_, t)| **t != NONE);
        alive.map(|(slot, &t)| (slot as u32, self.triangles[t as usize].vertices))
    }

    /// Polygon of a record.
    fn polygon(&self, record: u32) -> (&Record, FlatRing<'_, RingEntry>) {
        let r = &self.records[record as usize];
        let next = self.records.get(record as usize + 1);
        let end = next.map_or(self.entries.len(), |n| n.start as usize);
        (r, FlatRing { ring: &self.entries[r.start as usize..end], kind: r.kind })
    }

    /// Records the newest ring entries, from `start`, as the collapse of `from`, with the triangles
    /// that it replaces and makes.
    fn append(&mut self, from: u32, start: usize, kind: FanPlace) {
        let record = self.records.len() as u32;
        let k = self.entries.len() - start;
        let to = self.entries[start + kind.apex(k)].vertex;
        let first_post = self.triangles.len() as u32;
        for i in 0..kind.pre(k) {
            let pre = self.entries[start + i].pre as usize;
            self.triangles[pre].pre = record;
            let Triangle { vertices, slot, .. } = self.triangles[pre];
            let stays = (kind.post_start()..kind.post_start() + k - 2).contains(&i);
            self.current[slot as usize] = NONE;
            if stays {
                self.current[slot as usize] = self.triangles.len() as u32;
                let vertices = vertices.map(|v| if v == from { to } else { v });
                self.triangles.push(Triangle { vertices, pre: NONE, post: record, slot });
            }
        }
        self.records.push(Record { from, start: start as u32, first_post, kind });
    }
}

/// Collapses of one part of a mesh, flattened.
#[derive(Debug, Default)]
pub struct FlattenLog {
    /// Vertex that is removed, arrangement of the fans, and end of the ring entries of each
    /// collapse.
    collapses: Vec<(u32, FanPlace, usize)>,
    /// Ring entries, with half-edge faces in place of the triangles stored in them.
    entries: Vec<RingEntry>,
    /// Number of collapses refused.
    refused: u32,
    /// Scratch space of [`flatten`].
    spokes: Vec<Spoke>,
}

impl Log for FlattenLog {
    /// Flattens the ring; refuses a collapse whose polygon would fold, or that leaves a boundary
    /// vertex with no face to lie on.
    fn record(&mut self, collapse: &Collapse<'_>) -> bool {
        let Collapse { from, to, ring, faces, from_at, ring_at, boundary } = *collapse;
        let start = self.entries.len();
        let kind = match (boundary, ring.first() == Some(&to)) {
            (false, _) => FanPlace::Inner,
            (true, true) => FanPlace::First,
            (true, false) => FanPlace::Last,
        };
        debug_assert_eq!(faces.len(), kind.pre(ring.len()), "faces of vertex {from}");
        let Self { spokes, entries, .. } = self;
        let mut i = 0;
        let push = |flat| {
            entries.push(RingEntry {
                vertex: ring[i],
                pre: faces.get(i).map_or(NONE, |f| *f),
                flat,
            });
            i += 1;
        };
        let laid = flatten(from_at, ring_at.iter().copied(), kind, spokes, push)
            && FlatRing { ring: &self.entries[start..], kind }.unfolded();
        if laid {
            self.collapses.push((from, kind, self.entries.len()));
        } else {
            self.entries.truncate(start);
            self.refused += 1;
        }
        laid
    }
}

impl Recorder for Parameterization {
    type Log = FlattenLog;

    fn merge(&mut self, log: FlattenLog) {
        self.refused += log.refused;
        let mut begin = 0;
        for (from, kind, end) in log.collapses {
            let start = self.entries.len();
            let current = &self.current;
            let triangle = |slot: u32| if slot == NONE { NONE } else { current[slot as usize] };
            let ring = log.entries[begin..end].iter();
            self.entries.extend(ring.map(|e| RingEntry { pre: triangle(e.pre), ..*e }));
            self.append(from, start, kind);
            begin = end;
        }
    }
}
