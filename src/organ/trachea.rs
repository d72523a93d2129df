//! The trachea: a chain of round, air-filled cross sections with soft tissue around them.

use glam::{DVec2, DVec3, UVec3};
use rayon::prelude::*;

use super::numbers::of_airway::trachea::*;
use super::sections::{Section, SectionRegion, SlicedMask, Slices, longest_chain};
use super::values::{MIN_HU, between, quantile};
use crate::lumen::{BitVolume, closed};
use crate::volume::Volume;

/// A chain of cross sections.
pub(super) struct Trachea {
    /// Index axis that the cross sections are perpendicular to.
    pub axis: usize,
    /// Length times mean circularity, mm.
    pub score: f64,
    /// Length of the chain, mm.
    pub length_mm: f64,
    /// Voxels about the middle of each cross section.
    pub core: BitVolume,
    /// Centre of the middle cross section.
    pub seed: UVec3,
    /// Centre of the cross section nearest to the head.
    pub upper_end: UVec3,
    /// Radius of a disc of the mean area, mm.
    pub radius_mm: f64,
    /// Standard deviation of the areas in parts of their mean.
    pub variation: f64,
    /// Distance from the chain's lower end to the volume's end there, mm.
    pub below_mm: f64,
}

/// Chains across any index axis, best first: a gut that is full of gas has some too.
pub(super) fn candidates(volume: &Volume) -> Vec<Trachea> {
    let air = between(volume, MIN_HU, AIR_HU);
    if air.is_empty() {
        return Vec::new();
    }
    let mut out: Vec<Trachea> = (0..3).flat_map(|axis| across(volume, &air, axis)).collect();
    out.sort_by(|a, b| b.score.total_cmp(&a.score));
    out
}

/// Returns chains across an axis, each the best of the sections that earlier ones left.
fn across(volume: &Volume, air: &BitVolume, axis: usize) -> Vec<Trachea> {
    let slices = Slices::of(volume, axis);
    // A ball that is flat: noise leaves pinholes in a cross section.
    let mut flat = DVec3::splat(1e9);
    (flat[slices.u], flat[slices.v]) = (1.0, 1.0);
    let air = closed(air, flat, 1.5);
    let air = SlicedMask::new(&air, &slices);
    let mut sections: Vec<Vec<Section>> = (0..volume.grid.dims[axis])
        .into_par_iter()
        .map(|slice| sections(volume, &air, &slices, slice))
        .collect();
    let reach_mm = (3.0 * slices.step_mm).max(1.5 * slices.pixel_mm.max_element()) + 1.0;
    let mut out = Vec::new();
    while out.len() < MAX_CHAINS {
        let chain = longest_chain(&sections, &slices, reach_mm, |s, b| {
            AREA_RATIO.contains(&(s.area_mm2 / b.area_mm2))
        });
        let Some(trachea) = Trachea::of(volume, &slices, &chain) else { break };
        out.push(trachea);
        for s in &chain {
            sections[s.slice as usize].retain(|other| other.centre_mm != s.centre_mm);
        }
    }
    out
}

impl Trachea {
    /// Measures a chain; `None` for one that is too short.
    fn of(volume: &Volume, slices: &Slices, chain: &[Section]) -> Option<Self> {
        let (first, last) = (chain.first()?, chain.last()?);
        let length_mm = f64::from(last.slice - first.slice) * slices.step_mm;
        if length_mm < MIN_CHAIN_MM {
            return None;
        }
        let mean = |of: fn(&Section) -> f64| chain.iter().map(of).sum::<f64>() / chain.len() as f64;
        let (area, circularity) = (mean(|s| s.area_mm2), mean(|s| s.circularity));
        let mut core = BitVolume::new(volume.grid.dims);
        for s in chain {
            let radius = CORE * (s.area_mm2 / std::f64::consts::PI).sqrt();
            let low = ((s.centre_mm - radius) / slices.pixel_mm).ceil().max(DVec2::ZERO);
            let high = ((s.centre_mm + radius) / slices.pixel_mm).floor();
            for q in low.y as usize..=(high.y as usize).min(slices.height - 1) {
                for p in low.x as usize..=(high.x as usize).min(slices.width - 1) {
                    let at = DVec2::new(p as f64, q as f64) * slices.pixel_mm;
                    if at.distance(s.centre_mm) <= radius {
                        let v = slices.voxel(s.slice, p, q);
                        core.set(v.x, v.y, v.z);
                    }
                }
            }
        }
        let centre = |section: &Section| {
            let centre = (section.centre_mm / slices.pixel_mm).round();
            slices.voxel(section.slice, centre.x as usize, centre.y as usize)
        };
        let seed = centre(&chain[chain.len() / 2]);
        let height = |v: UVec3| volume.grid.world_from_voxel().transform_point3(v.as_dvec3()).z;
        let [a, b] = [centre(first), centre(last)];
        let beyond = volume.grid.dims[slices.axis] - 1 - last.slice;
        let (upper_end, below) = if height(a) > height(b) { (a, beyond) } else { (b, first.slice) };
        let radius_mm = (area / std::f64::consts::PI).sqrt();
        let off = mean(|s| s.area_mm2 * s.area_mm2) - area * area;
        Some(Self {
            axis: slices.axis,
            score: length_mm * circularity,
            length_mm,
            core,
            seed,
            upper_end,
            radius_mm,
            variation: off.max(0.0).sqrt() / area,
            below_mm: f64::from(below) * slices.step_mm,
        })
    }
}

/// The cross sections of a slice that may be a trachea's.
fn sections(volume: &Volume, air: &SlicedMask<'_>, slices: &Slices, slice: u32) -> Vec<Section> {
    let is_trachea = |shape: &SectionRegion| {
        let section = shape.section(slices, slice, ASPECT)?;
        let is_round = AREA_MM2.contains(&section.area_mm2) && section.circularity >= CIRCULARITY;
        let ring = || shape.ring_values(volume, slices, slice, &RING);
        let has_wall = |ring: Vec<f64>| !ring.is_empty() && quantile(&ring, 0.5) >= RING_HU;
        (is_round && has_wall(ring())).then_some(section)
    };
    air.regions(slice, &AREA_MM2).iter().filter_map(is_trachea).collect()
}
