//! Triangles of one base face at its fineness, matched to the fineness of its edges.

use super::base_mesh::BaseMesh;
use super::fineness::{Fineness, level, morph};
use super::samples::{SampleGrid, SurfaceSamples, triangles};
use crate::geometry::Vertex;

/// Levels inside a block: a face at a finer level is split into several blocks of 64 triangles.
const BLOCK_DEPTH: u32 = 3;

/// Fineness of a face and its three edges: all that its triangles depend on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FaceFineness {
    /// Base face id.
    pub face: u32,
    /// Fineness of the face.
    pub own: Fineness,
    /// Fineness of its edges; each has the level of the face or the next one.
    pub edges: [Fineness; 3],
}

/// A part of a face that is written at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Block {
    /// Fineness of the face.
    pub cell: FaceFineness,
    /// Corners on the grid of the face at level `level - depth`, and the steps of that grid.
    corners: [SampleGrid; 3],
    steps: u32,
    /// Levels inside the block.
    depth: u32,
    /// Sides (from corner e to e + 1) that are on edge e of the face and are split once more.
    pub split: [bool; 3],
    /// Sides that are on edge e of the face.
    on_edge: [bool; 3],
}

impl FaceFineness {
    /// Blocks of the face, in a fixed order.
    pub fn blocks(self) -> impl Iterator<Item = Block> {
        let own = level(self.own);
        let depth = own.min(BLOCK_DEPTH);
        let steps = 1 << (own - depth);
        triangles(steps).map(move |corners| {
            let on =
                |e: usize| corners[e][(e + 2) % 3] == 0 && corners[(e + 1) % 3][(e + 2) % 3] == 0;
            let on_edge = [on(0), on(1), on(2)];
            let split = [0, 1, 2].map(|e| on_edge[e] && level(self.edges[e]) > own);
            Block { cell: self, corners, steps, depth, split, on_edge }
        })
    }
}

impl Block {
    fn splits(&self) -> usize {
        self.split.iter().filter(|s| **s).count() << self.depth
    }

    /// Number of triangles.
    pub fn triangles(&self) -> usize {
        (1 << (2 * self.depth)) + self.splits()
    }

    /// Number of vertices.
    pub fn vertices(&self) -> usize {
        let m = 1usize << self.depth;
        (m + 1) * (m + 2) / 2 + self.splits()
    }

    /// Everything that the triangles of the block depend on, as two numbers.
    pub fn content(&self) -> [u64; 2] {
        let seen = |e: usize| if self.on_edge[e] { u64::from(self.cell.edges[e]) } else { 0xff };
        let fine = [u64::from(self.cell.own), seen(0), seen(1), seen(2)];
        let [a, b, _] = self.corners[0];
        let [c, d, _] = self.corners[1];
        let place = [a, b, c, d].iter().fold(0, |p, c| p << 8 | u64::from(*c));
        [u64::from(self.cell.face) << 32 | fine.iter().fold(0, |p, f| p << 8 | f), place]
    }

    /// Appends the vertices and triangles of the block.
    pub fn write(
        &self,
        base: &BaseMesh,
        samples: &SurfaceSamples,
        vertices: &mut Vec<Vertex>,
        faces: &mut Vec<[u8; 3]>,
    ) {
        let first = vertices.len();
        let m = 1u32 << self.depth;
        // In half steps, so that midpoints of split sides have integer coordinates.
        let scale = (1 << samples.depth()) / self.steps;
        let grid = |p: SampleGrid| -> SampleGrid {
            [0, 1, 2].map(|k| {
                let sum: u32 = (0..3).map(|c| p[c] * self.corners[c][k]).sum();
                sum * scale / (2 * m)
            })
        };
        let at = |p: SampleGrid| self.cell.vertex(base, samples, grid(p));
        // Rows by the first coordinate.
        let place = |[a, b, _]: SampleGrid| {
            first + (a * (m + 1) + b) as usize - (a * a.saturating_sub(1) / 2) as usize
        };
        for a in 0..=m {
            vertices.extend((0..=m - a).map(|b| at([2 * a, 2 * b, 2 * (m - a - b)])));
        }
        for t in triangles(m) {
            let v = t.map(|p| place(p) as u8);
            // Only upright triangles have sides on the sides of the block.
            let upright = t[0][0] == t[1][0] + 1;
            let side = |e: usize| upright && t[e][(e + 2) % 3] == 0 && self.split[e];
            let middle = [0, 1, 2].map(|e| {
                side(e).then(|| {
                    let (p, q) = (t[e], t[(e + 1) % 3]);
                    vertices.push(at([0, 1, 2].map(|k| p[k] + q[k])));
                    (vertices.len() - 1) as u8
                })
            });
            template(v, middle, faces);
        }
    }
}

