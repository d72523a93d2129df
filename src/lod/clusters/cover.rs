//! How far a piece of one surface is from another: an upper bound that is nearly exact.

use std::cell::Cell;

use glam::{DVec3, Vec3};

use super::partition::NONE;
use crate::geometry::TriangleBvh;

/// Corners of a piece, at most.
pub const CORNERS: usize = 8;
/// Cuts behind each other, at most: near a corner the planes of its edges do not quite meet, and a
/// piece could be handed around.
const CUTS: u32 = 16;

thread_local! {
    /// Room for [`Target::part`]: too much to ask for again for each piece.
    static OPEN: Cell<Vec<Open>> = const { Cell::new(Vec::new()) };
}

/// A piece to be cut, a face near it, how many cuts it may get, and whether halves bring it nearer.
type Open = (Piece, u32, u32, bool);

/// How much larger than need be a bound may be.
const SLACK: f64 = 1.05;

/// A flat convex piece of a surface.
#[derive(Clone, Copy)]
pub struct Piece {
    count: usize,
    at: [DVec3; CORNERS],
}

impl Piece {
    /// From its corners, as many as fit.
    pub fn new(corners: &[DVec3]) -> Self {
        let mut piece = Self { count: corners.len().min(CORNERS), at: [DVec3::ZERO; CORNERS] };
        piece.at[..piece.count].copy_from_slice(&corners[..piece.count]);
        piece
    }

    /// Its corners.
    pub fn corners(&self) -> &[DVec3] {
        &self.at[..self.count]
    }

    /// Mean of its corners.
    pub fn centre(&self) -> DVec3 {
        self.corners().iter().sum::<DVec3>() / self.count.max(1) as f64
    }

    /// Area, mm².
    pub fn area(&self) -> f64 {
        let p = self.corners();
        let fan = p.windows(2).map(|w| (w[0] - p[0]).cross(w[1] - p[0])).sum::<DVec3>();
        0.5 * fan.length()
    }

    /// Heights of its corners over a plane.
    fn heights(&self, normal: DVec3, through: DVec3) -> [f64; CORNERS] {
        let mut heights = [0.0; CORNERS];
        let corners = self.corners().iter();
        heights.iter_mut().zip(corners).for_each(|(h, p)| *h = normal.dot(*p - through));
        heights
    }

    /// The parts on either side of a plane, the side of its normal second; `None` if there would be
    /// too many corners.
    fn cut(&self, normal: DVec3, through: DVec3) -> Option<[Self; 2]> {
        self.cut_at(&self.heights(normal, through))
    }

    /// [`Self::cut`] by the plane that its corners are so high over.
    fn cut_at(&self, heights: &[f64; CORNERS]) -> Option<[Self; 2]> {
        let mut out = [Self { count: 0, at: [DVec3::ZERO; CORNERS] }; 2];
        let mut put = |side: usize, p: DVec3| {
            let o = &mut out[side];
            *o.at.get_mut(o.count)? = p;
            o.count += 1;
            Some(())
        };
        let corners = self.corners();
        for (i, &p) in corners.iter().enumerate() {
            let j = if i + 1 < corners.len() { i + 1 } else { 0 };
            let (q, hp, hq) = (corners[j], heights[i], heights[j]);
            if hp <= 0.0 {
                put(0, p)?;
            }
            if hp >= 0.0 {
                put(1, p)?;
            }
            if hp * hq < 0.0 {
                let crossing = p + (q - p) * (hp / (hp - hq));
                put(0, crossing)?;
                put(1, crossing)?;
            }
        }
        Some(out)
    }

    /// Two halves across its longest diagonal, and the length of that.
    fn longest(&self) -> (f64, DVec3, DVec3) {
        let p = self.corners();
        let mut best = (0.0, DVec3::ZERO, DVec3::ZERO);
        for i in 0..p.len() {
            for j in 0..i {
                let d = p[i].distance_squared(p[j]);
                if d > best.0 {
                    best = (d, p[i], p[j]);
                }
            }
        }
        (best.0.sqrt(), best.1, best.2)
    }
}

/// Where a point of a piece is nearest to a surface: distance, and weights of the face's corners.
pub struct Near {
    /// Squared distance, mm².
    pub d2: f64,
    /// Weights of the three corners.
    pub weights: [f64; 3],
}

/// A triangle and what the nearest place on it takes.
#[derive(Clone, Copy)]
pub struct Known {
    corners: [DVec3; 3],
    ab: DVec3,
    ac: DVec3,
    /// Products of the two sides.
    bb: f64,
    bc: f64,
    cc: f64,
}

