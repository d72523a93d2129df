//! The star of a vertex (its faces and neighbours), and whether it may collapse onto a neighbour.

use glam::{DVec3, Vec3};

use super::HalfEdges;
use super::halfedge::{NONE, next, prev};
use super::triangle_x8::{LANES, TriangleX8};

/// Largest valence a collapse may make.
const MAX_NEIGHBOURS: usize = 24;

/// The faces around one vertex.
#[derive(Default)]
pub struct Star {
    /// The vertex.
    pub centre: u32,
    /// Half-edges that leave it, in order.
    pub leaving: Vec<u32>,
    /// Neighbours in order: face i holds the centre, `ring[i]` and the next.
    pub ring: Vec<u32>,
    /// Positions of the ring.
    pub at: Vec<DVec3>,
    /// Whether the centre lies on a boundary.
    pub open: bool,
    /// Positions of the ring relative to the centre, in units of the longest spoke, and normals (0
    /// where normals do not count).
    spokes: Vec<(Vec3, Vec3)>,
    faces: Vec<TriangleX8>,
    /// Whether normals count.
    shaded: bool,
    /// The longest spoke to the fourth power: the unit of squared areas.
    unit4: f64,
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

    /// Measures the faces, as [`Self::deviation`] needs.
    #[inline]
    pub fn measure(&mut self, from: DVec3, normals: &[Vec3]) {
        self.shaded = !normals.is_empty();
        let longest2 = self.at.iter().fold(0.0, |most, p| p.distance_squared(from).max(most));
        let per = if longest2 > 0.0 { longest2.sqrt().recip() } else { 1.0 };
        self.unit4 = if longest2 > 0.0 { longest2 * longest2 } else { 1.0 };
        self.spokes.clear();
        for (w, p) in self.ring.iter().zip(&self.at) {
            let normal = if self.shaded { normals[*w as usize] } else { Vec3::ZERO };
            self.spokes.push((((*p - from) * per).as_vec3(), normal));
        }
        let (n, faces) = (self.ring.len(), self.leaving.len());
        self.faces.clear();
        for first in (0..faces).step_by(LANES) {
            let mut eight = TriangleX8::default();
            for lane in 0..LANES.min(faces - first) {
                let i = first + lane;
                let ((a, na), (b, nb)) =
                    (self.spokes[i], self.spokes[if i + 1 == n { 0 } else { i + 1 }]);
                eight.set(lane, a, b, na + nb);
            }
            eight.measure();
            self.faces.push(eight);
        }
    }

    /// Deviation of the kept faces from the normals of their corners when the centre collapses onto
    /// `ring[k]`: Σ 2 A r (A' + 180 A r), where r = 1 − n·N, N is the mean normal of the three corners,
    /// and A' lies between A and the area of the equilateral face with the same sum of squared sides;
    /// 0 without normals. As r is half the squared angle, the unit is that of a quadric weighted by
    /// area (area times squared distance); for large angles the fourth power of the angle counts.
    /// `None` if a face turns or thins too much.
    ///
    /// In f32: the rounding of about 10⁻⁷ A² corresponds to an angle of 0.02°.
    #[inline]
    pub fn deviation(&self, k: usize) -> Option<f64> {
        let (to, normal) = self.spokes[k];
        let before = if k == 0 { self.ring.len() - 1 } else { k - 1 };
        let faces = self.leaving.len();
        let mut sum = [0.0; LANES];
        for (chunk, eight) in self.faces.iter().enumerate() {
            let stays = std::array::from_fn(|lane| {
                let i = LANES * chunk + lane;
                f32::from(u8::from(i != k && i != before && i < faces))
            });
            if !eight.moved(to, normal, &stays, &mut sum) {
                return None;
            }
        }
        let sum = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
        Some(if self.shaded { f64::from(sum) * self.unit4 } else { 0.0 })
    }

    /// Whether the mesh keeps its topology when the centre collapses onto `ring[k]`: centre and
    /// target have no neighbours in common but those of the faces that are removed (the link
    /// condition, Dey et al. 1999), no two faces coincide, and no valence exceeds 24. `in_ring`
    /// says whether a vertex is in the ring.
    #[inline]
    pub fn keeps_topology(
        &self,
        edges: &HalfEdges,
        k: usize,
        in_ring: impl Fn(u32) -> bool,
    ) -> bool {
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
        if common != goes || n + neighbours > MAX_NEIGHBOURS + 2 + goes {
            return false;
        }
        // A ring of three leaves one face (at a boundary, none): it must not coincide with another
        // face, nor may the last face of a component be removed.
        if !self.open && n == 3 {
            let across = edges.pair(next(self.leaving[(k + 1) % 3]));
            return across == NONE || edges.origin(prev(across)) != to;
        }
        !self.open || n > 2 || edges.pair(next(self.leaving[0])) != NONE
    }
}
