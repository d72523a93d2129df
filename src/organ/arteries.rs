//! The aorta and its branches in a CT with contrast medium.

use super::aorta::{self, Aorta, SectionContent};
use super::body::PatientBody;
use super::branches::{Mouths, follow};
use super::frame::{BodyFrame, FrameSearch};
use super::gates::Gates;
use super::numbers::of_vessel::arteries::*;
use super::sections::{SlicedMask, Slices};
use super::smooth::smoothed;
use super::values::{MIN_HU, between, noise, quantile, sorted};
use super::vessel::{MAX_ML, SURE_ML, shape};
use super::{FoundOrgan, Organ, OrganError, Segment};
use crate::lumen::{BitVolume, IntensitySelection, closed, dilated, holes_filled, pieces};
use crate::volume::Volume;

const PARTED: &str =
    "its sections hold more than blood: a flap between two lumens, a stent or clot";

/// The aorta of a CT with contrast medium, and its branches: sections of even blood come first. Without
/// an aorta among them, sections with a flap, a stent or clot are searched.
pub(super) fn find(volume: &Volume, gates: &Gates) -> Result<FoundOrgan, OrganError> {
    let (copy, factor) = aorta::coarse(volume);
    let search = FrameSearch::new(volume, &copy, factor);
    let mut refused = Vec::new();
    for content in [SectionContent::Even, SectionContent::Parted] {
        let chains = aorta::candidates(&copy, factor, content);
        let mut found = ShapedChains::of(volume, &chains, &search, gates, true);
        found.shaped.sort_by(|a, b| b.gates.confidence.total_cmp(&a.gates.confidence));
        if content == SectionContent::Even {
            refused.append(&mut found.refused);
        }
        let vessels = found.vessels();
        for mut chain in found.shaped {
            let name = chain.aorta.name();
            let made = match chain.refusal(&vessels) {
                Some(why) => Err(why),
                None if content == SectionContent::Parted && chain.frame.is_none() => continue,
                None => {
                    if content == SectionContent::Parted {
                        chain.gates.doubt(PARTED.into(), UNEVEN);
                    }
                    let veins: Vec<&Aorta> = chains.iter().filter(|c| chain.is_vein(c)).collect();
                    from_aorta(volume, chain, &veins)
                }
            };
            match made {
                Err(OrganError::NotFound { why, .. }) => refused.push(format!("{name}: {why}")),
                other => return other,
            }
        }
    }
    if refused.is_empty() {
        return Err(aorta::none(gates));
    }
    refused.truncate(LISTED);
    Err(gates.refuse(refused.join("; ")))
}

/// Describes the patient's frame and each chain of bright sections with its name: a line each.
pub(super) fn named(volume: &Volume) -> Vec<String> {
    let (copy, factor) = aorta::coarse(volume);
    let search = FrameSearch::new(volume, &copy, factor);
    let frame = search.find_without(&BitVolume::new(volume.grid.dims));
    let mut lines = vec![frame.map_or("no spine seen".into(), |frame| frame.line())];
    let chains = aorta::candidates(&copy, factor, SectionContent::Even);
    let found = ShapedChains::of(volume, &chains, &search, &Gates::new(Organ::Vessel), false);
    let vessels = found.vessels();
    for chain in &found.shaped {
        let words = match chain.refusal(&vessels) {
            None => "aorta".into(),
            Some(OrganError::NotFound { why, .. }) if chain.is_vertebrae() => {
                format!("vertebrae; else aorta ({why})")
            }
            Some(OrganError::NotFound { why, .. }) => format!("other vessel; else aorta ({why})"),
            Some(other) => other.to_string(),
        };
        lines.push(format!("{}: {words}", chain.aorta.name()));
    }
    lines.extend(found.refused.iter().map(|line| format!("other; else aorta: {line}")));
    lines
}

/// Chains of bright sections, sorted by shape.
struct ShapedChains<'a> {
    shaped: Vec<ShapedChain<'a>>,
    /// Texts of the refusals of the others.
    refused: Vec<String>,
}