impl Known {
    /// Of a triangle.
    #[inline]
    pub fn new([a, b, c]: [DVec3; 3]) -> Self {
        let (ab, ac) = (b - a, c - a);
        let (bb, bc, cc) = (ab.dot(ab), ab.dot(ac), ac.dot(ac));
        Self { corners: [a, b, c], ab, ac, bb, bc, cc }
    }

    /// Nearest place (Ericson 2005, Real-Time Collision Detection, 5.1.5).
    #[inline]
    pub fn nearest(&self, p: DVec3) -> Near {
        let ap = p - self.corners[0];
        let put = |w: [f64; 3]| {
            let q = self.ab * w[1] + self.ac * w[2];
            Near { d2: ap.distance_squared(q), weights: w }
        };
        let (d1, d2) = (self.ab.dot(ap), self.ac.dot(ap));
        if d1 <= 0.0 && d2 <= 0.0 {
            return put([1.0, 0.0, 0.0]);
        }
        let (d3, d4) = (d1 - self.bb, d2 - self.bc);
        if d3 >= 0.0 && d4 <= d3 {
            return put([0.0, 1.0, 0.0]);
        }
        let vc = d1 * d4 - d3 * d2;
        if vc <= 0.0 && d1 >= 0.0 && d3 <= 0.0 {
            let v = d1 / (d1 - d3).max(f64::MIN_POSITIVE);
            return put([1.0 - v, v, 0.0]);
        }
        let (d5, d6) = (d1 - self.bc, d2 - self.cc);
        if d6 >= 0.0 && d5 <= d6 {
            return put([0.0, 0.0, 1.0]);
        }
        let vb = d5 * d2 - d1 * d6;
        if vb <= 0.0 && d2 >= 0.0 && d6 <= 0.0 {
            let w = d2 / (d2 - d6).max(f64::MIN_POSITIVE);
            return put([1.0 - w, 0.0, w]);
        }
        let va = d3 * d6 - d5 * d4;
        if va <= 0.0 && d4 >= d3 && d5 >= d6 {
            let w = (d4 - d3) / ((d4 - d3) + (d5 - d6)).max(f64::MIN_POSITIVE);
            return put([0.0, 1.0 - w, w]);
        }
        let sum = va + vb + vc;
        if sum.is_nan() || sum <= 0.0 {
            // No area: one of the corners, which is not nearer than the nearest place.
            let d = self.corners.map(|q| q.distance_squared(p));
            let k = (0..3).fold(0, |k, i| if d[i] < d[k] { i } else { k });
            let mut weights = [0.0; 3];
            weights[k] = 1.0;
            return Near { d2: d[k], weights };
        }
        let (v, w) = (vb / sum, vc / sum);
        put([1.0 - v - w, v, w])
    }
}

/// A plane on an edge of a face, towards the face beside it: outward unit normal, and a point.
pub type Wall = Option<(DVec3, DVec3)>;

/// What is asked of faces again and again, worked out once.
#[derive(Default)]
pub struct Worked {
    faces: Vec<Known>,
    walls: Vec<[Wall; 3]>,
}

impl Worked {
    /// Of all faces of a target.
    pub fn new(target: &Target<'_>) -> Self {
        let all = 0..target.faces.len() as u32;
        Self {
            faces: all.clone().map(|f| Known::new(target.corners(f))).collect(),
            walls: all.map(|f| [0, 1, 2].map(|k| target.wall(f, k))).collect(),
        }
    }
}

/// A triangle surface to measure to.
#[derive(Clone, Copy)]
pub struct Target<'a> {
    /// Vertex positions, mm.
    pub positions: &'a [Vec3],
    /// Unit normals, one a vertex: the cuts between faces stand along them.
    pub normals: &'a [Vec3],
    /// Faces.
    pub faces: &'a [[u32; 3]],
    /// Face across each edge.
    pub beside: &'a [[u32; 3]],
    /// The same faces for search from afar.
    pub tree: &'a TriangleBvh,
    /// Of all faces, or of none where they are too many.
    pub worked: &'a Worked,
}

