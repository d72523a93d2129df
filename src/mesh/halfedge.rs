//! Half-edges: who is beside whom, and what a collapse does to that.

use rayon::prelude::*;

use super::MeshError;
use crate::geometry::Mesh;

/// No half-edge, vertex or face.
pub const NONE: u32 = u32::MAX;

/// Faces that ids can count: four half-edge ids a face, and one id to say none.
pub const MOST_FACES: usize = (1 << 30) - 1;

/// Three half-edges; the fourth place keeps a face within a cache line and its corner shifts cheap.
#[repr(align(32))]
#[derive(Clone, Copy, Debug)]
struct Face {
    /// Vertex each half-edge leaves; all `NONE` for a face that is gone. The fourth is the mark.
    corner: [u32; 4],
    /// The other half-edge of the same edge, `NONE` on a boundary.
    pair: [u32; 4],
}

/// A manifold mesh as half-edges: half-edge 4 f + c leaves corner c of face f for the next one, so
/// next and previous need no memory. 32 bytes a face and 4 a vertex.
///
/// *Why not 3 f + c:* a division in the innermost loop, and faces that straddle cache lines.
#[derive(Clone, Debug)]
pub struct HalfEdges {
    faces: Vec<Face>,
    /// One half-edge that leaves each vertex, `NONE` for a vertex without faces. On a boundary,
    /// the one without a pair: walking counter-clockwise from it meets every face.
    out: Vec<u32>,
}

/// The next half-edge around the face.
#[inline]
pub fn next(h: u32) -> u32 {
    h & !3 | 0b00_10_01 >> (2 * (h & 3)) & 3
}

/// The previous half-edge around the face.
#[inline]
pub fn prev(h: u32) -> u32 {
    h & !3 | 0b01_00_10 >> (2 * (h & 3)) & 3
}

/// The face of a half-edge.
#[inline]
pub fn face(h: u32) -> u32 {
    h >> 2
}

impl HalfEdges {
    /// Half-edges of a manifold, consistently oriented mesh. O(F): edges are matched in buckets of
    /// their lower vertex, found by counting.
    ///
    /// # Errors
    /// [`MeshError`] naming the first index out of range, degenerate face, edge with more than two
    /// faces or with faces looking to different sides, or vertex where fans touch. A mesh that may
    /// have such faults goes through [`super::prepare`] first.
    pub fn new(mesh: &Mesh) -> Result<Self, MeshError> {
        check_sizes(mesh)?;
        let vertices = mesh.positions.len();
        for (i, f) in mesh.faces.iter().enumerate() {
            if let Some(&vertex) = f.iter().find(|v| **v as usize >= vertices) {
                return Err(MeshError::Index { face: i, vertex, vertices });
            }
            if f[0] == f[1] || f[1] == f[2] || f[2] == f[0] {
                return Err(MeshError::Degenerate { face: i });
            }
        }
        let faces =
            mesh.faces.iter().map(|&[a, b, c]| Face { corner: [a, b, c, 0], pair: [NONE; 4] });
        let mut this = Self { faces: faces.collect(), out: vec![NONE; vertices] };
        let (start, edges) = by_lower_vertex(&mesh.faces, vertices);
        for low in 0..vertices {
            let row = &edges[start[low] as usize..start[low + 1] as usize];
            for (i, &(high, h)) in row.iter().enumerate() {
                if this.pair(h) != NONE {
                    continue;
                }
                let mut twins = row[i + 1..].iter().filter(|e| e.0 == high).map(|e| e.1);
                let Some(twin) = twins.next() else { continue };
                let edge = || [low as u32, high].map(|v| mesh.positions[v as usize]);
                if twins.next().is_some() {
                    return Err(MeshError::NonManifoldEdge { edge: edge() });
                }
                if this.origin(twin) == this.origin(h) {
                    return Err(MeshError::Misoriented { edge: edge() });
                }
                this.glue(h, twin);
            }
        }
        this.find_outs();
        let short = |v: &u32| this.around(*v).count() as u32;
        let mut incident = vec![0u32; vertices];
        mesh.faces.iter().flatten().for_each(|v| incident[*v as usize] += 1);
        let touching = (0..vertices as u32)
            .into_par_iter()
            .with_min_len(8192)
            .find_first(|v| short(v) != incident[*v as usize]);
        if let Some(vertex) = touching {
            let position = mesh.positions[vertex as usize];
            return Err(MeshError::NonManifoldVertex { vertex, position });
        }
        Ok(this)
    }

    fn find_outs(&mut self) {
        for h in self.half_edges() {
            let out = &mut self.out[self.faces[face(h) as usize].corner[(h & 3) as usize] as usize];
            if *out == NONE || self.faces[face(h) as usize].pair[(h & 3) as usize] == NONE {
                *out = h;
            }
        }
    }

