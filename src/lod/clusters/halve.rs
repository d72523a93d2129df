//! Simplification of one group of clusters: some thousand faces, any soup of them, borders fixed.
//!
//! *Why not [`crate::mesh::simplify`]:* it takes manifold meshes, as parameterisation must; a group
//! as a rule has vertices where several fans of its clusters touch, and input may be any soup.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DMat3, DVec3};

use super::fans::Fans;
use super::partition::NONE;

/// Faces at a vertex after a collapse, at most.
const VALENCE_MAX: usize = 24;
/// Cosine of how far a face may turn in one collapse (75°).
const TURN_MIN: f64 = 0.2588;
/// Sine of the smallest angle a face may get (0.1°), unless it had a smaller one. With 1° the
/// cheapest collapses of nearly flat places, which go by way of needles, are not made: a group then
/// ends far from its half, and the coarsest surface of a colon of 1 M faces at 86 clusters for 3.
const ANGLE_MIN: f64 = 0.001745;
/// Weight of what holds an open boundary in place against that of its faces.
const BOUNDARY: f64 = 10.0;
/// Share of a quadric's stiffness that holds a vertex where it is: along flats and ridges, where
/// planes say nothing, it stays.
const HOLD: f64 = 1e-3;
/// Cosine of how far a face may turn in one move (30°).
const MOVE_TURN_MIN: f64 = 0.866;
/// A vertex moves by this share of its shortest edge at most.
const MOVE_MAX: f64 = 0.5;

/// A collapse is judged at this share of the way from the vertex that stays to the one that goes,
/// as the one that stays will move a little towards it.
const SHARE: f64 = 0.25;

/// The faces left, and where every vertex went.
pub struct Halved {
    /// Ids as given; none twice in a face.
    pub faces: Vec<[u16; 3]>,
    /// The vertex that stands for each one now.
    pub onto: Vec<u16>,
    /// Where each vertex is now, as given or moved; of no use for those that are gone.
    pub at: Vec<DVec3>,
}

/// Squared distance to weighted planes: p·A p + 2 b·p + c.
#[derive(Clone, Copy, Default)]
struct Quadric {
    a: [f64; 6],
    b: DVec3,
    c: f64,
}

impl Quadric {
    fn plane(n: DVec3, through: DVec3, weight: f64) -> Self {
        let d = -n.dot(through);
        let a = [n.x * n.x, n.y * n.y, n.z * n.z, n.x * n.y, n.y * n.z, n.z * n.x];
        Self { a: a.map(|v| weight * v), b: weight * d * n, c: weight * d * d }
    }

    fn add(&mut self, o: &Self) {
        self.a.iter_mut().zip(o.a).for_each(|(a, b)| *a += b);
        self.b += o.b;
        self.c += o.c;
    }

    /// Half the gradient at `p`, and the matrix A.
    fn slope(&self, p: DVec3) -> (DVec3, DMat3) {
        let [xx, yy, zz, xy, yz, zx] = self.a;
        let m = DMat3::from_cols_array(&[xx, xy, zx, xy, yy, yz, zx, yz, zz]);
        (m * p + self.b, m)
    }

    fn at(&self, p: DVec3) -> f64 {
        let [xx, yy, zz, xy, yz, zx] = self.a;
        let square = xx * p.x * p.x + yy * p.y * p.y + zz * p.z * p.z;
        let mixed = xy * p.x * p.y + yz * p.y * p.z + zx * p.z * p.x;
        square + 2.0 * (mixed + self.b.dot(p)) + self.c
    }
}

struct Soup<'a> {
    at: Vec<DVec3>,
    faces: Vec<[u16; 3]>,
    /// Faces of each vertex; what is gone is taken out.
    of: Fans,
    quadric: Vec<Quadric>,
    /// Marks of the vertices around the one under work, and which work.
    mark: Vec<(u32, u8)>,
    round: u32,
    ring: Vec<u16>,
    locked: &'a [bool],
}

