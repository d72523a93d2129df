//! Continuous map of the fine faces of a group onto its coarse faces.
//!
//! A side is traced once and used by both of its faces, so the map is continuous, and it is the
//! identity on the common boundary. Counted modulo 2, the images of the fine faces and the coarse
//! faces then have the same boundary, so a coarse face at the boundary is covered by images, and so
//! is its neighbour, and so on. Sides of fine faces that cannot be mapped may be boundary of the
//! image: coarse faces that they cross, and those that can be reached from the boundary only across
//! these, count as not covered.

use glam::DVec3;

use super::distance_bound::TargetSurface;
use super::partition::NO_FACE;
use super::projection::{BoundaryTrace, EdgeCrossing, ProjectedPoint};
use super::surfaces::FineSurface;

/// Result of mapping the fine faces.
pub struct SurfaceMap {
    /// Whether images of fine faces cover a coarse face.
    pub covered: Vec<bool>,
    /// Coarse faces that fine faces overlap, and the distance bound there, mm.
    pub overlaps: Vec<(u32, f64)>,
    /// Range of each fine face in `overlaps`; empty if the face could not be mapped.
    pub ranges: Vec<std::ops::Range<usize>>,
}

/// Range of the crossings of a side.
type TracedSide = Option<(u32, u32)>;
/// A boundary edge, lower vertex first, and its face.
type BoundaryEdge = ([u32; 2], u32);

/// State of the mapping.
struct SurfaceMapper<'a> {
    coarse: &'a TargetSurface<'a>,
    fine: &'a FineSurface<'a>,
    limit2: f64,
    projected: Vec<ProjectedPoint>,
    boundary: Vec<BoundaryEdge>,
    fine_boundary: Vec<BoundaryEdge>,
    crossings: Vec<EdgeCrossing>,
    /// Sides of the faces so far.
    traced: Vec<[TracedSide; 3]>,
    /// Coarse faces at the common boundary, and then all faces reached from there.
    reachable: Vec<u32>,
    /// Coarse faces that are, or may be, on the boundary of the image.
    barrier: Vec<bool>,
}

/// Maps the fine faces onto the coarse ones across edges within `limit`, mm.
pub fn map_surface(coarse: &TargetSurface<'_>, fine: &FineSurface<'_>, limit: f64) -> SurfaceMap {
    let mut mapper = SurfaceMapper::new(coarse, fine, limit * limit);
    let mut trace = BoundaryTrace::default();
    let faces = fine.target.faces;
    let mut overlaps: Vec<(u32, f64)> = Vec::with_capacity(4 * faces.len());
    let mut ranges = Vec::with_capacity(faces.len());
    for (i, f) in (0..).zip(faces) {
        let closes = mapper.face(i, &mut trace);
        let projected = f.map(|v| mapper.projected[v as usize]);
        let first = overlaps.len();
        trace.covered_faces(&projected, closes.unwrap_or(0.0), &mut overlaps);
        if closes.is_none() {
            overlaps.drain(first..).for_each(|o| mapper.barrier[o.0 as usize] = true);
        }
        ranges.push(first..overlaps.len());
    }
    SurfaceMap { covered: mapper.covered(), overlaps, ranges }
}

impl<'a> SurfaceMapper<'a> {
    fn new(coarse: &'a TargetSurface<'a>, fine: &'a FineSurface<'a>, limit2: f64) -> Self {
        let same = |v: usize| fine.target.positions[v] == coarse.positions[v];
        let projected = |v: usize| {
            let near = fine.coarse_at[v];
            // Collapsed vertices have no coarse face.
            if same(v) && coarse.faces[near as usize].contains(&(v as u32)) {
                return ProjectedPoint { face: near, d2: 0.0 };
            }
            coarse.project(near, fine.at(v as u32))
        };
        Self {
            coarse,
            fine,
            limit2,
            projected: (0..fine.target.positions.len()).map(projected).collect(),
            boundary: boundary(coarse),
            fine_boundary: boundary(&fine.target),
            crossings: Vec::new(),
            traced: Vec::with_capacity(fine.target.faces.len()),
            reachable: Vec::new(),
            barrier: vec![false; coarse.faces.len()],
        }
    }

    /// Maps the next face: returns the squared distance of the vertex that its boundary encloses, 0
    /// if none; `None` if it cannot be mapped.
    fn face(&mut self, i: u32, trace: &mut BoundaryTrace) -> Option<f64> {
        trace.crossings.clear();
        let sides = [0, 1, 2].map(|k| match self.fine.target.face_neighbors[i as usize][k] {
            other if other < i => self.reuse_side(i, other, k, trace),
            other => self.trace_new_side(i, k, other == NO_FACE, trace),
        });
        self.traced.push(sides);
        let f = self.fine.target.faces[i as usize];
        let near = f.iter().all(|v| self.projected[*v as usize].d2 <= self.limit2);
        let corners = f.map(|v| self.fine.at(v));
        (near && sides.iter().all(Option::is_some))
            .then(|| self.coarse.close_trace(&corners, self.limit2, trace))
            .flatten()
    }

