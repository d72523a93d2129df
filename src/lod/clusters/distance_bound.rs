//! Distance bound: a nearly exact upper bound of the distance from a piece of one surface to
//! another.

use std::cell::Cell;

use glam::{DVec3, Vec3};

use super::convex_polygon::ConvexPolygon;
use super::partition::NO_FACE;
use crate::geometry::TriangleBvh;

/// Most clips in sequence: near a corner the planes of its edges do not quite meet, and a piece
/// could circulate.
const MAX_CUTS: u32 = 16;

thread_local! {
    /// Stack of [`TargetSurface::clip_to_faces`], kept between calls.
    static STACK: Cell<Vec<StackEntry>> = const { Cell::new(Vec::new()) };
}

/// Piece to clip, a face near it, the number of clips left, and whether halving brings it nearer.
type StackEntry = (ConvexPolygon, u32, u32, bool);

/// Part that is too far from a face: the part, the face, the distance bound (mm), and the number of
/// clips left.
type OpenPart = (ConvexPolygon, u32, f64, u32);

/// Factor by which a bound may exceed the least possible one.
const BOUND_SLACK: f64 = 1.05;

/// Nearest point of a triangle to a given point: distance, and barycentric weights.
pub struct Near {
    /// Squared distance, mm².
    pub d2: f64,
    /// Weights of the three corners.
    pub weights: [f64; 3],
}

/// A triangle with the products that the nearest-point query needs.
#[derive(Clone, Copy)]
pub struct TriangleCache {
    corners: [DVec3; 3],
    ab: DVec3,
    ac: DVec3,
    /// Dot products of the two sides.
    bb: f64,
    bc: f64,
    cc: f64,
}

impl TriangleCache {
    /// Precomputes the products.
    #[inline]
    pub fn new([a, b, c]: [DVec3; 3]) -> Self {
        let (ab, ac) = (b - a, c - a);
        let (bb, bc, cc) = (ab.dot(ab), ab.dot(ac), ac.dot(ac));
        Self { corners: [a, b, c], ab, ac, bb, bc, cc }
    }

    /// Nearest point (Ericson 2005, Real-Time Collision Detection, 5.1.5).
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

/// Plane through an edge of a face, perpendicular to the surface: outward unit normal, and a point.
pub type EdgePlane = Option<(DVec3, DVec3)>;

/// Precomputed data of each face of a target.
#[derive(Default)]
pub struct TargetCache {
    faces: Vec<TriangleCache>,
    edge_planes: Vec<[EdgePlane; 3]>,
}

impl TargetCache {
    /// Precomputes the data of all faces.
    pub fn new(target: &TargetSurface<'_>) -> Self {
        let all = 0..target.faces.len() as u32;
        Self {
            faces: all.clone().map(|f| TriangleCache::new(target.corners(f))).collect(),
            edge_planes: all.map(|f| [0, 1, 2].map(|k| target.edge_plane(f, k))).collect(),
        }
    }
}

/// A triangle surface to measure distances to.
#[derive(Clone, Copy)]
pub struct TargetSurface<'a> {
    /// Vertex positions, mm.
    pub positions: &'a [Vec3],
    /// Unit normals, one a vertex; edge planes contain them.
    pub normals: &'a [Vec3],
    /// Faces.
    pub faces: &'a [[u32; 3]],
    /// Face across each edge.
    pub face_neighbors: &'a [[u32; 3]],
    /// Search tree over the same faces, for queries from afar.
    pub bvh: &'a TriangleBvh,
    /// Cache of all faces, or empty where they are too many.
    pub cache: &'a TargetCache,
}

