//! The input of a simplification, shared by the runs over all of it or over parts.

use glam::DVec3;
use rayon::prelude::*;

use super::quadric::Quadric;
use super::vertex_quadrics::{Freedom, PARCEL, floor, freedoms, quadrics};
use super::{HalfEdges, MeshError, Metric, SimplifyOptions};
use crate::geometry::Mesh;

/// The input mesh with its connectivity, vertex freedoms and metric.
pub struct Input<'a> {
    /// The mesh.
    pub mesh: &'a Mesh,
    /// Half-edges of the mesh; the mark of a face is 1 for a cap.
    pub edges: HalfEdges,
    /// Collapses and moves that each vertex is allowed.
    pub freedom: Vec<Freedom>,
    /// Cost of a collapse.
    pub metric: Metric,
    /// Weight added to the area of each face.
    pub floor: f64,
    /// Whether kept vertices are relocated.
    pub moves: bool,
    /// Longest side of the bounding box, mm: the unit length of a run.
    pub mm: f64,
    centre: DVec3,
}

impl<'a> Input<'a> {
    /// Checks a mesh. O(V + F).
    ///
    /// # Errors
    /// As [`HalfEdges::new`].
    pub fn new(mesh: &'a Mesh, options: &SimplifyOptions<'_>) -> Result<Self, MeshError> {
        let mut edges = HalfEdges::new(mesh)?;
        for (f, cap) in mesh.caps.iter().enumerate() {
            edges.set_mark(f as u32, u32::from(*cap));
        }
        let (lo, hi) = mesh.bounds().unwrap_or_default();
        let (lo, hi) = (lo.as_dvec3(), hi.as_dvec3());
        let side = (hi - lo).max_element();
        let mut this = Self {
            mesh,
            freedom: freedoms(&edges, options.locked),
            edges,
            metric: options.metric,
            moves: options.relocate,
            mm: if side > 0.0 { side } else { 1.0 },
            centre: 0.5 * (lo + hi),
            floor: 0.0,
        };
        this.floor = floor(mesh, |v| this.at(v), options.metric);
        Ok(this)
    }

    /// Position of a vertex in the units of a run: the box centred at 0, its longest side 1.
    #[inline]
    pub fn at(&self, v: u32) -> DVec3 {
        (self.mesh.positions[v as usize].as_dvec3() - self.centre) / self.mm
    }

    /// Converts a position of a run to mm.
    #[inline]
    pub fn in_mm(&self, at: DVec3) -> DVec3 {
        at * self.mm + self.centre
    }

    /// Initial quadrics of these vertices.
    pub fn quadrics(&self, ids: &[u32]) -> Vec<Quadric> {
        quadrics(self.mesh, &self.edges, &|v| self.at(v), (self.metric, self.floor), ids)
    }

    /// Calls `what` for each of these vertices in parallel and returns the results in their order.
    pub fn of_each<T: Send>(&self, ids: &[u32], what: impl Fn(u32) -> T + Sync + Send) -> Vec<T> {
        ids.par_iter().with_min_len(PARCEL).map(|v| what(*v)).collect()
    }
}
