//! Backward direction of the error bound: from the coarse faces of a group to the original, by way
//! of the fine faces.
//!
//! The fine faces, which have the same boundary, are mapped onto the coarse ones
//! ([`super::surface_map`]). Every point of a covered coarse face has a fine point no farther away
//! than the map moves any, and the original is no farther from that than the known bound of the
//! fine face. Coarse faces that are not known to be covered, and those where the sum exceeds the
//! bound, are clipped along the fine faces instead.

use glam::DVec3;

use super::build::round_up;
use super::cluster_builder::ClusterBuilder;
use super::convex_polygon::ConvexPolygon;
use super::distance_bound::TargetSurface;
use super::group::VertexTable;
use super::group_error::GroupErrorMeasure;
use super::partition::{self, NO_FACE};
use super::surface_map::SurfaceMap;

/// The fine faces of a group, as the path from the coarse faces back to the original.
pub struct FineSurface<'a> {
    /// The faces, with the vertex ids of the coarse ones; the search tree is not used.
    pub target: TargetSurface<'a>,
    /// One-sided distance bound of each face to the original, mm.
    pub to_original_mm: Vec<f32>,
    /// One of the faces at each vertex.
    pub face_at: Vec<u32>,
    /// Vertex ids.
    pub ids: &'a [u32],
    /// Vertices of all levels.
    pub places: &'a VertexTable,
    /// A surface to measure to before the original.
    pub intermediate: Option<&'a IntermediateSurface>,
    /// A coarse face near each vertex.
    pub coarse_at: Vec<u32>,
}

/// A surface between the original and the fine one: three levels below the coarse one, or the
/// first.
pub struct IntermediateSurface {
    /// Faces, by vertex ids of all levels.
    pub faces: Vec<[u32; 3]>,
    /// Face across each edge.
    pub face_neighbors: Vec<[u32; 3]>,
    /// One-sided distance bound of each face to the original, mm.
    pub to_original_mm: Vec<f32>,
    /// An incident face of each of its vertices.
    pub face_at: Vec<u32>,
}

impl FineSurface<'_> {
    /// Position of a vertex, mm.
    pub fn at(&self, v: u32) -> DVec3 {
        self.target.positions[v as usize].as_dvec3()
    }
}

impl IntermediateSurface {
    /// The surface of the live clusters; `vertices`: number of vertices of all levels.
    pub fn new<'a>(
        live: impl Iterator<Item = &'a ClusterBuilder> + Clone,
        vertices: usize,
    ) -> Self {
        let faces: Vec<[u32; 3]> = live.clone().flat_map(ClusterBuilder::faces).collect();
        let mut face_at = vec![NO_FACE; vertices];
        for (f, i) in faces.iter().zip(0..) {
            f.iter().for_each(|v| face_at[*v as usize] = i);
        }
        crate::task::checkpoint();
        let face_neighbors = partition::face_neighbors(&faces, vertices);
        crate::task::checkpoint();
        Self {
            face_neighbors,
            to_original_mm: live.flat_map(|d| d.to_original_mm.iter().copied()).collect(),
            faces,
            face_at,
        }
    }
}

impl GroupErrorMeasure<'_> {
    /// One-sided distance bound from the coarse faces to the original: the largest, and that of
    /// each face. `map`: of the fine faces.
    pub fn measure_backward(
        &self,
        bound: f64,
        fine: &FineSurface<'_>,
        map: &SurfaceMap,
    ) -> (f64, Vec<f32>) {
        let far = bounds_through_map(map, &fine.to_original_mm, bound);
        let mut bound = bound;
        let far = (0..).zip(far).map(|(t, far)| match far {
            Some(far) => round_up(far),
            None => round_up(self.measure_by_clipping(t, fine, &mut bound)),
        });
        let far = far.collect();
        (bound, far)
    }

    /// Clips a coarse face along the fine ones and adds their known bounds; where the sum is too
    /// much, measures to the original.
    fn measure_by_clipping(&self, face: u32, fine: &FineSurface<'_>, bound: &mut f64) -> f64 {
        let piece = ConvexPolygon::new(&self.target.corners(face));
        let mut far: f64 = 0.0;
        let from = fine.face_at[self.target.faces[face as usize][0] as usize];
        fine.target.clip_to_faces(&piece, from, &mut |t, part, away| {
            let sum = away + f64::from(fine.to_original_mm[t as usize]);
            if sum <= *bound {
                far = far.max(sum);
                return;
            }
            let vertex = fine.ids[fine.target.faces[t as usize][0] as usize];
            self.measure_against_original(part, vertex, fine, bound, &mut far);
        });
        far
    }

    /// Measures a part of a coarse face near a fine vertex to the intermediate surface, then to the
    /// original where that is not enough: raises `far`, and `bound` where needed.
    fn measure_against_original(
        &self,
        part: &ConvexPolygon,
        vertex: u32,
        fine: &FineSurface<'_>,
        bound: &mut f64,
        far: &mut f64,
    ) {
        let places = fine.places;
        let original = |part: &ConvexPolygon, vertex: u32, bound: &mut f64, far: &mut f64| {
            let start = places.face_at[vertex as usize];
            self.original.target.bound_distance(part, start, bound, |_, _, d| *far = far.max(d));
        };
        let Some(intermediate) = fine.intermediate else {
            return original(part, vertex, bound, far);
        };
        // Vertices that moved since then: the vertex that they replace.
        let at = |v: u32| intermediate.face_at.get(v as usize).copied().unwrap_or(NO_FACE);
        let mut then = vertex;
        while at(then) == NO_FACE {
            match places.predecessor[then as usize] {
                NO_FACE => return original(part, vertex, bound, far),
                before => then = before,
            }
        }
        let target = TargetSurface {
            positions: &places.positions,
            normals: &places.normals,
            faces: &intermediate.faces,
            face_neighbors: &intermediate.face_neighbors,
            ..self.original.target
        };
        target.clip_to_faces(part, at(then), &mut |t, part, away| {
            let sum = away + f64::from(intermediate.to_original_mm[t as usize]);
            if sum <= *bound {
                *far = far.max(sum);
            } else {
                original(part, intermediate.faces[t as usize][0], bound, far);
            }
        });
    }
}

/// One-sided distance bound of each coarse face to the original by way of the fine faces that cover
/// it; `None` if they do not, or if it exceeds `bound`. `to_original_mm`: of the fine faces.
pub fn bounds_through_map(
    map: &SurfaceMap,
    to_original_mm: &[f32],
    bound: f64,
) -> Vec<Option<f64>> {
    let mut far: Vec<f64> =
        map.covered.iter().map(|c| if *c { 0.0 } else { f64::INFINITY }).collect();
    for (range, to_original_mm) in map.ranges.iter().zip(to_original_mm) {
        for (t, away) in &map.overlaps[range.clone()] {
            let sum = away + f64::from(*to_original_mm);
            far[*t as usize] = far[*t as usize].max(sum);
        }
    }
    far.into_iter().map(|f| (f.is_finite() && f <= bound).then_some(f)).collect()
}