impl TargetSurface<'_> {
    #[inline]
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
        if let Some(c) = self.cache.faces.get(face as usize) {
            return c.corners;
        }
        self.faces[face as usize].map(|v| self.positions[v as usize].as_dvec3())
    }

    /// Nearest point of a face.
    #[inline]
    pub fn nearest(&self, face: u32, p: DVec3) -> Near {
        match self.cache.faces.get(face as usize) {
            Some(f) => f.nearest(p),
            None => TriangleCache::new(self.corners(face)).nearest(p),
        }
    }

    /// Walks across edges as long as that comes nearer to `p`; returns the face where it ends, a
    /// local minimum.
    pub fn walk_to_face(&self, from: u32, p: DVec3) -> u32 {
        self.walk_to_point(from, p).0
    }

    /// [`Self::walk_to_face`], with the nearest point of the face where it ends.
    #[inline]
    pub fn walk_to_point(&self, from: u32, p: DVec3) -> (u32, Near) {
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
                if let Some(found) = self.turn_around_vertex(face, k, p, here.d2, corner) {
                    next = Some(found);
                    break;
                }
            }
            let Some((f, near)) = next else { break };
            (face, here) = (f, near);
        }
        (face, here)
    }

    /// A face nearer than `d2` across edge `k` or, where the nearest point is a corner, among those
    /// that follow around it.
    fn turn_around_vertex(
        &self,
        face: u32,
        k: usize,
        p: DVec3,
        d2: f64,
        corner: bool,
    ) -> Option<(u32, Near)> {
        let f = self.faces[face as usize];
        // The pivot: the end of edge k that has all the weight.
        let (mut at, mut edge) = (face, k);
        let pivot = {
            let [a, b] = [f[k], f[(k + 1) % 3]];
            let d = |v: u32| self.positions[v as usize].as_dvec3().distance_squared(p);
            if d(a) <= d(b) { a } else { b }
        };
        for _ in 0..if corner { 12 } else { 1 } {
            let next = self.face_neighbors[at as usize][edge];
            if next == NO_FACE || next == face {
                return None;
            }
            let near = self.nearest(next, p);
            if near.d2 < d2 {
                return Some((next, near));
            }
            // Leave by the other edge at the pivot.
            let g = self.faces[next as usize];
            edge = (0..3).find(|&e| {
                self.face_neighbors[next as usize][e] != at
                    && (g[e] == pivot || g[(e + 1) % 3] == pivot)
            })?;
            at = next;
        }
        None
    }

    fn max_distance(&self, face: u32, piece: &ConvexPolygon) -> f64 {
        let d2 = piece.corners().iter().map(|p| self.nearest(face, *p).d2);
        d2.fold(0.0, f64::max).sqrt()
    }

    /// Splits a piece into parts, assigns each part a face near it, and raises `bound` (mm) to the
    /// largest distance. Distance to one triangle is convex and the parts make up the whole, so
    /// this is an upper bound for every point wherever the splits are. Parts within `bound` are not
    /// split further, nor are those that exceed the least possible bound, given by the exact
    /// distances of their corners, by no more than [`BOUND_SLACK`]. `emit` gets face, part and
    /// distance.
    ///
    /// The planes between two faces contain their common edge and the normals of its ends, so both
    /// sides split alike. Where that makes no progress (boundaries, needles, corners where planes
    /// do not meet in a line), parts are halved.
    pub fn bound_distance(
        &self,
        piece: &ConvexPolygon,
        start: u32,
        bound: &mut f64,
        mut emit: impl FnMut(u32, &ConvexPolygon, f64),
    ) {
        // Most pieces are near one face as a whole.
        let face = self.walk_to_face(start, piece.centre());
        let far = self.max_distance(face, piece);
        if far <= *bound {
            emit(face, piece, far);
            return;
        }
        // Most others extend across one edge.
        if let Some((next, [inside, outside])) = self.split_across_one_edge(piece, face) {
            let far = [self.max_distance(face, &inside), self.max_distance(next, &outside)];
            if far[0] <= *bound && far[1] <= *bound {
                emit(face, &inside, far[0]);
                emit(next, &outside, far[1]);
                return;
            }
        }
        let mut rest = Vec::new();
        self.clip_to_faces(piece, face, &mut |face, part, far| {
            if far <= *bound {
                emit(face, part, far);
            } else {
                rest.push((*part, face, far, MAX_CUTS));
            }
        });
        self.bound_parts(rest, bound, emit);
    }

    /// Bounds parts that are farther than `bound` from the face they were given, by exact queries.
    fn bound_parts(
        &self,
        mut open: Vec<OpenPart>,
        bound: &mut f64,
        mut emit: impl FnMut(u32, &ConvexPolygon, f64),
    ) {
        while let Some((piece, face, far, cuts)) = open.pop() {
            crate::task::checkpoint();
            let (face, far) = match self.bvh.closest_within(piece.centre(), far) {
                Some(c) => match self.max_distance(c.at.face, &piece) {
                    nearer if nearer < far => (c.at.face, nearer),
                    _ => (face, far),
                },
                None => (face, far),
            };
            if far <= *bound {
                emit(face, &piece, far);
                continue;
            }
            let least = piece.corners().iter().filter_map(|p| self.bvh.closest_within(*p, far));
            *bound = least.fold(*bound, |m, c| m.max(c.distance_mm));
            let (length, a, b) = piece.longest_diagonal();
            if far <= BOUND_SLACK * *bound || length <= 1e-9 {
                *bound = bound.max(far);
                emit(face, &piece, far);
                continue;
            }
            // Clipped along the face that is nearest indeed, if that parts it. Where a surface is
            // flat the bound is tiny, and halves would have to become as small.
            let mut clipped = Vec::new();
            if cuts > 0
                && let Some(inner) =
                    self.clip_at_edge_planes(face, piece, &mut |n, part| clipped.push((part, n)))
                && !clipped.is_empty()
            {
                clipped.push((inner, face));
                let cut = |(part, f)| (part, f, self.max_distance(f, &part), cuts - 1);
                open.extend(clipped.into_iter().map(cut));
                continue;
            }
            match piece.split(b - a, 0.5 * (a + b)) {
                Some(halves) => {
                    let half = |h| (h, face, self.max_distance(face, &h), cuts);
                    open.extend(halves.map(half));
                }
                None => {
                    *bound = bound.max(far);
                    emit(face, &piece, far);
                }
            }
        }
    }

    /// Clips a piece along edge planes, so that each part is near one face; `emit` gets face, part,
    /// and a distance bound of the part to that face.
    pub fn clip_to_faces(
        &self,
        piece: &ConvexPolygon,
        start: u32,
        emit: &mut impl FnMut(u32, &ConvexPolygon, f64),
    ) {
        crate::task::checkpoint();
        let mut open = STACK.take();
        open.clear();
        open.push((*piece, self.walk_to_face(start, piece.centre()), MAX_CUTS, true));
        while let Some((piece, face, cuts, simplify_faces)) = open.pop() {
            let [a, b, c] = self.corners(face);
            let side2 = a.distance_squared(b).max(b.distance_squared(c));
            // No two corners are farther apart than twice this.
            let first = piece.at[0];
            let reach2 = piece.corners().iter().fold(0.0, |r, p| p.distance_squared(first).max(r));
            if simplify_faces
                && reach2 > side2
                && cuts > 0
                && let (length, a, b) = piece.longest_diagonal()
                && length > 2.0 * side2.sqrt()
                && let Some(halves) = piece.split(b - a, 0.5 * (a + b))
            {
                // Where all walks end on one tiny face, as in folds, halves are no nearer to it.
                open.extend(halves.map(|h| {
                    let next = self.walk_to_face(face, h.centre());
                    (h, next, cuts - 1, next != face)
                }));
                continue;
            }
            // A part handed across an edge plane is not walked again: by distance it may seem to
            // belong where it came from.
            let mut hand = |next, part| open.push((part, next, cuts - 1, true));
            let inner = match cuts {
                0 => Some(piece),
                _ => self.clip_at_edge_planes(face, piece, &mut hand),
            };
            if let Some(inner) = inner {
                emit(face, &inner, self.max_distance(face, &inner));
            }
        }
        STACK.set(open);
    }

    /// Splits a piece between a face and the one behind the only edge plane that it crosses.
    fn split_across_one_edge(
        &self,
        piece: &ConvexPolygon,
        face: u32,
    ) -> Option<(u32, [ConvexPolygon; 2])> {
        let mut across = None;
        for k in 0..3 {
            let next = self.face_neighbors[face as usize][k];
            let Some((normal, through)) = self.edge_plane(face, k) else { continue };
            if next != NO_FACE && piece.corners().iter().any(|p| normal.dot(*p - through) > 1e-9) {
                if across.is_some() {
                    return None;
                }
                across = Some((next, normal, through));
            }
        }
        let (next, normal, through) = across?;
        let parts = piece.split(normal, through)?;
        (parts[0].count > 2 && parts[1].count > 2).then_some((next, parts))
    }

    /// Hands what is beyond each edge plane of a face to the face there; returns the rest, if any.
    fn clip_at_edge_planes(
        &self,
        face: u32,
        piece: ConvexPolygon,
        hand: &mut impl FnMut(u32, ConvexPolygon),
    ) -> Option<ConvexPolygon> {
        let mut rest = piece;
        for k in 0..3 {
            let next = self.face_neighbors[face as usize][k];
            if next == NO_FACE {
                continue;
            }
            let Some((normal, through)) = self.edge_plane(face, k) else { continue };
            let heights = rest.heights(normal, through);
            let corners = &heights[..rest.count];
            if !corners.iter().any(|h| *h > 1e-9) {
                continue;
            }
            if !corners.iter().any(|h| *h < -1e-9) {
                hand(next, rest);
                return None;
            }
            if let Some([inside, outside]) = rest.split_at(&heights) {
                hand(next, outside);
                rest = inside;
            }
        }
        Some(rest)
    }

    /// The plane through edge `k` of a face: outward unit normal and a point; `None` if degenerate.
    #[inline]
    fn edge_plane(&self, face: u32, k: usize) -> EdgePlane {
        if let Some(w) = self.cache.edge_planes.get(face as usize) {
            return w[k];
        }
        let f = self.faces[face as usize];
        let (a, b) = (f[k] as usize, f[(k + 1) % 3] as usize);
        let at = |v: usize| self.positions[v].as_dvec3();
        let up = (self.normals[a] + self.normals[b]).as_dvec3();
        let out = (at(b) - at(a)).cross(up).try_normalize()?;
        // Outward means away from the third corner, whatever the normals say.
        let third = at(f[(k + 2) % 3] as usize) - at(a);
        Some((if out.dot(third) > 0.0 { -out } else { out }, at(a)))
    }
}

/// Rounds up to f32.
pub fn round_up(v: f64) -> f32 {
    let f = v as f32;
    if f64::from(f) < v { f.next_up() } else { f }
}