/// Red-green templates: a triangle with some sides split at the midpoint becomes one to four
/// triangles.
pub fn template<T: Copy>(v: [T; 3], middle: [Option<T>; 3], faces: &mut Vec<[T; 3]>) {
    // One side, from the first to the second corner, is split.
    let one = |[a, b, c]: [T; 3], m| [[a, m, c], [m, b, c]];
    // It is not split, and the other two are.
    let two = |[a, b, c]: [T; 3], bc, ca| [[bc, c, ca], [a, b, bc], [a, bc, ca]];
    let [a, b, c] = v;
    match middle {
        [None, None, None] => faces.push(v),
        [Some(m), None, None] => faces.extend(one([a, b, c], m)),
        [None, Some(m), None] => faces.extend(one([b, c, a], m)),
        [None, None, Some(m)] => faces.extend(one([c, a, b], m)),
        [None, Some(bc), Some(ca)] => faces.extend(two([a, b, c], bc, ca)),
        [Some(ab), None, Some(ca)] => faces.extend(two([b, c, a], ca, ab)),
        [Some(ab), Some(bc), None] => faces.extend(two([c, a, b], ab, bc)),
        [Some(ab), Some(bc), Some(ca)] => {
            faces.extend([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]]);
        }
    }
}

impl FaceFineness {
    /// A vertex of the face: the sample, or a point on the way there from the midpoint of the edge
    /// that it splits. Vertices on an edge depend on the edge alone.
    fn vertex(&self, base: &BaseMesh, samples: &SurfaceSamples, g: SampleGrid) -> Vertex {
        let depth = samples.depth();
        let at = |g| samples.vertex(base, self.face, g);
        // The level at which the vertex is inserted.
        let unit = (g[0] | g[1] | g[2] | 1 << depth).trailing_zeros();
        let born = depth - unit;
        let q = match g.iter().position(|&c| c == 0) {
            Some(zero) => self.edges[(zero + 1) % 3],
            None => self.own,
        };
        if born == 0 || born < level(q) || morph(q) == 8 {
            return at(g);
        }
        // Two of its coordinates are odd on the grid of that level: the split edge runs along
        // these.
        let odd = [0, 1, 2].map(|k| g[k] >> unit & 1 == 1);
        let even = odd.iter().position(|o| !o).unwrap_or(0);
        let (i, j) = ((even + 1) % 3, (even + 2) % 3);
        let (mut p, mut q_end) = (g, g);
        (p[i], p[j]) = (g[i] + (1 << unit), g[j] - (1 << unit));
        (q_end[i], q_end[j]) = (g[i] - (1 << unit), g[j] + (1 << unit));
        let (p, q_end, end) = (at(p), at(q_end), at(g));
        let a = morph(q) as f32 / 8.0;
        // Addition commutes: both faces of an edge get the same bits.
        Vertex::new(
            (p.position() + q_end.position()) * (0.5 * (1.0 - a)) + end.position() * a,
            ((p.normal() + q_end.normal()) * (0.5 * (1.0 - a)) + end.normal() * a)
                .normalize_or_zero(),
            (p.w() + q_end.w()) * (0.5 * (1.0 - a)) + end.w() * a,
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn directed(faces: &[[u8; 3]]) -> Vec<(u8, u8)> {
        let mut edges: Vec<(u8, u8)> =
            faces.iter().flat_map(|f| [(f[0], f[1]), (f[1], f[2]), (f[2], f[0])]).collect();
        edges.sort_unstable();
        edges
    }

    #[test]
    fn templates_fill_the_triangle_and_split_exactly_the_given_sides() {
        for mask in 0..8u8 {
            let middle = [0, 1, 2].map(|e| (mask >> e & 1 == 1).then_some(3 + e));
            let mut faces = Vec::new();
            template([0, 1, 2], middle, &mut faces);
            assert_eq!(faces.len(), 1 + mask.count_ones() as usize);
            let edges = directed(&faces);
            let outer: Vec<_> = edges
                .iter()
                .copied()
                .filter(|&(a, b)| edges.binary_search(&(b, a)).is_err())
                .collect();
            let mut want: Vec<(u8, u8)> = (0..3u8)
                .flat_map(|e| {
                    let (a, b) = (e, (e + 1) % 3);
                    middle[e as usize].map_or(vec![(a, b)], |m| vec![(a, m), (m, b)])
                })
                .collect();
            want.sort_unstable();
            assert_eq!(outer, want, "sides {mask:03b}");
        }
    }

    #[test]
    fn predicted_block_sizes_match_the_written_blocks() {
        let base = BaseMesh::new(vec![[0, 1, 2]], 3);
        let original = super::super::tests::Flat;
        let samples = SurfaceSamples::take(&base, 5, &original);
        let mut used = 0;
        for own in 0..=40u8 {
            for mask in 0..8 {
                let edge = |e: u32| if mask >> e & 1 == 1 { (own + 8).min(40) } else { own };
                let cell = FaceFineness { face: 0, own, edges: [edge(0), edge(1), edge(2)] };
                let mut area = 0.0;
                for block in cell.blocks() {
                    let (mut v, mut f) = (Vec::new(), Vec::new());
                    block.write(&base, &samples, &mut v, &mut f);
                    assert_eq!((v.len(), f.len()), (block.vertices(), block.triangles()));
                    assert!(v.len() <= 128 && f.len() <= 128);
                    for t in f {
                        let [a, b, c] = t.map(|i| v[i as usize].position());
                        let cross = (b - a).cross(c - a).z;
                        assert!(cross > 0.0, "triangles keep their side");
                        area += 0.5 * f64::from(cross);
                    }
                    used |= 1 << block.split.iter().fold(0, |m, s| m << 1 | u32::from(*s));
                }
                assert!((area - 0.5).abs() < 1e-6, "fineness {own}, sides {mask:03b}: {area}");
            }
        }
        assert_eq!(used, 0xff, "all templates");
    }
}
