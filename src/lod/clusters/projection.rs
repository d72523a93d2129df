//! Projection of a convex polygon onto a triangle surface without clipping: the faces that it
//! overlaps, and a distance bound to them.
//!
//! Each corner has a face near it. Where two consecutive corners have different ones, the side
//! between them is traced from face to face: for every edge E that is crossed there is a point e of
//! the side near E. If the boundary of the polygon crosses back over every edge that it crossed,
//! chords between the two points e of an edge divide it into parts, each of which has all its
//! corners near one face: its own corners, and points near edges of that face. Distance to one
//! triangle is convex, so no point of the part is farther from it than those. If the boundary goes
//! around a vertex, some point m of the polygon near it joins the parts as the centre of a star.
//! Parts may overlap: joined along chords they are a disk with the boundary of the polygon, which
//! covers the polygon.

use glam::DVec3;

use super::convex_polygon::{ConvexPolygon, MAX_CORNERS};
use super::distance_bound::TargetSurface;
use super::partition::NO_FACE;

/// Most faces visited to trace one side.
const MAX_TRACE_FACES: usize = 24;

/// Parts of less than this share of the area are dropped: no wider than rounding, they lie along
/// others.
const MIN_AREA_SHARE: f64 = 1e-15;

/// The face that a point projects to, and their squared distance, mm².
#[derive(Clone, Copy)]
pub struct ProjectedPoint {
    /// The face.
    pub face: u32,
    /// Squared distance, mm².
    pub d2: f64,
}

/// Crossing of an edge by a side of a polygon.
#[derive(Clone, Copy)]
pub struct EdgeCrossing {
    /// The face that the side leaves.
    pub from: u32,
    /// The face that the side enters.
    pub to: u32,
    /// Vertices of the edge, the lower first.
    pub edge: [u32; 2],
    /// Point of the side nearest to the edge.
    pub at: DVec3,
    /// Squared distance of that point from the edge, mm².
    pub d2: f64,
}

impl EdgeCrossing {
    /// Whether this crosses the same edge in the other direction.
    fn is_reverse_of(&self, o: &Self) -> bool {
        self.from == o.to && self.to == o.from && self.edge == o.edge
    }

    /// The crossing in the opposite direction.
    pub fn reversed(&self) -> Self {
        Self { from: self.to, to: self.from, ..*self }
    }
}

/// Boundary of a polygon traced over a surface, with buffers.
#[derive(Default)]
pub struct BoundaryTrace {
    /// Crossings in order, each with the side of the polygon that it is on: side k runs from corner
    /// k to k + 1.
    pub crossings: Vec<(u8, EdgeCrossing)>,
    /// Result of [`Self::split_by_cluster`]: a face near each part, and its corners.
    pub parts: Vec<(u32, Vec<DVec3>)>,
    /// Unfinished parts, inner ones last.
    open_parts: Vec<(u32, Vec<DVec3>)>,
    /// Reused allocations.
    spare_polygons: Vec<Vec<DVec3>>,
    unmatched: Vec<EdgeCrossing>,
    search: Vec<(EdgeCrossing, u8)>,
}

impl BoundaryTrace {
    /// Adds the faces that the polygon overlaps and the distance bound to each there, mm.
    ///
    /// * `projected`: projections of the polygon's corners.
    /// * `middle`: the result of [`TargetSurface::close_trace`].
    pub fn covered_faces(
        &self,
        projected: &[ProjectedPoint],
        middle: f64,
        out: &mut Vec<(u32, f64)>,
    ) {
        let first = out.len();
        let mut put = |t: u32, d2: f64| match out[first..].iter_mut().find(|o| o.0 == t) {
            Some(o) => o.1 = o.1.max(d2),
            None => out.push((t, middle.max(d2))),
        };
        projected.iter().for_each(|l| put(l.face, l.d2));
        for (_, c) in &self.crossings {
            put(c.from, c.d2);
            put(c.to, c.d2);
        }
        out[first..].iter_mut().for_each(|o| o.1 = o.1.sqrt());
    }