/// What is around a vertex.
enum Fan {
    Closed,
    /// The two neighbours on the boundary.
    Open(u16, u16),
    /// More than one fan, or edges with more than two faces.
    Other,
}

/// Collapses vertices that are not `locked` onto neighbours, cheapest first, until no more than
/// `target` faces are left or nothing legal remains. A vertex that took another's place moves to
/// the least of their quadric, if it is neither locked nor on a boundary.
///
/// Costs after Garland & Heckbert 1997. Ours: each face weighs the mean area of all more than its
/// own, as the worst places of a group are pits made of specks; half-edge collapses, each followed
/// by a move that no face around it turns or thins too much by; costs are worked out anew only when
/// a vertex comes up; and it works on index soup, where a vertex of a group may have several fans.
/// The tangent planes of [`crate::mesh::Metric::NormalQem`] do not pay here: what counts is the
/// largest distance.
///
/// * `at`: near the origin, or costs lose digits.
/// * `beside`: the face across each edge, [`NONE`] where there is none or more than one.
pub fn halve(
    at: Vec<DVec3>,
    faces: Vec<[u16; 3]>,
    beside: &[[u32; 3]],
    locked: &[bool],
    target: usize,
) -> Halved {
    let count = at.len();
    let mut s = Soup::new(at, faces, beside, locked);
    let mut live = s.faces.len();
    let mut onto: Vec<u16> = (0..count as u16).collect();
    // Whether a vertex waits in the heap. Its cost there may be old: it is worked out anew when it
    // comes up.
    let mut waits = vec![false; count];
    let mut heap = BinaryHeap::new();
    let mut targets = Vec::new();
    // Costs are not negative but for rounding: their bits order them.
    let key = |cost: f64| cost.max(0.0).to_bits();
    for u in (0..count).filter(|u| !locked[*u]) {
        s.targets(u as u16, &mut targets);
        waits[u] = !targets.is_empty();
        heap.extend(cheapest(&targets).map(|cost| Reverse((key(cost), u as u16))));
    }
    let mut near = Vec::new();
    while live > target
        && let Some(Reverse((cost, u))) = heap.pop()
    {
        s.targets(u, &mut targets);
        targets.sort_unstable_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        let Some(&(now, v)) = targets.iter().find(|t| s.legal(u, t.1)) else {
            waits[u as usize] = false;
            continue;
        };
        // Dearer than it was, or the cheapest is not allowed: it waits for its turn.
        if key(now) > cost && heap.peek().is_some_and(|next| key(now) > next.0.0) {
            heap.push(Reverse((key(now), u)));
            continue;
        }
        live -= s.collapse(u, v);
        onto[u as usize] = v;
        waits[u as usize] = true;
        if let (Fan::Closed, false) = (s.around(v), locked[v as usize]) {
            s.settle(v);
        }
        near.clear();
        let rest = |w: &u16| !locked[*w as usize] && !waits[*w as usize];
        near.extend(s.ring.iter().copied().chain([v]).filter(rest));
        for &w in &near {
            s.targets(w, &mut targets);
            waits[w as usize] = !targets.is_empty();
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
    Halved { faces: s.faces, onto, at: s.at }
}

impl<'a> Soup<'a> {
    fn new(at: Vec<DVec3>, faces: Vec<[u16; 3]>, beside: &[[u32; 3]], locked: &'a [bool]) -> Self {
        let of = Fans::new(at.len(), &faces);
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
                quadric[v].add(&q);
            }
        }
        let mark = vec![(0, 0); at.len()];
        let mut s = Self { at, faces, of, quadric, mark, round: 0, ring: Vec::new(), locked };
        s.hold_boundaries(beside);
        s
    }

    /// Planes through edges with one face, at right angles to it.
    fn hold_boundaries(&mut self, beside: &[[u32; 3]]) {
        for (i, beside) in beside.iter().enumerate() {
            let f = self.faces[i];
            for k in (0..3).filter(|k| beside[*k] == NONE) {
                let (u, v) = (f[k], f[(k + 1) % 3]);
                let both = |g: &&u16| self.faces[**g as usize].contains(&v);
                if self.of.get(u).iter().filter(both).count() != 1 {
                    continue;
                }
                let [a, b, c] = [u, v, f[(k + 2) % 3]].map(|v| self.at[v as usize]);
                let along = (b - a).normalize_or_zero();
                let across = (c - a) - along * along.dot(c - a);
                let weight = BOUNDARY * (b - a).length_squared();
                let q = Quadric::plane(across.normalize_or_zero(), a, weight);
                self.quadric[u as usize].add(&q);
                self.quadric[v as usize].add(&q);
            }
        }
    }

    /// Puts the neighbours of `u` into `ring`, marked with how its faces use them.
    fn around(&mut self, u: u16) -> Fan {
        self.round += 1;
        self.ring.clear();
        let mut clean = true;
        for &f in self.of.get(u) {
            let f = self.faces[f as usize];
            let k = f.iter().position(|v| *v == u).unwrap_or(0);
            for (v, side) in [(f[(k + 1) % 3], 1), (f[(k + 2) % 3], 2)] {
                let m = &mut self.mark[v as usize];
                if m.0 != self.round {
                    *m = (self.round, 0);
                    self.ring.push(v);
                }
                clean &= m.1 & side == 0;
                m.1 |= side;
            }
        }
        let mut ends = self.ring.iter().filter(|v| self.mark[**v as usize].1 != 3);
        match (clean, ends.next(), ends.next(), ends.next()) {
            (true, None, ..) => Fan::Closed,
            (true, Some(&a), Some(&b), None) => Fan::Open(a, b),
            _ => Fan::Other,
        }
    }

    /// Where `u` could go, and what that costs.
    fn targets(&mut self, u: u16, out: &mut Vec<(f64, u16)>) {
        out.clear();
        let fan = self.around(u);
        let mut q = self.quadric[u as usize];
        let mut add = |v: u16| {
            let o = &self.quadric[v as usize];
            q = self.quadric[u as usize];
            q.add(o);
            let mut p = self.at[v as usize];
            if !self.locked[v as usize] {
                p += SHARE * (self.at[u as usize] - p);
            }
            out.push((q.at(p).max(0.0), v));
        };
        match fan {
            Fan::Closed => self.ring.iter().for_each(|v| add(*v)),
            Fan::Open(a, b) => [a, b].into_iter().for_each(&mut add),
            Fan::Other => {}
        }
    }

    /// Whether the surface stays one, and no face turns over or becomes a needle. `ring` and marks
    /// are those of `u`.
    fn legal(&self, u: u16, v: u16) -> bool {
        let of = |v: u16| self.of.get(v).iter().map(|f| self.faces[*f as usize]);
        let (mut shared, mut dying) = (0, 0);
        for f in of(v) {
            if f.contains(&u) {
                dying += 1;
                continue;
            }
            // A neighbour of both shows once as the next and once as the previous of v.
            let k = f.iter().position(|w| *w == v).unwrap_or(0);
            let (a, b) = (f[(k + 1) % 3], f[(k + 2) % 3]);
            let near = |w: u16| self.mark[w as usize].0 == self.round;
            // Around v beside the dying faces, only their third vertices may be neighbours of u.
            for w in [a, b] {
                let third = |g: [u16; 3]| g.contains(&u) && g.contains(&w);
                if near(w) && w != u && !of(v).any(third) {
                    shared += 1;
                }
            }
            // The face that u's last one would fall upon.
            if near(a) && near(b) && self.of.get(u).len() == 3 {
                return false;
            }
        }
        if shared > 0 || dying == 0 || dying > 2 {
            return false;
        }
        if self.of.get(u).len() + self.of.get(v).len() > VALENCE_MAX + 2 * dying {
            return false;
        }
        let to = self.at[v as usize];
        of(u).filter(|f| !f.contains(&v)).all(|f| {
            let old = f.map(|w| self.at[w as usize]);
            let new = f.map(|w| if w == u { to } else { self.at[w as usize] });
            let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
            let (o, n) = (cross(old), cross(new));
            let turned = o.dot(n) < TURN_MIN * o.length() * n.length();
            !turned && n.length() > 0.0 && {
                let fine = thinnest(new);
                fine > ANGLE_MIN || fine >= thinnest(old)
            }
        })
    }

    /// Moves `v`, inside one closed fan, to where its quadric is least, or half or a quarter of the
    /// way: the first place where no face around turns much or becomes a needle.
    fn settle(&mut self, v: u16) {
        let quadric = self.quadric[v as usize];
        let old = self.at[v as usize];
        let (slope, m) = quadric.slope(old);
        let trace = m.x_axis.x + m.y_axis.y + m.z_axis.z;
        if trace.is_nan() || trace <= 0.0 {
            return;
        }
        let held = m + DMat3::from_diagonal(DVec3::splat(HOLD * trace));
        let sides = self.ring.iter().map(|w| self.at[*w as usize].distance_squared(old));
        let shortest = sides.fold(f64::INFINITY, f64::min).sqrt();
        let step = (held.inverse() * -slope).clamp_length_max(MOVE_MAX * shortest);
        let fits = |p: DVec3| {
            self.of.get(v).iter().all(|f| {
                let f = self.faces[*f as usize];
                let was = f.map(|w| self.at[w as usize]);
                let is = f.map(|w| if w == v { p } else { self.at[w as usize] });
                let cross = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a);
                let (o, n) = (cross(was), cross(is));
                o.dot(n) > MOVE_TURN_MIN * o.length() * n.length() && {
                    let fine = thinnest(is);
                    fine > ANGLE_MIN || fine >= thinnest(was)
                }
            })
        };
        let places = [1.0, 0.5, 0.25].map(|s| old + s * step);
        let better = |p: &DVec3| p.is_finite() && quadric.at(*p) < quadric.at(old);
        if let Some(p) = places.into_iter().find(|p| fits(*p)).filter(better) {
            self.at[v as usize] = p;
        }
    }

    /// Moves the faces of `u` to `v`; how many went.
    fn collapse(&mut self, u: u16, v: u16) -> usize {
        let mut gone = 0;
        for i in self.of.take(u) {
            let f = self.of.at(i);
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
        self.quadric[v as usize].add(&q);
        gone
    }
}

