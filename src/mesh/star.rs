//! A vertex with the faces around it, and whether it may collapse onto a neighbour.

use glam::DVec3;

use super::HalfEdges;
use super::halfedge::{NONE, next, prev};

/// cos² of the most that a face may turn, 75°.
const COS2_TURN: f64 = 0.066_987_298_107_780_7;
/// sin² of the smallest angle of a face, 1°.
const SIN2_THIN: f64 = 3.045_865_2e-4;
/// Neighbours of a vertex, at most.
const MOST_NEIGHBOURS: usize = 24;

/// The faces around one vertex.
#[derive(Default)]
pub struct Star {
    /// The vertex.
    pub centre: u32,
    /// Half-edges that leave it, in order.
    pub leaving: Vec<u32>,
    /// Neighbours in order: face i holds the centre, `ring[i]` and the next.
    pub ring: Vec<u32>,
    /// Where they are.
    pub at: Vec<DVec3>,
    /// Whether the centre lies on a boundary.
    pub open: bool,
}

impl Star {
    /// Collects the star of `v`.
    #[inline]
    pub fn gather(&mut self, edges: &HalfEdges, v: u32, at: impl Fn(u32) -> DVec3) {
        self.centre = v;
        self.leaving.clear();
        self.ring.clear();
        self.at.clear();
        let first = edges.out(v);
        let mut h = first;
        loop {
            self.leaving.push(h);
            self.ring.push(edges.target(h));
            let p = prev(h);
            h = edges.pair(p);
            if h == first {
                self.open = false;
                break;
            }
            if h == NONE {
                self.open = true;
                self.ring.push(edges.origin(p));
                break;
            }
        }
        self.at.extend(self.ring.iter().map(|w| at(*w)));
    }

    /// Faces that stay when the centre goes to `ring[k]`, as places of their other two corners.
    fn staying(&self, k: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let n = self.ring.len();
        let faces = if self.open { n - 1 } else { n };
        let pairs = (0..faces).map(move |i| (i, if i + 1 == n { 0 } else { i + 1 }));
        pairs.filter(move |&(i, j)| i != k && j != k)
    }

    /// Whether no face turns or thins too much when the centre, now at `from`, goes to `ring[k]`.
    #[inline]
    pub fn keeps_shape(&self, k: usize, from: DVec3) -> bool {
        let to = self.at[k];
        self.staying(k).all(|(i, j)| {
            let (a, b) = (self.at[i], self.at[j]);
            let old = (a - from).cross(b - from);
            let new = (a - to).cross(b - to);
            let (old2, new2) = (old.length_squared(), new.length_squared());
            let along = old.dot(new);
            // A face without area has no direction to keep.
            if old2 > 0.0 && (along <= 0.0 || along * along < COS2_TURN * old2 * new2) {
                return false;
            }
            let thin = |cross2: f64, p: DVec3| cross2 / largest_two(a, b, p);
            new2 >= SIN2_THIN * largest_two(a, b, to) || thin(new2, to) > thin(old2, from)
        })
    }

    /// Whether the mesh stays a manifold of the same kind when the centre goes to `ring[k]`:
    /// centre and target have no neighbours in common but those of the faces that go (Dey et al.
    /// 1999), no two faces become one, and no vertex gets too many neighbours. `in_ring` says
    /// whether a vertex is in the ring.
    #[inline]
    pub fn keeps_kind(&self, edges: &HalfEdges, k: usize, in_ring: impl Fn(u32) -> bool) -> bool {
        let (to, n) = (self.ring[k], self.ring.len());
        let (mut common, mut neighbours) = (0, 0);
        let first = edges.out(to);
        let mut h = first;
        loop {
            common += usize::from(in_ring(edges.target(h)));
            neighbours += 1;
            let p = prev(h);
            h = edges.pair(p);
            if h == NONE {
                common += usize::from(in_ring(edges.origin(p)));
                neighbours += 1;
                break;
            }
            if h == first {
                break;
            }
        }
        let goes = if self.open { 1 } else { 2 };
        if common != goes || n + neighbours > MOST_NEIGHBOURS + 2 + goes {
            return false;
        }
        // Three faces (two, one at a boundary) leave one (none): it must not fall onto another,
        // nor may the last face of a component go.
        if !self.open && n == 3 {
            let across = edges.pair(next(self.leaving[(k + 1) % 3]));
            return across == NONE || edges.origin(prev(across)) != to;
        }
        !self.open || n > 2 || edges.pair(next(self.leaving[0])) != NONE
    }
}

/// Product of the two largest squared sides.
#[inline]
fn largest_two(a: DVec3, b: DVec3, c: DVec3) -> f64 {
    let [x, y, z] = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    (x * y).max(y * z).max(z * x)
}
