//! The fine faces of a group laid upon its coarse ones.
//!
//! Sides are led alike from both of their faces, so that it is a continuous map of the fine surface
//! onto the coarse one, and one that stays where it is along the rim that they share. Counted modulo
//! 2, images of the fine faces and the coarse faces themselves then have the same boundary, so that
//! a coarse face beside the rim is covered by images, and so is its neighbour, and so on. Where fine
//! faces cannot be laid, their sides may be boundary of the image: coarse faces these run over, and
//! those that cannot be reached from the rim but across them, count as not covered.

use glam::DVec3;

use super::back::Fine;
use super::cover::Target;
use super::lay::{Crossing, Landing, Round};
use super::partition::NONE;

/// What laying the fine faces told.
pub struct Image {
    /// Whether images of fine faces cover a coarse one.
    pub covered: Vec<bool>,
    /// Coarse faces that fine ones lie over, and how far those are from them at most there, mm.
    pub over: Vec<(u32, f64)>,
    /// Of each fine face, its range of `over`; empty if it was not laid.
    pub laid: Vec<std::ops::Range<usize>>,
}

/// Where the crossings of a side are.
type Led = Option<(u32, u32)>;
/// An edge with one face, the lower vertex first, and that face.
type Rim = ([u32; 2], u32);

/// The work.
struct Laying<'a> {
    coarse: &'a Target<'a>,
    fine: &'a Fine<'a>,
    limit2: f64,
    lands: Vec<Landing>,
    rim: Vec<Rim>,
    fine_rim: Vec<Rim>,
    crossings: Vec<Crossing>,
    /// The sides of the faces so far.
    led: Vec<[Led; 3]>,
    /// Coarse faces at the rim that both surfaces have.
    open: Vec<u32>,
    /// Those that are, or may be, on the boundary of what is laid.
    barrier: Vec<bool>,
}

/// Lays the fine faces upon the coarse ones over edges within `limit`, mm.
pub fn image(coarse: &Target<'_>, fine: &Fine<'_>, limit: f64) -> Image {
    let mut work = Laying::new(coarse, fine, limit * limit);
    let mut round = Round::default();
    let faces = fine.target.faces;
    let mut over: Vec<(u32, f64)> = Vec::with_capacity(4 * faces.len());
    let mut laid = Vec::with_capacity(faces.len());
    for (i, f) in (0..).zip(faces) {
        let closes = work.face(i, &mut round);
        let lands = f.map(|v| work.lands[v as usize]);
        let first = over.len();
        round.over(&lands, closes.unwrap_or(0.0), &mut over);
        if closes.is_none() {
            over.drain(first..).for_each(|o| work.barrier[o.0 as usize] = true);
        }
        laid.push(first..over.len());
    }
    Image { covered: work.covered(), over, laid }
}

impl<'a> Laying<'a> {
    fn new(coarse: &'a Target<'a>, fine: &'a Fine<'a>, limit2: f64) -> Self {
        let same = |v: usize| fine.target.positions[v] == coarse.positions[v];
        let land = |v: usize| {
            let near = fine.coarse_at[v];
            // Gone ones have no face of their own.
            if same(v) && coarse.faces[near as usize].contains(&(v as u32)) {
                return Landing { face: near, d2: 0.0 };
            }
            coarse.land(near, fine.at(v as u32))
        };
        Self {
            coarse,
            fine,
            limit2,
            lands: (0..fine.target.positions.len()).map(land).collect(),
            rim: rim(coarse),
            fine_rim: rim(&fine.target),
            crossings: Vec::new(),
            led: Vec::with_capacity(fine.target.faces.len()),
            open: Vec::new(),
            barrier: vec![false; coarse.faces.len()],
        }
    }

    /// Lays the next face: the squared distance of the vertex that it goes around, if it can be.
    fn face(&mut self, i: u32, round: &mut Round) -> Option<f64> {
        round.crossings.clear();
        let sides = [0, 1, 2].map(|k| match self.fine.target.beside[i as usize][k] {
            other if other < i => self.again(i, other, k, round),
            other => self.side(i, k, other == NONE, round),
        });
        self.led.push(sides);
        let f = self.fine.target.faces[i as usize];
        let near = f.iter().all(|v| self.lands[*v as usize].d2 <= self.limit2);
        let corners = f.map(|v| self.fine.at(v));
        (near && sides.iter().all(Option::is_some))
            .then(|| self.coarse.closes(&corners, self.limit2, round))
            .flatten()
    }

