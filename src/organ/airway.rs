//! Trachea and bronchi: grown from the trachea, the threshold drawn in to just before the first leak
//! into the lung (explosion control after Mori et al. 2000, doi:10.1109/42.836370). What joins is a
//! leak where it has no wall about it.

use glam::UVec3;

use super::body::PatientBody;
use super::bronchi;
use super::gates::Gates;
use super::numbers::of_airway::airway::*;
use super::smooth::smoothed;
use super::trachea::{self, Trachea};
use super::values::{MIN_HU, between, noise, quantile, share, sorted};
use super::walled::walled;
use super::{FoundOrgan, Organ, OrganError, Segment, head_foot_axis};
use crate::lumen::{BitVolume, Flood, IntensitySelection, dilated, eroded, grow, pieces};
use crate::volume::{Grid, Volume};

/// Values of most of a lung, HU.
const LUNG_RANGE_HU: (f64, f64) = (-950.0, -600.0);

/// * `thin`: look for bronchi beyond the threshold.
pub(super) fn find(volume: &Volume, thin: bool) -> Result<FoundOrgan, OrganError> {
    let mut refused = Vec::new();
    let lung_like = between(volume, LUNG_RANGE_HU.0, LUNG_RANGE_HU.1);
    let mut tried = BitVolume::new(volume.grid.dims);
    for trachea in trachea::candidates(volume) {
        let Some(seed) = seed(volume, &trachea).filter(|s| !tried.get(s.as_ivec3())) else {
            continue;
        };
        let range = IntensitySelection::Range { lo: MIN_HU, hi: LUNG_HU };
        let opens_into = grow(volume, &range, seed)?;
        match from_trachea(volume, &trachea, &opens_into, &lung_like, thin) {
            Err(OrganError::NotFound { why, .. }) => refused.push(format!(
                "{:.0} mm of round cross sections of air about voxel {}: {why}",
                trachea.length_mm, trachea.seed
            )),
            other => return other,
        }
        tried.add(&opens_into);
    }
    if refused.is_empty() {
        let none =
            "no chain of round cross sections of air with tissue around them, 15 mm or longer";
        refused.push(none.into());
    }
    refused.truncate(LISTED);
    Err(Gates::new(Organ::Airway).refuse(refused.join("; ")))
}

