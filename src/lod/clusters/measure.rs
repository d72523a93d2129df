//! The coarse faces of a group against the original they stand for: distance both ways, shading.

use glam::{DVec3, Vec3};
use rayon::prelude::*;

use super::carry::{Carried, Near};
use super::cover::{Piece, Target};
use super::lay::{Landing, Round};
use super::partition::NONE;
#[cfg(test)]
use crate::geometry::Mesh;
use crate::geometry::Vertex;

/// Pieces of the original measured by one task.
const TASK: usize = 4096;
/// Of so many original faces one is looked at for shading: it is a mean, and no bound.
const SHADING_SAMPLE: u32 = 8;

/// Part of an original face that a cluster stands for.
#[derive(Clone, Copy)]
pub struct Part {
    /// The original's face id.
    pub face: u32,
    /// Where its corners begin among all.
    first: u32,
    /// How many there are.
    count: u8,
    /// Triangle of the cluster that it was near to.
    pub triangle: u8,
}

/// Parts of original faces.
pub struct Parts<T> {
    /// Each with what is to be known of it.
    list: Vec<(T, Part)>,
    /// Their corners, mm.
    corners: Vec<DVec3>,
}

impl<T> Default for Parts<T> {
    fn default() -> Self {
        Self { list: Vec::new(), corners: Vec::new() }
    }
}

impl<T> Parts<T> {
    fn push(&mut self, of: T, face: u32, triangle: u8, corners: &[DVec3]) {
        let (first, count) = (self.corners.len() as u32, corners.len() as u8);
        self.corners.extend_from_slice(corners);
        self.list.push((of, Part { face, first, count, triangle }));
    }

    fn corners(&self, part: &Part) -> &[DVec3] {
        &self.corners[part.first as usize..][..usize::from(part.count)]
    }
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
    pub parts: Parts<()>,
    /// For each triangle, what is near it of both.
    pub near: Vec<Near>,
    /// For each triangle, how far any point of it is from the original at most, mm.
    pub back: Vec<f32>,
    /// At least that, and how far any point of what it stands for is from it, mm.
    pub error: f64,
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
    /// What it stands for: original face, corners, and the triangle that is near.
    #[cfg(test)]
    pub fn stands_for(&self, original: &Mesh) -> Vec<(u32, Vec<DVec3>, u8)> {
        let corners = |f: u32| -> Vec<DVec3> {
            original.faces[f as usize].map(|v| original.positions[v as usize].as_dvec3()).to_vec()
        };
        let whole = self.whole.iter().map(|(f, t)| (*f, corners(*f), *t));
        let parts = self.parts.list.iter();
        let part = |p: &Part| (p.face, self.parts.corners(p).to_vec(), p.triangle);
        whole.chain(parts.map(|(_, p)| part(p))).collect()
    }

    /// Puts faces together again of which all parts are here.
    pub fn unite(&mut self, original: &Original<'_>) {
        let mut list = std::mem::take(&mut self.parts.list);
        list.sort_by_key(|p| p.1.face);
        for own in list.chunk_by(|a, b| a.1.face == b.1.face) {
            let Part { face, triangle, .. } = own[0].1;
            let area = own.iter().map(|p| Piece::new(self.parts.corners(&p.1)).area());
            if area.sum::<f64>() > (1.0 - 1e-6) * Piece::new(&original.corners(face)).area() {
                self.whole.push((face, triangle));
                for p in own {
                    let other = self.near[usize::from(p.1.triangle)];
                    self.near[usize::from(triangle)].join(other);
                }
            } else {
                self.parts.list.extend_from_slice(own);
            }
        }
    }
}

impl Original<'_> {
    /// A vertex at `p` with what the original has nearest to there: its normal and relief, between
    /// `vertices`; and the face of that. `from`: a face near it.
    pub fn vertex(&self, p: Vec3, from: u32, vertices: &[Vertex]) -> (Vertex, u32) {
        let (face, near) = self.target.walked(from, p.as_dvec3());
        let w = near.weights.map(|w| w as f32);
        let [a, b, c] = self.target.faces[face as usize].map(|v| vertices[v as usize]);
        let normal = a.normal() * w[0] + b.normal() * w[1] + c.normal() * w[2];
        let relief = a.w() * w[0] + b.w() * w[1] + c.w() * w[2];
        (Vertex::new(p, normal.try_normalize().unwrap_or(a.normal()), relief), face)
    }

    fn corners(&self, face: u32) -> [DVec3; 3] {
        self.target.faces[face as usize].map(|v| self.target.positions[v as usize].as_dvec3())
    }
}

