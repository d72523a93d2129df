//! Samples of the original at every vertex of the finest level.
//!
//! The grid of a face at depth L has n = 2^L steps a side; the grid point (i, j, k), i + j + k = n,
//! has the weights i/n, j/n, k/n. Points on edges and at corners are stored once for all incident
//! faces, sampled from the face with the lowest id, so both sides read the same bits.

use glam::Vec3;
use rayon::prelude::*;

use super::base_mesh::BaseMesh;
use super::original::Original;
use crate::geometry::Vertex;

/// Grid point of a face.
pub type SampleGrid = [u32; 3];

/// All samples.
#[derive(Clone, Debug, Default)]
pub struct SurfaceSamples {
    depth: u32,
    vertices: Vec<Vertex>,
    /// First sample of edges and first sample of faces.
    begin: [usize; 2],
}

/// Number of inner points of an edge and of a face.
fn inner(depth: u32) -> [usize; 2] {
    let n = 1usize << depth;
    [n - 1, (n - 1) * (n.max(2) - 2) / 2]
}

/// Number of samples of a base mesh at a depth.
pub fn count(base: &BaseMesh, depth: u32) -> usize {
    let [edge, face] = inner(depth);
    base.vertices + base.edges.len() * edge + base.faces.len() * face
}

/// Inner grid points of a face, in storage order.
fn inner_points(n: u32) -> impl Iterator<Item = SampleGrid> {
    (1..n.saturating_sub(1)).flat_map(move |i| (1..n - i).map(move |j| [i, j, n - i - j]))
}

impl SurfaceSamples {
    /// Takes all samples.
    pub fn take(base: &BaseMesh, depth: u32, original: &dyn Original) -> Self {
        let n = 1u32 << depth;
        let weights = |g: SampleGrid| g.map(|c| f64::from(c) / f64::from(n));
        let begin = [base.vertices, base.vertices + base.edges.len() * inner(depth)[0]];
        let mut corner = vec![None; base.vertices];
        for (f, face) in base.faces.iter().enumerate() {
            for (c, v) in face.iter().enumerate() {
                corner[*v as usize].get_or_insert((f as u32, c));
            }
        }
        // Vertices without faces are never read.
        let mut vertices: Vec<Vertex> = corner
            .par_iter()
            .map(|at| {
                let mut g = [0; 3];
                at.map_or_else(Vertex::default, |(f, c)| {
                    g[c] = n;
                    original.at(f, weights(g))
                })
            })
            .collect();
        vertices.par_extend(base.edges.par_iter().flat_map_iter(|e| {
            (1..n).map(move |k| {
                let mut g = [0; 3];
                g[e.corner as usize] = n - k;
                g[(e.corner as usize + 1) % 3] = k;
                original.at(e.faces[0], weights(g))
            })
        }));
        vertices.par_extend(
            (0..base.faces.len() as u32)
                .into_par_iter()
                .flat_map_iter(|f| inner_points(n).map(move |g| original.at(f, weights(g)))),
        );
        Self { depth, vertices, begin }
    }

    /// The depth L.
    pub fn depth(&self) -> u32 {
        self.depth
    }

    /// Index of a grid point of a face among the samples.
    pub fn index(&self, base: &BaseMesh, f: u32, g: SampleGrid) -> usize {
        let n = 1u32 << self.depth;
        if let Some(c) = g.iter().position(|&c| c == n) {
            return base.faces[f as usize][c] as usize;
        }
        let [i, j, _] = g.map(|c| c as usize);
        let [edge_points, face_points] = inner(self.depth);
        if let Some(zero) = g.iter().position(|&c| c == 0) {
            let e = (zero + 1) % 3;
            let id = base.face_edges[f as usize][e];
            let along = if id & 1 == 0 { g[(e + 1) % 3] } else { g[e] };
            return self.begin[0] + (id >> 1) as usize * edge_points + along as usize - 1;
        }
        let row = (i - 1) * (n as usize - 1) - (i - 1) * i / 2;
        self.begin[1] + f as usize * face_points + row + j - 1
    }

    /// The original at a grid point.
    pub fn vertex(&self, base: &BaseMesh, f: u32, g: SampleGrid) -> Vertex {
        self.vertices[self.index(base, f, g)]
    }

    /// Position of a grid point, LPS mm.
    pub fn position(&self, base: &BaseMesh, f: u32, g: SampleGrid) -> Vec3 {
        self.vertex(base, f, g).position()
    }

    /// Every sample.
    pub fn all(&self) -> &[Vertex] {
        &self.vertices
    }
}

/// Triangles of a triangular grid with `m` steps a side, all oriented like the face: first the
/// upright ones, then the inverted ones.
pub fn triangles(m: u32) -> impl Iterator<Item = [SampleGrid; 3]> {
    let points = |s: u32| (0..=s).flat_map(move |a| (0..=s - a).map(move |b| [a, b, s - a - b]));
    let up = points(m - 1).map(|[a, b, c]| [[a + 1, b, c], [a, b + 1, c], [a, b, c + 1]]);
    let down = (m >= 2).then(|| points(m - 2)).into_iter().flatten();
    up.chain(down.map(|[a, b, c]| [[a, b + 1, c + 1], [a + 1, b, c + 1], [a + 1, b + 1, c]]))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn samples_are_indexed_once_and_shared_across_edges() {
        let base = BaseMesh::new(vec![[0, 1, 2], [2, 1, 3], [3, 0, 2]], 4);
        let depth = 3;
        let samples = SurfaceSamples {
            depth,
            vertices: Vec::new(),
            begin: [4, 4 + base.edges.len() * inner(depth)[0]],
        };
        let mut seen = vec![0; count(&base, depth)];
        for f in 0..3 {
            for i in 0..=8 {
                for j in 0..=8 - i {
                    seen[samples.index(&base, f, [i, j, 8 - i - j])] += 1;
                }
            }
        }
        // Shared by two faces: three edges would be on a closed mesh; here 1-2, 2-3, 0-2.
        let shared = seen[4..].iter().filter(|n| **n == 2).count();
        assert_eq!(shared, 3 * 7);
        assert!(seen.iter().all(|n| *n >= 1));
        // From either side the same point of the edge: 1-2 lies in faces 0 and 1.
        for k in 1..8 {
            let a = samples.index(&base, 0, [0, k, 8 - k]);
            assert_eq!(a, samples.index(&base, 1, [8 - k, k, 0]));
        }
    }

    #[test]
    fn grid_triangles_tile_the_face() {
        for m in [1, 2, 4, 8] {
            let twice_area = |[a, b, c]: [SampleGrid; 3]| {
                let d = |p: SampleGrid, q: SampleGrid| {
                    [0, 1].map(|k| i64::from(q[k]) - i64::from(p[k]))
                };
                let (u, v) = (d(a, b), d(a, c));
                u[0] * v[1] - u[1] * v[0]
            };
            let all: Vec<_> = triangles(m).collect();
            assert_eq!(all.len(), (m * m) as usize);
            let one = twice_area([[1, 0, 0], [0, 1, 0], [0, 0, 1]]);
            assert!(all.iter().all(|t| twice_area(*t) == one));
        }
    }
}