    /// Splits the polygon into `parts` of one cluster each, along the chords between faces of
    /// different clusters. False where the boundary goes around a vertex or a part has too many
    /// corners.
    ///
    /// * `first`: the face of the first corner.
    pub fn split_by_cluster(
        &mut self,
        corners: &[DVec3],
        first: u32,
        cluster: impl Fn(u32) -> u16,
    ) -> bool {
        self.spare_polygons
            .extend(self.parts.drain(..).chain(self.open_parts.drain(..)).map(|p| p.1));
        self.unmatched.clear();
        let fresh = |spare_polygons: &mut Vec<Vec<DVec3>>| {
            let mut part = spare_polygons.pop().unwrap_or_default();
            part.clear();
            part
        };
        self.open_parts.push((first, fresh(&mut self.spare_polygons)));
        let mut rest = self.crossings.as_slice();
        for (side, p) in (0..).zip(corners) {
            if let Some(part) = self.open_parts.last_mut() {
                part.1.push(*p);
            }
            while let [(s, c), after @ ..] = rest
                && *s == side
            {
                rest = after;
                let over = cluster(c.from) != cluster(c.to);
                if over && let Some(part) = self.open_parts.last_mut() {
                    part.1.push(c.at);
                }
                if self.unmatched.last().is_some_and(|last| last.is_reverse_of(c)) {
                    self.unmatched.pop();
                    if over {
                        self.parts.extend(self.open_parts.pop());
                        if let Some(part) = self.open_parts.last_mut() {
                            part.1.push(c.at);
                        }
                    }
                } else {
                    self.unmatched.push(*c);
                    if over {
                        let mut part = fresh(&mut self.spare_polygons);
                        part.push(c.at);
                        self.open_parts.push((c.to, part));
                    }
                }
            }
        }
        self.parts.append(&mut self.open_parts);
        let area = |p: &[DVec3]| ConvexPolygon::new(p).area();
        let speck = MIN_AREA_SHARE * area(corners);
        let fits = self.unmatched.is_empty() && self.parts.iter().all(|p| p.1.len() <= MAX_CORNERS);
        self.parts.retain(|p| p.1.len() > 2 && area(&p.1) > speck);
        fits && !self.parts.is_empty()
    }
}

/// Squared distance of two segments, and the nearest point of the first (Ericson 2005, Real-Time
/// Collision Detection, 5.1.9).
fn segment_distance2(p: DVec3, q: DVec3, a: DVec3, b: DVec3) -> (f64, DVec3) {
    let (u, v, r) = (q - p, b - a, p - a);
    let (uu, vv, ur, vr, uv) = (u.dot(u), v.dot(v), u.dot(r), v.dot(r), u.dot(v));
    let unit = |x: f64| if x > 0.0 { x.min(1.0) } else { 0.0 };
    // A quotient that is NaN becomes 0: any point will do, if not the nearest.
    let s = unit((uv * vr - ur * vv) / (uu * vv - uv * uv));
    let t = (uv * s + vr) / vv;
    let s = match t {
        t if t < 0.0 => unit(-ur / uu),
        t if t > 1.0 => unit((uv - ur) / uu),
        _ => s,
    };
    let t = unit(t);
    let at = p + u * s;
    (at.distance_squared(a + v * t), at)
}

