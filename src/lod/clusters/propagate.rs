//! Propagation of correspondences from fine to coarse clusters.
//!
//! Each level replaces all of the original, so measuring against it anew would take as long at
//! every level. But an original face near fine faces is near the coarse faces that these overlap
//! ([`super::surface_map`]): its distance is at most the sum of both distances. The bound of a
//! group is the largest distance anywhere, so nearly everywhere this sum is within it. Only pieces
//! that may be farther, and those over faces of several clusters, are measured.

use std::cmp::Ordering;

use super::cluster_builder::Correspondence;
use super::distance_bound::round_up;
use super::surface_map::SurfaceMap;

/// Coarse faces of one cluster that a fine face overlaps.
#[derive(Clone, Copy)]
pub struct CoarseOverlap {
    /// One of the faces.
    face: u32,
    /// Cluster of the faces.
    cluster: u16,
    /// One bit for each triangle of the cluster: whether it is one of the faces.
    triangle_mask: u64,
    /// Distance bound of the fine face to them, mm.
    distance_mm: f64,
}

/// A correspondence propagated to a coarse cluster.
#[derive(Clone, Copy)]
pub struct Propagated {
    /// A coarse face near the piece.
    pub near: u32,
    /// The cluster of that face.
    pub cluster: u16,
    /// The correspondence with triangles of that cluster.
    pub corr: Correspondence,
}

impl Propagated {
    /// Distance bound, mm.
    pub fn distance_mm(&self) -> f64 {
        f64::from(self.corr.distance_mm)
    }
}

/// A propagated correspondence that waits for the bound to rise.
pub struct DeferredPatch {
    /// The propagated correspondence.
    pub to: Propagated,
    /// Index of the fine cluster among the inputs.
    pub draft: u32,
    /// Index of the piece in the fine cluster: whole faces first, then parts.
    pub piece: u32,
}

impl DeferredPatch {
    /// Order by distance, farthest first.
    pub fn farthest_first(&self, o: &Self) -> Ordering {
        let far = o.to.corr.distance_mm.total_cmp(&self.to.corr.distance_mm);
        far.then((self.draft, self.piece).cmp(&(o.draft, o.piece)))
    }
}

/// For each fine face, the coarse faces that it overlaps, if they belong to one cluster.
///
/// * `owner`: output cluster of each coarse face, and its index there.
pub fn coarse_overlaps(owner: &[(u16, u8)], map: &SurfaceMap) -> Vec<Option<CoarseOverlap>> {
    let of = |range: &std::ops::Range<usize>| {
        let overlaps = &map.overlaps[range.clone()];
        let face = overlaps.first()?.0;
        let (cluster, _) = owner[face as usize];
        let (mut triangle_mask, mut distance_mm) = (0, 0f64);
        for (face, far) in overlaps {
            let (other, triangle) = owner[*face as usize];
            if other != cluster {
                return None;
            }
            triangle_mask |= 1 << triangle;
            distance_mm = distance_mm.max(*far);
        }
        Some(CoarseOverlap { face, cluster, triangle_mask, distance_mm })
    };
    map.ranges.iter().map(of).collect()
}

/// Propagates a correspondence, if all the coarse faces that it may overlap belong to one cluster.
/// `overlaps`: of the triangles of its fine cluster.
pub fn propagate(corr: &Correspondence, overlaps: &[Option<CoarseOverlap>]) -> Option<Propagated> {
    let home = overlaps[corr.triangle()]?;
    let (mut triangle_mask, mut distance_mm) = (0, 0f64);
    for t in corr.triangles() {
        let other = overlaps[t]?;
        if other.cluster != home.cluster {
            return None;
        }
        triangle_mask |= other.triangle_mask;
        distance_mm = distance_mm.max(other.distance_mm);
    }
    let far = round_up(f64::from(corr.distance_mm) + distance_mm);
    Some(Propagated {
        near: home.face,
        cluster: home.cluster,
        corr: Correspondence { distance_mm: far, triangle_mask, ..*corr },
    })
}
