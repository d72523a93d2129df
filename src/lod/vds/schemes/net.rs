//! A triangle net whose vertices are places of a base mesh, and how places are halved and averaged
//! across its edges.

use std::collections::HashMap;

use glam::DVec3;

use crate::geometry::Vertex;
use crate::lod::vds::Original;
use crate::lod::vds::base::Base;
use crate::lod::vds::epsilon::to_triangle;

/// A place of the base: a face and weights of its corners.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Place {
    pub face: u32,
    pub weights: [f64; 3],
}

/// Vertices so far, each a place and the original there.
pub struct Net<'a> {
    pub base: &'a Base,
    original: &'a dyn Original,
    places: Vec<Place>,
    pub vertices: Vec<Vertex>,
    middles: HashMap<(u32, u32), u32>,
    /// Faces around each vertex of the base.
    around: Vec<Vec<u32>>,
}

/// Weights this close to nothing are nothing.
const TINY: f64 = 1e-9;

impl<'a> Net<'a> {
    /// The vertices of the base that its faces use keep their ids.
    pub fn new(base: &'a Base, original: &'a dyn Original) -> Self {
        let mut places = vec![Place { face: 0, weights: [0.0; 3] }; base.vertices];
        let mut around = vec![Vec::new(); base.vertices];
        for (f, face) in base.faces.iter().enumerate() {
            for c in 0..3 {
                around[face[c] as usize].push(f as u32);
                if around[face[c] as usize].len() > 1 {
                    continue;
                }
                let mut weights = [0.0; 3];
                weights[c] = 1.0;
                places[face[c] as usize] = Place { face: f as u32, weights };
            }
        }
        let at = |p: &Place| original.at(p.face, p.weights);
        let vertices = places.iter().map(at).collect();
        Self { base, original, places, vertices, middles: HashMap::new(), around }
    }

    /// Weights of a place with respect to another face: its own face, one that shares the corner
    /// or the edge it lies on, or (then `true`) the one across an edge, laid flat as a
    /// parallelogram.
    fn seen_from(&self, p: Place, face: u32) -> Option<([f64; 3], bool)> {
        if p.face == face {
            return Some((p.weights, false));
        }
        let (own, other) = (self.base.faces[p.face as usize], self.base.faces[face as usize]);
        let mut out = [0.0; 3];
        let mut apart = None;
        for (v, w) in own.iter().zip(p.weights) {
            match other.iter().position(|o| o == v) {
                Some(c) => out[c] += w,
                None if w.abs() < TINY => {}
                None if apart.is_none() => apart = Some(w),
                None => return None,
            }
        }
        let Some(w) = apart else { return Some((out, false)) };
        // The two corners that both faces have, and the one that only this has.
        let alone = (0..3).find(|c| !own.contains(&other[*c]))?;
        let shared = (0..3).filter(|c| own.contains(&other[*c])).count();
        if shared != 2 {
            return None;
        }
        for (c, out) in out.iter_mut().enumerate() {
            *out += if c == alone { -w } else { w };
        }
        Some((out, true))
    }

    /// The mean of some places that lie in one face or in two that share an edge.
    fn mean(&self, of: &[u32]) -> Option<Place> {
        let mut near: Vec<u32> = Vec::new();
        for v in of {
            let Place { face, weights } = self.places[*v as usize];
            near.push(face);
            match weights.iter().position(|w| *w > 1.0 - TINY) {
                // At a corner of the base: in each face around it.
                Some(c) => near.extend(&self.around[self.base.faces[face as usize][c] as usize]),
                None => near.extend((0..3).filter_map(|e| self.base.across(face, e))),
            }
        }
        let share = 1.0 / of.len() as f64;
        let sum = |face: u32| -> Option<(i32, f64, Place)> {
            let mut weights = [0.0; 3];
            let mut across = 0;
            for v in of {
                let (seen, flat) = self.seen_from(self.places[*v as usize], face)?;
                weights.iter_mut().zip(seen).for_each(|(w, s)| *w += share * s);
                across += i32::from(flat);
            }
            let low = weights.iter().copied().fold(f64::INFINITY, f64::min);
            Some((-across, low, Place { face, weights }))
        };
        // The face that holds most of them, then the one that the mean lies in: two vertices may be
        // neighbours and lie across an edge from each other as well.
        let mut best: Option<(i32, f64, Place)> = None;
        for p in near.into_iter().filter_map(sum) {
            if best.is_none_or(|b| (p.0, p.1) > (b.0, b.1)) {
                best = Some(p);
            }
        }
        best.map(|(.., p)| {
            let clean = p.weights.map(|w| if w < TINY { 0.0 } else { w });
            let sum: f64 = clean.iter().sum();
            Place { face: p.face, weights: clean.map(|w| w / sum) }
        })
    }

    /// The original at the mean of some vertices' places.
    fn between(&self, of: &[u32]) -> Option<(Place, Vertex)> {
        let p = self.mean(of)?;
        Some((p, self.original.at(p.face, p.weights)))
    }

    fn add(&mut self, (place, vertex): (Place, Vertex)) -> u32 {
        self.places.push(place);
        self.vertices.push(vertex);
        self.vertices.len() as u32 - 1
    }

    /// A new vertex in the middle of a triangle.
    pub fn centre(&mut self, t: [u32; 3]) -> Option<u32> {
        let new = self.between(&t)?;
        Some(self.add(new))
    }

    /// The vertex in the middle of an edge, if there is one.
    pub fn middle(&self, a: u32, b: u32) -> Option<u32> {
        self.middles.get(&(a.min(b), a.max(b))).copied()
    }

    /// The vertex in the middle of an edge, the same from both sides.
    pub fn halve(&mut self, a: u32, b: u32) -> Option<u32> {
        let key = (a.min(b), a.max(b));
        if let Some(m) = self.middles.get(&key) {
            return Some(*m);
        }
        let new = self.between(&[key.0, key.1])?;
        let m = self.add(new);
        self.middles.insert(key, m);
        Some(m)
    }

    /// Where a vertex lies, mm.
    pub fn position(&self, v: u32) -> DVec3 {
        self.vertices[v as usize].position().as_dvec3()
    }

    /// How far the original lies from a triangle, at its centre and the middles of its sides, mm.
    pub fn error_mm(&self, t: [u32; 3]) -> f64 {
        let corners = t.map(|v| self.position(v));
        let [a, b, c] = t;
        let far = |of: &[u32]| {
            self.between(of).map_or(0.0, |(_, x)| to_triangle(x.position().as_dvec3(), corners))
        };
        far(&t).max(far(&[a, b])).max(far(&[b, c])).max(far(&[c, a]))
    }
}
