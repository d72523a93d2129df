//! The coarse faces of a group back to the original, by way of the fine ones.
//!
//! The fine faces, which have the same rim, are laid upon the coarse ones ([`super::lay`]), side by
//! side alike from both of its faces. That makes a continuous map of the fine surface onto the
//! coarse one, and one that stays where it is along the rim. Counted modulo 2, images of the fine
//! faces and the coarse faces themselves then have the same boundary, so that a coarse face beside
//! the rim is covered by images, and so is its neighbour, and so on: every point of it has a fine
//! one no farther away than the map moves any, and the original is not farther from that than what
//! is known of the fine face.
//!
//! Where fine faces cannot be laid, their sides may be boundary of the image: coarse faces these
//! run over, and those that cannot be reached from the rim but across them, are cut up instead, and
//! so are those where the sum of distances is too much.

use glam::DVec3;
use rayon::prelude::*;

use super::build::up;
use super::cover::{Piece, Target};
use super::group::Places;
use super::lay::{Crossing, Landing, Round};
use super::measure::{Draft, Measure};
use super::partition::{self, NONE};

/// The fine faces of a group, as the way from the coarse ones back to the original.
pub struct Fine<'a> {
    /// The faces, with the vertex ids of the coarse ones; the tree is not asked.
    pub target: Target<'a>,
    /// For each, how far any point of it is from the original at most, mm.
    pub known: Vec<f32>,
    /// One of the faces at each vertex.
    pub face_at: Vec<u32>,
    /// Its vertices among all.
    pub ids: &'a [u32],
    /// All vertices.
    pub places: &'a Places,
    /// The surface to ask before the original.
    pub earlier: Option<&'a Earlier>,
    /// A coarse face near each vertex.
    pub coarse_at: Vec<u32>,
}

/// A surface between the original and the fine one: the last but two.
pub struct Earlier {
    /// Its faces, by ids of all vertices.
    pub faces: Vec<[u32; 3]>,
    /// Face across each edge.
    pub beside: Vec<[u32; 3]>,
    /// For each, how far any point of it is from the original at most, mm.
    pub known: Vec<f32>,
    /// A face at each vertex that it has.
    pub face_at: Vec<u32>,
}

impl Earlier {
    /// The surface of live clusters; `vertices`: how many there are of all levels.
    pub fn new<'a>(live: impl Iterator<Item = &'a Draft> + Clone, vertices: usize) -> Self {
        let faces: Vec<[u32; 3]> = live.clone().flat_map(Draft::faces).collect();
        let mut face_at = vec![NONE; vertices];
        for (f, i) in faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        let beside = partition::beside(&faces, vertices);
        Self { beside, known: live.flat_map(|d| d.back.iter().copied()).collect(), faces, face_at }
    }
}

/// What laying the fine faces told of the coarse ones.
pub struct Image {
    /// How far any point of each is from the original at most, mm, if it is `covered`.
    pub far: Vec<f64>,
    /// Whether images of fine faces near enough cover it.
    pub covered: Vec<bool>,
}

/// The sides of fine faces as led across the coarse ones: where their crossings are.
type Led = Option<(u32, u32)>;

