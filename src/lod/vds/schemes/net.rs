//! A refined triangle mesh whose vertices are points of a base mesh, with midpoints and centres
//! computed across its edges.

use std::collections::HashMap;

use glam::DVec3;

use crate::geometry::{Vertex, point_triangle_distance};
use crate::lod::vds::Original;
use crate::lod::vds::base_mesh::BaseMesh;

/// A point of the base: a face and barycentric weights.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct BasePoint {
    pub face: u32,
    pub weights: [f64; 3],
}

/// Vertices so far, each with its base point and the original there.
pub struct RefinedNet<'a> {
    pub base: &'a BaseMesh,
    original: &'a dyn Original,
    places: Vec<BasePoint>,
    pub vertices: Vec<Vertex>,
    midpoints: HashMap<(u32, u32), u32>,
    /// Faces around each vertex of the base.
    around: Vec<Vec<u32>>,
}

/// Weights below this count as 0.
const TINY: f64 = 1e-9;

impl<'a> RefinedNet<'a> {
    /// Vertices of the base that its faces use keep their ids.
    pub fn new(base: &'a BaseMesh, original: &'a dyn Original) -> Self {
        let mut places = vec![BasePoint { face: 0, weights: [0.0; 3] }; base.vertices];
        let mut around = vec![Vec::new(); base.vertices];
        for (f, face) in base.faces.iter().enumerate() {
            for c in 0..3 {
                around[face[c] as usize].push(f as u32);
                if around[face[c] as usize].len() > 1 {
                    continue;
                }
                let mut weights = [0.0; 3];
                weights[c] = 1.0;
                places[face[c] as usize] = BasePoint { face: f as u32, weights };
            }
        }
        let at = |p: &BasePoint| original.at(p.face, p.weights);
        let vertices = places.iter().map(at).collect();
        Self { base, original, places, vertices, midpoints: HashMap::new(), around }
    }

    /// Weights of a point with respect to another face: its own face, one that shares the corner or
    /// the edge it is on, or (then `true`) the one across an edge, unfolded as a parallelogram.
    fn seen_from(&self, p: BasePoint, face: u32) -> Option<([f64; 3], bool)> {
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
        // The two common corners, and the one that only this face has.
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

    /// Mean of points that are in one face or in two that share an edge.
    fn mean(&self, of: &[u32]) -> Option<BasePoint> {
        let mut near: Vec<u32> = Vec::new();
        for v in of {
            let BasePoint { face, weights } = self.places[*v as usize];
            near.push(face);
            match weights.iter().position(|w| *w > 1.0 - TINY) {
                // At a corner of the base: all faces around it.
                Some(c) => near.extend(&self.around[self.base.faces[face as usize][c] as usize]),
                None => near.extend((0..3).filter_map(|e| self.base.across(face, e))),
            }
        }
        let share = 1.0 / of.len() as f64;
        let sum = |face: u32| -> Option<(i32, f64, BasePoint)> {
            let mut weights = [0.0; 3];
            let mut across = 0;
            for v in of {
                let (seen, flat) = self.seen_from(self.places[*v as usize], face)?;
                weights.iter_mut().zip(seen).for_each(|(w, s)| *w += share * s);
                across += i32::from(flat);
            }
            let low = weights.iter().copied().fold(f64::INFINITY, f64::min);
            Some((-across, low, BasePoint { face, weights }))
        };
        // The face that contains most of them, then the one that contains the mean: two vertices
        // may be neighbours and also be opposite across an edge.
        let mut best: Option<(i32, f64, BasePoint)> = None;
        for p in near.into_iter().filter_map(sum) {
            if best.is_none_or(|b| (p.0, p.1) > (b.0, b.1)) {
                best = Some(p);
            }
        }
        best.map(|(.., p)| {
            let clean = p.weights.map(|w| if w < TINY { 0.0 } else { w });
            let sum: f64 = clean.iter().sum();
            BasePoint { face: p.face, weights: clean.map(|w| w / sum) }
        })
    }

    /// The original at the mean of the base points of some vertices.
    fn between(&self, of: &[u32]) -> Option<(BasePoint, Vertex)> {
        let p = self.mean(of)?;
        Some((p, self.original.at(p.face, p.weights)))
    }

    fn add(&mut self, (place, vertex): (BasePoint, Vertex)) -> u32 {
        self.places.push(place);
        self.vertices.push(vertex);
        self.vertices.len() as u32 - 1
    }

    /// A new vertex at the centre of a triangle.
    pub fn centre(&mut self, t: [u32; 3]) -> Option<u32> {
        let new = self.between(&t)?;
        Some(self.add(new))
    }

    /// The vertex at the midpoint of an edge, if there is one.
    pub fn midpoint(&self, a: u32, b: u32) -> Option<u32> {
        self.midpoints.get(&(a.min(b), a.max(b))).copied()
    }

    /// The vertex at the midpoint of an edge, the same from both sides; made if there is none.
    pub fn split_edge(&mut self, a: u32, b: u32) -> Option<u32> {
        let key = (a.min(b), a.max(b));
        if let Some(m) = self.midpoints.get(&key) {
            return Some(*m);
        }
        let new = self.between(&[key.0, key.1])?;
        let m = self.add(new);
        self.midpoints.insert(key, m);
        Some(m)
    }

    /// Position of a vertex, mm.
    pub fn position(&self, v: u32) -> DVec3 {
        self.vertices[v as usize].position().as_dvec3()
    }

    /// Distance of the original from a triangle, at its centre and the midpoints of its sides, mm.
    pub fn error_mm(&self, t: [u32; 3]) -> f64 {
        let corners = t.map(|v| self.position(v));
        let [a, b, c] = t;
        let far = |of: &[u32]| {
            self.between(of)
                .map_or(0.0, |(_, x)| point_triangle_distance(x.position().as_dvec3(), corners))
        };
        far(&t).max(far(&[a, b])).max(far(&[b, c])).max(far(&[c, a]))
    }
}
