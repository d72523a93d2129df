//! Boundary voxels that a flight does not see.

use rayon::prelude::*;

use super::Coverage;
use crate::geometry::TriangleBvh;
use crate::lumen::Lumen;

/// Returns the boundary voxels whose wall neither way saw: field element and rank of the missed
/// patch, in element order.
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
        .filter_map(|e| {
            let centre = world.transform_point3(lumen.bricks.voxel(e).as_dvec3());
            let face = tree.closest(centre)?.at.face;
            Some((e as u32, coverage.patch_of_face[face as usize]?))
        })
        .collect()
}
