//! The coarse faces of a group against the original they stand for: distance both ways, shading.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::build::up;
use super::cover::{Piece, Target};
use crate::geometry::Vertex;

/// Pieces of the original measured by one task.
const TASK: usize = 4096;
/// Of so many original faces one is looked at for shading: it is a mean, and no bound.
const SHADING_SAMPLE: u32 = 8;

/// Part of an original face that a cluster stands for.
pub struct Part {
    /// The original's face id.
    pub face: u32,
    /// Triangle of the cluster that it was near to.
    pub triangle: u8,
    /// Its corners, mm.
    pub corners: Box<[DVec3]>,
}

/// A cluster under work: with what it stands for.
pub struct Draft {
    /// The original's vertices, ascending.
    pub vertices: Vec<u32>,
    /// Places in `vertices`.
    pub triangles: Vec<[u8; 3]>,
    /// Original faces that lie near one of its triangles as a whole, and which.
    pub whole: Vec<(u32, u8)>,
    /// Those that were cut.
    pub parts: Vec<Part>,
    /// For each triangle, how far any point of it is from the original at most, mm.
    pub back: Vec<f32>,
}

impl Draft {
    /// Its triangles by the original's vertices.
    pub fn faces(&self) -> impl Iterator<Item = [u32; 3]> + '_ {
        self.triangles.iter().map(|t| t.map(|v| self.vertices[usize::from(v)]))
    }
}

/// The original, to measure to.
pub struct Original<'a> {
    /// Its faces.
    pub target: Target<'a>,
}

impl Draft {
    /// Puts faces together again of which all parts are here.
    pub fn unite(&mut self, original: &Original<'_>) {
        self.parts.sort_by_key(|p| p.face);
        let parts = std::mem::take(&mut self.parts);
        let mut parts = parts.into_iter().peekable();
        while let Some(first) = parts.next() {
            let mut own = vec![first];
            while let Some(p) = parts.next_if(|p| p.face == own[0].face) {
                own.push(p);
            }
            let area: f64 = own.iter().map(|p| Piece::new(&p.corners).area()).sum();
            if area > (1.0 - 1e-6) * Piece::new(&original.corners(own[0].face)).area() {
                self.whole.push((own[0].face, own[0].triangle));
            } else {
                self.parts.extend(own);
            }
        }
    }
}

impl Original<'_> {
    /// A vertex at `p` with what the original has nearest to there: its normal and relief, between
    /// `vertices`; and the face of that. `from`: a face near it.
    pub fn vertex(&self, p: Vec3, from: u32, vertices: &[Vertex]) -> (Vertex, u32) {
        let face = self.target.walk(from, p.as_dvec3());
        let w = self.target.nearest(face, p.as_dvec3()).weights.map(|w| w as f32);
        let [a, b, c] = self.target.faces[face as usize].map(|v| vertices[v as usize]);
        let normal = a.normal() * w[0] + b.normal() * w[1] + c.normal() * w[2];
        let relief = a.w() * w[0] + b.w() * w[1] + c.w() * w[2];
        (Vertex::new(p, normal.try_normalize().unwrap_or(a.normal()), relief), face)
    }

    fn corners(&self, face: u32) -> [DVec3; 3] {
        self.target.faces[face as usize].map(|v| self.target.positions[v as usize].as_dvec3())
    }
}

/// What one task measured.
pub struct Found {
    /// Largest distance, mm.
    pub bound: f64,
    /// Squared angles between normals times areas, and areas.
    pub turn: f64,
    pub area: f64,
    /// By output cluster.
    pub whole: Vec<(u16, (u32, u8))>,
    /// The same of those that were cut.
    pub parts: Vec<(u16, Part)>,
}

impl Found {
    fn new(bound: f64) -> Self {
        Self { bound, turn: 0.0, area: 0.0, whole: Vec::new(), parts: Vec::new() }
    }
}

/// The coarse faces of a group against the original.
pub struct Measure<'a> {
    /// The coarse faces.
    pub target: Target<'a>,
    /// What they stand for a part of.
    pub original: &'a Original<'a>,
    /// Output cluster of each coarse face, and its place there.
    pub owner: &'a [(u16, u8)],
}

/// The fine faces of a group, as the way from the coarse ones back to the original.
pub struct Fine<'a> {
    /// The faces; the tree is not asked.
    pub target: Target<'a>,
    /// For each, how far any point of it is from the original at most, mm.
    pub known: Vec<f32>,
    /// One of the faces at each vertex.
    pub face_at: Vec<u32>,
    /// An original face near each vertex.
    pub original_at: Vec<u32>,
}