impl<'a> ShapedChains<'a> {
    /// * `until_sure`: whether to end with a chain that leaves no doubt.
    fn of(
        volume: &Volume,
        chains: &'a [Aorta],
        search: &FrameSearch,
        gates: &Gates,
        until_sure: bool,
    ) -> Self {
        let mut out = Self { shaped: Vec::new(), refused: Vec::new() };
        for (i, aorta) in chains.iter().enumerate() {
            match ShapedChain::of(volume, aorta, search, gates.clone()) {
                Ok(found) => out.shaped.push(found),
                Err(OrganError::NotFound { why, .. }) => {
                    out.refused.push(format!("{}: {why}", aorta.name()));
                }
                Err(other) => out.refused.push(other.to_string()),
            }
            let has_rival = |found: &ShapedChain| {
                chains[i + 1..].iter().any(|other| other.is_artery_beside(found.aorta))
            };
            if until_sure && out.shaped.last().is_some_and(|c| c.is_sure() && !has_rival(c)) {
                break;
            }
        }
        out
    }

    /// The chains that are no vertebrae.
    fn vessels(&self) -> Vec<&'a Aorta> {
        let vessels = self.shaped.iter().filter(|chain| !chain.is_vertebrae());
        vessels.map(|chain| chain.aorta).collect()
    }
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

/// A chain of sections with the shape of an aorta.
struct ShapedChain<'a> {
    aorta: &'a Aorta,
    /// Voxels in and about it.
    around: BitVolume,
    frame: Option<BodyFrame>,
    gates: Gates,
    /// Whether its place is that of an aorta.
    place: Result<(), OrganError>,
}

impl<'a> ShapedChain<'a> {
    /// Checks shape and place of a chain.
    ///
    /// # Errors
    /// [`OrganError::NotFound`] for another shape.
    fn of(
        volume: &Volume,
        aorta: &'a Aorta,
        search: &FrameSearch,
        mut gates: Gates,
    ) -> Result<Self, OrganError> {
        aorta.has_shape(&mut gates)?;
        // The spine is looked for without the aorta, which may be brighter than bone. Of vertebrae
        // nothing is left then that looks like a spine behind them.
        let more_mm = volume.grid.spacing_mm.max_element().min(1.0);
        let around = aorta.tube(volume, TUBE_RADII, more_mm);
        let frame = search.find_without(&around);
        match &frame {
            Some(frame) => gates.note(frame.line()),
            None => gates.doubt("no spine seen, which tells aorta from vena cava".into(), NO_SPINE),
        }
        let place = aorta.has_place(frame.as_ref(), &mut gates);
        Ok(Self { aorta, around, frame, gates, place })
    }

    /// Why it is no aorta: it lies elsewhere, or is darker than a vessel beside it.
    fn refusal(&self, vessels: &[&Aorta]) -> Option<OrganError> {
        if let Err(why) = &self.place {
            return Some(why.clone());
        }
        let artery = vessels.iter().find(|other| other.is_artery_beside(self.aorta))?;
        Some(self.gates.refuse(format!("a vein beside {}", artery.name())))
    }

    fn is_sure(&self) -> bool {
        self.place.is_ok() && self.gates.confidence >= SURE_PLACE
    }

    fn is_vertebrae(&self) -> bool {
        self.frame.as_ref().is_some_and(|frame| self.aorta.is_vertebrae(frame))
    }

    /// Whether another chain is a vein beside it.
    fn is_vein(&self, chain: &Aorta) -> bool {
        let is_cava = |frame: &BodyFrame| chain.is_vena_cava(self.aorta, frame);
        self.frame.as_ref().is_some_and(is_cava) || self.aorta.is_artery_beside(chain)
    }
}

/// * `veins`: chains beside the aorta that its branches do not enter.
fn from_aorta(
    volume: &Volume,
    found: ShapedChain<'_>,
    veins: &[&Aorta],
) -> Result<FoundOrgan, OrganError> {
    let ShapedChain { aorta, around, frame, mut gates, .. } = found;
    let grid = &volume.grid;
    let core = sorted(volume, aorta.tube(volume, 0.6, 0.0).voxels());
    let (blood, sigma) = (quantile(&core, 0.5), noise(&core));
    gates.at_most("noise of the blood, HU", sigma, MAX_NOISE_HU, 25.0)?;
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
    tube.keep(&around);
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
    for vein in veins {
        gates.note(format!("a vein beside it: {}", vein.name()));
        allowed.remove(&vein.tube(volume, TUBE_RADII, 0.0));
    }
    allowed.remove(&around);
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
    gates.at_most("vessels, ml", volume_ml, MAX_ML, SURE_ML)?;
    let part = tube_ml / volume_ml;
    gates.at_least("share of the vessels that is aorta", part, MIN_TUBE, 0.5)?;
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
