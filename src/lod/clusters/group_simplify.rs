//! Simplification of one group of clusters by half-edge collapses: some thousand faces, any
//! triangle soup, boundaries locked.
//!
//! *Why not [`crate::mesh::simplify`]:* it takes manifold meshes, as parameterisation must. A group
//! usually has vertices where several face fans of its clusters touch, and the input may be any
//! soup.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::DVec3;

use super::partition::NO_FACE;
use super::vertex_faces::VertexFaces;
use crate::mesh::Quadric;

/// Cost of a collapse for its length, relative to that for a displacement as long. Where a wall is
/// flat all collapses are free, and in the order of their ids they would leave needles; finding the
/// nearest face among needles takes most of the time then.
const LENGTH_COST: f64 = 1e-6;
/// Most faces at a vertex after a collapse.
const MAX_VALENCE: usize = 24;
/// Least cosine of the angle that a face may turn by in one collapse (75°).
const MIN_TURN_COSINE: f64 = 0.2588;
/// Sine of the smallest angle that a face may get (0.1°), unless it had a smaller one. The cheapest
/// collapses of nearly flat regions go by way of needles: at 1° groups end far from half their
/// faces.
const MIN_ANGLE_SINE: f64 = 0.001745;
/// Weight of the planes that hold an open boundary in place, relative to that of faces.
const BOUNDARY_WEIGHT: f64 = 10.0;
/// Least cosine of the angle that a face may turn by in one vertex move (30°).
const MIN_MOVE_COSINE: f64 = 0.866;
/// Largest move of a vertex, relative to its shortest edge.
const MAX_MOVE_SHARE: f64 = 0.5;

/// A collapse is evaluated at this share of the way from the vertex that stays to the one that
/// goes, since the one that stays will move a little towards it.
const KEPT_VERTEX_SHARE: f64 = 0.25;

/// Result: the remaining faces, and the vertex that replaces each one.
pub struct SimplifiedFaces {
    /// Vertex ids as given; no degenerate face.
    pub faces: Vec<[u16; 3]>,
    /// The vertex that replaces each vertex, itself if it remains.
    pub onto: Vec<u16>,
    /// Position of each remaining vertex, as given or moved; of no meaning for the others.
    pub at: Vec<DVec3>,
}

struct TriangleSoup<'a> {
    at: Vec<DVec3>,
    faces: Vec<[u16; 3]>,
    /// Incident faces of each vertex; removed faces are not listed.
    of: VertexFaces,
    quadric: Vec<Quadric>,
    /// Cost of a collapse for its squared length.
    length_cost: f64,
    /// Marks of the one-ring vertices, each with the pass that set it.
    mark: Vec<(u32, u8)>,
    trace: u32,
    ring: Vec<u16>,
    locked: &'a [bool],
}

/// Topology of the faces at a vertex.
enum VertexFan {
    Closed,
    /// The two neighbours along the boundary.
    Open(u16, u16),
    /// Several fans, or edges with more than two faces.
    Other,
}