    /// Reuses a side that the face `other` has traced, reversed.
    fn reuse_side(&self, i: u32, other: u32, k: usize, trace: &mut BoundaryTrace) -> TracedSide {
        let j = self.fine.target.face_neighbors[other as usize].iter().position(|n| *n == i)?;
        let (first, end) = self.traced[other as usize][j]?;
        let way = &self.crossings[first as usize..end as usize];
        trace.crossings.extend(way.iter().rev().map(|c| (k as u8, c.reversed())));
        Some((first, end))
    }

    /// Traces a side for the first time; `lone`: no other face has it.
    fn trace_new_side(
        &mut self,
        i: u32,
        k: usize,
        lone: bool,
        trace: &mut BoundaryTrace,
    ) -> TracedSide {
        let f = self.fine.target.faces[i as usize];
        let ends = [f[k], f[(k + 1) % 3]];
        let [from, to] = ends.map(|v| self.projected[v as usize].face);
        let before = trace.crossings.len();
        let along = lone && self.trace_along_boundary(k as u8, ends, trace);
        if !along {
            let [p, q] = ends.map(|v| self.fine.at(v));
            if !self.coarse.trace_side(k as u8, (p, from), (q, to), self.limit2, trace) {
                return None;
            }
        }
        let way = &trace.crossings[before..];
        if lone && !along {
            let faces = [from, to].into_iter().chain(way.iter().map(|c| c.1.to));
            faces.for_each(|t| self.barrier[t as usize] = true);
        }
        let first = self.crossings.len() as u32;
        self.crossings.extend(way.iter().map(|c| c.1));
        Some((first, self.crossings.len() as u32))
    }

    /// Traces a side that is on the boundary of both surfaces along it.
    fn trace_along_boundary(
        &mut self,
        side: u8,
        [a, b]: [u32; 2],
        trace: &mut BoundaryTrace,
    ) -> bool {
        let edge = [a.min(b), a.max(b)];
        let find = |boundary: &[BoundaryEdge]| {
            boundary.binary_search_by_key(&edge, |e| e.0).ok().map(|n| boundary[n].1)
        };
        let (Some(_), Some(t)) = (find(&self.fine_boundary), find(&self.boundary)) else {
            return false;
        };
        let before = trace.crossings.len();
        let [from, to] = [a, b].map(|v| self.projected[v as usize].face);
        let there = self.coarse.rotate_about_vertex(side, a, from, t, trace)
            && self.coarse.rotate_about_vertex(side, b, t, to, trace);
        if there {
            self.reachable.push(t);
        } else {
            trace.crossings.truncate(before);
        }
        there
    }

    /// Coarse faces that can be reached from the boundary.
    fn covered(mut self) -> Vec<bool> {
        let mut covered = vec![false; self.barrier.len()];
        while let Some(t) = self.reachable.pop() {
            if !self.barrier[t as usize] && !covered[t as usize] {
                covered[t as usize] = true;
                let face_neighbors = self.coarse.face_neighbors[t as usize];
                self.reachable.extend(face_neighbors.into_iter().filter(|n| *n != NO_FACE));
            }
        }
        covered
    }
}

/// Boundary edges, sorted.
fn boundary(of: &TargetSurface<'_>) -> Vec<BoundaryEdge> {
    let mut all: Vec<BoundaryEdge> = Vec::new();
    for ((f, face_neighbors), i) in of.faces.iter().zip(of.face_neighbors).zip(0..) {
        for k in (0..3).filter(|k| face_neighbors[*k] == NO_FACE) {
            let (a, b) = (f[k], f[(k + 1) % 3]);
            all.push(([a.min(b), a.max(b)], i));
        }
    }
    all.sort_unstable();
    let once = all.chunk_by(|a, b| a.0 == b.0).filter(|c| c.len() == 1).map(|c| c[0]);
    once.collect()
}

impl TargetSurface<'_> {
    /// Rotates about vertex `v` from one incident face to another; all crossings are at the vertex.
    fn rotate_about_vertex(
        &self,
        side: u8,
        v: u32,
        from: u32,
        to: u32,
        trace: &mut BoundaryTrace,
    ) -> bool {
        let at: DVec3 = self.positions[v as usize].as_dvec3();
        let first = trace.crossings.len();
        for way in 0..2 {
            let (mut face, mut last) = (from, NO_FACE);
            for _ in 0..64 {
                if face == to {
                    return true;
                }
                let f = self.faces[face as usize];
                let Some(corner) = f.iter().position(|w| *w == v) else { break };
                // The two edges at the corner; never back, and the other one first in the second
                // attempt.
                let mut edges = [corner, (corner + 2) % 3];
                if way == 1 && last == NO_FACE {
                    edges.reverse();
                }
                let over = |k: &usize| self.face_neighbors[face as usize][*k];
                let Some(k) = (match last {
                    NO_FACE => Some(edges[0]).filter(|k| over(k) != NO_FACE),
                    _ => edges.into_iter().find(|k| over(k) != NO_FACE && over(k) != last),
                }) else {
                    break;
                };
                let edge = [f[k], f[(k + 1) % 3]];
                let edge = [edge[0].min(edge[1]), edge[0].max(edge[1])];
                let next = over(&k);
                trace
                    .crossings
                    .push((side, EdgeCrossing { from: face, to: next, edge, at, d2: 0.0 }));
                (last, face) = (face, next);
            }
            trace.crossings.truncate(first);
        }
        false
    }
}
