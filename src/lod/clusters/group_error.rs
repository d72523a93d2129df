//! Two-sided error of a simplified group: distances between its coarse faces and their source
//! patch, and the deviation of normals.

use glam::DVec3;

use super::cluster_builder::{ClusterBuilder, Correspondence};
use super::convex_polygon::ConvexPolygon;
use super::distance_bound::{TargetSurface, round_up};
use super::partition::NO_FACE;
use super::projection::{BoundaryTrace, ProjectedPoint};
use super::propagate::{DeferredPatch, Propagated, coarse_overlaps, propagate};
use super::surface_map::SurfaceMap;
use super::surfaces::OriginalSurface;

/// Normals are compared at one of this many original faces: the angle is a mean and no bound.
const SHADING_SAMPLE: u32 = 8;

/// Direct-mapped cache of projected vertices.
struct ProjectionCache(Vec<(u32, ProjectedPoint)>);

impl ProjectionCache {
    fn new(faces: usize) -> Self {
        let none = (NO_FACE, ProjectedPoint { face: NO_FACE, d2: f64::INFINITY });
        Self(vec![none; faces.next_power_of_two().clamp(64, 4096)])
    }

    fn of(&mut self, v: u32, work: impl FnOnce() -> ProjectedPoint) -> ProjectedPoint {
        let mask = self.0.len() as u32 - 1;
        let slot = &mut self.0[(v.wrapping_mul(0x9E37_79B1) >> 16 & mask) as usize];
        if slot.0 != v {
            *slot = (v, work());
        }
        slot.1
    }
}

/// Bound and mean angle of a group so far. Correspondences go to the clusters at once.
pub struct ErrorAccumulator<'d> {
    /// Largest distance, mm.
    pub bound: f64,
    /// Sum of squared angles times areas, rad² mm².
    angle2_area: f64,
    area: f64,
    outputs: &'d mut [ClusterBuilder],
    projections: ProjectionCache,
    projected: Vec<ProjectedPoint>,
    trace: BoundaryTrace,
    pieces: Vec<(u32, ConvexPolygon, f64)>,
}

impl<'d> ErrorAccumulator<'d> {
    /// An empty accumulator.
    ///
    /// * `outputs`: the clusters that take the correspondences.
    /// * `faces`: number of original faces, about.
    pub fn new(bound: f64, outputs: &'d mut [ClusterBuilder], faces: usize) -> Self {
        let (projected, trace, pieces) = (Vec::new(), BoundaryTrace::default(), Vec::new());
        let each = faces / outputs.len().max(1);
        outputs.iter_mut().for_each(|d| d.whole_faces.reserve(each));
        let projections = ProjectionCache::new(faces);
        Self { bound, angle2_area: 0.0, area: 0.0, outputs, projections, projected, trace, pieces }
    }

    /// The cluster that a propagated piece belongs to.
    fn builder_for(&mut self, to: &Propagated) -> &mut ClusterBuilder {
        let own = &mut self.outputs[usize::from(to.cluster)];
        own.error = own.error.max(to.distance_mm());
        own
    }

    /// Root mean square angle between normals, radians.
    pub fn angle(&self) -> f64 {
        if self.area > 0.0 { (self.angle2_area / self.area).sqrt() } else { 0.0 }
    }
}

/// Measures the coarse faces of a group against the original.
pub struct GroupErrorMeasure<'a> {
    /// The coarse faces.
    pub target: TargetSurface<'a>,
    /// The original, of which they replace a part.
    pub original: &'a OriginalSurface<'a>,
    /// Output cluster of each coarse face, and its index in that cluster.
    pub owner: &'a [(u16, u8)],
}

