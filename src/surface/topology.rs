//! Vertex adjacency, connected components, Euler number and watertightness of a mesh.

use glam::Vec3;
use rayon::prelude::*;

use super::extract::parts;
use crate::compute::{Buf, DeviceCopy, Plan};
use crate::geometry::{Mesh, in_rows};

/// Adjacent vertices of every vertex, ascending, in compressed rows.
#[derive(Clone, Debug, Default)]
pub struct Adjacency {
    /// Index of the first entry of each vertex, and the end: V + 1 numbers.
    pub(super) start: Vec<u32>,
    /// Adjacent vertices, by vertex.
    pub(super) near: Vec<u32>,
    copies: [DeviceCopy; 2],
}

/// Topological counts of a surface.
#[derive(Clone, Copy, Debug, PartialEq, Eq, serde::Serialize)]
pub struct Topology {
    /// Number of vertices used by faces.
    pub vertices: usize,
    /// Number of faces.
    pub faces: usize,
    /// Number of undirected edges.
    pub edges: usize,
    /// Number of connected components.
    pub components: usize,
    /// Euler number, V − E + F.
    pub euler: i64,
    /// Whether every directed edge occurs once and its reverse once.
    pub watertight: bool,
}

impl Topology {
    /// Returns the number of handles of a closed surface: loops of the lumen that a tree does not
    /// follow; 0 for a mesh that is not closed. A closed surface of genus g has Euler number 2 − 2
    /// g.
    pub fn tunnels(&self) -> i64 {
        if self.watertight { self.components as i64 - self.euler / 2 } else { 0 }
    }
}

impl Adjacency {
    fn new(start: Vec<u32>, near: Vec<u32>) -> Self {
        Self { start, near, copies: Default::default() }
    }

    /// Adds the rows and their entries to a plan.
    pub(super) fn upload<'a>(&'a self, plan: &mut Plan<'a>) -> (Buf<u32>, Buf<u32>) {
        let [start, near] = &self.copies;
        (
            plan.upload_kept("adjacency rows", &self.start, start),
            plan.upload_kept("adjacent vertices", &self.near, near),
        )
    }

    /// Computes the adjacency of a mesh of any kind, and whether it is watertight.
    pub fn of(mesh: &Mesh) -> (Self, bool) {
        let n = mesh.positions.len();
        // Directed edges by their first vertex; a closed oriented mesh has each reverse once.
        let edges = |f: &[u32; 3]| [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])];
        let (out_start, mut out) = in_rows(n, || mesh.faces.iter().flat_map(edges));
        crate::task::checkpoint();
        let ends = out_start.windows(2).map(|w| (w[1] - w[0]) as usize);
        let rows = parts(&mut out, ends);
        rows.into_par_iter().with_min_len(4096).for_each(|r| r.sort_unstable());
        let row = |v: u32| &out[out_start[v as usize] as usize..out_start[v as usize + 1] as usize];
        crate::task::checkpoint();
        // Sorted rows: a vertex with very many edges, the tip of a fan, is no reason to wait.
        let closed = (0..n as u32).into_par_iter().with_min_len(4096).all(|v| {
            let is_once = row(v).windows(2).all(|w| w[0] != w[1]);
            is_once && row(v).iter().all(|w| row(*w).binary_search(&v).is_ok())
        });
        if closed {
            // Neighbours are then exactly the ends of the outgoing edges.
            return (Self::new(out_start, out), true);
        }
        let both = |(a, b)| [(a, b), (b, a)];
        let mut pairs: Vec<(u32, u32)> =
            mesh.faces.par_iter().flat_map_iter(|f| edges(f).into_iter().flat_map(both)).collect();
        pairs.par_sort_unstable();
        pairs.dedup();
        let (start, near) = in_rows(n, || pairs.iter().copied());
        (Self::new(start, near), false)
    }

    /// Returns the index of the first entry of each vertex, with the end, and the entries.
    pub fn rows(&self) -> (&[u32], &[u32]) {
        (&self.start, &self.near)
    }

    /// Returns the adjacent vertices of `v`.
    pub fn row(&self, v: usize) -> &[u32] {
        &self.near[self.start[v] as usize..self.start[v + 1] as usize]
    }

    /// Returns the component of each vertex (its smallest vertex id).
    pub fn components(&self) -> Vec<u32> {
        let n = self.start.len().saturating_sub(1);
        let mut label = vec![u32::MAX; n];
        let mut open = Vec::new();
        for v in 0..n {
            if label[v] != u32::MAX {
                continue;
            }
            label[v] = v as u32;
            open.push(v);
            while let Some(u) = open.pop() {
                for &w in self.row(u) {
                    if label[w as usize] == u32::MAX {
                        label[w as usize] = v as u32;
                        open.push(w as usize);
                    }
                }
            }
        }
        label
    }

    /// Counts vertices, faces, edges and components of the mesh.
    pub fn topology(&self, mesh: &Mesh, watertight: bool) -> Topology {
        let n = mesh.positions.len();
        let used = (0..n).filter(|&v| !self.row(v).is_empty()).count();
        let labels = self.components();
        let roots = |v: &usize| labels[*v] as usize == *v && !self.row(*v).is_empty();
        let components = (0..n).filter(roots).count();
        let (edges, faces) = (self.near.len() / 2, mesh.faces.len());
        let euler = used as i64 - edges as i64 + faces as i64;
        Topology { vertices: used, faces, edges, components, euler, watertight }
    }
}

/// Extracts the component of one vertex, in the order of the mesh.
pub fn keep_component(mesh: &Mesh, labels: &[u32], of: u32) -> Mesh {
    let kept = labels[of as usize];
    let mut id = vec![u32::MAX; mesh.positions.len()];
    let mut next = 0;
    for (v, id) in id.iter_mut().enumerate() {
        if labels[v] == kept {
            *id = next;
            next += 1;
        }
    }
    let pick = |p: &[Vec3]| -> Vec<Vec3> {
        p.iter().zip(labels).filter(|(_, l)| **l == kept).map(|(p, _)| *p).collect()
    };
    let keeps = |f: &[u32; 3]| labels[f[0] as usize] == kept;
    Mesh {
        positions: pick(&mesh.positions),
        normals: pick(&mesh.normals),
        faces: mesh.faces.iter().filter(|f| keeps(f)).map(|f| f.map(|v| id[v as usize])).collect(),
        caps: mesh
            .faces
            .iter()
            .zip(&mesh.caps)
            .filter(|(f, _)| keeps(f))
            .map(|(_, c)| *c)
            .collect(),
    }
}
