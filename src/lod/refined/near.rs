//! Distance from a point to the refined wall.

use std::collections::HashMap;
use std::sync::{Arc, Mutex, PoisonError};

use glam::{DVec3, Vec3};

use super::grid::FaceGrid;
use super::wall::{MAX_DEPARTURE, MAX_LAST_BULGE, RefinedWall};
use crate::geometry::point_triangle_distance;

/// Splits by which a face is measured.
const LEVEL: u32 = 2;
/// Largest number of faces that are kept.
const MAX_KEPT: usize = 1 << 18;

/// A face as distances are measured to it.
#[derive(Debug)]
struct NearFace {
    /// Points after [`LEVEL`] splits.
    points: [Vec3; FaceGrid::points_at(LEVEL)],
    /// Largest distance of any drawn point of the face, at any fineness, from the triangles of these
    /// points, mm.
    departure_mm: f32,
}

/// Faces that distances were measured to.
#[derive(Debug, Default)]
pub(super) struct NearFaces(Mutex<HashMap<u32, Arc<NearFace>>>);

/// Distance from a point to the refined wall, mm.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RefinedDistance {
    /// To the faces after two splits.
    pub nominal_mm: f64,
    /// Not more than that to any drawn point, at any fineness.
    pub proven_mm: f64,
}

impl RefinedWall {
    /// Returns the distance from a point (LPS mm) to the wall at any fineness; both figures are
    /// `limit_mm` if nothing is nearer.
    ///
    /// The bound: between two levels, a point of the face moves by at most the distance of the new
    /// vertices from the middles of their edges. We measure this distance for three levels, and take
    /// the largest that it may be for the fourth.
    pub fn distance(&self, p: DVec3, limit_mm: f64) -> RefinedDistance {
        let mut best = RefinedDistance { nominal_mm: limit_mm, proven_mm: limit_mm };
        let nodes = self.octree.nodes();
        let to_box = |at: usize| {
            let (lo, hi) = (nodes[at].lo.as_dvec3(), nodes[at].hi.as_dvec3());
            (lo - p).max(p - hi).max(DVec3::ZERO).length()
        };
        let mut open: Vec<(f64, usize)> = Vec::new();
        if !nodes.is_empty() {
            open.push((to_box(0), 0));
        }
        while let Some((away, at)) = open.pop() {
            // Boxes hold the wall at any fineness.
            if away >= best.nominal_mm.max(best.proven_mm) {
                continue;
            }
            let n = &nodes[at];
            if n.is_leaf() {
                (n.first..n.first + n.count).for_each(|face| self.nearer(p, face, &mut best));
                continue;
            }
            let first = open.len();
            open.extend(self.octree.children(at).map(|child| (to_box(child), child)));
            // The nearest child is looked at first.
            open[first..].sort_unstable_by(|a, b| b.0.total_cmp(&a.0));
        }
        best
    }

    /// Lowers distances to those of a face.
    fn nearer(&self, p: DVec3, face: u32, best: &mut RefinedDistance) {
        let corners = self.faces()[face as usize].map(|v| self.position(v).as_dvec3());
        let flat = point_triangle_distance(p, corners);
        let departure = f64::from(MAX_DEPARTURE * self.longest_edge_mm(face as usize));
        if flat - departure >= best.nominal_mm.max(best.proven_mm) {
            return;
        }
        let near = self.near_face(face);
        let grid = FaceGrid::get();
        let indices = grid.indices_of(LEVEL, [LEVEL; 3]);
        let at = |i: &u32| near.points[*i as usize].as_dvec3();
        let distances = indices
            .chunks_exact(3)
            .map(|t| point_triangle_distance(p, [at(&t[0]), at(&t[1]), at(&t[2])]));
        let nominal = distances.fold(f64::INFINITY, f64::min);
        best.nominal_mm = best.nominal_mm.min(nominal);
        best.proven_mm = best.proven_mm.min((nominal - f64::from(near.departure_mm)).max(0.0));
    }

    fn near_face(&self, face: u32) -> Arc<NearFace> {
        let kept = &self.near.0;
        let locked = || kept.lock().unwrap_or_else(PoisonError::into_inner);
        if let Some(near) = locked().get(&face) {
            return Arc::clone(near);
        }
        let vertices = self.patch(face, LEVEL + 1);
        let mut bulges = [0.0f32; LEVEL as usize + 2];
        for (vertex, point) in vertices.iter().zip(&FaceGrid::get().points) {
            let bulge = vertex.own.position().distance(vertex.on_edge.position());
            bulges[point.born as usize] = bulge.max(bulges[point.born as usize]);
        }
        let departure_mm =
            bulges.iter().sum::<f32>() + MAX_LAST_BULGE * self.longest_edge_mm(face as usize);
        let points = std::array::from_fn(|i| vertices[i].own.position());
        let near = Arc::new(NearFace { points, departure_mm });
        let mut all = locked();
        if all.len() >= MAX_KEPT {
            all.clear();
        }
        all.insert(face, Arc::clone(&near));
        near
    }
}
