//! The aorta in a CT with contrast medium: a chain of round, even, bright cross sections beside bone.
//!
//! No single threshold separates an aorta from the spine, the heart and the veins beside it. So
//! sections are looked for at several thresholds on a coarse copy of the volume, as those of the
//! trachea are in air. Heart chambers and kidneys are not round, vertebrae are not even, and none
//! of them keeps its position and area from slice to slice. An aorta lies in front of the spine or to
//! the left of it; where the spine is not seen, bone has to lie beside it.

use glam::{DVec2, DVec3, UVec3};
use rayon::prelude::*;

use super::OrganError;
use super::coarse::{block_means, noise_between_neighbours};
use super::frame::BodyFrame;
use super::gates::Gates;
use super::numbers::of_vessel::aorta::*;
use super::sections::{Section, SectionRegion, SlicedMask, Slices, longest_chain};
use super::smooth::smoothed;
use super::values::{MIN_HU, between, quantile};
use super::vertebrae::VERTEBRA_MM;
use crate::lumen::{BitVolume, opened};
use crate::volume::Volume;

/// Median distance to the left of the spine's middle from which a chain is no vena cava, mm, and from
/// which there is no doubt.
const MIN_LEFT_MM: (f64, f64) = (-14.0, -2.0);

/// Content of a section.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum SectionContent {
    /// Blood of one value.
    Even,
    /// Blood with a flap between two lumens, with the wires of a stent or with clot.
    Parted,
}

impl SectionContent {
    /// Value of the blood; `None` for values that are no such content.
    ///
    /// * `values`: of a section, sorted.
    fn blood_hu(self, values: &[f64]) -> Option<f64> {
        let n = values.len() as f64;
        let median = quantile(values, 0.5);
        let mean = values.iter().sum::<f64>() / n;
        let fits = match self {
            Self::Even => {
                let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>() / n;
                variance.sqrt() <= MAX_SPREAD_HU
            }
            Self::Parted => {
                let alike = values.iter().filter(|v| (*v - median).abs() <= MAX_SPREAD_HU).count();
                alike as f64 >= MIN_ALIKE * n
            }
        };
        (values.len() >= 4 && fits && median <= MAX_BLOOD_HU).then_some(median)
    }
}

/// A chain of sections.
pub(super) struct Aorta {
    slices: Slices,
    chain: Vec<Section>,
    /// Number of the volume's voxels along each side of a coarse voxel.
    factor: UVec3,
    score: f64,
    contrast_hu: f64,
    /// Whether bone lies beside each section.
    is_beside_bone: Vec<bool>,
    beside_gas: f64,
}

/// The copy in which sections are looked for, and the number of the volume's voxels along each side of
/// one of its voxels.
pub(super) fn coarse(volume: &Volume) -> (Volume, UVec3) {
    block_means(volume, DVec3::splat(COARSE_MM))
}

/// Chains across any index axis of a coarse copy, best first.
pub(super) fn candidates(coarse: &Volume, factor: UVec3, content: SectionContent) -> Vec<Aorta> {
    let sigma_mm = SMOOTHING * coarse.grid.spacing_mm.min_element();
    let is_noisy = noise_between_neighbours(coarse) > NOISY_HU;
    let calm = is_noisy.then(|| smoothed(coarse, sigma_mm, MIN_HU));
    let coarse = calm.as_ref().unwrap_or(coarse);
    let axes = (0..3).flat_map(|axis| across(coarse, factor, axis, content));
    let mut out: Vec<Aorta> = axes.collect();
    out.sort_by(|a, b| b.score.total_cmp(&a.score));
    out
}