    /// Leads a side that the face `other` has led, the other way.
    fn again(&self, i: u32, other: u32, k: usize, round: &mut Round) -> Led {
        let j = self.fine.target.beside[other as usize].iter().position(|n| *n == i)?;
        let (first, end) = self.led[other as usize][j]?;
        let way = &self.crossings[first as usize..end as usize];
        round.crossings.extend(way.iter().rev().map(|c| (k as u8, c.reversed())));
        Some((first, end))
    }

    /// Leads a side for the first time; `lone`: no other face has it.
    fn side(&mut self, i: u32, k: usize, lone: bool, round: &mut Round) -> Led {
        let f = self.fine.target.faces[i as usize];
        let ends = [f[k], f[(k + 1) % 3]];
        let [from, to] = ends.map(|v| self.lands[v as usize].face);
        let before = round.crossings.len();
        let along = lone && self.along(k as u8, ends, round);
        if !along {
            let [p, q] = ends.map(|v| self.fine.at(v));
            if !self.coarse.lead(k as u8, (p, from), (q, to), self.limit2, round) {
                return None;
            }
        }
        let way = &round.crossings[before..];
        if lone && !along {
            let faces = [from, to].into_iter().chain(way.iter().map(|c| c.1.to));
            faces.for_each(|t| self.barrier[t as usize] = true);
        }
        let first = self.crossings.len() as u32;
        self.crossings.extend(way.iter().map(|c| c.1));
        Some((first, self.crossings.len() as u32))
    }

    /// Leads a side that is on the rim of both surfaces along it.
    fn along(&mut self, side: u8, [a, b]: [u32; 2], round: &mut Round) -> bool {
        let edge = [a.min(b), a.max(b)];
        let find = |rim: &[Rim]| rim.binary_search_by_key(&edge, |e| e.0).ok().map(|n| rim[n].1);
        let (Some(_), Some(t)) = (find(&self.fine_rim), find(&self.rim)) else { return false };
        let before = round.crossings.len();
        let [from, to] = [a, b].map(|v| self.lands[v as usize].face);
        let there = self.coarse.turn_about(side, a, from, t, round)
            && self.coarse.turn_about(side, b, t, to, round);
        if there {
            self.open.push(t);
        } else {
            round.crossings.truncate(before);
        }
        there
    }

    /// Coarse faces that can be reached from the rim.
    fn covered(mut self) -> Vec<bool> {
        let mut covered = vec![false; self.barrier.len()];
        while let Some(t) = self.open.pop() {
            if !self.barrier[t as usize] && !covered[t as usize] {
                covered[t as usize] = true;
                let beside = self.coarse.beside[t as usize];
                self.open.extend(beside.into_iter().filter(|n| *n != NONE));
            }
        }
        covered
    }
}

/// Edges with one face, in order.
fn rim(of: &Target<'_>) -> Vec<Rim> {
    let mut all: Vec<Rim> = Vec::new();
    for ((f, beside), i) in of.faces.iter().zip(of.beside).zip(0..) {
        for k in (0..3).filter(|k| beside[*k] == NONE) {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            all.push(([a.min(b), a.max(b)], i));
        }
    }
    all.sort_unstable();
    let once = all.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() == 1).map(|c| c[0]);
    once.collect()
}

impl Target<'_> {
    /// Goes around vertex `v` from one face at it to another, all crossings at the vertex.
    fn turn_about(&self, side: u8, v: u32, from: u32, to: u32, round: &mut Round) -> bool {
        let at: DVec3 = self.positions[v as usize].as_dvec3();
        let first = round.crossings.len();
        for way in 0..2 {
            let (mut face, mut last) = (from, NONE);
            for _ in 0..64 {
                if face == to {
                    return true;
                }
                let f = self.faces[face as usize];
                let Some(corner) = f.iter().position(|w| *w == v) else { break };
                // The two edges at the corner; never back, and the second way first the other.
                let mut edges = [corner, (corner + 2) % 3];
                if way == 1 && last == NONE {
                    edges.reverse();
                }
                let over = |k: &usize| self.beside[face as usize][*k];
                let Some(k) = (match last {
                    NONE => Some(edges[0]).filter(|k| over(k) != NONE),
                    _ => edges.into_iter().find(|k| over(k) != NONE && over(k) != last),
                }) else {
                    break;
                };
                let edge = [f[k], f[(k + 1) % 3]];
                let edge = [edge[0].min(edge[1]), edge[0].max(edge[1])];
                let next = over(&k);
                round.crossings.push((side, Crossing { from: face, to: next, edge, at, d2: 0.0 }));
                (last, face) = (face, next);
            }
            round.crossings.truncate(first);
        }
        false
    }
}
