//! The coarse faces of a group against the original they stand for: distance both ways, shading.

use glam::{DVec3, Vec3};

use super::build::up;
use super::carry::{Carried, Late, carried};
use super::cover::{Piece, Target};
use super::draft::{Draft, Lies};
use super::image::Image;
use super::lay::{Landing, Round};
use super::partition::NONE;
use crate::geometry::Vertex;

/// Of so many original faces one is looked at for shading: it is a mean, and no bound.
const SHADING_SAMPLE: u32 = 8;

/// The original, to measure to.
pub struct Original<'a> {
    /// Its faces.
    pub target: Target<'a>,
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

    /// The corners of a face, mm.
    pub fn corners(&self, face: u32) -> [DVec3; 3] {
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

/// What measuring a group has found so far; what it stands for goes to its clusters at once.
pub struct Found<'d> {
    /// Largest distance, mm.
    pub bound: f64,
    /// Squared angles between normals times areas, and areas.
    turn: f64,
    area: f64,
    outputs: &'d mut [Draft],
    known: Landings,
    lands: Vec<Landing>,
    round: Round,
    cuts: Vec<(u32, Piece, f64)>,
}

impl<'d> Found<'d> {
    /// Nothing yet.
    ///
    /// * `outputs`: those that are to stand for what is measured.
    /// * `faces`: how many original ones, about.
    pub fn new(bound: f64, outputs: &'d mut [Draft], faces: usize) -> Self {
        let (lands, round, cuts) = (Vec::new(), Round::default(), Vec::new());
        let each = faces / outputs.len().max(1);
        outputs.iter_mut().for_each(|d| d.whole.reserve(each));
        let known = Landings::new(faces);
        Self { bound, turn: 0.0, area: 0.0, outputs, known, lands, round, cuts }
    }

    /// The cluster that something goes along to.
    fn take(&mut self, to: &Carried) -> &mut Draft {
        let own = &mut self.outputs[usize::from(to.cluster)];
        own.error = own.error.max(to.far());
        own
    }

