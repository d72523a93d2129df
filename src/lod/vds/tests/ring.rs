//! Originals for tests.

use std::f64::consts::TAU;

use glam::{DVec3, Vec3};

use crate::geometry::{Mesh, TriangleBvh, Vertex};
use crate::lod::vds::Original;

/// A torus with folds, parameterised over a coarser one. `jitter` displaces samples by that much,
/// differently for every base face: two faces then disagree on their common edge, as rounding would
/// have it.
pub struct Ring {
    /// Quads of the base round the ring and round the tube, and steps of the original in each.
    cells: [u32; 2],
    steps: u32,
    pub jitter: f64,
    pub mesh: Mesh,
    pub tree: TriangleBvh,
}

pub const RING_MM: f64 = 30.0;
const TUBE_MM: f64 = 8.0;

impl Ring {
    /// Creates a ring whose original has `steps` steps to a quad of the base.
    pub fn new(cells: [u32; 2], steps: u32) -> Self {
        let mesh = grid(cells, steps);
        let tree = TriangleBvh::new(&mesh);
        Self { cells, steps, jitter: 0.0, mesh, tree }
    }

    pub fn base(&self) -> Mesh {
        grid(self.cells, 1)
    }

    /// Corners of a base face in steps of the base grid, not wrapped round.
    fn corners(&self, face: u32) -> [[u32; 2]; 3] {
        let (i, j) = (face / 2 / self.cells[1], face / 2 % self.cells[1]);
        let [a, b, c, d] = [[i, j], [i + 1, j], [i + 1, j + 1], [i, j + 1]];
        if face.is_multiple_of(2) { [a, c, b] } else { [a, d, c] }
    }
}

/// The ring with `steps` steps to a quad.
fn grid(cells: [u32; 2], steps: u32) -> Mesh {
    let [nu, nv] = cells.map(|c| c * steps);
    let mut mesh = Mesh::default();
    for i in 0..nu {
        for j in 0..nv {
            let (u, v) = (TAU * f64::from(i) / f64::from(nu), TAU * f64::from(j) / f64::from(nv));
            // Folds, so that no level is exact by symmetry.
            let r = TUBE_MM * (1.0 + 0.06 * (5.0 * u + 2.0 * v).sin());
            let out = DVec3::new(v.cos() * u.cos(), v.cos() * u.sin(), v.sin());
            let at = DVec3::new(u.cos(), u.sin(), 0.0) * RING_MM + r * out;
            mesh.positions.push(at.as_vec3());
            mesh.normals.push(-out.as_vec3());
            let id = |i: u32, j: u32| i % nu * nv + j % nv;
            let [a, b, c, d] = [id(i, j), id(i + 1, j), id(i + 1, j + 1), id(i, j + 1)];
            mesh.faces.extend([[a, c, b], [a, d, c]]);
        }
    }
    mesh
}

impl Original for Ring {
    fn at(&self, face: u32, weights: [f64; 3]) -> Vertex {
        let corners = self.corners(face);
        let m = f64::from(self.steps);
        let [x, y] =
            [0, 1].map(|k| m * (0..3).map(|c| weights[c] * f64::from(corners[c][k])).sum::<f64>());
        let low = |x: f64, k: usize| {
            let first = corners[0][k].min(corners[1][k]).min(corners[2][k]) * self.steps;
            (x.floor() as u32).clamp(first, first + self.steps - 1)
        };
        let (i, j) = (low(x, 0), low(y, 1));
        let (fx, fy) = (x - f64::from(i), y - f64::from(j));
        let quad = (i * self.cells[1] * self.steps + j) * 2;
        let (id, w) = if fx >= fy {
            (quad, [1.0 - fx, fy, fx - fy])
        } else {
            (quad + 1, [1.0 - fy, fy - fx, fx])
        };
        let f = self.mesh.faces[id as usize];
        let sum = |of: &dyn Fn(usize) -> Vec3| -> DVec3 {
            (0..3).map(|c| w[c] * of(f[c] as usize).as_dvec3()).sum()
        };
        let shift = self.jitter * (f64::from(face % 7) - 3.0);
        let at = sum(&|v| self.mesh.positions[v]) + DVec3::splat(shift);
        let normal = sum(&|v| self.mesh.normals[v]).as_vec3().normalize();
        Vertex::new(at.as_vec3(), normal, 0.25)
    }

    fn vertices(&self) -> u32 {
        self.mesh.positions.len() as u32
    }

    fn vertex(&self, vertex: u32) -> Option<(u32, [f64; 3], Vertex)> {
        let nv = self.cells[1] * self.steps;
        let at = [vertex / nv, vertex % nv];
        let quad = at[0] / self.steps * self.cells[1] + at[1] / self.steps;
        let [fx, fy] = at.map(|x| f64::from(x % self.steps) / f64::from(self.steps));
        let (half, w) =
            if fx >= fy { (0, [1.0 - fx, fy, fx - fy]) } else { (1, [1.0 - fy, fy - fx, fx]) };
        let v = vertex as usize;
        let vertex = Vertex::new(self.mesh.positions[v], self.mesh.normals[v], 0.25);
        Some((quad * 2 + half, w, vertex))
    }

    fn faces(&self) -> u64 {
        self.mesh.faces.len() as u64
    }

    fn distance_mm(&self, p: DVec3) -> f64 {
        self.tree.closest(p).map_or(f64::INFINITY, |c| c.distance_mm)
    }
}
