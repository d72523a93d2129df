//! A flat convex piece of one surface upon another, without cutting it: which faces it lies over,
//! and how far it is from them at most.
//!
//! Each corner has a face near it. Where two corners in turn have different ones, the side between
//! them is led from face to face: for every edge E crossed there is a point e of the side near E.
//! If the round of the piece crosses back over every edge that it crossed, chords between the two
//! points e of an edge cut it into parts, each of which has all its corners near one face: its own
//! corners, and points near edges of that face. Distance to one triangle is convex, so no point of
//! the part is farther from it than those. If the round goes around a vertex, some point m of the
//! piece near that joins the parts as the middle of a star. Parts may lie one over another: joined
//! along chords they are a disk whose rim is that of the piece, which covers the piece.

use glam::DVec3;

use super::cover::{CORNERS, Piece, Target};
use super::partition::NONE;

/// Faces looked at on the way along one side, at most.
const WAY: usize = 24;

/// Parts of less than this share of a piece are left out: no wider than rounding, they lie along
/// others.
const SPECK: f64 = 1e-15;

/// The face that a point is near to, and their squared distance, mm².
#[derive(Clone, Copy)]
pub struct Landing {
    /// The face.
    pub face: u32,
    /// Squared distance, mm².
    pub d2: f64,
}

/// A side of a piece crosses an edge.
#[derive(Clone, Copy)]
pub struct Crossing {
    /// From this face,
    pub from: u32,
    /// to this one,
    pub to: u32,
    /// over the edge between these vertices, the lower first.
    pub edge: [u32; 2],
    /// The point of the side.
    pub at: DVec3,
    /// Its squared distance from the edge, mm².
    pub d2: f64,
}

impl Crossing {
    /// The same edge the other way.
    fn undoes(&self, o: &Self) -> bool {
        self.from == o.to && self.to == o.from && self.edge == o.edge
    }

    /// Seen from the other end of the side.
    pub fn reversed(&self) -> Self {
        Self { from: self.to, to: self.from, ..*self }
    }
}

/// The round of a piece, and room to work it out.
#[derive(Default)]
pub struct Round {
    /// Crossings in order, each with the side of the piece that it is on: from corner k to k + 1.
    pub crossings: Vec<(u8, Crossing)>,
    /// What [`Self::split`] found: a face that each part is near to, and its corners.
    pub parts: Vec<(u32, Vec<DVec3>)>,
    /// Parts under way, those inside others last.
    under: Vec<(u32, Vec<DVec3>)>,
    /// Room of parts that are not needed any more.
    spare: Vec<Vec<DVec3>>,
    open: Vec<Crossing>,
    way: Vec<(Crossing, u8)>,
}

impl Round {
    /// Adds the faces that a piece lies over and how far it is from each there at most, mm.
    ///
    /// * `lands`: of its corners.
    /// * `middle`: what [`Target::closes`] said.
    pub fn over(&self, lands: &[Landing], middle: f64, out: &mut Vec<(u32, f64)>) {
        let first = out.len();
        let mut put = |t: u32, d2: f64| match out[first..].iter_mut().find(|o| o.0 == t) {
            Some(o) => o.1 = o.1.max(d2),
            None => out.push((t, middle.max(d2))),
        };
        lands.iter().for_each(|l| put(l.face, l.d2));
        for (_, c) in &self.crossings {
            put(c.from, c.d2);
            put(c.to, c.d2);
        }
        out[first..].iter_mut().for_each(|o| o.1 = o.1.sqrt());
    }

    /// Cuts a piece along the chords between faces of different clusters into `parts`, each of one
    /// cluster. False where the round goes around a vertex or a part has too many corners.
    ///
    /// * `first`: the face of the first corner.
    pub fn split(&mut self, corners: &[DVec3], first: u32, cluster: impl Fn(u32) -> u16) -> bool {
        self.spare.extend(self.parts.drain(..).chain(self.under.drain(..)).map(|p| p.1));
        self.open.clear();
        let fresh = |spare: &mut Vec<Vec<DVec3>>| {
            let mut part = spare.pop().unwrap_or_default();
            part.clear();
            part
        };
        self.under.push((first, fresh(&mut self.spare)));
        let mut rest = self.crossings.as_slice();
        for (side, p) in (0..).zip(corners) {
            if let Some(part) = self.under.last_mut() {
                part.1.push(*p);
            }
            while let [(s, c), after @ ..] = rest
                && *s == side
            {
                rest = after;
                let over = cluster(c.from) != cluster(c.to);
                if over && let Some(part) = self.under.last_mut() {
                    part.1.push(c.at);
                }
                if self.open.last().is_some_and(|last| last.undoes(c)) {
                    self.open.pop();
                    if over {
                        self.parts.extend(self.under.pop());
                        if let Some(part) = self.under.last_mut() {
                            part.1.push(c.at);
                        }
                    }
                } else {
                    self.open.push(*c);
                    if over {
                        let mut part = fresh(&mut self.spare);
                        part.push(c.at);
                        self.under.push((c.to, part));
                    }
                }
            }
        }
        self.parts.append(&mut self.under);
        let area = |p: &[DVec3]| Piece::new(p).area();
        let speck = SPECK * area(corners);
        let fits = self.open.is_empty() && self.parts.iter().all(|p| p.1.len() <= CORNERS);
        self.parts.retain(|p| p.1.len() > 2 && area(&p.1) > speck);
        fits && !self.parts.is_empty()
    }
}

