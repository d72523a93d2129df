//! Edge connectivity of the base mesh.

use std::collections::HashMap;

/// Stands for "no face".
pub const NO_FACE: u32 = u32::MAX;

/// An edge, in the direction in which its first face runs along it.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Edge {
    /// The two faces; the one with the lower id comes first, and samples of the edge are taken from
    /// it.
    pub faces: [u32; 2],
    /// The corner of the first face at which the edge begins.
    pub corner: u32,
}

/// Connectivity of a base mesh. Edge e of a face runs from its corner e to corner e + 1.
#[derive(Clone, Debug, Default)]
pub struct BaseMesh {
    /// Vertices of each face.
    pub faces: Vec<[u32; 3]>,
    /// Edges by id.
    pub edges: Vec<Edge>,
    /// Edges of each face: edge id · 2, + 1 where the face runs against the edge.
    pub face_edges: Vec<[u32; 3]>,
    /// Number of vertices.
    pub vertices: usize,
}

impl BaseMesh {
    /// Builds the connectivity. Where more than two faces meet in an edge, or two run along it the
    /// same way, faces are paired in order and the rest get an edge of their own, as on a boundary.
    pub fn new(faces: Vec<[u32; 3]>, vertices: usize) -> Self {
        let mut base =
            Self { face_edges: vec![[0; 3]; faces.len()], faces, vertices, ..Self::default() };
        let mut waiting: HashMap<(u32, u32), u32> = HashMap::new();
        for f in 0..base.faces.len() {
            for e in 0..3 {
                let (a, b) = (base.faces[f][e], base.faces[f][(e + 1) % 3]);
                let id = match waiting.remove(&(b, a)) {
                    Some(edge) if base.edges[edge as usize].faces[0] != f as u32 => {
                        base.edges[edge as usize].faces[1] = f as u32;
                        edge << 1 | 1
                    }
                    _ => {
                        let edge = base.edges.len() as u32;
                        base.edges.push(Edge { faces: [f as u32, NO_FACE], corner: e as u32 });
                        waiting.insert((a, b), edge);
                        edge << 1
                    }
                };
                base.face_edges[f][e] = id;
            }
        }
        base
    }

    /// The face across edge `e` of face `f`, and the edge's place in it.
    pub fn twin(&self, f: u32, e: usize) -> Option<(u32, u32)> {
        let id = self.face_edges[f as usize][e] >> 1;
        let [a, b] = self.edges[id as usize].faces;
        let other = if a == f { b } else { a };
        let own = self.face_edges.get(other as usize)?;
        own.iter().position(|k| k >> 1 == id).map(|k| (other, k as u32))
    }

    /// The face across edge `e` of face `f`.
    pub fn across(&self, f: u32, e: usize) -> Option<u32> {
        self.twin(f, e).map(|t| t.0)
    }
}