    /// Root mean square angle between normals, radians.
    pub fn angle(&self) -> f64 {
        if self.area > 0.0 { (self.turn / self.area).sqrt() } else { 0.0 }
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
            for lies in d.whole.iter().step_by(every) {
                let p = self.original.corners(lies.face)[0];
                let near = self.target.walk(start[lies.triangle()], p);
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

    /// What `inputs` stand for, against the coarse faces. `start`: for each of the triangles of each,
    /// where to begin.
    ///
    /// What can go along unmeasured but may be farther than the bound so far waits; then the worst
    /// are measured, which raises the bound until the rest is within it.
    pub fn towards(
        &self,
        inputs: &[&Draft],
        start: &[Vec<u32>],
        image: &Image,
        found: &mut Found<'_>,
    ) {
        let below = self.below(image);
        let (mut below, mut late) = (below.as_slice(), Vec::new());
        for ((draft, d), start) in (0..).zip(inputs).zip(start) {
            let (own, rest) = below.split_at(d.triangles.len());
            below = rest;
            let mut last = None;
            for (piece, lies) in (0..).zip(&d.whole) {
                match carried(lies, own) {
                    Some(to) if to.far() <= found.bound => self.hand_whole(&to, found),
                    Some(to) => late.push(Late { to, draft, piece }),
                    None => {
                        let start = last.unwrap_or(start[lies.triangle()]);
                        last = self.whole(lies.face, start, found);
                        continue;
                    }
                }
                last = None;
            }
            for (piece, p) in (d.whole.len() as u32..).zip(&d.parts.list) {
                let corners = d.parts.corners(p);
                match carried(&p.lies, own) {
                    Some(to) if to.far() <= found.bound => self.hand_part(corners, &to, found),
                    Some(to) => late.push(Late { to, draft, piece }),
                    None => self.part(p.lies.face, corners, start[p.lies.triangle()], found),
                }
            }
        }
        late.sort_unstable_by(Late::before);
        for Late { to, draft, piece } in &late {
            let d = inputs[*draft as usize];
            let within = to.far() <= found.bound;
            match (piece.checked_sub(d.whole.len() as u32), within) {
                (None, true) => self.hand_whole(to, found),
                (None, false) => {
                    self.whole(to.lies.face, to.near, found);
                }
                (Some(part), within) => {
                    let corners = d.parts.corners(&d.parts.list[part as usize]);
                    if within {
                        self.hand_part(corners, to, found);
                    } else {
                        self.part(to.lies.face, corners, to.near, found);
                    }
                }
            }
        }
    }

    fn hand_whole(&self, to: &Carried, found: &mut Found<'_>) {
        found.take(to).whole.push(to.lies);
        let corners = || Piece::new(&self.original.corners(to.lies.face));
        self.shade_near(to.lies.face, to.near, corners, found);
    }

    fn hand_part(&self, corners: &[DVec3], to: &Carried, found: &mut Found<'_>) {
        found.take(to).parts.push(to.lies, corners);
        self.shade_near(to.lies.face, to.near, || Piece::new(corners), found);
    }

    /// Measures a whole original face; where to begin with the next.
    fn whole(&self, face: u32, start: u32, found: &mut Found<'_>) -> Option<u32> {
        let corners = self.original.corners(face);
        let mut from = start;
        let lands = [0, 1, 2].map(|k| {
            let v = self.original.target.faces[face as usize][k];
            let land = found.known.of(v, || self.target.land(from, corners[k]));
            from = land.face;
            land
        });
        if self.lay(face, &corners, &lands, true, found) {
            return Some(from);
        }
        self.one(face, &Piece::new(&corners), start, true, found);
        None
    }

    /// Measures a part of an original face.
    fn part(&self, face: u32, corners: &[DVec3], start: u32, found: &mut Found<'_>) {
        let mut lands = std::mem::take(&mut found.lands);
        let mut from = start;
        lands.clear();
        lands.extend(corners.iter().map(|c| {
            let land = self.target.land(from, *c);
            from = land.face;
            land
        }));
        if !self.lay(face, corners, &lands, false, found) {
            self.one(face, &Piece::new(corners), start, false, found);
        }
        found.lands = lands;
    }

    /// Lays a piece of an original face upon the coarse faces if it is within the bound as it is:
    /// whether it was. `lands`: of its corners.
    fn lay(
        &self,
        face: u32,
        corners: &[DVec3],
        lands: &[Landing],
        whole: bool,
        found: &mut Found<'_>,
    ) -> bool {
        let mut round = std::mem::take(&mut found.round);
        let laid = self.lay_with(face, corners, lands, whole, &mut round, found);
        found.round = round;
        laid
    }

    fn lay_with(
        &self,
        face: u32,
        corners: &[DVec3],
        lands: &[Landing],
        whole: bool,
        round: &mut Round,
        found: &mut Found<'_>,
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
        found: &mut Found<'_>,
    ) {
        let (cluster, _) = self.owner[t as usize];
        let over = over.into_iter().map(|t| self.owner[t as usize]).filter(|o| o.0 == cluster);
        let over = over.fold(0, |over, o| over | 1 << o.1);
        let lies = Lies { face, far: up(far2.sqrt()), over };
        let own = &mut found.outputs[usize::from(cluster)];
        own.error = own.error.max(f64::from(lies.far));
        if whole {
            own.whole.push(lies);
        } else {
            own.parts.push(lies, corners);
        }
    }

    fn one(&self, face: u32, piece: &Piece, start: u32, whole: bool, found: &mut Found<'_>) {
        let mut cuts = std::mem::take(&mut found.cuts);
        cuts.clear();
        let mut bound = found.bound;
        self.target.cover(piece, start, &mut bound, |t, p, far| cuts.push((t, *p, far)));
        found.bound = bound;
        for (t, p, _) in &cuts {
            self.shade(face, *t, p.corners(), found);
        }
        let cluster = |c: &(u32, Piece, f64)| self.owner[c.0 as usize].0;
        if let Some(first) = cuts.first()
            && cuts.iter().all(|c| cluster(c) == cluster(first))
        {
            // Cut, but all in one cluster.
            let far = cuts.iter().fold(0f64, |far, c| far.max(c.2));
            let over = cuts.iter().map(|c| c.0);
            self.put((face, first.0), piece.corners(), whole, far * far, over, found);
        } else {
            for (t, p, far) in &cuts {
                self.put((face, *t), p.corners(), false, far * far, [*t], found);
            }
        }
        found.cuts = cuts;
    }

    /// Takes the shading of a piece of an original face on the coarse face `t` into account.
    fn shade(&self, face: u32, t: u32, corners: &[DVec3], found: &mut Found<'_>) {
        if face.is_multiple_of(SHADING_SAMPLE) {
            let piece = Piece::new(corners);
            let area = piece.area();
            found.turn += area * self.angle(face, t, piece.centre()).powi(2);
            found.area += area;
        }
    }

    /// The same, with the coarse face at its middle, which is not far from `from`.
    fn shade_near(&self, face: u32, from: u32, piece: impl Fn() -> Piece, found: &mut Found<'_>) {
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
