//! Backward direction of the error bound: from the coarse faces of a group to the original, by way
//! of the fine faces.
//!
//! The fine faces, which have the same boundary, are mapped onto the coarse ones
//! ([`super::surface_map`]). Every point of a covered coarse face has a fine point no farther away
//! than the map moves any, and the original is no farther from that than the known bound of the
//! fine face. Coarse faces that are not known to be covered, and those where the sum exceeds the
//! bound, are clipped along the fine faces instead.

use super::convex_polygon::ConvexPolygon;
use super::distance_bound::{TargetSurface, round_up};
use super::group_error::GroupErrorMeasure;
use super::partition::NO_FACE;
use super::surface_map::SurfaceMap;
use super::surfaces::FineSurface;

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