/// * `opens_into`: air and lung joined to the trachea.
/// * `lung_like`: all voxels with values of lung.
fn from_trachea(
    volume: &Volume,
    trachea: &Trachea,
    opens_into: &BitVolume,
    lung_like: &BitVolume,
    thin: bool,
) -> Result<FoundOrgan, OrganError> {
    let mut gates = Gates::new(Organ::Airway);
    gates.note(format!(
        "trachea: {:.0} mm of cross sections with a mean radius of {:.1} mm, across axis {}",
        trachea.length_mm,
        trachea.radius_mm,
        ["i", "j", "k"][trachea.axis]
    ));
    gates.at_least("length of the trachea, mm", trachea.length_mm, 15.0, 40.0)?;
    let ml = volume.grid.voxel_mm3() / 1000.0;
    let lung_ml = opens_into.count() as f64 * ml;
    let like_lung = share(opens_into, lung_like);
    let is_short = lung_ml < MIN_LUNG_ML;
    if is_short {
        pass_without_lung(volume, trachea, opens_into, like_lung, &mut gates)?;
    } else {
        gates.at_least(
            "air and lung that the trachea opens into, ml",
            lung_ml,
            MIN_LUNG_ML,
            1000.0,
        )?;
        gates.at_least(
            "share of this air with the values of lung",
            like_lung,
            MIN_LUNG_SHARE,
            0.8,
        )?;
    }
    let air = sorted(volume, trachea.core.voxels());
    let sigma = noise(&air);
    gates.note(format!("air of the trachea: median {:.0} HU", quantile(&air, 0.5)));
    gates.at_most("noise of the trachea's air, HU", sigma, MAX_NOISE_HU, NOISY_HU)?;

    let (mut start, mut calm) = (None, None);
    if sigma <= NOISY_HU {
        start = Start::new(volume, trachea)?;
    }
    for sides in SMOOTHING {
        if start.is_none() {
            let sigma_mm = sides * volume.grid.spacing_mm.min_element();
            let smoothed = calm.insert(smoothed(volume, sigma_mm, MIN_HU));
            start = Start::new(smoothed, trachea)?;
            gates.note(format!("smoothed with a Gaussian of {sigma_mm:.2} mm against noise"));
        }
    }
    let Some(start) = start else {
        return Err(gates.refuse(format!(
            "{:.0} % of them join up only together with more than {MAX_AIRWAY_ML} ml",
            100.0 * JOINED
        )));
    };
    let values = calm.as_ref().unwrap_or(volume);
    let tree = Tree::grown(values, &start, &mut gates)?;
    let (threshold, mut mask) = (tree.threshold, tree.mask);
    let tree_ml = mask.count() as f64 * ml;
    gates.at_most("airway, ml", tree_ml, MAX_AIRWAY_ML, 80.0)?;
    let has_wall = walled(values, mask.voxels(), |v| mask.get(v));
    gates.at_least("share of the airway's boundary that is wall", has_wall, MIN_WALLED, 0.6)?;
    if is_short {
        let area_mm2 = std::f64::consts::PI * trachea.radius_mm * trachea.radius_mm;
        let part = trachea.length_mm * area_mm2 / 1000.0 / tree_ml;
        gates.at_least("share of the airway that is trachea", part, MIN_TRACHEA, 0.6)?;
    } else {
        gates.at_most(
            "share of the lung that the airway fills",
            tree_ml / lung_ml,
            MAX_FILLED,
            0.05,
        )?;
    }
    let slice_mm = volume.grid.spacing_mm.max_element();
    if slice_mm > DOUBTFUL_SLICE_MM {
        gates.at_most("thickness of slices, mm", slice_mm, MAX_SLICE_MM, DOUBTFUL_SLICE_MM)?;
    }
    if slice_mm > THICK_MM {
        mask = without_thin(&volume.grid, &mask, start.seed, THIN_PART * slice_mm);
        let ml = mask.count() as f64 * ml;
        gates.note(format!(
            "bronchi of less than {:.1} mm radius are left out, as they are thinner than the slices \
             show: {ml:.1} ml remain",
            THIN_PART * slice_mm
        ));
    }
    if thin && slice_mm <= THICK_MM {
        match bronchi::grow(values, &mask, threshold) {
            Some(added) => {
                gates.note(format!(
                    "thin bronchi: {} pieces with {:.2} ml, {} branches behind a narrow place \
                     with {:.2} ml, closed in {} voxels where they leak",
                    added.pieces, added.ml, added.branches, added.branches_ml, added.leaks
                ));
                mask = added.mask;
            }
            None => gates.note("thin bronchi: none, as half of the tree would be added".into()),
        }
    }
    let volume_ml = mask.count() as f64 * ml;
    if !is_short && trachea.axis == head_foot_axis(&volume.grid) {
        let (lungs, trees) = (sides(volume, opens_into, trachea), sides(volume, &mask, trachea));
        if lungs > MIN_LUNG_SIDE && trees < MIN_TREE_SIDE {
            let line = format!(
                "share of the bronchi on the side that has fewer {trees:.2}, of the lung \
                 {lungs:.2}: a main bronchus may be blocked"
            );
            gates.doubt(line, ONE_SIDED);
        }
    }

    Ok(FoundOrgan {
        root: Some(trachea.upper_end),
        organ: Organ::Airway,
        mask,
        core: None,
        fluid: None,
        selection: IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: threshold },
        threshold,
        segments: vec![Segment { seed: start.seed, volume_ml }],
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

/// The part of an airway that is nowhere thinner than some balls, with its rim.
fn without_thin(grid: &Grid, mask: &BitVolume, seed: UVec3, radius_mm: f64) -> BitVolume {
    let mut thick =
        dilated(&eroded(mask, grid.spacing_mm, radius_mm), grid.spacing_mm, 2.0 * radius_mm);
    thick.keep(mask);
    let with_seed = pieces(&thick, 1).into_iter().map(|piece| piece.mask(grid.dims));
    with_seed.into_iter().find(|piece| piece.get(seed.as_ivec3())).unwrap_or_else(|| mask.clone())
}

/// Share of a mask beside the trachea, some way off, that lies on the side with less of it.
fn sides(volume: &Volume, mask: &BitVolume, trachea: &Trachea) -> f64 {
    let to_world = volume.grid.world_from_voxel();
    let x = |v: UVec3| to_world.transform_point3(v.as_dvec3()).x;
    let middle = trachea.core.voxels().map(x).sum::<f64>() / trachea.core.count().max(1) as f64;
    let off = mask.voxels().map(|v| x(v) - middle).filter(|off| off.abs() > BESIDE_MM);
    let (left, all) = off.fold((0u64, 0u64), |(l, n), off| (l + u64::from(off > 0.0), n + 1));
    left.min(all - left) as f64 / all.max(1) as f64
}

/// A trachea in a scan that ends near the carina or above it opens into little lung or none: it is an
/// even tube along the patient, and no other air is joined to it. It forks to both sides, or the scan's
/// last slice before the feet cuts it: an oesophagus full of gas ends above.
///
/// * `joined`: air and lung joined to it.
/// * `like_lung`: share of what is joined to it with the values of lung.
fn pass_without_lung(
    volume: &Volume,
    trachea: &Trachea,
    joined: &BitVolume,
    like_lung: f64,
    gates: &mut Gates,
) -> Result<(), OrganError> {
    let what = "air and lung that the trachea opens into, ml";
    let joined_ml = joined.count() as f64 * volume.grid.voxel_mm3() / 1000.0;
    let is_upright = trachea.axis == head_foot_axis(&volume.grid);
    let is_cut = trachea.below_mm <= SHORT_FROM_END_MM;
    if !is_upright || !(is_cut || sides(volume, joined, trachea) >= MIN_FORK_SIDE) {
        gates.at_least(what, joined_ml, MIN_LUNG_ML, 1000.0)?;
    }
    gates.note(format!("{what}: {joined_ml:.1}; a scan that ends near the carina, or no trachea"));
    let air_ml = joined_ml * (1.0 - like_lung);
    gates.at_most("air without the values of lung, ml", air_ml, MAX_SHORT_ML, 100.0)?;
    gates.at_least(
        "length of a trachea without lung, mm",
        trachea.length_mm,
        MIN_SHORT_MM,
        60.0,
    )?;
    // An oesophagus full of gas is longer and thinner.
    gates.at_most(
        "length of a trachea without lung, mm",
        trachea.length_mm,
        MAX_SHORT_MM,
        140.0,
    )?;
    gates.at_least("radius of the trachea, mm", trachea.radius_mm, MIN_SHORT_RADIUS_MM, 5.5)?;
    gates.at_most("radius of the trachea, mm", trachea.radius_mm, SHORT_RADIUS_MM, 11.0)?;
    let varies = trachea.variation;
    gates.at_most("variation of the trachea's sections", varies, SHORT_VARIATION, 0.2)?;
    // A hollow rail of the table is such a tube too.
    let inside = PatientBody::of(volume).map_or(0.0, |body| share(&trachea.core, &body.inside));
    gates.at_least("share of the trachea inside the body", inside, SHORT_INSIDE, 1.0)
}

/// An airway grown from the trachea to just before lung joins.
struct Tree {
    mask: BitVolume,
    threshold: f64,
}

impl Tree {
    /// The threshold rises in steps of leak control. What a step adds has a wall about it if it is
    /// bronchi, however much it is: a narrow place may hide half of the tree. Lung has none.
    fn grown(volume: &Volume, start: &Start, gates: &mut Gates) -> Result<Self, OrganError> {
        let flood = &start.flood;
        let mut level = start.level;
        let mut mask = flood.mask(level);
        let mut leak = None;
        while let Some(next) = flood.next_level(level) {
            crate::task::checkpoint();
            let mut more = mask.clone();
            flood.joined(level, next).for_each(|v| more.set(v.x, v.y, v.z));
            let added_ml = flood.volume_ml(next) - flood.volume_ml(level);
            if added_ml > JUDGED_ML {
                let has_wall = walled(volume, flood.joined(level, next), |v| more.get(v));
                let airway_ml = flood.volume_ml(next);
                if has_wall < MIN_WALLED || airway_ml > MAX_AIRWAY_ML {
                    leak = Some((added_ml, has_wall));
                    break;
                }
                if added_ml > JUMP_ML.max(JUMP_SHARE * flood.volume_ml(level)) {
                    let what = format!(
                        "share of the boundary of {added_ml:.1} ml that join at {:.0} HU that is \
                         wall",
                        flood.threshold(next)
                    );
                    gates.at_least(&what, has_wall, MIN_WALLED, 0.6)?;
                }
            }
            (level, mask) = (next, more);
        }
        let threshold = flood.threshold(level);
        let volume_ml = flood.volume_ml(level);
        match leak {
            None => {
                gates.note(format!("threshold {threshold:.0}: {volume_ml:.1} ml, no leak above"))
            }
            Some((added_ml, has_wall)) => {
                gates.note(format!(
                    "threshold {threshold:.0}: {volume_ml:.1} ml; 8 higher {added_ml:.0} ml join"
                ));
                if added_ml > JUMP_ML && volume_ml + added_ml <= MAX_AIRWAY_ML {
                    let what = "share of the boundary of what leaks that is wall";
                    gates.at_most(what, has_wall, MIN_WALLED, 0.3)?;
                }
            }
        }
        Ok(Self { mask, threshold })
    }
}

/// Seed and level from which the airway is grown.
struct Start {
    flood: Flood,
    seed: UVec3,
    /// The level at which the trachea has joined up.
    level: usize,
}

impl Start {
    /// Returns `None` where the trachea joins up only together with more than an airway holds.
    fn new(volume: &Volume, trachea: &Trachea) -> Result<Option<Self>, OrganError> {
        let Some(seed) = seed(volume, trachea) else { return Ok(None) };
        let range = IntensitySelection::Range { lo: MIN_HU, hi: LUNG_HU };
        let flood = Flood::new(volume, &range, seed, MAX_FLOOD_ML)?;
        let Some(level) = flood.level_of_share(&trachea.core, JOINED) else { return Ok(None) };
        let joined = flood.volume_ml(level) <= MAX_AIRWAY_ML;
        Ok(joined.then_some(Self { flood, seed, level }))
    }
}

/// The darkest voxel of the trachea's core near its middle: noise may have made any one bright.
fn seed(volume: &Volume, trachea: &Trachea) -> Option<UVec3> {
    let real = |v: &UVec3| volume.real(volume.grid.index(*v));
    let off = |v: &UVec3| v.as_ivec3().distance_squared(trachea.seed.as_ivec3());
    let is_padding = |v: &UVec3| volume.is_padding(volume.samples.get(volume.grid.index(*v)));
    let inside = |v: &UVec3| (MIN_HU..=LUNG_HU).contains(&real(v)) && !is_padding(v);
    let core = || trachea.core.voxels().filter(inside);
    let least = core().map(|v| off(&v)).min()?;
    core()
        .filter(|v| off(v) <= least + 9)
        .min_by(|a, b| real(a).total_cmp(&real(b)).then(off(a).cmp(&off(b))))
}