fn across(coarse: &Volume, factor: UVec3, axis: usize, content: SectionContent) -> Vec<Aorta> {
    let slices = Slices::of(coarse, axis);
    let mut flat = DVec3::splat(1e9);
    (flat[slices.u], flat[slices.v]) = (1.0, 1.0);
    let mut sections: Vec<Vec<(Section, f64)>> = vec![Vec::new(); coarse.grid.dims[axis] as usize];
    for level in LEVELS_HU {
        crate::task::checkpoint();
        let bright = opened(&between(coarse, level, f64::INFINITY), flat, 1.0);
        let bright = SlicedMask::new(&bright, &slices);
        let of = |slice: usize| sections_of(coarse, &bright, &slices, slice as u32, content);
        let found: Vec<_> = (0..sections.len()).into_par_iter().map(of).collect();
        sections.iter_mut().zip(found).for_each(|(all, found)| all.extend(found));
    }
    let contrast_of = |s: &Section, among: &[Vec<(Section, f64)>]| {
        let same = among[s.slice as usize].iter().find(|o| o.0.centre_mm == s.centre_mm);
        same.map_or(0.0, |o| o.1)
    };
    let with_contrast = sections;
    let mut sections: Vec<Vec<Section>> =
        with_contrast.iter().map(|s| s.iter().map(|s| s.0.clone()).collect()).collect();
    let reach_mm = REACH_MM.max(slices.step_mm).max(1.2 * slices.pixel_mm.max_element());
    let mut out = Vec::new();
    while out.len() < MAX_CHAINS {
        let chain = longest_chain(&sections, &slices, reach_mm, |a, b| {
            AREA_RATIO.contains(&(a.area_mm2 / b.area_mm2))
                && (a.value - b.value).abs() <= VALUE_STEP_HU
        });
        let (Some(first), Some(last)) = (chain.first(), chain.last()) else { break };
        let length_mm = f64::from(last.slice - first.slice) * slices.step_mm;
        if length_mm < MIN_CHAIN_MM {
            break;
        }
        for s in &chain {
            let near = (s.area_mm2 / std::f64::consts::PI).sqrt();
            sections[s.slice as usize].retain(|o| o.centre_mm.distance(s.centre_mm) > near);
        }
        let n = chain.len() as f64;
        let round = chain.iter().map(|s| s.circularity).sum::<f64>() / n;
        let contrast = chain.iter().map(|s| contrast_of(s, &with_contrast)).sum::<f64>() / n;
        let beside: Vec<(bool, bool)> = chain.iter().map(|s| beside(coarse, &slices, s)).collect();
        out.push(Aorta {
            slices,
            factor,
            score: length_mm * round,
            contrast_hu: contrast,
            is_beside_bone: beside.iter().map(|b| b.0).collect(),
            beside_gas: beside.iter().filter(|b| b.1).count() as f64 / n,
            chain,
        });
    }
    out
}

/// The sections of a slice, each with its contrast.
fn sections_of(
    volume: &Volume,
    bright: &SlicedMask<'_>,
    slices: &Slices,
    slice: u32,
    content: SectionContent,
) -> Vec<(Section, f64)> {
    let section = |shape: &SectionRegion| {
        let mut section = shape.section(slices, slice, ASPECT)?;
        let is_round = AREA_MM2.contains(&section.area_mm2) && section.circularity >= CIRCULARITY;
        if !is_round || shape.holes > HOLES {
            return None;
        }
        section.value = content.blood_hu(&shape.inner_values(volume, slices, slice))?;
        let ring = shape.ring_values(volume, slices, slice, &RING);
        let contrast = section.value - quantile(&ring, 0.5);
        (contrast >= MIN_CONTRAST_HU).then_some((section, contrast))
    };
    bright.regions(slice, &AREA_MM2).iter().filter_map(section).collect()
}

/// Whether bone lies beside a section, and whether gas does.
fn beside(volume: &Volume, slices: &Slices, section: &Section) -> (bool, bool) {
    let least = BONE_HU.max(section.value + BONE_ABOVE_BLOOD_HU);
    let radius = section.radius_mm();
    let pixel = slices.pixel_mm.x * slices.pixel_mm.y;
    let (mut bone, mut gas) = (0.0, 0.0);
    for (p, q) in disc(slices, section.centre_mm, radius + BONE_WITHIN_MM) {
        let at = DVec2::new(p as f64, q as f64) * slices.pixel_mm;
        let off = at.distance(section.centre_mm);
        let value = volume.real(volume.grid.index(slices.voxel(section.slice, p, q)));
        if off > OWN_RADII * radius && value >= least {
            bone += pixel;
        }
        if off < radius + GAS_WITHIN_MM && value <= GAS_HU {
            gas += pixel;
        }
    }
    (bone >= BONE_MM2, gas >= GAS_MM2)
}

/// Whether a section lies before a vertebra or to its left, as an aorta does. Kidneys lie farther to the
/// side, or behind the middle of the spine.
///
/// * `off`: offset from the middle of the spine to the left and to the back, mm.
fn is_beside_vertebra(section: &Section, off: DVec2) -> bool {
    let near = section.radius_mm() + VERTEBRA_MM;
    off.length() <= near + SPINE_WITHIN_MM && off.y < 0.0 && off.x.abs() <= near + SIDE_MM
}

/// Pixels whose middle lies in a disc.
fn disc(
    slices: &Slices,
    centre_mm: DVec2,
    radius_mm: f64,
) -> impl Iterator<Item = (usize, usize)> + '_ {
    let low = ((centre_mm - radius_mm) / slices.pixel_mm).ceil().max(DVec2::ZERO);
    let high = ((centre_mm + radius_mm) / slices.pixel_mm).floor().max(DVec2::ZERO);
    let rows = low.y as usize..=(high.y as usize).min(slices.height - 1);
    let row = move |q: usize| {
        (low.x as usize..=(high.x as usize).min(slices.width - 1)).map(move |p| (p, q))
    };
    rows.flat_map(row).filter(move |(p, q)| {
        let at = DVec2::new(*p as f64, *q as f64) * slices.pixel_mm;
        at.distance(centre_mm) <= radius_mm
    })
}