/// Squared distance of two segments, and the point of the first there (Ericson 2005, 5.1.9).
fn apart(p: DVec3, q: DVec3, a: DVec3, b: DVec3) -> (f64, DVec3) {
    let (u, v, r) = (q - p, b - a, p - a);
    let (uu, vv, ur, vr, uv) = (u.dot(u), v.dot(v), u.dot(r), v.dot(r), u.dot(v));
    let unit = |x: f64| if x > 0.0 { x.min(1.0) } else { 0.0 };
    // A quotient that is no number becomes nought: any point will do, if not the nearest.
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

impl Target<'_> {
    /// The face that a walk from `from` ends on.
    pub fn land(&self, from: u32, p: DVec3) -> Landing {
        let (face, near) = self.walked(from, p);
        Landing { face, d2: near.d2 }
    }

    fn crossing(&self, from: u32, k: usize, p: DVec3, q: DVec3) -> Crossing {
        let c = self.corners(from);
        let f = self.faces[from as usize];
        let (a, b) = (f[k], f[(k + 1) % 3]);
        let (d2, at) = apart(p, q, c[k], c[(k + 1) % 3]);
        let edge = [a.min(b), a.max(b)];
        Crossing { from, to: self.beside[from as usize][k], edge, at, d2 }
    }

    /// Leads the side from `p`, near face `from`, to `q`, near face `to`, over edges within
    /// √`limit2` of it, by few of them; adds them to `round`. Whether there is a way.
    pub fn lead(
        &self,
        side: u8,
        (p, from): (DVec3, u32),
        (q, to): (DVec3, u32),
        limit2: f64,
        round: &mut Round,
    ) -> bool {
        if from == to {
            return true;
        }
        if let Some(k) = (0..3).find(|k| self.beside[from as usize][*k] == to) {
            let c = self.crossing(from, k, p, q);
            if c.d2 <= limit2 {
                round.crossings.push((side, c));
                return true;
            }
        }
        // Most others have a vertex in common, and one face between them.
        for k in 0..3 {
            let middle = self.beside[from as usize][k];
            if middle == NONE {
                continue;
            }
            if let Some(j) = (0..3).find(|j| self.beside[middle as usize][*j] == to) {
                let c = self.crossing(from, k, p, q);
                if c.d2 <= limit2 {
                    let d = self.crossing(middle, j, p, q);
                    if d.d2 <= limit2 {
                        round.crossings.extend([(side, c), (side, d)]);
                        return true;
                    }
                }
            }
        }
        let way = &mut round.way;
        way.clear();
        // Broad first; `u8::MAX` leads back to the beginning.
        let (mut face, mut by, mut next) = (from, u8::MAX, 0);
        loop {
            for k in 0..3 {
                let over = self.beside[face as usize][k];
                if over == NONE || over == from || way.iter().any(|w| w.0.to == over) {
                    continue;
                }
                let c = self.crossing(face, k, p, q);
                if c.d2 > limit2 {
                    continue;
                }
                way.push((c, by));
                if over == to {
                    let first = round.crossings.len();
                    let mut at = way.len() as u8 - 1;
                    while let Some((c, before)) = way.get(usize::from(at)) {
                        round.crossings.push((side, *c));
                        at = *before;
                    }
                    round.crossings[first..].reverse();
                    return true;
                }
            }
            if next >= way.len() || way.len() > WAY {
                return false;
            }
            (face, by) = (way[next].0.to, next as u8);
            next += 1;
        }
    }

    /// Whether a piece whose sides have been led lies over the faces that they were led across as
    /// a whole: then the squared distance of the vertex that they go around, nought if none.
    pub fn closes(&self, corners: &[DVec3], limit2: f64, round: &mut Round) -> Option<f64> {
        let open = &mut round.open;
        open.clear();
        for (_, c) in &round.crossings {
            if open.last().is_some_and(|last| last.undoes(c)) {
                open.pop();
            } else {
                open.push(*c);
            }
        }
        let mut rest = open.as_slice();
        while let [first, middle @ .., last] = rest
            && last.undoes(first)
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

/// Nearest place of a triangle.
fn nearest(t: [DVec3; 3], p: DVec3) -> super::cover::Near {
    super::cover::Known::new(t).nearest(p)
}
