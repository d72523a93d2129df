//! Half-edge connectivity of a manifold mesh, and the half-edge collapse.

use rayon::prelude::*;

use super::MeshError;
use crate::geometry::{Mesh, in_rows};

/// No half-edge, vertex or face.
pub const NONE: u32 = u32::MAX;

/// Faces that ids can count: four half-edge ids a face, and one id to say none.
pub const MAX_FACES: usize = (1 << 30) - 1;

/// The three half-edges of a face. Padded to four, so that a face lies within one cache line and
/// ids need no division.
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
    /// have such faults goes through [`super::make_manifold`] first.
    pub fn new(mesh: &Mesh) -> Result<Self, MeshError> {
        check_sizes(mesh)?;
        let vertices = mesh.positions.len();
        if let Some(error) = mesh.faces.iter().enumerate().find_map(|(i, f)| {
            let out = f.iter().find(|v| **v as usize >= vertices);
            let twice = f[0] == f[1] || f[1] == f[2] || f[2] == f[0];
            match out {
                Some(&vertex) => Some(MeshError::Index { face: i, vertex, vertices }),
                None => twice.then_some(MeshError::Degenerate { face: i }),
            }
        }) {
            return Err(error);
        }
        crate::task::checkpoint();
        let (start, leaving) = by_origin(&mesh.faces, vertices);
        crate::task::checkpoint();
        let from = |v: u32| &leaving[start[v as usize] as usize..start[v as usize + 1] as usize];
        let blank = |&[a, b, c]: &[u32; 3]| Face { corner: [a, b, c, 0], pair: [NONE; 4] };
        let mut faces: Vec<Face> = mesh.faces.par_iter().with_min_len(8192).map(blank).collect();
        let corner = |h: u32| mesh.faces[face(h) as usize][(h & 3) as usize];
        let wrong = faces.par_iter_mut().with_min_len(8192).find_map_first(|f| {
            for c in 0..3 {
                let (a, b) = (f.corner[c], f.corner[(c + 1) % 3]);
                match twin([a, b], from, corner) {
                    Ok(pair) => f.pair[c] = pair,
                    Err(kind) => return Some(kind([a, b].map(|v| mesh.positions[v as usize]))),
                }
            }
            None
        });
        if let Some(error) = wrong {
            return Err(error);
        }
        crate::task::checkpoint();
        // Walking begins at a boundary if there is one.
        let begin = |v: u32| {
            let open = |h: &&u32| faces[face(**h) as usize].pair[(**h & 3) as usize] == NONE;
            let list = from(v);
            list.iter().find(open).or(list.first()).copied().unwrap_or(NONE)
        };
        let out = (0..vertices as u32).into_par_iter().with_min_len(8192).map(begin).collect();
        let this = Self { faces, out };
        let touching = (0..vertices as u32)
            .into_par_iter()
            .with_min_len(8192)
            .find_first(|v| this.around(*v).count() != from(*v).len());
        if let Some(vertex) = touching {
            let position = mesh.positions[vertex as usize];
            return Err(MeshError::NonManifoldVertex { vertex, position });
        }
        Ok(this)
    }

    /// Half-edges from corners, pairs and mark of each face, taken as they are. Where several fans
    /// of faces touch in a vertex, which [`Self::new`] refuses, only one of them can be walked.
    pub(super) fn from_pairs(
        faces: impl Iterator<Item = ([u32; 3], [u32; 3], u32)>,
        vertices: usize,
    ) -> Self {
        let faces = faces.map(|([a, b, c], [p, q, r], mark)| Face {
            corner: [a, b, c, mark],
            pair: [p, q, r, NONE],
        });
        let mut this = Self { faces: faces.collect(), out: vec![NONE; vertices] };
        this.find_outs();
        this
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

    /// A number of the caller's own for each face.
    #[inline]
    pub(super) fn mark(&self, f: u32) -> u32 {
        self.faces[f as usize].corner[3]
    }

    /// Sets the mark of a face.
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
    /// as [`Self::around`] gives them. One or two faces are removed. The caller guarantees that the
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
    if faces > MAX_FACES || vertices > MAX_FACES {
        return Err(MeshError::TooLarge { faces, vertices, limit: MAX_FACES });
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

/// The error for an edge with these ends.
type EdgeError = fn([glam::Vec3; 2]) -> MeshError;

/// The half-edge b → a, `NONE` on a boundary. `from` lists the half-edges that leave a vertex,
/// `corner` gives the vertex that one leaves.
///
/// Every face at the edge stands in the lists of both ends; the shorter one is read, so that a
/// vertex of a million faces does not cost a million million steps.
fn twin<'l>(
    [a, b]: [u32; 2],
    from: impl Fn(u32) -> &'l [u32],
    corner: impl Fn(u32) -> u32,
) -> Result<u32, EdgeError> {
    let (mut same, mut against, mut pair) = (0, 0, NONE);
    let swap = from(b).len() > from(a).len();
    let (here, there) = if swap { (a, b) } else { (b, a) };
    for &h in from(here) {
        // Out to the other end, and in from there.
        if corner(next(h)) == there {
            let count = if swap { &mut same } else { &mut against };
            *count += 1;
            pair = if swap { pair } else { h };
        }
        if corner(prev(h)) == there {
            let count = if swap { &mut against } else { &mut same };
            *count += 1;
            pair = if swap { prev(h) } else { pair };
        }
    }
    match (same, against) {
        (1, 0 | 1) => Ok(pair),
        (2, 0) => Err(|edge| MeshError::Misoriented { edge }),
        _ => Err(|edge| MeshError::NonManifoldEdge { edge }),
    }
}

/// Half-edges that leave each vertex, in the order of the faces: first of each vertex and the end.
fn by_origin(faces: &[[u32; 3]], vertices: usize) -> (Vec<u32>, Vec<u32>) {
    let each = |(f, i): (&[u32; 3], u32)| [0, 1, 2].map(|c| (f[c as usize], 4 * i + c));
    in_rows(vertices, || faces.iter().zip(0u32..).flat_map(each))
}

/// Half-edges in rows of the lower vertex of their edge: first entry of each row and the end, and
/// for each entry the higher vertex and the half-edge, in the order of the faces.
pub fn by_lower_vertex(faces: &[[u32; 3]], vertices: usize) -> (Vec<u32>, Vec<(u32, u32)>) {
    let each = |(f, i): (&[u32; 3], u32)| {
        [0, 1, 2].map(|c| {
            let (a, b) = (f[c as usize], f[(c as usize + 1) % 3]);
            (a.min(b), (a.max(b), 4 * i + c))
        })
    };
    in_rows(vertices, || faces.iter().zip(0u32..).flat_map(each))
}
