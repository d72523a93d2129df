//! Mapping of points over the recorded collapses.

use glam::DVec3;
use rayon::prelude::*;

use super::flatten::clean;
use super::{NONE, Parameterization, ParameterizationError, RemovedVertex, Triangle};
use crate::geometry::{Mesh, MeshPoint};
use crate::mesh::MappedPoint;

/// Least number of points for a thread: a hop takes some tens of nanoseconds.
const MIN_BATCH: usize = 512;

/// Corner of `triangle` that is `vertex`.
fn corner(triangle: &Triangle, vertex: u32) -> usize {
    triangle.vertices.iter().position(|&v| v == vertex).unwrap_or(0)
}

impl Parameterization {
    /// Maps a point on the original mesh to the base mesh.
    ///
    /// Weights that are negative or undefined count as 0; the result's are not negative and sum
    /// to 1.
    ///
    /// # Errors
    /// [`ParameterizationError::NoFace`] for a face the original mesh does not have.
    pub fn to_base(&self, at: MeshPoint) -> Result<MappedPoint, ParameterizationError> {
        self.to_base_with(at, |w| w)
    }

    /// Maps a point on the base mesh, its face named by half-edge face, to the original mesh.
    ///
    /// # Errors
    /// [`ParameterizationError::NoFace`] for a face the base mesh does not have.
    pub fn to_fine(&self, at: MeshPoint) -> Result<MappedPoint, ParameterizationError> {
        self.to_fine_with(at, |w| w)
    }

    /// Positions of all removed vertices on the base, in the order of removal.
    pub fn removed_vertices(&self) -> Vec<RemovedVertex> {
        let tuple = |record: u32| {
            let (r, polygon) = self.polygon(record);
            let (j, w) = polygon.find_post([0.0; 2]);
            let (t, w) = self.enter_post(record, j, w);
            RemovedVertex { vertex: r.from, at: self.down(t, w, |w| w).at }
        };
        (0..self.records.len() as u32).into_par_iter().with_min_len(MIN_BATCH).map(tuple).collect()
    }

    /// A point of the original mesh.
    ///
    /// # Errors
    /// [`ParameterizationError::NoFace`] for a face or vertex that does not exist.
    pub fn point(mesh: &Mesh, at: MeshPoint) -> Result<DVec3, ParameterizationError> {
        let missing = ParameterizationError::NoFace { face: at.face, mesh: "original" };
        let Some(face) = mesh.faces.get(at.face as usize) else { return Err(missing) };
        let mut sum = DVec3::ZERO;
        for (&v, w) in face.iter().zip(at.weights) {
            let Some(&p) = mesh.positions.get(v as usize) else { return Err(missing) };
            sum += w * DVec3::from(p);
        }
        Ok(sum)
    }

    /// [`Parameterization::to_base`], the weights passing through `between` after each hop.
    pub(super) fn to_base_with(
        &self,
        at: MeshPoint,
        between: impl Fn([f64; 3]) -> [f64; 3],
    ) -> Result<MappedPoint, ParameterizationError> {
        if at.face >= self.faces {
            return Err(ParameterizationError::NoFace { face: at.face, mesh: "original" });
        }
        Ok(self.down(at.face, clean(at.weights), between))
    }

    /// [`Parameterization::to_fine`], the weights passing through `between` before each hop.
    pub(super) fn to_fine_with(
        &self,
        at: MeshPoint,
        between: impl Fn([f64; 3]) -> [f64; 3],
    ) -> Result<MappedPoint, ParameterizationError> {
        let missing = ParameterizationError::NoFace { face: at.face, mesh: "base" };
        let Some(&t) = self.current.get(at.face as usize) else { return Err(missing) };
        if t == NONE {
            return Err(missing);
        }
        Ok(self.up(t, clean(at.weights), between))
    }

    /// Maps a point of a triangle to the base. Ids of triangles grow with every hop, so it ends.
    fn down(
        &self,
        mut t: u32,
        mut w: [f64; 3],
        between: impl Fn([f64; 3]) -> [f64; 3],
    ) -> MappedPoint {
        let mut hops = 0;
        loop {
            let triangle = &self.triangles[t as usize];
            if triangle.pre == NONE {
                return MappedPoint { at: MeshPoint { face: triangle.slot, weights: w }, hops };
            }
            let (record, polygon) = self.polygon(triangle.pre);
            let i = polygon.ring.iter().position(|e| e.pre == t).unwrap_or(0);
            // The faces are in the ring's order, so after `from` come the two ring vertices.
            let c = corner(triangle, record.from);
            let [_, a, b] = polygon.pre(i);
            let (wa, wb) = (w[(c + 1) % 3], w[(c + 2) % 3]);
            let p = [wa * a[0] + wb * b[0], wa * a[1] + wb * b[1]];
            let (j, found) = polygon.find_post(p);
            (t, w) = self.enter_post(triangle.pre, j, found);
            w = between(w);
            hops += 1;
        }
    }

    /// Post triangle `j` of a record, the weights put in the order of its vertices.
    fn enter_post(&self, record: u32, j: usize, found: [f64; 3]) -> (u32, [f64; 3]) {
        let (r, polygon) = self.polygon(record);
        let t = r.first_post + j as u32;
        let to = polygon.ring[r.kind.apex(polygon.ring.len())].vertex;
        let mut w = found;
        w.rotate_right(corner(&self.triangles[t as usize], to));
        (t, w)
    }

    /// Maps a point of a triangle to the original. Ids of triangles fall with every hop, so it
    /// ends.
    fn up(
        &self,
        mut t: u32,
        mut w: [f64; 3],
        between: impl Fn([f64; 3]) -> [f64; 3],
    ) -> MappedPoint {
        let mut hops = 0;
        loop {
            let triangle = &self.triangles[t as usize];
            if triangle.post == NONE {
                return MappedPoint { at: MeshPoint { face: t, weights: w }, hops };
            }
            w = between(w);
            let (record, polygon) = self.polygon(triangle.post);
            let to = polygon.ring[record.kind.apex(polygon.ring.len())].vertex;
            w.rotate_left(corner(triangle, to));
            let [a, b, c] = polygon.post((t - record.first_post) as usize);
            let p = [0, 1].map(|x| w[0] * a[x] + w[1] * b[x] + w[2] * c[x]);
            let (i, found) = polygon.find_pre(p);
            t = polygon.ring[i].pre;
            w = found;
            w.rotate_right(corner(&self.triangles[t as usize], record.from));
            hops += 1;
        }
    }
}
