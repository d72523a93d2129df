//! The polygon of one collapse: flattening, its two fans, finding a point in them.
//!
//! The neighbourhood of the removed vertex u is laid out in the plane with u at the origin. The
//! *pre* fan are the faces of u; the *post* fan are the remaining faces, about the vertex that
//! replaces u. Both cover the same polygon, so going from one to the other is a piecewise linear
//! bijection.

use std::f64::consts::PI;

use glam::DVec3;

/// Least signed area of a triangle of either fan; the farthest ring vertex is at distance 1.
const MIN_AREA: f64 = 1e-6;
/// Least distance of a ring vertex from the origin: one that coincides with u would flatten its
/// faces.
const MIN_RADIUS: f64 = 0.01;
/// Least angle of a wedge, and least difference from π, even where a face has no area.
const MIN_WEDGE_RAD: f64 = 1e-3;

/// Arrangement of the fans of a collapse in its ring.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum FanPlace {
    /// u is an inner vertex; ring vertex 0 replaces it.
    Inner = 0,
    /// u lies on a boundary; ring vertex 0 replaces it.
    First = 1,
    /// u lies on a boundary; the last ring vertex replaces it.
    Last = 2,
}

impl FanPlace {
    /// Number of faces of the pre fan for a ring of `k` vertices; face i holds ring vertices i, i +
    /// 1.
    pub fn pre(self, k: usize) -> usize {
        if self == Self::Inner { k } else { k - 1 }
    }

    /// Ring index of the vertex that replaces u.
    pub fn apex(self, k: usize) -> usize {
        if self == Self::Last { k - 1 } else { 0 }
    }

    /// Index in the pre fan of post face 0; post face j comes from pre face `post_start() + j`.
    pub fn post_start(self) -> usize {
        usize::from(self != Self::Last)
    }
}

/// A ring vertex as seen from u.
#[derive(Clone, Copy, Debug)]
pub(super) struct Spoke {
    /// Vector from u to the ring vertex.
    to: DVec3,
    /// Length of that vector.
    length: f64,
    /// Angle to the next spoke.
    wedge_rad: f64,
}

/// Lays the ring out in the plane by the conformal power map z^a, u at the origin, ring vertex 0
/// on the positive x axis, the farthest at distance 1. Gives one point a ring vertex to `push`.
/// `spokes` is scratch space.
///
/// Returns false, some points pushed or none, if a position is not finite or the ring too short.
///
/// After Lee et al. 1998 (MAPS), doi:10.1145/280814.280828, with these departures: wedges are
/// blended with equal ones as far as it takes to keep each within 0..π, and edges have a least
/// length, so that faces without area do not stand in the way of their own removal; the points
/// are rounded to f32 before they are judged, because the stored ones define the map.
pub(super) fn flatten(
    u: DVec3,
    ring: impl Iterator<Item = DVec3>,
    kind: FanPlace,
    spokes: &mut Vec<Spoke>,
    mut push: impl FnMut([f32; 2]),
) -> bool {
    spokes.clear();
    spokes.extend(ring.map(|r| Spoke { to: r - u, length: (r - u).length(), wedge_rad: 0.0 }));
    let k = spokes.len();
    if k < 3 || !spokes.iter().all(|s| s.length.is_finite()) {
        return false;
    }
    let longest = spokes.iter().fold(0.0f64, |m, s| m.max(s.length));
    let wedges = kind.pre(k);
    let mut around = 0.0;
    for i in 0..wedges {
        let (d, next) = (spokes[i].to, spokes[if i + 1 == k { 0 } else { i + 1 }].to);
        // atan2 of two zeros is 0: an edge without length has a wedge without angle.
        spokes[i].wedge_rad = d.cross(next).length().atan2(d.dot(next));
        around += spokes[i].wedge_rad;
    }
    let total = if kind == FanPlace::Inner { 2.0 * PI } else { PI };
    let (equal, flatly) = (total / wedges as f64, around < MIN_WEDGE_RAD);
    let power = if flatly { 1.0 } else { total / around };
    let least = MIN_WEDGE_RAD.min(0.5 * equal);
    let mut blend = 0.0f64;
    for s in &mut spokes[..wedges] {
        s.wedge_rad = if flatly { equal } else { power * s.wedge_rad };
        if s.wedge_rad < least {
            blend = blend.max((least - s.wedge_rad) / (equal - s.wedge_rad));
        } else if s.wedge_rad > PI - MIN_WEDGE_RAD {
            blend = blend.max((s.wedge_rad - PI + MIN_WEDGE_RAD) / (s.wedge_rad - equal));
        }
    }
    let mut angle = 0.0f64;
    for (i, s) in spokes.iter().enumerate() {
        let relative = if longest > 0.0 { s.length / longest } else { 1.0 };
        let radius = relative.powf(power).max(MIN_RADIUS);
        let (sin, cos) = match kind {
            _ if i == 0 => (0.0, 1.0),
            // Exactly opposite, so that u lies on the edge that closes the polygon.
            FanPlace::First | FanPlace::Last if i + 1 == k => (0.0, -1.0),
            _ => angle.sin_cos(),
        };
        push([(radius * cos) as f32, (radius * sin) as f32]);
        angle += s.wedge_rad + blend * (equal - s.wedge_rad);
    }
    true
}