impl TargetSurface<'_> {
    /// Projects a point, starting from a face near it.
    pub fn project(&self, from: u32, p: DVec3) -> ProjectedPoint {
        let (face, near) = self.walk_to_point(from, p);
        ProjectedPoint { face, d2: near.d2 }
    }

    fn edge_crossing(&self, from: u32, k: usize, p: DVec3, q: DVec3) -> EdgeCrossing {
        let c = self.corners(from);
        let f = self.faces[from as usize];
        let (a, b) = (f[k], f[(k + 1) % 3]);
        let (d2, at) = segment_distance2(p, q, c[k], c[(k + 1) % 3]);
        let edge = [a.min(b), a.max(b)];
        EdgeCrossing { from, to: self.face_neighbors[from as usize][k], edge, at, d2 }
    }

    /// Traces the side from `p`, near face `from`, to `q`, near face `to`, across edges within
    /// √`limit2` of it, as few as can be found; adds them to `trace`. Returns whether there is a
    /// path.
    pub fn trace_side(
        &self,
        side: u8,
        (p, from): (DVec3, u32),
        (q, to): (DVec3, u32),
        limit2: f64,
        trace: &mut BoundaryTrace,
    ) -> bool {
        if from == to {
            return true;
        }
        if let Some(k) = (0..3).find(|k| self.face_neighbors[from as usize][*k] == to) {
            let c = self.edge_crossing(from, k, p, q);
            if c.d2 <= limit2 {
                trace.crossings.push((side, c));
                return true;
            }
        }
        // Most others have a common vertex, and one face between them.
        for k in 0..3 {
            let middle = self.face_neighbors[from as usize][k];
            if middle == NO_FACE {
                continue;
            }
            if let Some(j) = (0..3).find(|j| self.face_neighbors[middle as usize][*j] == to) {
                let c = self.edge_crossing(from, k, p, q);
                if c.d2 <= limit2 {
                    let d = self.edge_crossing(middle, j, p, q);
                    if d.d2 <= limit2 {
                        trace.crossings.extend([(side, c), (side, d)]);
                        return true;
                    }
                }
            }
        }
        let search = &mut trace.search;
        search.clear();
        // Breadth-first search; `u8::MAX` marks the start.
        let (mut face, mut by, mut next) = (from, u8::MAX, 0);
        loop {
            for k in 0..3 {
                let over = self.face_neighbors[face as usize][k];
                if over == NO_FACE || over == from || search.iter().any(|w| w.0.to == over) {
                    continue;
                }
                let c = self.edge_crossing(face, k, p, q);
                if c.d2 > limit2 {
                    continue;
                }
                search.push((c, by));
                if over == to {
                    let first = trace.crossings.len();
                    let mut at = search.len() as u8 - 1;
                    while let Some((c, before)) = search.get(usize::from(at)) {
                        trace.crossings.push((side, *c));
                        at = *before;
                    }
                    trace.crossings[first..].reverse();
                    return true;
                }
            }
            if next >= search.len() || search.len() > MAX_TRACE_FACES {
                return false;
            }
            (face, by) = (search[next].0.to, next as u8);
            next += 1;
        }
    }

    /// Whether the polygon, whose sides have been traced, is covered by the parts described above:
    /// then the squared distance of the vertex that its boundary goes around, 0 if none.
    pub fn close_trace(
        &self,
        corners: &[DVec3],
        limit2: f64,
        trace: &mut BoundaryTrace,
    ) -> Option<f64> {
        let unmatched = &mut trace.unmatched;
        unmatched.clear();
        for (_, c) in &trace.crossings {
            if unmatched.last().is_some_and(|last| last.is_reverse_of(c)) {
                unmatched.pop();
            } else {
                unmatched.push(*c);
            }
        }
        let mut rest = unmatched.as_slice();
        while let [first, middle @ .., last] = rest
            && last.is_reverse_of(first)
        {
            rest = middle;
        }
        let Some(first) = rest.first() else { return Some(0.0) };
        let around = first.edge.into_iter().find(|v| rest.iter().all(|c| c.edge.contains(v)))?;
        let v = self.positions[around as usize].as_dvec3();
        let fan = corners.windows(2).skip(1);
        let d2 = fan.map(|w| nearest([corners[0], w[0], w[1]], v).d2).fold(f64::INFINITY, f64::min);
        (d2 <= limit2).then_some(d2)
    }
}

/// Nearest point of a triangle.
fn nearest(t: [DVec3; 3], p: DVec3) -> super::distance_bound::Near {
    super::distance_bound::TriangleCache::new(t).nearest(p)
}