/// Collapses vertices that are not `locked` onto neighbours, cheapest first, until at most `target`
/// faces are left or no legal collapse remains. A vertex that replaced another moves to the minimum
/// of their quadric, if it is neither locked nor on a boundary.
///
/// Quadric error metric of Garland & Heckbert 1997 (doi:10.1145/258734.258849). Departures: each
/// face weighs the mean area of all plus its own, since concave tips consist of tiny triangles that
/// area weights ignore; half-edge collapses, each followed by a move that turns and thins no
/// incident face too much; costs are updated lazily, when a vertex reaches the top of the heap; and
/// it works on triangle soup, where a vertex may have several fans. The tangent planes of
/// [`crate::mesh::Metric::NormalQem`] do not help here, since the largest distance counts.
///
/// * `at`: positions near the origin, or costs lose digits.
/// * `face_neighbors`: the face across each edge, [`NO_FACE`] where there is none or more than one.
pub fn simplify_faces(
    at: Vec<DVec3>,
    faces: Vec<[u16; 3]>,
    face_neighbors: &[[u32; 3]],
    locked: &[bool],
    target: usize,
) -> SimplifiedFaces {
    let count = at.len();
    let mut s = TriangleSoup::new(at, faces, face_neighbors, locked);
    let mut live = s.faces.len();
    let mut onto: Vec<u16> = (0..count as u16).collect();
    // Whether a vertex is in the heap. Its cost there may be outdated: it is computed anew when the
    // vertex is popped.
    let mut queued = vec![false; count];
    let mut heap = BinaryHeap::new();
    let mut targets = Vec::new();
    // Costs are not negative but for rounding, so their bits order them.
    let key = |cost: f64| cost.max(0.0).to_bits();
    for u in (0..count).filter(|u| !locked[*u]) {
        s.targets(u as u16, &mut targets);
        queued[u] = !targets.is_empty();
        heap.extend(cheapest(&targets).map(|cost| Reverse((key(cost), u as u16))));
    }
    let mut neighbors = Vec::new();
    while live > target
        && let Some(Reverse((cost, u))) = heap.pop()
    {
        s.targets(u, &mut targets);
        targets.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some(&(now, v)) = targets.iter().find(|t| s.is_legal(u, t.1)) else {
            queued[u as usize] = false;
            continue;
        };
        // More expensive than its entry says, or the cheapest collapse is not legal: back into the
        // heap.
        if key(now) > cost && heap.peek().is_some_and(|next| key(now) > next.0.0) {
            heap.push(Reverse((key(now), u)));
            continue;
        }
        live -= s.collapse(u, v);
        onto[u as usize] = v;
        queued[u as usize] = true;
        if let (VertexFan::Closed, false) = (s.gather_ring(v), locked[v as usize]) {
            s.relocate(v);
        }
        neighbors.clear();
        let rest = |w: &u16| !locked[*w as usize] && !queued[*w as usize];
        neighbors.extend(s.ring.iter().copied().chain([v]).filter(rest));
        for &w in &neighbors {
            s.targets(w, &mut targets);
            queued[w as usize] = !targets.is_empty();
            heap.extend(cheapest(&targets).map(|cost| Reverse((key(cost), w))));
        }
    }
    for v in 0..onto.len() {
        let mut to = onto[v];
        while onto[to as usize] != to {
            to = onto[to as usize];
        }
        onto[v] = to;
    }
    s.faces.retain(|f| f[0] != f[1]);
    SimplifiedFaces { faces: s.faces, onto, at: s.at }
}

impl<'a> TriangleSoup<'a> {
    fn new(
        at: Vec<DVec3>,
        faces: Vec<[u16; 3]>,
        face_neighbors: &[[u32; 3]],
        locked: &'a [bool],
    ) -> Self {
        let of = VertexFaces::new(at.len(), &faces);
        let mut quadric = vec![Quadric::default(); at.len()];
        let cross = |f: &[u16; 3]| {
            let [a, b, c] = f.map(|v| at[v as usize]);
            (b - a).cross(c - a)
        };
        let area = |f: &[u16; 3]| 0.5 * cross(f).length();
        let floor = faces.iter().map(area).sum::<f64>() / faces.len().max(1) as f64;
        for f in &faces {
            let normal = cross(f).normalize_or_zero();
            let q = Quadric::plane(normal, at[f[0] as usize], area(f) + floor);
            for v in f.map(usize::from) {
                quadric[v] += q;
            }
        }
        let mark = vec![(0, 0); at.len()];
        let length_cost = LENGTH_COST * floor;
        let ring = Vec::new();
        let mut s = Self { at, faces, of, quadric, length_cost, mark, trace: 0, ring, locked };
        s.add_boundary_planes(face_neighbors);
        s
    }

