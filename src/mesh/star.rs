//! A vertex with the faces around it, and whether it may collapse onto a neighbour.

use glam::{DVec3, Vec3};

use super::HalfEdges;
use super::halfedge::{NONE, next, prev};

/// cos² of the most that a face may turn, 75°.
const COS2_TURN: f32 = 0.066_987_3;
/// sin² of the smallest angle of a face, 1°.
const SIN2_THIN: f32 = 3.045_865e-4;
/// Neighbours of a vertex, at most.
const MOST_NEIGHBOURS: usize = 24;
/// Faces looked at side by side.
const LANES: usize = 8;

/// One number of each of eight faces.
type Lanes = [f32; LANES];

/// Eight vectors, component by component.
type Vectors = [Lanes; 3];

/// Eight faces of a star. Lengths are in units of the longest spoke, places from the centre.
#[derive(Clone, Copy)]
struct Eight {
    /// The two corners beside the centre.
    a: Vectors,
    b: Vectors,
    /// Sum of their normals.
    normals: Vectors,
    /// Twice the area times the normal, and its squared length.
    cross: Vectors,
    cross2: Lanes,
    /// Squared length of the edge across.
    across2: Lanes,
    /// Squared sine of the smallest angle, nearly.
    thin: Lanes,
}

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
    /// Whether the centre lies on a boundary.
    pub open: bool,
    /// Where they are from the centre, in units of the longest spoke, and their normals (0 where
    /// normals do not count).
    spokes: Vec<(Vec3, Vec3)>,
    faces: Vec<Eight>,
    /// Whether normals count.
    shaded: bool,
    /// The longest spoke to the fourth: what squared areas are in.
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

    /// Measures the faces, so that [`Self::deviation`] can be asked for.
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
            let mut eight = Eight::default();
            for lane in 0..LANES.min(faces - first) {
                let i = first + lane;
                let ((a, na), (b, nb)) =
                    (self.spokes[i], self.spokes[if i + 1 == n { 0 } else { i + 1 }]);
                for c in 0..3 {
                    eight.a[c][lane] = a[c];
                    eight.b[c][lane] = b[c];
                    eight.normals[c][lane] = na[c] + nb[c];
                }
            }
            eight.measure();
            self.faces.push(eight);
        }
    }

    /// What the faces that stay deviate from the normals of their corners when the centre goes to
    /// `ring[k]`: Σ 2 A² (1 − n·N), N the mean of the three, which is area times squared sine of
    /// the angle times squared size, as a squared distance by area is; 0 without normals. `None`
    /// if a face turns or thins too much.
    ///
    /// In single precision: about 10⁻⁷ of A² is lost, what an angle of 0.02° amounts to.
    #[inline]
    pub fn deviation(&self, k: usize) -> Option<f64> {
        let (to, normal) = self.spokes[k];
        let before = if k == 0 { self.ring.len() - 1 } else { k - 1 };
        let faces = self.leaving.len();
        let mut sum = [0.0; LANES];
        for (chunk, eight) in self.faces.iter().enumerate() {
            let mut stays = [0.0; LANES];
            for (lane, stays) in stays.iter_mut().enumerate() {
                let i = LANES * chunk + lane;
                *stays = f32::from(u8::from(i != k && i != before && i < faces));
            }
            if !eight.moved(to, normal, &stays, &mut sum) {
                return None;
            }
        }
        let sum = ((sum[0] + sum[4]) + (sum[2] + sum[6])) + ((sum[1] + sum[5]) + (sum[3] + sum[7]));
        Some(if self.shaded { f64::from(sum) * self.unit4 } else { 0.0 })
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

impl Default for Eight {
    fn default() -> Self {
        let (none, nowhere) = ([0.0; LANES], [[0.0; LANES]; 3]);
        Self {
            a: nowhere,
            b: nowhere,
            normals: nowhere,
            cross: nowhere,
            cross2: none,
            across2: none,
            thin: none,
        }
    }
}

impl Eight {
    /// Fills in what follows from the corners.
    #[inline]
    fn measure(&mut self) {
        let mut across = [[0.0; LANES]; 3];
        for c in 0..3 {
            for l in 0..LANES {
                across[c][l] = self.b[c][l] - self.a[c][l];
            }
        }
        self.cross = cross(&self.a, &self.b);
        self.cross2 = dot(&self.cross, &self.cross);
        self.across2 = dot(&across, &across);
        let two = largest_two(&dot(&self.a, &self.a), &dot(&self.b, &self.b), &self.across2);
        for l in 0..LANES {
            self.thin[l] = if two[l] > 0.0 { self.cross2[l] / two[l] } else { 0.0 };
        }
    }

    /// Adds what the faces that stay (1, others 0) deviate with the centre at `to`, whose normal
    /// is `normal`; says whether none turns or thins too much.
    #[inline]
    fn moved(&self, to: Vec3, normal: Vec3, stays: &Lanes, sum: &mut Lanes) -> bool {
        let (mut a, mut b, mut mean) = (self.a, self.b, self.normals);
        for c in 0..3 {
            for l in 0..LANES {
                a[c][l] -= to[c];
                b[c][l] -= to[c];
                mean[c][l] += normal[c];
            }
        }
        let new = cross(&a, &b);
        let (new2, along, facing) = (dot(&new, &new), dot(&self.cross, &new), dot(&new, &mean));
        let two = largest_two(&dot(&a, &a), &dot(&b, &b), &self.across2);
        let mut bad = 0;
        for l in 0..LANES {
            let old2 = self.cross2[l];
            // A face without area has no direction to keep.
            let turns = (old2 > 0.0)
                & ((along[l] <= 0.0) | (along[l] * along[l] < COS2_TURN * old2 * new2[l]));
            let thins = (new2[l] < SIN2_THIN * two[l]) & (new2[l] <= self.thin[l] * two[l]);
            bad |= u32::from((stays[l] > 0.0) & (turns | thins));
            let twice = new2[l].sqrt();
            sum[l] += stays[l] * (0.5 * twice * (twice - facing[l] * (1.0 / 3.0))).max(0.0);
        }
        bad == 0
    }
}

#[inline]
fn cross(a: &Vectors, b: &Vectors) -> Vectors {
    let mut out = [[0.0; LANES]; 3];
    for c in 0..3 {
        let (d, e) = ((c + 1) % 3, (c + 2) % 3);
        for l in 0..LANES {
            out[c][l] = a[d][l] * b[e][l] - a[e][l] * b[d][l];
        }
    }
    out
}

#[inline]
fn dot(a: &Vectors, b: &Vectors) -> Lanes {
    let mut out = [0.0; LANES];
    for l in 0..LANES {
        out[l] = a[0][l] * b[0][l] + a[1][l] * b[1][l] + a[2][l] * b[2][l];
    }
    out
}

/// Product of the two largest of three squared sides.
#[inline]
fn largest_two(x: &Lanes, y: &Lanes, z: &Lanes) -> Lanes {
    let mut out = [0.0; LANES];
    for l in 0..LANES {
        out[l] = (x[l] * y[l]).max(y[l] * z[l]).max(z[l] * x[l]);
    }
    out
}
