//! The aorta and its branches in a CT with contrast medium.

use super::aorta::{self, Aorta};
use super::body::PatientBody;
use super::branches::{Mouths, follow};
use super::frame::{BodyFrame, FrameSearch};
use super::gates::Gates;
use super::sections::{SlicedMask, Slices};
use super::smooth::smoothed;
use super::values::{MIN_HU, between, noise, quantile, sorted};
use super::vessel::{MAX_ML, SURE_ML, shape};
use super::{FoundOrgan, Organ, OrganError, Segment};
use crate::lumen::{BitVolume, IntensitySelection, closed, dilated, holes_filled, pieces};
use crate::volume::Volume;

/// Soft tissue, HU: thresholds of a CT lie between it and the blood, half way in the aorta and so far
/// in its branches, which organs with contrast medium surround.
const SOFT_TISSUE_HU: f64 = 45.0;
const TUBE_PART: f64 = 0.5;
const BRANCH_PART: f64 = 0.75;
/// Bone is brighter than blood by this, HU, and by so many standard deviations of the noise;
/// voxels nearer to it than this, mm, are mixed with it.
const BONE_ABOVE_HU: f64 = 120.0;
const BONE_DEVIATIONS: f64 = 4.0;
const BONE_RIM_MM: f64 = 2.0;
/// Least piece of bone, ml; gaps in its cortex that are closed, mm; largest marrow or canal that it
/// encloses in a slice, mm²: the ring of the pelvis encloses more.
const BONE_ML: f64 = 0.5;
const BONE_GAP_MM: f64 = 3.0;
const BONE_HOLE_MM2: f64 = 3000.0;
/// The aorta lies within this many of its radii about the middle of its sections, and a voxel more.
const TUBE_RADII: f64 = 1.15;
/// Greatest area of a branch and of the arch, in areas of the aorta.
const BRANCH_AREAS: f64 = 0.6;
const ARCH_AREAS: f64 = 1.6;
/// Noise above which branches are followed in a smoothed copy, HU, and its Gaussian in sides of the
/// smallest voxel side; most noise.
const NOISY_HU: f64 = 15.0;
const SMOOTHING: f64 = 0.9;
const MAX_NOISE_HU: f64 = 120.0;
/// Least share of the mask that is aorta: the rest are its branches.
const MIN_TUBE: f64 = 0.2;
/// Confidence of a chain's shape and place from which no other is looked at.
const SURE_PLACE: f64 = 0.5;
/// Most chains that a refusal names.
const LISTED: usize = 3;

/// The aorta of a CT with contrast medium, and its branches.
pub(super) fn find(volume: &Volume, gates: &Gates) -> Result<FoundOrgan, OrganError> {
    let mut refused = Vec::new();
    let (copy, factor) = aorta::coarse(volume);
    let search = FrameSearch::new(volume, &copy, factor);
    let mut placed: Vec<PlacedAorta> = Vec::new();
    for aorta in aorta::candidates(copy, factor) {
        match PlacedAorta::of(volume, aorta, &search, gates.clone()) {
            Ok(found) => placed.push(found),
            Err(why) => refused.push(why),
        }
        if placed.last().is_some_and(|found| found.gates.confidence >= SURE_PLACE) {
            break;
        }
    }
    // A vena cava may pass too, but by less.
    placed.sort_by(|a, b| b.gates.confidence.total_cmp(&a.gates.confidence));
    for PlacedAorta { aorta, around, frame, gates } in placed {
        match from_aorta(volume, &aorta, (&around, frame.as_ref()), gates) {
            Err(OrganError::NotFound { why, .. }) => {
                refused.push(format!("{}: {why}", aorta.name()));
            }
            other => return other,
        }
    }
    if refused.is_empty() {
        return Err(aorta::none(gates));
    }
    refused.truncate(LISTED);
    Err(gates.refuse(refused.join("; ")))
}

/// Bone and the marrow that it encloses in the slices across an axis, with its rim.
///
/// * `least`: least value of bone, real units; specks of it are calcified walls of vessels.
fn bone(volume: &Volume, least: f64, axis: usize) -> BitVolume {
    let grid = &volume.grid;
    let mut bone = BitVolume::new(grid.dims);
    let specks = (BONE_ML * 1000.0 / grid.voxel_mm3()).ceil() as u64;
    for piece in pieces(&between(volume, least, f64::INFINITY), specks) {
        bone.add(&piece.mask(grid.dims));
    }
    let bone = closed(&bone, grid.spacing_mm, BONE_GAP_MM);
    let mut holes = holes_filled(&bone, axis);
    holes.remove(&bone);
    let slices = Slices::of(volume, axis);
    let mut out = bone;
    let holes = SlicedMask::new(&holes, &slices);
    for slice in 0..grid.dims[axis] {
        for hole in holes.regions(slice, &(0.0..BONE_HOLE_MM2)) {
            hole.voxels(&slices, slice).for_each(|v| out.set(v.x, v.y, v.z));
        }
    }
    dilated(&out, grid.spacing_mm, BONE_RIM_MM)
}