    /// Adds to the quadrics the planes through boundary edges, perpendicular to their face.
    fn add_boundary_planes(&mut self, face_neighbors: &[[u32; 3]]) {
        for (i, face_neighbors) in face_neighbors.iter().enumerate() {
            let f = self.faces[i];
            for k in (0..3).filter(|k| face_neighbors[*k] == NO_FACE) {
                let (u, v) = (f[k], f[(k + 1) % 3]);
                let both = |g: &&u16| self.faces[**g as usize].contains(&v);
                if self.of.get(u).iter().filter(both).count() != 1 {
                    continue;
                }
                let [a, b, c] = [u, v, f[(k + 2) % 3]].map(|v| self.at[v as usize]);
                let along = (b - a).normalize_or_zero();
                let across = (c - a) - along * along.dot(c - a);
                let weight = BOUNDARY_WEIGHT * (b - a).length_squared();
                let q = Quadric::plane(across.normalize_or_zero(), a, weight);
                self.quadric[u as usize] += q;
                self.quadric[v as usize] += q;
            }
        }
    }

    /// Collects the one-ring of `u` into `ring`, with marks of how its faces use each neighbour.
    fn gather_ring(&mut self, u: u16) -> VertexFan {
        self.trace += 1;
        self.ring.clear();
        let mut clean = true;
        for &f in self.of.get(u) {
            let f = self.faces[f as usize];
            let k = f.iter().position(|v| *v == u).unwrap_or(0);
            for (v, side) in [(f[(k + 1) % 3], 1), (f[(k + 2) % 3], 2)] {
                let m = &mut self.mark[v as usize];
                if m.0 != self.trace {
                    *m = (self.trace, 0);
                    self.ring.push(v);
                }
                clean &= m.1 & side == 0;
                m.1 |= side;
            }
        }
        let mut ends = self.ring.iter().filter(|v| self.mark[**v as usize].1 != 3);
        match (clean, ends.next(), ends.next(), ends.next()) {
            (true, None, ..) => VertexFan::Closed,
            (true, Some(&a), Some(&b), None) => VertexFan::Open(a, b),
            _ => VertexFan::Other,
        }
    }

    /// Neighbours that `u` could collapse onto, with costs.
    fn targets(&mut self, u: u16, out: &mut Vec<(f64, u16)>) {
        out.clear();
        let fan = self.gather_ring(u);
        let own = self.quadric[u as usize];
        let mut add = |v: u16| {
            let mut q = own;
            q += self.quadric[v as usize];
            let mut p = self.at[v as usize];
            let along = self.at[u as usize] - p;
            if !self.locked[v as usize] {
                p += KEPT_VERTEX_SHARE * along;
            }
            out.push((q.at(p) + self.length_cost * along.length_squared(), v));
        };
        match fan {
            VertexFan::Closed => self.ring.iter().for_each(|v| add(*v)),
            VertexFan::Open(a, b) => [a, b].into_iter().for_each(&mut add),
            VertexFan::Other => {}
        }
    }

    /// Whether a collapse keeps the topology and flips or thins no face. `ring` and marks are those
    /// of `u`.
    fn is_legal(&self, u: u16, v: u16) -> bool {
        let of = |v: u16| self.of.get(v).iter().map(|f| self.faces[*f as usize]);
        let (mut shared, mut dying) = (0, 0);
        for f in of(v) {
            if f.contains(&u) {
                dying += 1;
                continue;
            }
            // A common neighbour appears once as the next and once as the previous vertex around v.
            let k = f.iter().position(|w| *w == v).unwrap_or(0);
            let (a, b) = (f[(k + 1) % 3], f[(k + 2) % 3]);
            let near = |w: u16| self.mark[w as usize].0 == self.trace;
            // Common neighbours other than the third vertices of removed faces break the link
            // condition.
            for w in [a, b] {
                let third = |g: [u16; 3]| g.contains(&u) && g.contains(&w);
                if near(w) && w != u && !of(v).any(third) {
                    shared += 1;
                }
            }
            // The collapse would fold the last face of u onto this one.
            if near(a) && near(b) && self.of.get(u).len() == 3 {
                return false;
            }
        }
        if shared > 0 || dying == 0 || dying > 2 {
            return false;
        }
        if self.of.get(u).len() + self.of.get(v).len() > MAX_VALENCE + 2 * dying {
            return false;
        }
        let to = self.at[v as usize];
        of(u).filter(|f| !f.contains(&v)).all(|f| {
            let old = f.map(|w| self.at[w as usize]);
            let new = f.map(|w| if w == u { to } else { self.at[w as usize] });
            let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
            let (o, n) = (cross(old), cross(new));
            let turned = o.dot(n) < MIN_TURN_COSINE * o.length() * n.length();
            !turned && n.length() > 0.0 && {
                let fine = sine_of_smallest_angle(new);
                fine > MIN_ANGLE_SINE || fine >= sine_of_smallest_angle(old)
            }
        })
    }

