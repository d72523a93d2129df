//! Initial quadrics of the vertices, and their freedom to be collapsed or moved.

use glam::DVec3;
use rayon::prelude::*;

use super::halfedge::{NONE, face, next, prev};
use super::quadric::Quadric;
use super::{HalfEdges, Metric};
use crate::geometry::Mesh;

/// Weight of the planes that hold boundaries and cap rims in place, relative to faces.
const RIM_WEIGHT: f64 = 10.0;
/// Weight of a vertex per unit of [`crease`]. By area alone sharp tips and ridges, whose faces are
/// often small, would be collapsed early.
const CREASE_WEIGHT: f64 = 100.0;
/// Weight of the tangent plane of a vertex relative to its faces together.
const TANGENT_WEIGHT: f64 = 0.5;
/// Vertices of a parallel task; smaller meshes stay on their thread.
pub const PARCEL: usize = 4096;

/// Collapses and moves that a vertex is allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Freedom {
    /// May collapse onto any neighbour, and move.
    Free,
    /// Lies on a boundary or on the rim of a cap, and collapses along it only.
    Rim,
    /// Is kept where it is.
    Locked,
    /// Is kept, and no vertex may collapse onto it: belongs to more than one part of the mesh.
    Foreign,
}

/// Whether an edge is a boundary or separates a cap from the rest.
#[inline]
pub fn on_rim(edges: &HalfEdges, h: u32) -> bool {
    let pair = edges.pair(h);
    pair == NONE || edges.mark(face(h)) != edges.mark(face(pair))
}

/// Freedom of every vertex.
pub fn freedoms(edges: &HalfEdges, locked: Option<&[bool]>) -> Vec<Freedom> {
    let freedom = |v: u32| {
        if edges.out(v) == NONE || locked.is_some_and(|l| l[v as usize]) {
            return Freedom::Locked;
        }
        let leaving = edges.around(v).filter(|h| on_rim(edges, *h)).count();
        match leaving + usize::from(edges.on_boundary(v)) {
            0 => Freedom::Free,
            2 => Freedom::Rim,
            _ => Freedom::Locked,
        }
    };
    (0..edges.vertex_count() as u32).into_par_iter().with_min_len(PARCEL).map(freedom).collect()
}

/// Quadrics of the vertices `of`, from positions in the units of the result. The weight of a face is
/// its area plus `floor`.
pub fn quadrics(
    mesh: &Mesh,
    edges: &HalfEdges,
    at: &(impl Fn(u32) -> DVec3 + Sync),
    (metric, floor): (Metric, f64),
    of: &[u32],
) -> Vec<Quadric> {
    let one = |&v: &u32| {
        let mut q = Quadric::default();
        let mut sum = DVec3::ZERO;
        let p = at(v);
        for h in edges.around(v) {
            let (a, b) = (at(edges.target(h)), at(edges.origin(prev(h))));
            let cross = (a - p).cross(b - p);
            let length = cross.length();
            if length == 0.0 {
                continue;
            }
            let n = cross / length;
            sum += cross;
            let weight = if metric == Metric::Paper { 1.0 } else { 0.5 * length + floor };
            q += Quadric::plane(n, p, weight);
        }
        if metric != Metric::Qem {
            let own = mesh.normals.get(v as usize).map(|n| n.as_dvec3());
            let normal = own.unwrap_or(sum).try_normalize();
            if let Some(n) = normal {
                let share = if metric == Metric::Paper { 1.0 } else { TANGENT_WEIGHT };
                q += Quadric::plane(n, p, share * q.weight);
            }
        }
        if metric == Metric::NormalQem {
            q = q.times(1.0 + CREASE_WEIGHT * crease(mesh, edges, v));
        }
        for h in edges.around(v) {
            for h in [h, prev(h)].into_iter().filter(|h| on_rim(edges, *h)) {
                q += edge_plane(edges, at, h);
            }
        }
        q
    };
    of.par_iter().with_min_len(PARCEL).map(one).collect()
}

/// Weight added to the area of each face: the mean area, as concave tips consist of tiny triangles
/// that area weights ignore. Chunks are summed in order: the same at any number of threads.
pub fn floor(mesh: &Mesh, at: impl Fn(u32) -> DVec3 + Sync, metric: Metric) -> f64 {
    if metric != Metric::NormalQem {
        return 0.0;
    }
    let twice = |f: &[u32; 3]| {
        let [a, b, c] = f.map(&at);
        (b - a).cross(c - a).length()
    };
    let chunks = mesh.faces.par_chunks(PARCEL);
    let sums: Vec<f64> = chunks.map(|part| part.iter().map(twice).sum()).collect();
    0.5 * sums.iter().sum::<f64>() / mesh.faces.len().max(1) as f64
}

/// Mean of 1 − cos between the normal of `v` and those of its neighbours: 0.3 on a sharp ridge of
/// 90°, below 0.01 where a mesh is fine enough for its shape. The normals should be smoothed, or the
/// voxel steps of a mask count as creases.
fn crease(mesh: &Mesh, edges: &HalfEdges, v: u32) -> f64 {
    let Some(n) = mesh.normals.get(v as usize) else { return 0.0 };
    let turn = |h: u32| 1.0 - f64::from(n.dot(mesh.normals[edges.target(h) as usize]));
    let (sum, count) = edges.around(v).fold((0.0, 0.0), |(s, c), h| (s + turn(h), c + 1.0));
    if count > 0.0 { f64::max(sum / count, 0.0) } else { 0.0 }
}

/// The plane through an edge at right angles to its face.
fn edge_plane(edges: &HalfEdges, at: &impl Fn(u32) -> DVec3, h: u32) -> Quadric {
    let [a, b, c] = [h, next(h), prev(h)].map(|h| at(edges.origin(h)));
    let along = b - a;
    match along.cross(along.cross(c - a)).try_normalize() {
        Some(n) => Quadric::plane(n, a, RIM_WEIGHT * along.length_squared()),
        None => Quadric::default(),
    }
}