/// The least of some costs.
fn cheapest(targets: &[(f64, u16)]) -> Option<f64> {
    targets.iter().map(|t| t.0).reduce(f64::min)
}

/// Sine of the smallest angle, or a little less: twice the area over the two longest sides.
fn thinnest([a, b, c]: [DVec3; 3]) -> f64 {
    let sides = [a.distance_squared(b), b.distance_squared(c), c.distance_squared(a)];
    let shortest = sides.into_iter().fold(f64::INFINITY, f64::min);
    let product: f64 = sides.into_iter().product();
    (b - a).cross(c - a).length() * (shortest / product.max(f64::MIN_POSITIVE)).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use std::collections::HashMap;

    /// A bumpy square of 2 n² faces.
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

    fn halved(at: Vec<DVec3>, faces: Vec<[u16; 3]>, locked: &[bool], target: usize) -> Halved {
        let wide: Vec<[u32; 3]> = faces.iter().map(|f| f.map(u32::from)).collect();
        let beside = super::super::partition::beside(&wide, at.len());
        halve(at, faces, &beside, locked, target)
    }

    #[test]
    fn a_sheet_loses_half_its_faces_and_nothing_of_its_locked_rim() {
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
        // Some 30 mm of sheet with 0.4 mm of bumps: places chosen well straddle it.
        let moved = (0..at.len() as u16).filter(|v| h.onto[*v as usize] == *v);
        let moved = moved.filter(|v| h.at[*v as usize] != at[*v as usize]);
        assert!(moved.count() > 100);
        // Unlocked, the rim gives way too but keeps its place.
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
    fn a_tetrahedron_an_edge_of_three_faces_and_a_double_fan_stop_it() {
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
