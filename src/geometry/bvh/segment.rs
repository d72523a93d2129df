//! Intersections of triangles with a segment.

use glam::{DVec3, Vec3, Vec3A, Vec4};

use super::{Bounds, DEPTH, TriangleBvh};

/// Share of a segment that is tested: triangles through its end do not count.
const SEGMENT_END: f64 = 1.0 - 1e-6;
/// Barycentric slack of a triangle's edges, so that no segment passes between two faces.
const EDGE_SLACK: f64 = 1e-9;
/// Share by which the far end of a box is extended: more than three roundings in single precision.
const SLAB_SLACK: f32 = 1e-6;

impl Bounds {
    /// Returns the entry of a segment into the box, as a share of the segment's length; infinite
    /// where they do not meet before its end. Single precision, with slack enough that no
    /// intersection is missed.
    #[inline]
    fn enter(&self, from: Vec3A, inverse: Vec3A) -> f32 {
        let a = (Vec3A::from(self.lo) - from) * inverse;
        let b = (Vec3A::from(self.hi) - from) * inverse;
        let near = a.min(b).max_element().max(0.0);
        let far = a.max(b).min_element() * (1.0 + SLAB_SLACK);
        if near <= far.min(1.0) { near } else { f32::INFINITY }
    }

    /// Returns the segments, one bit each, that enter the box before their end, and the least of
    /// their entries, as [`Self::enter`].
    ///
    /// * `inverse`: reciprocals of the segments' components, by axis.
    #[inline]
    fn enter_all(&self, from: Vec3, inverse: &[Vec4; 3]) -> (u32, f32) {
        let (mut near, mut far) = (Vec4::ZERO, Vec4::INFINITY);
        for axis in 0..3 {
            let a = (self.lo[axis] - from[axis]) * inverse[axis];
            let b = (self.hi[axis] - from[axis]) * inverse[axis];
            near = near.max(a.min(b));
            far = far.min(a.max(b));
        }
        let enters = near.cmple((far * (1.0 + SLAB_SLACK)).min(Vec4::ONE));
        (enters.bitmask(), Vec4::select(enters, near, Vec4::INFINITY).min_element())
    }
}

/// Most segments that are tested at once.
const LANES: usize = TriangleBvh::LANES;

impl TriangleBvh {
    /// Most segments of one call of [`Self::occluders`].
    pub const LANES: usize = 4;

    /// Returns a triangle's corners relative to a point.
    #[inline]
    pub fn corners_about(&self, place: usize, from: DVec3) -> [DVec3; 3] {
        self.triangles[place].map(|p| p.as_dvec3() - from)
    }

    /// Returns a triangle that meets the segment from an eye to `eye + along`, as
    /// [`Self::occluders`] of one segment.
    pub fn occluder(&self, eye: DVec3, along: DVec3, own: usize) -> Option<usize> {
        self.occluders(eye, &[(along, own)])[0]
    }

    /// Returns for each of up to four segments from one eye a triangle that meets it, by its place
    /// in the leaves: the first that is found, other than the segment's own.
    ///
    /// * `eye`: coordinates that single precision holds.
    /// * `segments`: vector from the eye to the end, and place of the triangle that does not count.
    ///
    /// Boxes are tested against all segments at once, which pays where they lie close together.
    pub fn occluders(&self, eye: DVec3, segments: &[(DVec3, usize)]) -> [Option<usize>; LANES] {
        assert!(segments.len() <= LANES, "{} segments", segments.len());
        let from = eye.as_vec3();
        let mut inverse = [Vec4::splat(1e30); 3];
        for (lane, (along, _)) in segments.iter().enumerate() {
            for axis in 0..3 {
                // A component of 0 would give NaN in planes through the eye.
                if along[axis].abs() >= 1e-30 {
                    inverse[axis][lane] = (1.0 / along[axis]) as f32;
                }
            }
        }
        let mut found = [None; LANES];
        let mut open = [(self.root(), (1u32 << segments.len()) - 1); DEPTH];
        let mut depth = 1;
        let mut sought = (1u32 << segments.len()) - 1;
        while depth > 0 && sought != 0 {
            depth -= 1;
            let (s, lanes) = open[depth];
            let lanes = lanes & sought;
            if lanes == 0 {
                continue;
            }
            if s.is_leaf() {
                for lane in (0..LANES).filter(|lane| lanes >> lane & 1 != 0) {
                    let (along, own) = segments[lane];
                    found[lane] = s.triangles().find(|t| *t != own && self.meets(*t, eye, along));
                    sought &= !(u32::from(found[lane].is_some()) << lane);
                }
                continue;
            }
            let halves = s.children();
            let entered = halves.each_ref().map(|s| self.nodes[s.node].enter_all(from, &inverse));
            // The child that one of the segments enters first is opened first.
            let first = usize::from(entered[1].1 < entered[0].1);
            for child in [1 - first, first] {
                let lanes = entered[child].0 & lanes;
                if lanes != 0 {
                    open[depth] = (halves[child], lanes);
                    depth += 1;
                }
            }
        }
        found
    }

    /// Returns the intersection nearest to an eye of the segment from it to `eye + along` with a
    /// triangle.
    ///
    /// * `eye`: coordinates that single precision holds.
    pub fn first_hit(&self, eye: DVec3, along: DVec3) -> Option<DVec3> {
        let from = eye.as_vec3a();
        let inverse = along.map(|d| if d.abs() < 1e-30 { 1e30 } else { 1.0 / d }).as_vec3a();
        let mut open = [self.root(); DEPTH];
        let mut depth = usize::from(along.is_finite() && eye.is_finite());
        let mut best = f64::INFINITY;
        while depth > 0 {
            depth -= 1;
            let s = open[depth];
            if s.is_leaf() {
                for t in s.triangles().filter(|t| self.meets(*t, eye, along)) {
                    let [a, b, c] = self.corners_about(t, eye);
                    let n = (b - a).cross(c - a);
                    best = best.min(n.dot(a) / n.dot(along));
                }
                continue;
            }
            let [left, right] = s.children();
            let [a, b] = [left, right].map(|s| self.nodes[s.node].enter(from, inverse));
            let order = if a <= b { [(right, b), (left, a)] } else { [(left, a), (right, b)] };
            // Boxes are entered in single precision: a little early does no harm.
            for (s, _) in order.iter().filter(|o| f64::from(o.1) * (1.0 - 1e-5) <= best.min(1.0)) {
                open[depth] = *s;
                depth += 1;
            }
        }
        best.is_finite().then(|| eye + along * best)
    }

    /// Whether a triangle meets the segment from an eye along `along` before its end (Möller and
    /// Trumbore 1997, Fast, minimum storage ray-triangle intersection,
    /// doi:10.1080/10867651.1997.10487468).
    #[inline]
    pub fn meets(&self, place: usize, eye: DVec3, along: DVec3) -> bool {
        let [a, b, c] = self.corners_about(place, eye);
        let (e, f) = (b - a, c - a);
        let p = along.cross(f);
        let det = e.dot(p);
        if det == 0.0 {
            return false;
        }
        let u = -a.dot(p) / det;
        let q = -a.cross(e);
        let v = along.dot(q) / det;
        let t = f.dot(q) / det;
        u >= -EDGE_SLACK
            && v >= -EDGE_SLACK
            && u + v <= 1.0 + EDGE_SLACK
            && t > 0.0
            && t < SEGMENT_END
    }
}