/// Where vertices landed, as far as there is room to remember it.
struct Landings(Vec<(u32, Landing)>);

impl Landings {
    fn new(faces: usize) -> Self {
        let none = (NONE, Landing { face: NONE, d2: f64::INFINITY });
        Self(vec![none; faces.next_power_of_two().clamp(64, 4096)])
    }

    fn of(&mut self, v: u32, work: impl FnOnce() -> Landing) -> Landing {
        let mask = self.0.len() as u32 - 1;
        let slot = &mut self.0[(v.wrapping_mul(0x9E37_79B1) >> 16 & mask) as usize];
        if slot.0 != v {
            *slot = (v, work());
        }
        slot.1
    }
}

/// What one task measured.
pub struct Found {
    /// Largest distance, mm.
    pub bound: f64,
    /// Squared angles between normals times areas, and areas.
    pub turn: f64,
    pub area: f64,
    /// By coarse face.
    pub near: Vec<Near>,
    /// By output cluster.
    pub whole: Vec<(u16, (u32, u8))>,
    /// The same of those that were cut.
    pub parts: Parts<u16>,
}

impl Found {
    /// Hands what was found to the clusters that stand for it. `owner`: as in [`Measure`].
    pub fn share(&self, owner: &[(u16, u8)], among: &mut [Draft]) {
        for ((cluster, triangle), near) in owner.iter().zip(&self.near) {
            among[usize::from(*cluster)].near[usize::from(*triangle)].join(*near);
        }
        for (c, w) in &self.whole {
            among[usize::from(*c)].whole.push(*w);
        }
        for (c, p) in &self.parts.list {
            let parts = &mut among[usize::from(*c)].parts;
            parts.push((), p.face, p.triangle, self.parts.corners(p));
        }
    }

