//! Connected patches of wall that no view saw.

use std::num::NonZeroU32;

use glam::{DVec3, Vec3};

use crate::geometry::{DisjointSets, Mesh};

/// Faces that share edges and that no view saw.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedPatch {
    /// Area, mm².
    pub area_mm2: f64,
    /// Area-weighted mean of the faces, LPS mm; may lie off a curved patch.
    pub center_mm: DVec3,
    /// Length of the path up to the eye nearest to the centre, mm; jumps between pieces do not count.
    pub arc_mm: f64,
    /// Number of faces.
    pub faces: usize,
}

/// Returns all missed patches, largest first, without their place on the path, and the number, from 1,
/// of the patch that each face belongs to.
///
/// Equally large patches stand in the order of their first faces.
pub(super) fn missed_patches(
    wall: &Mesh,
    areas: &[f32],
    missed: impl Fn(usize) -> bool,
) -> (Vec<MissedPatch>, Vec<Option<NonZeroU32>>) {
    let faces: Vec<u32> = (0..wall.faces.len()).filter(|f| missed(*f)).map(|f| f as u32).collect();
    let first_of = components(wall, &faces);
    // Sums by component, components in the order of their first faces.
    let mut order: Vec<usize> = (0..faces.len()).collect();
    order.sort_by_key(|i| first_of[*i]);
    let mut found: Vec<(MissedPatch, Vec<u32>)> = order
        .chunk_by(|a, b| first_of[*a] == first_of[*b])
        .map(|part| {
            let ids: Vec<u32> = part.iter().map(|i| faces[*i]).collect();
            (patch(wall, areas, &ids), ids)
        })
        .collect();
    found.sort_by(|a, b| b.0.area_mm2.total_cmp(&a.0.area_mm2));
    let mut patch_of_face = vec![None; wall.faces.len()];
    for (number, (_, ids)) in (1..).zip(&found) {
        ids.iter().for_each(|f| patch_of_face[*f as usize] = NonZeroU32::new(number));
    }
    (found.into_iter().map(|f| f.0).collect(), patch_of_face)
}

fn patch(wall: &Mesh, areas: &[f32], faces: &[u32]) -> MissedPatch {
    let mut area_mm2 = 0.0;
    let mut moment = DVec3::ZERO;
    for f in faces {
        let corners = wall.faces[*f as usize].map(|v| wall.positions[v as usize].as_dvec3());
        let area = f64::from(areas[*f as usize]);
        area_mm2 += area;
        moment += area / 3.0 * corners.iter().sum::<DVec3>();
    }
    let center_mm = moment / area_mm2;
    MissedPatch { area_mm2, center_mm, arc_mm: 0.0, faces: faces.len() }
}

/// Returns the length of the path up to the eye nearest to a place, mm; the first of equally near ones.
///
/// * `eyes`: positions of the eye, LPS mm, in the order flown, each with the length of the path up to it.
pub(super) fn arc_at(eyes: &[(Vec3, f64)], place: DVec3) -> f64 {
    let near = |eye: &(Vec3, f64)| eye.0.as_dvec3().distance_squared(place);
    eyes.iter().min_by(|a, b| near(a).total_cmp(&near(b))).map_or(0.0, |eye| eye.1)
}

/// Returns, for each of `faces`, ascending, the position in the list of the first face of its
/// component, connected over shared edges.
fn components(wall: &Mesh, faces: &[u32]) -> Vec<u32> {
    let mut edges: Vec<(u32, u32, u32)> = Vec::with_capacity(3 * faces.len());
    for (i, f) in faces.iter().enumerate() {
        let [a, b, c] = wall.faces[*f as usize];
        edges.extend([(a, b), (b, c), (c, a)].map(|(u, v)| (u.min(v), u.max(v), i as u32)));
    }
    edges.sort_unstable();
    let mut sets = DisjointSets::new(faces.len());
    for w in edges.windows(2) {
        if (w[0].0, w[0].1) == (w[1].0, w[1].1) {
            sets.join(w[0].2, w[1].2);
        }
    }
    (0..faces.len() as u32).map(|i| sets.root(i)).collect()
}
