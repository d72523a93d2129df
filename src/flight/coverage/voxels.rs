//! Boundary voxels that a flight does not see.

use glam::DVec3;
use rayon::prelude::*;

use super::Coverage;
use crate::geometry::TriangleBvh;
use crate::lumen::Lumen;

/// Factor by which a limit of search exceeds the distance to a known point of the wall: the search
/// finds nothing at the limit itself, and that point was rounded.
const BEYOND: f64 = 1.0 + 1e-9;

/// Returns the boundary voxels whose wall neither way saw: field element and rank of the missed
/// patch, from 0, in element order.
///
/// * `tree`: triangles of the wall that the coverage was computed for.
///
/// A boundary voxel belongs to the face nearest to its centre and is unseen when that face is.
/// Voxels nearest to a cap are not listed: the lumen ends there, not its wall.
pub fn unseen_voxels(lumen: &Lumen, tree: &TriangleBvh, coverage: &Coverage) -> Vec<(u32, u32)> {
    if coverage.patch_of_face.iter().all(Option::is_none) {
        return Vec::new();
    }
    let world = lumen.grid.world_from_voxel();
    let elements: Vec<usize> = lumen.elements(&lumen.boundary).collect();
    elements
        .into_par_iter()
        .with_min_len(256)
        .map_init(
            || None,
            |last: &mut Option<DVec3>, e| {
                let centre = world.transform_point3(lumen.bricks.voxel(e).as_dvec3());
                // The point nearest to the voxel before is hardly ever far from this one, which
                // spares most of the search.
                let limit = last.map_or(f64::INFINITY, |p| BEYOND * p.distance(centre));
                let nearest =
                    tree.closest_within(centre, limit).or_else(|| tree.closest(centre))?;
                *last = Some(nearest.point);
                let patch = coverage.patch_of_face[nearest.at.face as usize]?;
                Some((e as u32, patch.get() - 1))
            },
        )
        .flatten_iter()
        .collect()
}