impl Aorta {
    /// Describes the aorta by its length and a voxel of it, for a message.
    pub fn name(&self) -> String {
        let middle = &self.chain[self.chain.len() / 2];
        let centre = (middle.centre_mm / self.slices.pixel_mm).round();
        let at = self.slices.voxel(middle.slice, centre.x as usize, centre.y as usize);
        format!(
            "{:.0} mm of round, even, bright cross sections about voxel {}",
            self.length_mm(),
            at * self.factor + self.factor / 2
        )
    }

    fn length_mm(&self) -> f64 {
        f64::from(self.chain[self.chain.len() - 1].slice - self.chain[0].slice)
            * self.slices.step_mm
    }

    fn mean(&self, of: impl Fn(&Section) -> f64) -> f64 {
        self.chain.iter().map(of).sum::<f64>() / self.chain.len() as f64
    }

    /// Mean area of its sections, mm².
    pub fn area_mm2(&self) -> f64 {
        self.mean(|s| s.area_mm2)
    }

    /// Median value of its sections, HU.
    pub fn blood_hu(&self) -> f64 {
        let mut values: Vec<f64> = self.chain.iter().map(|s| s.value).collect();
        values.sort_by(f64::total_cmp);
        quantile(&values, 0.5)
    }

    /// Refuses a chain that has not the shape of an aorta.
    pub fn has_shape(&self, gates: &mut Gates) -> Result<(), OrganError> {
        let area = self.area_mm2();
        let radius = (area / std::f64::consts::PI).sqrt();
        let variation = (self.mean(|s| (s.area_mm2 - area).powi(2))).sqrt() / area;
        gates.note(format!(
            "{}, mean radius {radius:.1} mm, {:.0} HU",
            self.name(),
            self.blood_hu()
        ));
        gates.at_least("length of the aorta, mm", self.length_mm(), MIN_MM, 120.0)?;
        gates.at_least("radius of the aorta, mm", radius, RADIUS_MM.start, 7.0)?;
        gates.at_most("radius of the aorta, mm", radius, RADIUS_MM.end, 16.0)?;
        gates.at_most("variation of the aorta's sections", variation, MAX_VARIATION, 0.25)?;
        let contrast = self.contrast_hu;
        gates.at_least("aorta above its surroundings, HU", contrast, MIN_CONTRAST_HU, 100.0)?;
        let gas = self.beside_gas;
        gates.at_most("share of the aorta by gas", gas, MAX_BESIDE_GAS, 0.2)
    }

    /// Refuses a chain that lies elsewhere than an aorta.
    ///
    /// * `frame`: of the patient, if his spine is seen; else bone has to lie beside the chain.
    pub fn has_place(
        &self,
        frame: Option<&BodyFrame>,
        gates: &mut Gates,
    ) -> Result<(), OrganError> {
        let places = self.places(frame);
        let inside = self.share_in_spine(&places);
        gates.at_most("share of the aorta that is vertebrae", inside, MAX_IN_SPINE, 0.1)?;
        let what = "share of the aorta by the spine or bone";
        gates.at_least(what, self.beside_spine(&places), MIN_BESIDE_BONE, 0.8)?;
        if let Some(left_mm) = frame.and_then(|frame| self.left_mm(&places, frame)) {
            // A vena cava lies to the right.
            let what = "distance of the aorta to the left of the spine's middle, mm";
            gates.at_least(what, left_mm, MIN_LEFT_MM.0, MIN_LEFT_MM.1)?;
        }
        Ok(())
    }

    /// Offset of each section from the middle of the spine there, mm.
    fn places(&self, frame: Option<&BodyFrame>) -> Vec<Option<DVec2>> {
        let frame = frame.filter(|frame| frame.along() == self.slices.axis);
        let off = |s: &Section| frame.and_then(|frame| frame.offset_from_spine(self.middle(s)));
        self.chain.iter().map(off).collect()
    }

    fn share_in_spine(&self, places: &[Option<DVec2>]) -> f64 {
        let inside = places.iter().flatten().filter(|off| off.length() < IN_SPINE_MM).count();
        inside as f64 / self.chain.len() as f64
    }

    /// Whether too much of it lies in the spine for an aorta.
    pub fn is_vertebrae(&self, frame: &BodyFrame) -> bool {
        self.share_in_spine(&self.places(Some(frame))) > MAX_IN_SPINE
    }