impl Target<'_> {
    #[inline]
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        if let Some(c) = self.worked.faces.get(face as usize) {
            return c.corners;
        }
        self.faces[face as usize].map(|v| self.positions[v as usize].as_dvec3())
    }

    /// Nearest place of a face.
    #[inline]
    pub fn nearest(&self, face: u32, p: DVec3) -> Near {
        match self.worked.faces.get(face as usize) {
            Some(f) => f.nearest(p),
            None => Known::new(self.corners(face)).nearest(p),
        }
    }

    /// Goes from face to face as long as that brings it nearer to `p`.
    pub fn walk(&self, from: u32, p: DVec3) -> u32 {
        self.walked(from, p).0
    }

    /// [`Self::walk`] with the place on the face where it ends.
    #[inline]
    pub fn walked(&self, from: u32, p: DVec3) -> (u32, Near) {
        let mut face = from;
        let mut here = self.nearest(face, p);
        for _ in 0..10_000 {
            if here.d2 == 0.0 {
                break;
            }
            let zeros = here.weights.map(|w| w <= 0.0);
            // Edge k is opposite corner k + 2.
            let mut next = None;
            for k in (0..3).filter(|k| zeros[(k + 2) % 3]) {
                let corner = zeros[(k + 1) % 3] || zeros[k];
                if let Some(found) = self.turn(face, k, p, here.d2, corner) {
                    next = Some(found);
                    break;
                }
            }
            let Some((f, near)) = next else { break };
            (face, here) = (f, near);
        }
        (face, here)
    }

    /// A face nearer than `d2` across edge `k`, or, where the nearest place is a corner, among
    /// those that follow around it.
    fn turn(&self, face: u32, k: usize, p: DVec3, d2: f64, corner: bool) -> Option<(u32, Near)> {
        let f = self.faces[face as usize];
        // The corner turned about: the end of edge k that has all the weight.
        let (mut at, mut edge) = (face, k);
        let pivot = {
            let [a, b] = [f[k], f[(k + 1) % 3]];
            let d = |v: u32| self.positions[v as usize].as_dvec3().distance_squared(p);
            if d(a) <= d(b) { a } else { b }
        };
        for _ in 0..if corner { 12 } else { 1 } {
            let next = self.beside[at as usize][edge];
            if next == NONE || next == face {
                return None;
            }
            let near = self.nearest(next, p);
            if near.d2 < d2 {
                return Some((next, near));
            }
            // Leave by the other edge at the pivot.
            let g = self.faces[next as usize];
            edge = (0..3).find(|&e| {
                self.beside[next as usize][e] != at && (g[e] == pivot || g[(e + 1) % 3] == pivot)
            })?;
            at = next;
        }
        None
    }

    fn farthest(&self, face: u32, piece: &Piece) -> f64 {
        let d2 = piece.corners().iter().map(|p| self.nearest(face, *p).d2);
        d2.fold(0.0, f64::max).sqrt()
    }

    /// Cuts a piece up, gives each part a face near it, and raises `bound` (mm) to the largest
    /// distance: of every point of a part to its face it is an upper bound whatever the cuts are,
    /// since distance to one triangle is convex and parts make up the whole. Parts within `bound`
    /// are not cut further; nor are those that reach no more than [`SLACK`] beyond what their
    /// corners' true distances make the least bound there can be. `take` gets face, part and distance.
    ///
    /// The cuts between two faces stand on their common edge along the normals of its ends, so that
    /// both sides cut alike. Where that leads nowhere (rims, needles, corners where such planes do
    /// not meet in a line), halving does.
    pub fn cover(
        &self,
        piece: &Piece,
        start: u32,
        bound: &mut f64,
        mut take: impl FnMut(u32, &Piece, f64),
    ) {
        // Most pieces lie near one face as they are.
        let face = self.walk(start, piece.centre());
        let far = self.farthest(face, piece);
        if far <= *bound {
            take(face, piece, far);
            return;
        }
        // Most others lie on both sides of one edge.
        if let Some((next, [inside, outside])) = self.two(piece, face) {
            let far = [self.farthest(face, &inside), self.farthest(next, &outside)];
            if far[0] <= *bound && far[1] <= *bound {
                take(face, &inside, far[0]);
                take(next, &outside, far[1]);
                return;
            }
        }
        let mut rest = Vec::new();
        self.part(piece, face, &mut |face, part, far| {
            if far <= *bound {
                take(face, part, far);
            } else {
                rest.push((*part, face, far));
            }
        });
        while let Some((piece, face, far)) = rest.pop() {
            // Exact from here on.
            let (face, far) = match self.tree.closest_within(piece.centre(), far) {
                Some(c) => match self.farthest(c.at.face, &piece) {
                    nearer if nearer < far => (c.at.face, nearer),
                    _ => (face, far),
                },
                None => (face, far),
            };
            if far <= *bound {
                take(face, &piece, far);
                continue;
            }
            let least = piece.corners().iter().filter_map(|p| self.tree.closest_within(*p, far));
            *bound = least.fold(*bound, |m, c| m.max(c.distance_mm));
            let (length, a, b) = piece.longest();
            let halves = if far <= SLACK * *bound || length <= 1e-9 {
                None
            } else {
                piece.cut(b - a, 0.5 * (a + b))
            };
            match halves {
                Some(halves) => rest.extend(halves.map(|h| (h, face, self.farthest(face, &h)))),
                None => {
                    *bound = bound.max(far);
                    take(face, &piece, far);
                }
            }
        }
    }

    /// Cuts a piece up along walls, so that each part is near one face; `take` gets face, part,
    /// and how far any point of the part is from that face at most.
    pub fn part(&self, piece: &Piece, start: u32, take: &mut impl FnMut(u32, &Piece, f64)) {
        let mut open = OPEN.take();
        open.clear();
        open.push((*piece, self.walk(start, piece.centre()), CUTS, true));
        while let Some((piece, face, cuts, halve)) = open.pop() {
            let [a, b, c] = self.corners(face);
            let side2 = a.distance_squared(b).max(b.distance_squared(c));
            // No two corners are farther apart than both are from a third.
            let first = piece.at[0];
            let reach2 = piece.corners().iter().fold(0.0, |r, p| p.distance_squared(first).max(r));
            if halve
                && reach2 > side2
                && cuts > 0
                && let (length, a, b) = piece.longest()
                && length > 2.0 * side2.sqrt()
                && let Some(halves) = piece.cut(b - a, 0.5 * (a + b))
            {
                // Where all walks end on one tiny face, as on folds, halves lie no nearer to it.
                open.extend(halves.map(|h| {
                    let next = self.walk(face, h.centre());
                    (h, next, cuts - 1, next != face)
                }));
                continue;
            }
            // What is handed across a wall is not walked again: by distance it may seem to belong
            // where it came from.
            let mut hand = |next, part| open.push((part, next, cuts - 1, true));
            let inner = match cuts {
                0 => Some(piece),
                _ => self.cut_along_walls(face, piece, &mut hand),
            };
            if let Some(inner) = inner {
                take(face, &inner, self.farthest(face, &inner));
            }
        }
        OPEN.set(open);
    }

    /// The parts of a piece on a face and on the one behind the only wall that it reaches across.
    fn two(&self, piece: &Piece, face: u32) -> Option<(u32, [Piece; 2])> {
        let mut across = None;
        for k in 0..3 {
            let next = self.beside[face as usize][k];
            let Some((normal, through)) = self.wall(face, k) else { continue };
            if next != NONE && piece.corners().iter().any(|p| normal.dot(*p - through) > 1e-9) {
                if across.is_some() {
                    return None;
                }
                across = Some((next, normal, through));
            }
        }
        let (next, normal, through) = across?;
        let parts = piece.cut(normal, through)?;
        (parts[0].count > 2 && parts[1].count > 2).then_some((next, parts))
    }

    /// Hands what lies beyond each wall of a face to the face there; what is left, if anything.
    fn cut_along_walls(
        &self,
        face: u32,
        piece: Piece,
        hand: &mut impl FnMut(u32, Piece),
    ) -> Option<Piece> {
        let mut rest = piece;
        for k in 0..3 {
            let next = self.beside[face as usize][k];
            if next == NONE {
                continue;
            }
            let Some((normal, through)) = self.wall(face, k) else { continue };
            let heights = rest.heights(normal, through);
            let corners = &heights[..rest.count];
            if !corners.iter().any(|h| *h > 1e-9) {
                continue;
            }
            if !corners.iter().any(|h| *h < -1e-9) {
                hand(next, rest);
                return None;
            }
            if let Some([inside, outside]) = rest.cut_at(&heights) {
                hand(next, outside);
                rest = inside;
            }
        }
        Some(rest)
    }

    /// The plane on edge `k` of a face: outward unit normal and a point; `None` without a direction.
    #[inline]
    fn wall(&self, face: u32, k: usize) -> Wall {
        if let Some(w) = self.worked.walls.get(face as usize) {
            return w[k];
        }
        let f = self.faces[face as usize];
        let (a, b) = (f[k] as usize, f[(k + 1) % 3] as usize);
        let at = |v: usize| self.positions[v].as_dvec3();
        let up = (self.normals[a] + self.normals[b]).as_dvec3();
        let out = (at(b) - at(a)).cross(up).try_normalize()?;
        // Out is away from the third corner, whatever the normals say.
        let third = at(f[(k + 2) % 3] as usize) - at(a);
        Some((if out.dot(third) > 0.0 { -out } else { out }, at(a)))
    }
}