/// A chain of sections with the shape and the place of an aorta.
struct PlacedAorta {
    aorta: Aorta,
    /// Voxels in and about it.
    around: BitVolume,
    frame: Option<BodyFrame>,
    gates: Gates,
}

impl PlacedAorta {
    /// Checks shape and place of a chain. The error is the text of the refusal.
    fn of(
        volume: &Volume,
        aorta: Aorta,
        search: &FrameSearch,
        mut gates: Gates,
    ) -> Result<Self, String> {
        let words = |e: OrganError| match e {
            OrganError::NotFound { why, .. } => format!("{}: {why}", aorta.name()),
            other => other.to_string(),
        };
        aorta.has_shape(&mut gates).map_err(words)?;
        // The spine is looked for without the aorta, which may be brighter than bone. Of vertebrae
        // nothing is left then that looks like a spine behind them.
        let more_mm = volume.grid.spacing_mm.max_element().min(1.0);
        let around = aorta.tube(volume, TUBE_RADII, more_mm);
        let frame = search.find_without(&around);
        gates.note(frame.as_ref().map_or("no spine seen".into(), BodyFrame::line));
        aorta.has_place(frame.as_ref(), &mut gates).map_err(words)?;
        Ok(Self { aorta, around, frame, gates })
    }
}

fn from_aorta(
    volume: &Volume,
    aorta: &Aorta,
    (around, frame): (&BitVolume, Option<&BodyFrame>),
    mut gates: Gates,
) -> Result<FoundOrgan, OrganError> {
    let grid = &volume.grid;
    let core = sorted(volume, aorta.tube(volume, 0.6, 0.0).voxels());
    let (blood, sigma) = (quantile(&core, 0.5), noise(&core));
    gates.at_most("noise of its blood in HU", sigma, MAX_NOISE_HU, 25.0)?;
    let calm = (sigma > NOISY_HU).then(|| {
        let sigma_mm = SMOOTHING * grid.spacing_mm.min_element();
        gates.note(format!("smoothed with a Gaussian of {sigma_mm:.2} mm against noise"));
        smoothed(volume, sigma_mm, MIN_HU)
    });
    let values = calm.as_ref().unwrap_or(volume);
    let Some(body) = PatientBody::of(volume) else { return Err(gates.refuse("no tissue")) };
    let level = |part: f64| SOFT_TISSUE_HU + part * (blood - SOFT_TISSUE_HU);
    let top = blood + BONE_ABOVE_HU.max(BONE_DEVIATIONS * sigma);
    let mut tube = between(values, level(TUBE_PART), top);
    tube.keep(around);
    let Some(tube) = pieces(&tube, 1).into_iter().next() else {
        return Err(gates.refuse("no bright voxels in it"));
    };
    let tube = tube.mask(grid.dims);
    let mut allowed = between(values, level(BRANCH_PART), top);
    allowed.keep(&body.inside);
    allowed.remove(&bone(values, top, aorta.range().0));
    // Marrow may be as bright as blood, and thick slices join both through the arteries between the ribs.
    if let Some(frame) = frame {
        allowed.remove(&frame.spine(grid.dims));
    }
    allowed.remove(around);
    allowed.add(&tube);
    let mouths = Mouths {
        tube: &tube,
        along: aorta.range(),
        side_mm2: BRANCH_AREAS * aorta.area_mm2(),
        end_mm2: ARCH_AREAS * aorta.area_mm2(),
    };
    let followed = follow(grid, &allowed, &mouths);
    let ml = grid.voxel_mm3() / 1000.0;
    let (tube_ml, branches_ml) = (tube.count() as f64 * ml, followed.mask.count() as f64 * ml);
    gates.note(format!(
        "blood {blood:.0} HU; aorta from {:.0} HU: {tube_ml:.1} ml; branches from {:.0} HU: \
         {branches_ml:.1} ml, {} taken back where they widen",
        level(TUBE_PART),
        level(BRANCH_PART),
        followed.taken_back
    ));
    let mut mask = tube;
    mask.add(&followed.mask);
    let Some(tree) = pieces(&mask, 1).into_iter().next() else {
        return Err(gates.refuse("nothing of it is left"));
    };
    let mask = tree.mask(grid.dims);
    let volume_ml = tree.component.volume_ml(grid);
    gates.at_most("vessels in ml", volume_ml, MAX_ML, SURE_ML)?;
    let part = tube_ml / volume_ml;
    gates.at_least("share of them that is aorta", part, MIN_TUBE, 0.5)?;
    let (seed, _) = shape(volume, &tree, &mask, &mut gates)?;
    Ok(FoundOrgan {
        root: None,
        organ: Organ::Vessel,
        mask,
        core: None,
        fluid: None,
        selection: IntensitySelection::Range { lo: level(TUBE_PART), hi: f64::INFINITY },
        threshold: level(TUBE_PART),
        segments: vec![Segment { seed, volume_ml }],
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}
