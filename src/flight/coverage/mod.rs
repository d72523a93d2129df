//! Coverage: the share of the wall's area that the frames of a flight saw, and the patches they
//! missed.

mod patches;
mod sight;
mod voxels;

pub use patches::MissedPatch;
pub use sight::CoverageMap;
pub use voxels::unseen_voxels;

use std::num::NonZeroU32;

use glam::Vec3;

use crate::geometry::{Lens, Pose};

/// Least area of a missed patch that is listed by itself, mm². A reader who looks at patches of 300
/// mm² and more after a flight both ways has seen 97.9 % of a colon (Pickhardt, Taylor and Gopal
/// 2006, Surface visualization at 3D endoluminal CT colonography, Gastroenterology 130:1582).
pub const LISTED_FROM_MM2: f64 = 300.0;

/// Area, mm², above which a face has three samples instead of one.
const LARGE_FACE_MM2: f32 = 2.0;

/// Share of the wall that the frames of a flight saw, and the patches they missed.
#[derive(Clone, Debug, PartialEq)]
pub struct Coverage {
    /// Share of the wall's area that the flight as flown saw, 0 to 1; 0 of a wall without area.
    pub one_way_fraction: f64,
    /// Share that the flight as flown or the one back saw, 0 to 1.
    pub both_ways_fraction: f64,
    /// Area of the wall without caps, mm².
    pub area_mm2: f64,
    /// Patches that neither way saw, of [`LISTED_FROM_MM2`] and more, largest first.
    pub patches: Vec<MissedPatch>,
    /// Number of patches smaller than that.
    pub smaller_patches: usize,
    /// Summed area of the smaller patches, mm².
    pub smaller_patches_mm2: f64,
    /// Whether the flight as flown saw a face, one flag a face of the wall.
    pub seen_one_way: Vec<bool>,
    /// Whether either way saw a face, one flag a face of the wall.
    pub seen_both_ways: Vec<bool>,
    /// Number of the missed patch that a face belongs to, from 1, largest patch first; one entry a
    /// face. `None` for seen faces, caps and faces without area.
    pub patch_of_face: Vec<Option<NonZeroU32>>,
}

/// Computes the share of a wall's area that two sets of views saw.
///
/// * `map`: map of the wall, in which nothing was seen yet. Caps hide what is behind them but do
///   not count as wall; neither do faces without area.
/// * `forward`, `backward`: pose and lens of every frame of the flight and of the one back. A
///   lens sees what is in front of its near plane and within its field of view.
/// * `arcs_mm`: length of the path up to each view of `forward`, or of `backward` if there is no other;
///   the places of patches are told by it.
///
/// A sample of the wall is seen in a view when it lies inside the view frustum, when its face looks
/// at the eye, and when no other face of the wall meets the segment between them. The sample of
/// a face is its centroid; a face of more than 2 mm² has three, one towards each corner. A face is
/// seen when most of its samples are. The samples are those of the mesh, whatever the size of the
/// picture; the answer does not depend on the order of the views or on the number of threads.
///
/// Boxes of faces outside the frustum, boxes that lie behind the outside of a closed wall, and faces
/// already seen are passed over.
///
/// Eyes are expected inside the lumen: a closed wall whose faces look outwards is not seen from
/// outside.
pub fn coverage(
    mut map: CoverageMap<'_>,
    forward: &[(Pose, Lens)],
    backward: &[(Pose, Lens)],
    arcs_mm: &[f64],
) -> Coverage {
    map.add(forward);
    let (one_way_fraction, seen_one_way) = (map.fraction(), map.seen().to_vec());
    map.add(backward);
    let (both_ways_fraction, seen_both_ways) = (map.fraction(), map.seen().to_vec());
    // Patches need the memory that the map takes.
    let (wall, areas) = map.into_areas();
    let areas = &areas[..];
    let missed = |f: usize| areas[f] > 0.0 && !seen_both_ways[f];
    let path = if forward.is_empty() { backward } else { forward };
    let eyes: Vec<(Vec3, f64)> =
        path.iter().map(|(pose, _)| pose.position_mm).zip(arcs_mm.iter().copied()).collect();
    let (mut patches, patch_of_face) = patches::missed_patches(wall, areas, missed);
    let listed = patches.partition_point(|p| p.area_mm2 >= LISTED_FROM_MM2);
    let smaller = patches.split_off(listed);
    patches.iter_mut().for_each(|p| p.arc_mm = patches::arc_at(&eyes, p.center_mm));
    Coverage {
        one_way_fraction,
        both_ways_fraction,
        area_mm2: areas.iter().map(|a| f64::from(*a)).sum(),
        patches,
        smaller_patches: smaller.len(),
        smaller_patches_mm2: smaller.iter().map(|p| p.area_mm2).sum(),
        seen_one_way,
        seen_both_ways,
        patch_of_face,
    }
}

#[cfg(test)]
mod tests;