    /// Moves `v`, the centre of a closed fan, to the minimum of its quadric, or half or a quarter
    /// of the way: the first place where no incident face turns or thins too much.
    fn relocate(&mut self, v: u16) {
        let quadric = self.quadric[v as usize];
        let old = self.at[v as usize];
        let sides = self.ring.iter().map(|w| self.at[*w as usize].distance_squared(old));
        let shortest = sides.fold(f64::INFINITY, f64::min).sqrt();
        let Some(step) = quadric.step_to_minimum(old, MAX_MOVE_SHARE * shortest) else { return };
        let fits = |p: DVec3| {
            self.of.get(v).iter().all(|f| {
                let f = self.faces[*f as usize];
                let was = f.map(|w| self.at[w as usize]);
                let is = f.map(|w| if w == v { p } else { self.at[w as usize] });
                let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
                let (o, n) = (cross(was), cross(is));
                o.dot(n) > MIN_MOVE_COSINE * o.length() * n.length() && {
                    let fine = sine_of_smallest_angle(is);
                    fine > MIN_ANGLE_SINE || fine >= sine_of_smallest_angle(was)
                }
            })
        };
        let places = [1.0, 0.5, 0.25].map(|s| old + s * step);
        let better = |p: &DVec3| p.is_finite() && quadric.sum(*p) < quadric.sum(old);
        if let Some(p) = places.into_iter().find(|p| fits(*p)).filter(better) {
            self.at[v as usize] = p;
        }
    }

    /// Moves the faces of `u` to `v`; returns how many degenerate and disappear.
    fn collapse(&mut self, u: u16, v: u16) -> usize {
        let mut gone = 0;
        for i in self.of.clear(u) {
            let f = self.of.face(i);
            let face = &mut self.faces[f as usize];
            if face.contains(&v) {
                for w in *face {
                    self.of.remove(w, f);
                }
                *face = [0; 3];
                gone += 1;
            } else {
                face.iter_mut().filter(|w| **w == u).for_each(|w| *w = v);
                self.of.push(v, f);
            }
        }
        let q = self.quadric[u as usize];
        self.quadric[v as usize] += q;
        gone
    }
}

/// Least cost.
fn cheapest(targets: &[(f64, u16)]) -> Option<f64> {
    targets.iter().map(|t| t.0).reduce(f64::min)
}