    /// Ids of all half-edges, dead faces included.
    fn half_edges(&self) -> impl Iterator<Item = u32> + use<> {
        (0..self.faces.len() as u32).flat_map(|f| [4 * f, 4 * f + 1, 4 * f + 2])
    }

    /// Vertex that `h` leaves.
    #[inline]
    pub fn origin(&self, h: u32) -> u32 {
        self.faces[face(h) as usize].corner[(h & 3) as usize]
    }

    /// Vertex that `h` goes to.
    #[inline]
    pub fn target(&self, h: u32) -> u32 {
        self.origin(next(h))
    }

    /// The other half of the edge, [`NONE`] on a boundary.
    #[inline]
    pub fn pair(&self, h: u32) -> u32 {
        self.faces[face(h) as usize].pair[(h & 3) as usize]
    }

    /// One half-edge leaving `v`: the first of its fan on a boundary, [`NONE`] without faces.
    #[inline]
    pub fn out(&self, v: u32) -> u32 {
        self.out[v as usize]
    }

    /// Whether `v` lies on a boundary.
    #[inline]
    pub fn on_boundary(&self, v: u32) -> bool {
        let h = self.out(v);
        h != NONE && self.pair(h) == NONE
    }

    /// Half-edges that leave `v`, counter-clockwise seen along −normal; one for each face.
    pub fn around(&self, v: u32) -> impl Iterator<Item = u32> + '_ {
        let first = self.out(v);
        let mut h = first;
        std::iter::from_fn(move || {
            if h == NONE {
                return None;
            }
            let here = h;
            h = self.pair(prev(h));
            if h == first {
                h = NONE;
            }
            Some(here)
        })
    }

    /// Vertices of a face, `None` where it is gone.
    pub fn face(&self, f: u32) -> Option<[u32; 3]> {
        let [a, b, c, _] = self.faces[f as usize].corner;
        (a != NONE).then_some([a, b, c])
    }

    /// Faces, those gone included.
    pub fn face_count(&self) -> usize {
        self.faces.len()
    }

    /// Vertices, those gone included.
    pub fn vertex_count(&self) -> usize {
        self.out.len()
    }

    /// A number of the caller's own beside each face.
    #[inline]
    pub(super) fn mark(&self, f: u32) -> u32 {
        self.faces[f as usize].corner[3]
    }

    /// Sets the number beside a face.
    pub(super) fn set_mark(&mut self, f: u32, mark: u32) {
        self.faces[f as usize].corner[3] = mark;
    }

    #[inline]
    fn set_pair(&mut self, h: u32, to: u32) {
        self.faces[face(h) as usize].pair[(h & 3) as usize] = to;
    }

    /// Makes two half-edges, either of which may be `NONE`, halves of one edge.
    #[inline]
    fn glue(&mut self, a: u32, b: u32) {
        if a != NONE {
            self.set_pair(a, b);
        }
        if b != NONE {
            self.set_pair(b, a);
        }
    }

    /// Collapses the vertex `from` onto `to`. `leaving` are the half-edges around `from` in order,
    /// as [`Self::around`] gives them. One or two faces go. The caller has seen to it that the
    /// result is manifold.
    pub(super) fn collapse(&mut self, from: u32, to: u32, leaving: &[u32]) {
        let first = leaving[0];
        let open = self.pair(first) == NONE;
        let mut new_out = NONE;
        for &h in leaving {
            let (n, p) = (next(h), prev(h));
            if self.origin(n) == to {
                // Face (from, to, w): its edges to–w and w–from become one.
                let w = self.origin(p);
                let (beyond, inside) = (self.pair(n), self.pair(p));
                self.glue(beyond, inside);
                if self.out(w) == p {
                    self.out[w as usize] = beyond;
                }
                if self.out(to) == n {
                    new_out = inside;
                }
                self.kill(h);
            } else if self.origin(p) == to {
                // Face (from, w, to).
                let w = self.origin(n);
                let (inside, beyond) = (self.pair(h), self.pair(n));
                self.glue(beyond, inside);
                if self.out(w) == n {
                    self.out[w as usize] = inside;
                }
                if self.out(to) == p {
                    // On a boundary the fan of `to` now begins where that of `from` began.
                    new_out = if open && h != first { first } else { beyond };
                }
                self.kill(h);
            } else {
                self.faces[face(h) as usize].corner[(h & 3) as usize] = to;
            }
        }
        if new_out != NONE {
            self.out[to as usize] = new_out;
        }
        self.out[from as usize] = NONE;
    }

    fn kill(&mut self, h: u32) {
        let f = &mut self.faces[face(h) as usize];
        f.corner[..3].fill(NONE);
        f.pair.fill(NONE);
    }

    /// Checks every invariant. O(F).
    ///
    /// # Errors
    /// The first one broken, and where.
    pub fn check(&self) -> Result<(), MeshError> {
        let broken = |half_edge, what| Err(MeshError::Broken { half_edge, what });
        let lost = |vertex, what| Err(MeshError::BrokenVertex { vertex, what });
        let (vertices, faces) = (self.out.len() as u32, self.faces.len() as u32);
        let mut incident = vec![0u32; self.out.len()];
        for h in self.half_edges() {
            let corner = self.faces[face(h) as usize].corner;
            if corner[..3] == [NONE; 3] {
                continue;
            }
            let (a, b) = (self.origin(h), self.target(h));
            if a >= vertices || self.out(a) == NONE {
                return broken(h, "leaves a vertex that is not there");
            }
            if a == b {
                return broken(h, "ends where it begins");
            }
            incident[a as usize] += 1;
            let p = self.pair(h);
            if p == NONE {
                continue;
            }
            if face(p) >= faces || p & 3 == 3 || self.face(face(p)).is_none() {
                return broken(h, "is paired with a half-edge that is not there");
            }
            if face(p) == face(h) || self.pair(p) != h {
                return broken(h, "is not the pair of its pair");
            }
            if self.origin(p) != b || self.target(p) != a {
                return broken(h, "has other ends than its pair");
            }
        }
        let mut seen = vec![NONE; self.out.len()];
        for v in 0..vertices {
            let first = self.out(v);
            if first == NONE {
                continue;
            }
            if face(first) >= faces || self.face(face(first)).is_none() || self.origin(first) != v {
                return lost(v, "is not left by the half-edge it names");
            }
            let (mut count, mut last) = (0, first);
            for h in self.around(v) {
                if seen[self.target(h) as usize] == v {
                    return lost(v, "has two edges to one neighbour");
                }
                seen[self.target(h) as usize] = v;
                (count, last) = (count + 1, h);
                if count > incident[v as usize] {
                    return lost(v, "has a fan without end");
                }
            }
            if count != incident[v as usize] {
                return lost(v, "has more than one fan of faces");
            }
            let closed = self.pair(first) != NONE;
            if closed != (self.pair(prev(last)) != NONE) {
                return lost(v, "has a fan that does not begin at the boundary");
            }
            if !closed && seen[self.origin(prev(last)) as usize] == v {
                return lost(v, "has two edges to one neighbour");
            }
        }
        Ok(())
    }
}