impl Measure<'_> {
    /// A distance that the original certainly has from the coarse faces somewhere, or `least` if
    /// that is more: that of some of its vertices, about `count`. `start`: as for
    /// [`Self::towards`], for each of `inputs`.
    pub fn least(&self, inputs: &[&Draft], start: &[Vec<u32>], count: usize, least: f64) -> f64 {
        let mut bound = least;
        let all: usize = inputs.iter().map(|d| d.whole.len()).sum();
        let every = (4 * all / count.max(1)).max(1);
        for (d, start) in inputs.iter().zip(start) {
            for &(face, triangle) in d.whole.iter().step_by(every) {
                let p = self.original.corners(face)[0];
                let near = self.target.walk(start[usize::from(triangle)], p);
                let near = self.target.nearest(near, p).d2.sqrt();
                if near > bound {
                    // The walk may have ended in a corner of the group.
                    let true_one = self.target.tree.closest_within(p, near);
                    bound = bound.max(true_one.map_or(near, |c| c.distance_mm));
                }
            }
        }
        bound
    }

    /// What `d` stands for, against the coarse faces. `start`: for each of its triangles, where to
    /// begin. Tasks are cut the same whatever the number of threads.
    pub fn towards(&self, d: &Draft, start: &[u32], bound: f64) -> Vec<Found> {
        let whole = d.whole.par_chunks(TASK).map(|own| {
            let mut found = Found::new(bound);
            let mut last = None;
            for &(face, triangle) in own {
                let corners = self.original.corners(face);
                let start = last.unwrap_or(start[usize::from(triangle)]);
                if let Some(t) = self.target.near(corners, start, found.bound) {
                    last = Some(t);
                    let (cluster, triangle) = self.owner[t as usize];
                    found.whole.push((cluster, (face, triangle)));
                    self.shade(face, t, &corners, &mut found);
                } else {
                    last = None;
                    self.one(face, &Piece::new(&corners), start, true, &mut found);
                }
            }
            found
        });
        let parts = d.parts.par_chunks(TASK).map(|own| {
            let mut found = Found::new(bound);
            for p in own {
                let piece = Piece::new(&p.corners);
                self.one(p.face, &piece, start[usize::from(p.triangle)], false, &mut found);
            }
            found
        });
        whole.chain(parts).collect()
    }

    fn one(&self, face: u32, piece: &Piece, start: u32, whole: bool, found: &mut Found) {
        let first = found.parts.len();
        let mut bound = found.bound;
        self.target.cover(piece, start, &mut bound, |t, p, _, all| {
            self.shade(face, t, p.corners(), found);
            let (cluster, triangle) = self.owner[t as usize];
            if all && whole {
                found.whole.push((cluster, (face, triangle)));
            } else {
                found.parts.push((cluster, Part { face, triangle, corners: p.corners().into() }));
            }
        });
        found.bound = bound;
        // Cut, but all in one cluster.
        let parts = &found.parts[first..];
        if let Some((c, p)) = parts.first()
            && parts.iter().all(|q| q.0 == *c)
        {
            let (cluster, triangle) = (*c, p.triangle);
            found.parts.truncate(first);
            if whole {
                found.whole.push((cluster, (face, triangle)));
            } else {
                let corners = piece.corners().into();
                found.parts.push((cluster, Part { face, triangle, corners }));
            }
        }
    }

    /// The coarse faces against the original: the largest distance, and that of each face. They
    /// are first laid upon the finer ones, whose known distances add to that to those; where the
    /// sum is too much, the original itself is asked.
    pub fn back(&self, bound: f64, fine: &Fine<'_>) -> (f64, Vec<f32>) {
        let one = |f: &[u32; 3], bound: &mut f64| {
            let piece = Piece::new(&f.map(|v| self.target.positions[v as usize].as_dvec3()));
            let mut far: f64 = 0.0;
            let from = fine.face_at[f[0] as usize];
            fine.target.part(&piece, from, &mut |t, part, away, _| {
                let sum = away + f64::from(fine.known[t as usize]);
                if sum <= *bound {
                    far = far.max(sum);
                    return;
                }
                let start = fine.original_at[fine.target.faces[t as usize][0] as usize];
                self.original.target.cover(part, start, bound, |_, _, d, _| far = far.max(d));
            });
            up(far)
        };
        let tasks: Vec<(f64, Vec<f32>)> = self
            .target
            .faces
            .par_chunks(256)
            .map(|own| {
                let mut bound = bound;
                let far = own.iter().map(|f| one(f, &mut bound)).collect();
                (bound, far)
            })
            .collect();
        let bound = tasks.iter().map(|t| t.0).fold(bound, f64::max);
        (bound, tasks.into_iter().flat_map(|t| t.1).collect())
    }

    /// Takes the shading of a piece of an original face on the coarse face `t` into account.
    fn shade(&self, face: u32, t: u32, corners: &[DVec3], found: &mut Found) {
        if face.is_multiple_of(SHADING_SAMPLE) {
            let piece = Piece::new(corners);
            let area = piece.area();
            found.turn += area * self.angle(face, t, piece.centre()).powi(2);
            found.area += area;
        }
    }

    /// Angle between the interpolated normals of an original face and of the coarse face `t`, at a
    /// place of the first.
    fn angle(&self, face: u32, t: u32, p: DVec3) -> f64 {
        let mix = |of: &Target<'_>, face: u32| {
            let w = of.nearest(face, p).weights;
            let f = of.faces[face as usize];
            (0..3).map(|k| of.normals[f[k] as usize].as_dvec3() * w[k]).sum::<DVec3>()
        };
        let (n, m) = (mix(&self.original.target, face), mix(&self.target, t));
        n.cross(m).length().atan2(n.dot(m))
    }
}