/// Lower bound of the sine of the smallest angle: twice the area over the product of the two
/// longest sides.
fn sine_of_smallest_angle([a, b, c]: [DVec3; 3]) -> f64 {
    let sides = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    let shortest = sides.into_iter().fold(f64::INFINITY, f64::min);
    let product: f64 = sides.into_iter().product();
    (b - a).cross(c - a).length() * (shortest / product.max(f64::MIN_POSITIVE)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// A bumpy square sheet of 2 n² faces.
    fn sheet(n: u16) -> (Vec<DVec3>, Vec<[u16; 3]>) {
        let at = |i: u16| {
            let (x, y) = (f64::from(i % (n + 1)), f64::from(i / (n + 1)));
            DVec3::new(x, y, 0.4 * (0.7 * x).sin() * (0.5 * y).cos())
        };
        let all = 0..(n + 1) * (n + 1);
        let quad = |q: u16| {
            let i = q / n * (n + 1) + q % n;
            [[i, i + 1, i + n + 2], [i, i + n + 2, i + n + 1]]
        };
        let faces = (0..n * n).flat_map(quad).collect();
        (all.map(at).collect(), faces)
    }

    fn edges(faces: &[[u16; 3]]) -> HashMap<(u16, u16), u32> {
        let mut count = HashMap::new();
        for f in faces {
            (0..3).for_each(|k| *count.entry((f[k], f[(k + 1) % 3])).or_default() += 1);
        }
        count
    }

    fn border(faces: &[[u16; 3]]) -> Vec<(u16, u16)> {
        let all = edges(faces);
        assert!(all.values().all(|n| *n == 1));
        let mut out: Vec<_> =
            all.keys().filter(|e| !all.contains_key(&(e.1, e.0))).copied().collect();
        out.sort_unstable();
        out
    }

    fn halved(
        at: Vec<DVec3>,
        faces: Vec<[u16; 3]>,
        locked: &[bool],
        target: usize,
    ) -> SimplifiedFaces {
        let wide: Vec<[u32; 3]> = faces.iter().map(|f| f.map(u32::from)).collect();
        let face_neighbors = super::super::partition::face_neighbors(&wide, at.len());
        simplify_faces(at, faces, &face_neighbors, locked, target)
    }

    #[test]
    fn a_sheet_is_simplified_to_half_its_faces_with_its_boundary_locked() {
        let (at, faces) = sheet(30);
        let rim = border(&faces);
        let mut locked = vec![false; at.len()];
        rim.iter().for_each(|e| locked[e.0 as usize] = true);
        let h = halved(at.clone(), faces.clone(), &locked, 900);
        assert!(h.faces.len() <= 900 && h.faces.len() >= 898, "{}", h.faces.len());
        assert_eq!(border(&h.faces), rim);
        for f in &h.faces {
            let [a, b, c] = f.map(|v| h.at[v as usize]);
            assert!((b - a).cross(c - a).z > 0.0);
            assert!(f.iter().all(|v| h.onto[*v as usize] == *v));
        }
        assert!((0..at.len()).filter(|v| locked[*v]).all(|v| h.at[v] == at[v]));
        // On a sheet of 30 mm with bumps of 0.4 mm, optimal positions differ from the given ones.
        let moved = (0..at.len() as u16).filter(|v| h.onto[*v as usize] == *v);
        let moved = moved.filter(|v| h.at[*v as usize] != at[*v as usize]);
        assert!(moved.count() > 100);
        // Without locks the boundary is simplified too but keeps its place.
        let free = halved(at.clone(), faces, &vec![false; at.len()], 100);
        assert!(free.faces.len() <= 100);
        let rim = border(&free.faces);
        assert!(rim.len() < 60);
        let (x, y) = (|v: u16| free.at[v as usize].x, |v: u16| free.at[v as usize].y);
        for side in [0.0, 30.0] {
            assert!(rim.iter().any(|e| x(e.0) == side) && rim.iter().any(|e| y(e.0) == side));
        }
    }

    #[test]
    fn tetrahedra_and_non_manifold_edges_and_vertices_are_not_collapsed() {
        let at: Vec<DVec3> = [[0, 0, 0], [4, 0, 0], [0, 4, 0], [0, 0, 4], [4, 4, 4]]
            .map(|p: [i32; 3]| DVec3::from_array(p.map(f64::from)))
            .to_vec();
        let tetrahedron = vec![[0, 2, 1], [0, 1, 3], [0, 3, 2], [1, 2, 3]];
        let h = halved(at.clone(), tetrahedron.clone(), &[false; 5], 1);
        assert_eq!(h.faces, tetrahedron);
        let book = vec![[0, 1, 2], [0, 1, 3], [0, 1, 4]];
        let h = halved(at.clone(), book, &[false; 5], 0);
        assert!(h.faces.len() <= 3);
        let fans = vec![[0, 1, 2], [0, 3, 4]];
        let h = halved(at.clone(), fans, &[false; 5], 0);
        assert!(h.faces.iter().all(|f| f[0] != f[1] && f[1] != f[2] && f[2] != f[0]));
        assert!(halved(at, vec![], &[false; 5], 0).faces.is_empty());
    }
}