/// Whether lists fit together and coordinates are numbers.
pub(super) fn check_sizes(mesh: &Mesh) -> Result<(), MeshError> {
    let (vertices, faces) = (mesh.positions.len(), mesh.faces.len());
    if faces > MOST_FACES || vertices > MOST_FACES {
        return Err(MeshError::TooLarge { faces, vertices, limit: MOST_FACES });
    }
    let lists = [("normals", mesh.normals.len(), vertices), ("cap flags", mesh.caps.len(), faces)];
    for (what, found, wanted) in lists {
        if found != 0 && found != wanted {
            return Err(MeshError::Length { what, found, wanted });
        }
    }
    for (what, list) in [("position", &mesh.positions), ("normal", &mesh.normals)] {
        if let Some(vertex) = list.iter().position(|p| !p.is_finite()) {
            return Err(MeshError::NotFinite { what, vertex, value: list[vertex] });
        }
    }
    Ok(())
}

/// Half-edges in rows of the lower vertex of their edge: first entry of each row and the end, and
/// for each entry the higher vertex and the half-edge, in the order of the faces.
pub(super) fn by_lower_vertex(faces: &[[u32; 3]], vertices: usize) -> (Vec<u32>, Vec<(u32, u32)>) {
    let ends = |f: &[u32; 3], c: usize| (f[c].min(f[(c + 1) % 3]), f[c].max(f[(c + 1) % 3]));
    let mut start = vec![0u32; vertices + 1];
    for f in faces {
        for c in 0..3 {
            start[ends(f, c).0 as usize + 1] += 1;
        }
    }
    for i in 0..vertices {
        start[i + 1] += start[i];
    }
    let mut edges = vec![(0, 0); 3 * faces.len()];
    // Filling moves each start to the next row's; shifting by one afterwards undoes that.
    for (i, f) in faces.iter().enumerate() {
        for c in 0..3 {
            let (low, high) = ends(f, c);
            let at = &mut start[low as usize];
            edges[*at as usize] = (high, 4 * i as u32 + c as u32);
            *at += 1;
        }
    }
    start.copy_within(0..vertices, 1);
    start[0] = 0;
    (start, edges)
}