/// Twice the signed area of a triangle.
fn cross(a: [f64; 2], b: [f64; 2], c: [f64; 2]) -> f64 {
    (b[0] - a[0]) * (c[1] - a[1]) - (c[0] - a[0]) * (b[1] - a[1])
}

/// A flattened ring with the arrangement of its fans.
#[derive(Clone, Copy)]
pub(super) struct FlatRing<'a, E> {
    /// Ring entries.
    pub ring: &'a [E],
    /// Arrangement of the fans.
    pub kind: FanPlace,
}

/// A ring entry with its point in the plane.
pub(super) trait Flat {
    /// Returns the point.
    fn flat(&self) -> [f64; 2];
}

impl<E: Flat> FlatRing<'_, E> {
    /// Corners of pre face `i`: the origin and two ring points.
    pub fn pre(&self, i: usize) -> [[f64; 2]; 3] {
        let next = if i + 1 == self.ring.len() { 0 } else { i + 1 };
        [[0.0; 2], self.ring[i].flat(), self.ring[next].flat()]
    }

    /// Corners of post face `j`: the ring point that replaces the origin, and two more.
    pub fn post(&self, j: usize) -> [[f64; 2]; 3] {
        let [_, a, b] = self.pre(self.kind.post_start() + j);
        [self.ring[self.kind.apex(self.ring.len())].flat(), a, b]
    }

    /// Whether both fans cover the polygon without a fold.
    pub fn unfolded(&self) -> bool {
        let k = self.ring.len();
        let wide = |[a, b, c]: [[f64; 2]; 3]| 0.5 * cross(a, b, c) > MIN_AREA;
        (0..self.kind.pre(k)).all(|i| wide(self.pre(i))) && (0..k - 2).all(|j| wide(self.post(j)))
    }

    /// Pre face that holds `p`, and the weights of its corners.
    pub fn find_pre(&self, p: [f64; 2]) -> (usize, [f64; 3]) {
        nearest((0..self.kind.pre(self.ring.len())).map(|i| self.pre(i)), p)
    }

    /// Post face that holds `p`, and the weights of its corners.
    pub fn find_post(&self, p: [f64; 2]) -> (usize, [f64; 3]) {
        nearest((0..self.ring.len() - 2).map(|j| self.post(j)), p)
    }
}

/// Returns the first triangle that contains `p`, or the one it is least outside of; weights are
/// clamped.
fn nearest(fan: impl Iterator<Item = [[f64; 2]; 3]>, p: [f64; 2]) -> (usize, [f64; 3]) {
    let mut best = (0, [1.0, 0.0, 0.0]);
    let mut inside = f64::NEG_INFINITY;
    for (i, [a, b, c]) in fan.enumerate() {
        let area = cross(a, b, c);
        let w = [cross(p, b, c) / area, cross(p, c, a) / area, cross(p, a, b) / area];
        let least = w[0].min(w[1]).min(w[2]);
        if least > inside {
            (best, inside) = ((i, w), least);
        }
        if least >= 0.0 {
            break;
        }
    }
    (best.0, clean(best.1))
}

/// Weights without negative or undefined parts that sum to 1.
pub(super) fn clean(w: [f64; 3]) -> [f64; 3] {
    // max returns the other argument for a NaN.
    let w = w.map(|w| if w > 0.0 { w.min(f64::MAX / 8.0) } else { 0.0 });
    let sum = w[0] + w[1] + w[2];
    if sum > 0.0 { w.map(|w| w / sum) } else { [1.0 / 3.0; 3] }
}