    /// Share of its sections beside the spine, or beside bone where no spine is seen.
    fn beside_spine(&self, places: &[Option<DVec2>]) -> f64 {
        let all = self.chain.iter().zip(places).zip(&self.is_beside_bone);
        let beside = all.filter(|((section, off), is_beside_bone)| match off {
            Some(off) => is_beside_vertebra(section, *off),
            None => **is_beside_bone,
        });
        beside.count() as f64 / self.chain.len() as f64
    }

    /// Median distance to the left of the spine's middle, mm, where most of the spine beside it and the
    /// patient's sides are known.
    fn left_mm(&self, places: &[Option<DVec2>], frame: &BodyFrame) -> Option<f64> {
        let mut left: Vec<f64> = places.iter().flatten().map(|off| off.x).collect();
        left.sort_by(f64::total_cmp);
        (2 * left.len() > places.len() && !frame.is_turned).then(|| quantile(&left, 0.5))
    }

    /// Whether it is the vena cava beside an aorta: to the right of the spine, and near it.
    pub fn is_vena_cava(&self, aorta: &Self, frame: &BodyFrame) -> bool {
        let places = self.places(Some(frame));
        let is_right = self.left_mm(&places, frame).is_some_and(|mm| mm < MIN_LEFT_MM.0);
        is_right && self.runs_beside(aorta) && self.beside_spine(&places) >= BESIDE
    }

    /// Whether it is the artery of two vessels that run side by side: veins are no brighter.
    pub fn is_artery_beside(&self, other: &Self) -> bool {
        let is_brighter = self.blood_hu() > BRIGHTER * other.blood_hu();
        is_brighter && self.length_mm() >= MIN_MM && other.runs_beside(self)
    }

    /// Whether its sections lie in slices of another chain, a quarter of them at least.
    fn runs_beside(&self, other: &Self) -> bool {
        let (first, last) = (other.chain[0].slice, other.chain[other.chain.len() - 1].slice);
        let beside = self.chain.iter().filter(|s| (first..=last).contains(&s.slice)).count() as f64;
        self.slices.axis == other.slices.axis && beside >= BESIDE * self.chain.len() as f64
    }

    /// Middle of a section, voxels of the volume.
    fn middle(&self, section: &Section) -> DVec3 {
        let pixel = section.centre_mm / self.slices.pixel_mm;
        let mut at = DVec3::ZERO;
        (at[self.slices.axis], at[self.slices.u], at[self.slices.v]) =
            (f64::from(section.slice), pixel.x, pixel.y);
        (at + 0.5) * self.factor.as_dvec3() - 0.5
    }

    /// Voxels of the volume within a part of its radius, and so many mm more.
    pub fn tube(&self, volume: &Volume, part: f64, more_mm: f64) -> BitVolume {
        let fine = Slices::of(volume, self.slices.axis);
        let f = self.factor.as_dvec3();
        let (u, v, through) = (fine.u, fine.v, f[fine.axis]);
        let h = volume.grid.spacing_mm;
        // The first coarse voxel's middle lies this far from the first voxel's.
        let offset = 0.5 * DVec2::new((f[u] - 1.0) * h[u], (f[v] - 1.0) * h[v]);
        let mut out = BitVolume::new(volume.grid.dims);
        let ends = self.chain.iter().zip(self.chain.iter().skip(1).chain(self.chain.last()));
        for (a, b) in ends {
            let (from, to) = (f64::from(a.slice), f64::from(b.slice).max(f64::from(a.slice) + 1.0));
            for slice in (from * through) as u32..(to * through) as u32 {
                let t = (f64::from(slice) / through - from) / (to - from);
                let centre = a.centre_mm.lerp(b.centre_mm, t) + offset;
                let area = a.area_mm2 + t * (b.area_mm2 - a.area_mm2);
                let radius = part * (area / std::f64::consts::PI).sqrt() + more_mm;
                for (p, q) in disc(&fine, centre, radius) {
                    let v = fine.voxel(slice, p, q);
                    out.set(v.x, v.y, v.z);
                }
            }
        }
        out
    }

    /// The index axis along it, and the first and last of its slices in the volume.
    pub fn range(&self) -> (usize, u32, u32) {
        let axis = self.slices.axis;
        let slice = |s: &Section| s.slice * self.factor[axis];
        (axis, slice(&self.chain[0]), slice(&self.chain[self.chain.len() - 1]))
    }
}

/// The refusal where no chain of sections is an aorta.
pub(super) fn none(gates: &Gates) -> OrganError {
    gates.refuse(format!(
        "no chain of round, even, bright cross sections (up to {MAX_BLOOD_HU} HU, \
         {MIN_CONTRAST_HU} above their surroundings), {MIN_CHAIN_MM} mm or longer: no aorta \
         with contrast medium"
    ))
}