impl Measure<'_> {
    /// The coarse faces against the original: the largest distance, and that of each face.
    pub fn back(&self, bound: f64, fine: &Fine<'_>) -> (f64, Vec<f32>) {
        let image = self.image(bound, fine);
        let tasks: Vec<(f64, Vec<f32>)> = (0..self.target.faces.len())
            .collect::<Vec<_>>()
            .par_chunks(64)
            .map(|own| {
                let mut bound = bound;
                let far = own.iter().map(|t| match image.covered[*t] {
                    true => up(image.far[*t]),
                    false => up(self.cut_back(*t as u32, fine, &mut bound)),
                });
                let far = far.collect();
                (bound, far)
            })
            .collect();
        let bound = tasks.iter().map(|t| t.0).fold(bound, f64::max);
        (bound, tasks.into_iter().flat_map(|t| t.1).collect())
    }

    /// A coarse face is cut up along the fine ones, whose known distances add to that to those;
    /// where the sum is too much, the original itself is asked.
    fn cut_back(&self, face: u32, fine: &Fine<'_>, bound: &mut f64) -> f64 {
        let piece = Piece::new(&self.target.corners(face));
        let mut far: f64 = 0.0;
        let from = fine.face_at[self.target.faces[face as usize][0] as usize];
        fine.target.part(&piece, from, &mut |t, part, away, _| {
            let sum = away + f64::from(fine.known[t as usize]);
            if sum <= *bound {
                far = far.max(sum);
                return;
            }
            let vertex = fine.ids[fine.target.faces[t as usize][0] as usize];
            self.asked(part, vertex, fine, bound, &mut far);
        });
        far
    }

    /// A part of a coarse face near a fine vertex against the original, and first against the
    /// earlier surface: raises `far`, and `bound` where need be.
    fn asked(&self, part: &Piece, vertex: u32, fine: &Fine<'_>, bound: &mut f64, far: &mut f64) {
        let places = fine.places;
        let original = |part: &Piece, vertex: u32, bound: &mut f64, far: &mut f64| {
            let start = places.face_at[vertex as usize];
            self.original.target.cover(part, start, bound, |_, _, d, _| *far = far.max(d));
        };
        let Some(earlier) = fine.earlier else {
            return original(part, vertex, bound, far);
        };
        // What moved since was somewhere then.
        let at = |v: u32| earlier.face_at.get(v as usize).copied().unwrap_or(NONE);
        let mut then = vertex;
        while at(then) == NONE {
            match places.before[then as usize] {
                NONE => return original(part, vertex, bound, far),
                before => then = before,
            }
        }
        let target = Target {
            positions: &places.positions,
            normals: &places.normals,
            faces: &earlier.faces,
            beside: &earlier.beside,
            ..self.original.target
        };
        target.part(part, at(then), &mut |t, part, away, _| {
            let sum = away + f64::from(earlier.known[t as usize]);
            if sum <= *bound {
                *far = far.max(sum);
            } else {
                original(part, earlier.faces[t as usize][0], bound, far);
            }
        });
    }

    /// Lays the fine faces upon the coarse ones.
    pub fn image(&self, bound: f64, fine: &Fine<'_>) -> Image {
        let limit2 = bound * bound;
        let (coarse, faces) = (&self.target, fine.target.faces);
        let at = |v: u32| fine.target.positions[v as usize].as_dvec3();
        let lands: Vec<Landing> = (0..fine.target.positions.len() as u32)
            .map(|v| match fine.target.positions[v as usize] == coarse.positions[v as usize] {
                // Gone ones have no face of their own.
                true if coarse.faces[fine.coarse_at[v as usize] as usize].contains(&v) => {
                    Landing { face: fine.coarse_at[v as usize], d2: 0.0 }
                }
                _ => coarse.land(fine.coarse_at[v as usize], at(v)),
            })
            .collect();
        let all = coarse.faces.len();
        // Coarse faces that are, or may be, on the boundary of what is laid; or too far.
        let (mut barrier, mut high) = (vec![false; all], vec![false; all]);
        let mut far = vec![0f64; all];
        let mut open = Vec::new();
        let (rim, fine_rim) = (rim(coarse), rim(&fine.target));
        let mut crossings: Vec<Crossing> = Vec::new();
        let mut led: Vec<[Led; 3]> = Vec::with_capacity(faces.len());
        let mut round = Round::default();
        for (i, f) in (0..).zip(faces) {
            round.crossings.clear();
            let mut sides = [None; 3];
            for k in 0..3 {
                let before = round.crossings.len();
                let (a, b) = (f[k], f[(k + 1) % 3]);
                let other = fine.target.beside[i as usize][k];
                if other < i {
                    // Led before, the other way.
                    let j = fine.target.beside[other as usize].iter().position(|n| *n == i);
                    let Some((first, end)) = j.and_then(|j| led[other as usize][j]) else {
                        continue;
                    };
                    let way = &crossings[first as usize..end as usize];
                    round.crossings.extend(way.iter().rev().map(|c| (k as u8, c.reversed())));
                    sides[k] = Some((first, end));
                    continue;
                }
                let (from, to) = (lands[a as usize].face, lands[b as usize].face);
                let mut along = false;
                if other == NONE {
                    let edge = [a.min(b), a.max(b)];
                    let find = |rim: &[([u32; 2], u32)]| {
                        rim.binary_search_by_key(&edge, |e| e.0).ok().map(|n| rim[n].1)
                    };
                    if let (Some(_), Some(t)) = (find(&fine_rim), find(&rim)) {
                        along = coarse.turn_about(k as u8, a, from, t, &mut round)
                            && coarse.turn_about(k as u8, b, t, to, &mut round);
                        if along {
                            open.push(t);
                        } else {
                            round.crossings.truncate(before);
                        }
                    }
                }
                let (p, q) = ((at(a), from), (at(b), to));
                let there = along || coarse.lead(k as u8, p, q, limit2, &mut round);
                if !there {
                    continue;
                }
                let way = &round.crossings[before..];
                if other == NONE && !along {
                    barrier[from as usize] = true;
                    barrier[to as usize] = true;
                    way.iter().for_each(|c| barrier[c.1.to as usize] = true);
                }
                let first = crossings.len() as u32;
                crossings.extend(way.iter().map(|c| c.1));
                sides[k] = Some((first, crossings.len() as u32));
            }
            led.push(sides);
            let own = f.map(|v| lands[v as usize]);
            let corners = f.map(at);
            let whole = sides.iter().all(Option::is_some) && own.iter().all(|l| l.d2 <= limit2);
            let laid = whole.then(|| coarse.closes(&corners, limit2, &mut round)).flatten();
            let known = f64::from(fine.known[i as usize]);
            let mut over = |t: u32| {
                let Some(middle) = laid else {
                    barrier[t as usize] = true;
                    return;
                };
                // What is on this face: corners, and crossings of its edges.
                let lie = own.iter().filter(|l| l.face == t).map(|l| l.d2);
                let cross = round.crossings.iter().filter(|c| c.1.from == t || c.1.to == t);
                let far2 = lie.chain(cross.map(|c| c.1.d2)).fold(middle, f64::max);
                let sum = far2.sqrt() + known;
                high[t as usize] |= sum > bound;
                far[t as usize] = far[t as usize].max(sum);
            };
            own.iter().for_each(|l| over(l.face));
            round.crossings.iter().for_each(|c| over(c.1.to));
        }
        let mut covered = vec![false; all];
        while let Some(t) = open.pop() {
            if !barrier[t as usize] && !covered[t as usize] {
                covered[t as usize] = true;
                open.extend(coarse.beside[t as usize].iter().filter(|n| **n != NONE));
            }
        }
        covered.iter_mut().zip(&high).for_each(|(c, h)| *c &= !h);
        Image { far, covered }
    }
}

/// Edges with one face, the lower vertex first, in order, and that face.
fn rim(of: &Target<'_>) -> Vec<([u32; 2], u32)> {
    let mut all: Vec<([u32; 2], u32)> = Vec::new();
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