    fn new(bound: f64, owner: &[(u16, u8)]) -> Self {
        let (whole, parts) = (Vec::new(), Parts::default());
        let near = vec![Near::default(); owner.len()];
        Self { bound, turn: 0.0, area: 0.0, near, whole, parts }
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
    /// begin; `carried`: what need not be measured. Tasks are cut the same whatever the number of
    /// threads.
    pub fn towards(&self, d: &Draft, start: &[u32], bound: f64, carried: &[Carried]) -> Vec<Found> {
        let whole = d.whole.par_chunks(TASK).map(|own| {
            let mut found = Found::new(bound, self.owner);
            found.whole.reserve(own.len());
            let mut round = Round::default();
            let mut known = Landings::new(own.len());
            let mut last = None;
            for &(face, triangle) in own {
                if let Some((t, _)) = carried[usize::from(triangle)] {
                    let (cluster, triangle) = self.owner[t as usize];
                    found.whole.push((cluster, (face, triangle)));
                    self.shade_near(
                        face,
                        t,
                        || Piece::new(&self.original.corners(face)),
                        &mut found,
                    );
                    last = None;
                    continue;
                }
                let corners = self.original.corners(face);
                let start = last.unwrap_or(start[usize::from(triangle)]);
                let mut from = start;
                let lands = [0, 1, 2].map(|k| {
                    let v = self.original.target.faces[face as usize][k];
                    let land = known.of(v, || self.target.land(from, corners[k]));
                    from = land.face;
                    land
                });
                last = Some(from);
                if !self.lay(face, &corners, &lands, true, &mut round, &mut found) {
                    last = None;
                    self.one(face, &Piece::new(&corners), start, true, &mut found);
                }
            }
            found
        });
        let parts = d.parts.list.par_chunks(TASK).map(|own| {
            let mut found = Found::new(bound, self.owner);
            found.parts.list.reserve(own.len());
            let mut round = Round::default();
            let mut lands = Vec::new();
            for (_, p) in own {
                let corners = d.parts.corners(p);
                if let Some((t, _)) = carried[usize::from(p.triangle)] {
                    let (cluster, triangle) = self.owner[t as usize];
                    found.parts.push(cluster, p.face, triangle, corners);
                    self.shade_near(p.face, t, || Piece::new(corners), &mut found);
                    continue;
                }
                let start = start[usize::from(p.triangle)];
                let mut from = start;
                lands.clear();
                lands.extend(corners.iter().map(|c| {
                    let land = self.target.land(from, *c);
                    from = land.face;
                    land
                }));
                if !self.lay(p.face, corners, &lands, false, &mut round, &mut found) {
                    self.one(p.face, &Piece::new(corners), start, false, &mut found);
                }
            }
            found
        });
        whole.chain(parts).collect()
    }

    /// Lays a piece of an original face upon the coarse faces if it is within the bound as it is:
    /// whether it was. `lands`: of its corners.
    fn lay(
        &self,
        face: u32,
        corners: &[DVec3],
        lands: &[Landing],
        whole: bool,
        round: &mut Round,
        found: &mut Found,
    ) -> bool {
        let limit2 = found.bound * found.bound;
        if !lands.iter().all(|l| l.d2 <= limit2) {
            return false;
        }
        // Most lie near one face as a whole.
        let within = |l: &Landing| {
            corners.iter().zip(lands).try_fold(0f64, |far2, (c, o)| {
                let d2 = match o.face == l.face {
                    true => o.d2,
                    false => self.target.nearest(l.face, *c).d2,
                };
                (d2 <= limit2).then_some(far2.max(d2))
            })
        };
        let mut tried = NONE;
        for l in lands {
            if l.face != tried
                && let Some(far2) = within(l)
            {
                self.put((face, l.face), corners, whole, far2, [l.face], found);
                self.shade(face, l.face, corners, found);
                return true;
            }
            tried = l.face;
        }
        round.crossings.clear();
        for (k, l) in lands.iter().enumerate() {
            let j = (k + 1) % lands.len();
            let (from, to) = ((corners[k], l.face), (corners[j], lands[j].face));
            if !self.target.lead(k as u8, from, to, limit2, round) {
                return false;
            }
        }
        let Some(middle) = self.target.closes(corners, limit2, round) else { return false };
        let all = lands.iter().map(|l| l.d2).chain(round.crossings.iter().map(|c| c.1.d2));
        let far2 = all.fold(middle, f64::max);
        let first = lands[0].face;
        let cluster = |t: u32| self.owner[t as usize].0;
        let split = !round.crossings.iter().all(|c| cluster(c.1.to) == cluster(first));
        if split && !round.split(corners, first, cluster) {
            return false;
        }
        let over = || round.crossings.iter().map(|c| c.1.to).chain([first]);
        if split {
            for p in &round.parts {
                self.put((face, p.0), &p.1, false, far2, over(), found);
            }
        } else {
            self.put((face, first), corners, whole, far2, over(), found);
        }
        self.shade_near(face, first, || Piece::new(corners), found);
        true
    }

    /// Notes that a piece of an original face is near a coarse one, and how near. `over`: that one
    /// and all others that it may be near a part of; those of the same cluster count.
    fn put(
        &self,
        (face, t): (u32, u32),
        corners: &[DVec3],
        whole: bool,
        far2: f64,
        over: impl IntoIterator<Item = u32>,
        found: &mut Found,
    ) {
        let (cluster, triangle) = self.owner[t as usize];
        let near = &mut found.near[t as usize];
        near.far = near.far.max(far2.sqrt());
        let over = over.into_iter().map(|t| self.owner[t as usize]).filter(|o| o.0 == cluster);
        over.for_each(|o| near.over |= 1 << o.1);
        if whole {
            found.whole.push((cluster, (face, triangle)));
        } else {
            found.parts.push(cluster, face, triangle, corners);
        }
    }

    fn one(&self, face: u32, piece: &Piece, start: u32, whole: bool, found: &mut Found) {
        let first = found.parts.list.len();
        let mut bound = found.bound;
        self.target.cover(piece, start, &mut bound, |t, p, far, all| {
            self.shade(face, t, p.corners(), found);
            self.put((face, t), p.corners(), all && whole, far * far, [t], found);
        });
        found.bound = bound;
        // Cut, but all in one cluster.
        let parts = &found.parts.list[first..];
        if let Some((c, p)) = parts.first()
            && parts.iter().all(|q| q.0 == *c)
        {
            let (cluster, triangle) = (*c, p.triangle);
            // What else is near those triangles comes along; that is more than need be, not less.
            let start = self.owner.partition_point(|o| o.0 < cluster);
            for p in parts {
                let near = found.near[start + usize::from(p.1.triangle)];
                found.near[start + usize::from(triangle)].join(near);
            }
            found.parts.list.truncate(first);
            if whole {
                found.whole.push((cluster, (face, triangle)));
            } else {
                found.parts.push(cluster, face, triangle, piece.corners());
            }
        }
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

    /// The same, with the coarse face at its middle, which is not far from `from`.
    fn shade_near(&self, face: u32, from: u32, piece: impl Fn() -> Piece, found: &mut Found) {
        if face.is_multiple_of(SHADING_SAMPLE) {
            let piece = piece();
            let t = self.target.walk(from, piece.centre());
            self.shade(face, t, piece.corners(), found);
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
