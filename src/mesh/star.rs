//! A vertex with the faces around it, and whether it may collapse onto a neighbour.

use glam::{DVec3, Vec3};

use super::HalfEdges;
use super::halfedge::{NONE, next, prev};

/// cos² of the most that a face may turn, 75°.
const COS2_TURN: f64 = 0.066_987_298_107_780_7;
/// Square of the least fairness of a face, its area by [`fair`]: smallest angles of 0.1°. More
/// would keep the cheapest collapses on a plane, which go by way of needles, from being made.
const FAIR2_THIN: f64 = 9e-6;
/// How much of a face's area counts as the fair one by its sides in what it deviates; the rest is
/// its true area. Fair faces make fair normals of vertices; true areas alone lie nearer.
const FAIR_SHARE: f64 = 0.7;
/// How much more a face counts the more it deviates: twice as much at 1 − cos = 1/180, 6.0°.
const STEEP: f64 = 180.0;
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
    /// Their normals; none where normals do not count.
    pub normals: Vec<Vec3>,
    /// Where the centre is.
    from: DVec3,
    /// Twice the area times the normal of each face.
    cross: Vec<DVec3>,
    /// Whether the centre lies on a boundary.
    pub open: bool,
}

impl Star {
    /// Collects the star of `v`.
    #[inline]
    pub fn gather(
        &mut self,
        edges: &HalfEdges,
        v: u32,
        at: impl Fn(u32) -> DVec3,
        normals: &[Vec3],
    ) {
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
        self.normals.clear();
        if !normals.is_empty() {
            self.normals.extend(self.ring.iter().map(|w| normals[*w as usize]));
        }
        self.from = at(v);
        self.cross.clear();
        let n = self.at.len();
        let corners = (0..self.leaving.len()).map(|i| (i, if i + 1 == n { 0 } else { i + 1 }));
        let (at, from) = (&self.at, self.from);
        self.cross.extend(corners.map(|(i, j)| (at[i] - from).cross(at[j] - from)));
    }

    /// Faces that stay when the centre goes to `ring[k]`, as places of their other two corners.
    fn staying(&self, k: usize) -> impl Iterator<Item = (usize, usize)> + use<> {
        let n = self.ring.len();
        let faces = if self.open { n - 1 } else { n };
        let pairs = (0..faces).map(move |i| (i, if i + 1 == n { 0 } else { i + 1 }));
        pairs.filter(move |&(i, j)| i != k && j != k)
    }

    /// What the faces that stay deviate from the normals of their corners when the centre goes to
    /// `ring[k]`: Σ 2 A r (A' + 180 A r), where r = 1 − n·N, N the mean normal of the three, and A'
    /// lies between A and the area of the fair face with such sides; 0 without normals. r is the
    /// squared angle by half, so that this is area times squared size times squared angle, as a
    /// squared distance by area is; where the angle is large, its fourth power. `None` if a face
    /// turns or thins too much, or if the sum is not below `limit`.
    #[inline]
    pub fn deviation(&self, k: usize, limit: f64) -> Option<f64> {
        let to = self.at[k];
        let mut sum = 0.0;
        for (i, j) in self.staying(k) {
            let (a, b) = (self.at[i] - to, self.at[j] - to);
            let new = a.cross(b);
            let old = self.cross[i];
            let (old2, new2) = (old.length_squared(), new.length_squared());
            let along = old.dot(new);
            // A face without area has no direction to keep.
            if old2 > 0.0 && (along <= 0.0 || along * along < COS2_TURN * old2 * new2) {
                return None;
            }
            let fairest = fair(a, b);
            if new2 < FAIR2_THIN * fairest * fairest {
                let was = fair(self.at[i] - self.from, self.at[j] - self.from);
                if new2 * was * was <= old2 * fairest * fairest {
                    return None;
                }
            }
            if !self.normals.is_empty() {
                let mean = (self.normals[i] + self.normals[j] + self.normals[k]).as_dvec3() / 3.0;
                let twice = new2.sqrt();
                let off = (twice - new.dot(mean)).max(0.0);
                let size = FAIR_SHARE * fairest + (1.0 - FAIR_SHARE) * twice;
                sum += 0.5 * off * (size + STEEP * off);
                if sum >= limit {
                    return None;
                }
            }
        }
        Some(sum)
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

/// Twice the area of the fair (equilateral) face whose squared sides sum up to those of the face
/// with sides `a`, `b` and `b − a`; no face with that sum is larger.
#[inline]
fn fair(a: DVec3, b: DVec3) -> f64 {
    const BY_SUM: f64 = 0.288_675_134_594_812_9; // 1/√12
    BY_SUM * (a.length_squared() + b.length_squared() + a.distance_squared(b))
}