impl GroupErrorMeasure<'_> {
    /// Lower bound of the distance from the original to the coarse faces, at least `least`: the
    /// largest of about `count` sampled vertices. `start`: as for [`Self::measure_forward`], for
    /// each of `inputs`.
    pub fn lower_bound(
        &self,
        inputs: &[&ClusterBuilder],
        start: &[Vec<u32>],
        count: usize,
        least: f64,
    ) -> f64 {
        let mut bound = least;
        let all: usize = inputs.iter().map(|d| d.whole_faces.len()).sum();
        let every = (4 * all / count.max(1)).max(1);
        for (d, start) in inputs.iter().zip(start) {
            for corr in d.whole_faces.iter().step_by(every) {
                let p = self.original.corners(corr.face)[0];
                let near = self.target.walk_to_face(start[corr.triangle()], p);
                let near = self.target.nearest(near, p).d2.sqrt();
                if near > bound {
                    // The walk may have ended in a local minimum.
                    let true_one = self.target.bvh.closest_within(p, near);
                    bound = bound.max(true_one.map_or(near, |c| c.distance_mm));
                }
            }
        }
        bound
    }

    /// Forward direction: the source patch of `inputs` against the coarse faces. `start`: for each
    /// triangle of each input, a coarse face to start from.
    ///
    /// Correspondences that can be propagated without measuring but may exceed the bound so far are
    /// deferred; then the farthest are measured, which raises the bound until the rest is within
    /// it.
    pub fn measure_forward(
        &self,
        inputs: &[&ClusterBuilder],
        start: &[Vec<u32>],
        map: &SurfaceMap,
        found: &mut ErrorAccumulator<'_>,
    ) {
        let overlaps = coarse_overlaps(self.owner, map);
        let (mut overlaps, mut deferred) = (overlaps.as_slice(), Vec::new());
        for ((draft, d), start) in (0..).zip(inputs).zip(start) {
            let (own, rest) = overlaps.split_at(d.triangles.len());
            overlaps = rest;
            let mut last = None;
            for (piece, corr) in (0..).zip(&d.whole_faces) {
                match propagate(corr, own) {
                    Some(to) if to.distance_mm() <= found.bound => self.propagate_whole(&to, found),
                    Some(to) => deferred.push(DeferredPatch { to, draft, piece }),
                    None => {
                        let start = last.unwrap_or(start[corr.triangle()]);
                        last = self.measure_whole(corr.face, start, found);
                        continue;
                    }
                }
                last = None;
            }
            for (piece, p) in (d.whole_faces.len() as u32..).zip(&d.parts.list) {
                let corners = d.parts.corners(p);
                match propagate(&p.corr, own) {
                    Some(to) if to.distance_mm() <= found.bound => {
                        self.propagate_part(corners, &to, found)
                    }
                    Some(to) => deferred.push(DeferredPatch { to, draft, piece }),
                    None => {
                        self.measure_part(p.corr.face, corners, start[p.corr.triangle()], found)
                    }
                }
            }
        }
        deferred.sort_unstable_by(DeferredPatch::farthest_first);
        for DeferredPatch { to, draft, piece } in &deferred {
            let d = inputs[*draft as usize];
            let within = to.distance_mm() <= found.bound;
            match (piece.checked_sub(d.whole_faces.len() as u32), within) {
                (None, true) => self.propagate_whole(to, found),
                (None, false) => {
                    self.measure_whole(to.corr.face, to.near, found);
                }
                (Some(part), within) => {
                    let corners = d.parts.corners(&d.parts.list[part as usize]);
                    if within {
                        self.propagate_part(corners, to, found);
                    } else {
                        self.measure_part(to.corr.face, corners, to.near, found);
                    }
                }
            }
        }
    }

    fn propagate_whole(&self, to: &Propagated, found: &mut ErrorAccumulator<'_>) {
        found.builder_for(to).whole_faces.push(to.corr);
        let corners = || ConvexPolygon::new(&self.original.corners(to.corr.face));
        self.accumulate_angle_at_centre(to.corr.face, to.near, corners, found);
    }

    fn propagate_part(&self, corners: &[DVec3], to: &Propagated, found: &mut ErrorAccumulator<'_>) {
        found.builder_for(to).parts.push(to.corr, corners);
        self.accumulate_angle_at_centre(
            to.corr.face,
            to.near,
            || ConvexPolygon::new(corners),
            found,
        );
    }

    /// Measures a whole original face; returns the face to start the next one from.
    fn measure_whole(
        &self,
        face: u32,
        start: u32,
        found: &mut ErrorAccumulator<'_>,
    ) -> Option<u32> {
        let corners = self.original.corners(face);
        let mut from = start;
        let projected = [0, 1, 2].map(|k| {
            let v = self.original.target.faces[face as usize][k];
            let projected = found.projections.of(v, || self.target.project(from, corners[k]));
            from = projected.face;
            projected
        });
        if self.try_project(face, &corners, &projected, true, found) {
            return Some(from);
        }
        self.bound_and_record(face, &ConvexPolygon::new(&corners), start, true, found);
        None
    }

    /// Measures a part of an original face.
    fn measure_part(
        &self,
        face: u32,
        corners: &[DVec3],
        start: u32,
        found: &mut ErrorAccumulator<'_>,
    ) {
        let mut projected = std::mem::take(&mut found.projected);
        let mut from = start;
        projected.clear();
        projected.extend(corners.iter().map(|c| {
            let projected = self.target.project(from, *c);
            from = projected.face;
            projected
        }));
        if !self.try_project(face, corners, &projected, false, found) {
            self.bound_and_record(face, &ConvexPolygon::new(corners), start, false, found);
        }
        found.projected = projected;
    }

    /// Projects a piece of an original face onto the coarse faces without clipping, if that stays
    /// within the bound; returns whether it does. `projected`: its corners.
    fn try_project(
        &self,
        face: u32,
        corners: &[DVec3],
        projected: &[ProjectedPoint],
        whole: bool,
        found: &mut ErrorAccumulator<'_>,
    ) -> bool {
        let mut trace = std::mem::take(&mut found.trace);
        let laid = self.try_project_with(face, corners, projected, whole, &mut trace, found);
        found.trace = trace;
        laid
    }

    fn try_project_with(
        &self,
        face: u32,
        corners: &[DVec3],
        projected: &[ProjectedPoint],
        whole: bool,
        trace: &mut BoundaryTrace,
        found: &mut ErrorAccumulator<'_>,
    ) -> bool {
        let limit2 = found.bound * found.bound;
        if !projected.iter().all(|l| l.d2 <= limit2) {
            return false;
        }
        // Most pieces are near one face as a whole.
        let within = |l: &ProjectedPoint| {
            corners.iter().zip(projected).try_fold(0f64, |far2, (c, o)| {
                let d2 = match o.face == l.face {
                    true => o.d2,
                    false => self.target.nearest(l.face, *c).d2,
                };
                (d2 <= limit2).then_some(far2.max(d2))
            })
        };
        let mut tried = NO_FACE;
        for l in projected {
            if l.face != tried
                && let Some(far2) = within(l)
            {
                self.record((face, l.face), corners, whole, far2, [l.face], found);
                self.accumulate_angle(face, l.face, corners, found);
                return true;
            }
            tried = l.face;
        }
        trace.crossings.clear();
        for (k, l) in projected.iter().enumerate() {
            let j = (k + 1) % projected.len();
            let (from, to) = ((corners[k], l.face), (corners[j], projected[j].face));
            if !self.target.trace_side(k as u8, from, to, limit2, trace) {
                return false;
            }
        }
        let Some(middle) = self.target.close_trace(corners, limit2, trace) else { return false };
        let all = projected.iter().map(|l| l.d2).chain(trace.crossings.iter().map(|c| c.1.d2));
        let far2 = all.fold(middle, f64::max);
        let first = projected[0].face;
        let cluster = |t: u32| self.owner[t as usize].0;
        let split = !trace.crossings.iter().all(|c| cluster(c.1.to) == cluster(first));
        if split && !trace.split_by_cluster(corners, first, cluster) {
            return false;
        }
        let over = || trace.crossings.iter().map(|c| c.1.to).chain([first]);
        if split {
            for p in &trace.parts {
                self.record((face, p.0), &p.1, false, far2, over(), found);
            }
        } else {
            self.record((face, first), corners, whole, far2, over(), found);
        }
        self.accumulate_angle_at_centre(face, first, || ConvexPolygon::new(corners), found);
        true
    }

    /// Records the correspondence of a piece to a coarse face. `over`: that face and all others
    /// that may be near a part of the piece; those of the same cluster count.
    fn record(
        &self,
        (face, t): (u32, u32),
        corners: &[DVec3],
        whole: bool,
        far2: f64,
        over: impl IntoIterator<Item = u32>,
        found: &mut ErrorAccumulator<'_>,
    ) {
        let (cluster, _) = self.owner[t as usize];
        let over = over.into_iter().map(|t| self.owner[t as usize]).filter(|o| o.0 == cluster);
        let over = over.fold(0, |over, o| over | 1 << o.1);
        let corr = Correspondence { face, distance_mm: round_up(far2.sqrt()), triangle_mask: over };
        let own = &mut found.outputs[usize::from(cluster)];
        own.error = own.error.max(f64::from(corr.distance_mm));
        if whole {
            own.whole_faces.push(corr);
        } else {
            own.parts.push(corr, corners);
        }
    }

    fn bound_and_record(
        &self,
        face: u32,
        piece: &ConvexPolygon,
        start: u32,
        whole: bool,
        found: &mut ErrorAccumulator<'_>,
    ) {
        let mut pieces = std::mem::take(&mut found.pieces);
        pieces.clear();
        let mut bound = found.bound;
        self.target.bound_distance(piece, start, &mut bound, |t, p, far| pieces.push((t, *p, far)));
        found.bound = bound;
        for (t, p, _) in &pieces {
            self.accumulate_angle(face, *t, p.corners(), found);
        }
        let cluster = |c: &(u32, ConvexPolygon, f64)| self.owner[c.0 as usize].0;
        if let Some(first) = pieces.first()
            && pieces.iter().all(|c| cluster(c) == cluster(first))
        {
            // Clipped, but all parts belong to one cluster.
            let far = pieces.iter().fold(0f64, |far, c| far.max(c.2));
            let over = pieces.iter().map(|c| c.0);
            self.record((face, first.0), piece.corners(), whole, far * far, over, found);
        } else {
            for (t, p, far) in &pieces {
                self.record((face, *t), p.corners(), false, far * far, [*t], found);
            }
        }
        found.pieces = pieces;
    }

    /// Accumulates the angle between normals at the centre of a piece on the coarse face `t`.
    fn accumulate_angle(
        &self,
        face: u32,
        t: u32,
        corners: &[DVec3],
        found: &mut ErrorAccumulator<'_>,
    ) {
        if face.is_multiple_of(SHADING_SAMPLE) {
            let piece = ConvexPolygon::new(corners);
            let area = piece.area();
            found.angle2_area += area * self.angle(face, t, piece.centre()).powi(2);
            found.area += area;
        }
    }

    /// Accumulates the angle between normals at the centre of a piece, on the coarse face nearest
    /// to the centre; the search starts at the face `from`.
    fn accumulate_angle_at_centre(
        &self,
        face: u32,
        from: u32,
        piece: impl Fn() -> ConvexPolygon,
        found: &mut ErrorAccumulator<'_>,
    ) {
        if face.is_multiple_of(SHADING_SAMPLE) {
            let piece = piece();
            let t = self.target.walk_to_face(from, piece.centre());
            self.accumulate_angle(face, t, piece.corners(), found);
        }
    }

    /// Angle between the interpolated normals of an original face and of the coarse face `t`, at a
    /// point of the first.
    fn angle(&self, face: u32, t: u32, p: DVec3) -> f64 {
        let mix = |of: &TargetSurface<'_>, face: u32| {
            let w = of.nearest(face, p).weights;
            let f = of.faces[face as usize];
            (0..3).map(|k| of.normals[f[k] as usize].as_dvec3() * w[k]).sum::<DVec3>()
        };
        let (n, m) = (mix(&self.original.target, face), mix(&self.target, t));
        n.cross(m).length().atan2(n.dot(m))
    }
}
