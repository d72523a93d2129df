//! Trachea and bronchi: grown from the trachea, the threshold drawn in to just before the first leak
//! into the lung (explosion control after Mori et al. 2000, doi:10.1109/42.836370).

use glam::UVec3;

use super::bronchi;
use super::gates::Gates;
use super::smooth::smoothed;
use super::trachea::{self, Trachea};
use super::values::{LEAST_HU, between, noise, quantile, share, sorted};
use super::{FoundOrgan, Organ, OrganError, Segment};
use crate::lumen::{BitVolume, Flood, IntensitySelection, grow};
use crate::volume::Volume;

/// Highest value that is looked at, HU: air and lung.
const LUNG_HU: f64 = -400.0;
/// Values of most of a lung, HU.
const LUNG_RANGE_HU: (f64, f64) = (-950.0, -600.0);
/// Least volume of the air and lung that the trachea opens into, ml …
const LEAST_LUNG_ML: f64 = 300.0;
/// … and least share of it with the values of lung.
const LEAST_LUNG_SHARE: f64 = 0.5;
/// The flood ends here, ml: no airway is larger.
const MOST_FLOOD_ML: f64 = 400.0;
/// Largest airway, ml.
const MOST_AIRWAY_ML: f64 = 120.0;
/// Most chains that a refusal names.
const LISTED: usize = 4;
/// Share of the trachea's core that must have joined before a jump in volume counts as a leak.
const JOINED: f64 = 0.95;
/// Noise above which the volume is smoothed, standard deviation in HU.
const NOISY_HU: f64 = 20.0;
/// Standard deviations of the smoothing that is tried, in sides of the smallest voxel side.
const SMOOTHING: [f64; 3] = [0.6, 0.9, 1.3];

/// * `thin`: look for bronchi beyond the threshold.
pub(super) fn find(volume: &Volume, thin: bool) -> Result<FoundOrgan, OrganError> {
    let mut refused = Vec::new();
    let lung_like = between(volume, LUNG_RANGE_HU.0, LUNG_RANGE_HU.1);
    let mut tried = BitVolume::new(volume.grid.dims);
    for trachea in trachea::candidates(volume) {
        let Some(seed) = seed(volume, &trachea).filter(|s| !tried.get(s.as_ivec3())) else {
            continue;
        };
        let range = IntensitySelection::Range { lo: LEAST_HU, hi: LUNG_HU };
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
    let lung_ml = opens_into.count() as f64 * volume.grid.voxel_mm3() / 1000.0;
    gates.at_least("ml of air and lung it opens into", lung_ml, LEAST_LUNG_ML, 1500.0)?;
    let like_lung = share(opens_into, lung_like);
    gates.at_least("share of that with the values of lung", like_lung, LEAST_LUNG_SHARE, 0.8)?;
    let air = sorted(volume, trachea.core.voxels());
    let sigma = noise(&air);
    gates.note(format!("air in it: median {:.0}, noise {sigma:.0}", quantile(&air, 0.5)));

    let (mut start, mut calm) = (None, None);
    if sigma <= NOISY_HU {
        start = Start::new(volume, trachea)?;
    }
    for sides in SMOOTHING {
        if start.is_none() {
            let sigma_mm = sides * volume.grid.spacing_mm.min_element();
            let smoothed = calm.insert(smoothed(volume, sigma_mm, LEAST_HU));
            start = Start::new(smoothed, trachea)?;
            gates.note(format!("smoothed with a Gaussian of {sigma_mm:.2} mm against noise"));
        }
    }
    let Some(start) = start else {
        return Err(gates.refuse(format!(
            "{:.0} % of them join up only together with more than {MOST_AIRWAY_ML} ml",
            100.0 * JOINED
        )));
    };
    let (level, leak_ml) = start.flood.before_leak(start.level, 0);
    let threshold = start.flood.threshold(level);
    let volume_ml = start.flood.volume_ml(level);
    gates.at_most("airway in ml", volume_ml, MOST_AIRWAY_ML, 60.0)?;
    gates.note(format!(
        "threshold {threshold:.0}: {volume_ml:.1} ml; {}",
        leak_ml.map_or("no leak above it".into(), |ml| format!("8 higher it leaks to {ml:.0} ml"))
    ));

    gates.at_least("trachea in mm", trachea.length_mm, 15.0, 40.0)?;
    let mut mask = start.flood.mask(level);
    if thin {
        match bronchi::grow(calm.as_ref().unwrap_or(volume), &mask, threshold) {
            Some(added) => {
                gates.note(format!(
                    "thin bronchi: {} pieces with {:.2} ml, closed in {} voxels where they leak",
                    added.pieces, added.ml, added.leaks
                ));
                mask = added.mask;
            }
            None => gates.note("thin bronchi: none, as half of the tree would be added".into()),
        }
    }
    let volume_ml = mask.count() as f64 * volume.grid.voxel_mm3() / 1000.0;

    Ok(FoundOrgan {
        organ: Organ::Airway,
        mask,
        selection: IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: threshold },
        threshold,
        segments: vec![Segment { seed: start.seed, volume_ml }],
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

/// Where growing starts.
struct Start {
    flood: Flood,
    seed: UVec3,
    /// The level at which the trachea has joined up.
    level: usize,
}

impl Start {
    /// Nothing where the trachea joins up only together with more than an airway holds.
    fn new(volume: &Volume, trachea: &Trachea) -> Result<Option<Self>, OrganError> {
        let Some(seed) = seed(volume, trachea) else { return Ok(None) };
        let range = IntensitySelection::Range { lo: LEAST_HU, hi: LUNG_HU };
        let flood = Flood::new(volume, &range, seed, MOST_FLOOD_ML)?;
        let Some(level) = flood.level_of_share(&trachea.core, JOINED) else { return Ok(None) };
        let joined = flood.volume_ml(level) <= MOST_AIRWAY_ML;
        Ok(joined.then_some(Self { flood, seed, level }))
    }
}

/// The darkest voxel of the trachea's core near its middle: noise may have made any one bright.
fn seed(volume: &Volume, trachea: &Trachea) -> Option<UVec3> {
    let real = |v: &UVec3| volume.real(volume.grid.index(*v));
    let off = |v: &UVec3| v.as_ivec3().distance_squared(trachea.seed.as_ivec3());
    let inside = |v: &UVec3| (LEAST_HU..=LUNG_HU).contains(&real(v));
    let core = || trachea.core.voxels().filter(inside);
    let least = core().map(|v| off(&v)).min()?;
    core()
        .filter(|v| off(v) <= least + 9)
        .min_by(|a, b| real(a).total_cmp(&real(b)).then(off(a).cmp(&off(b))))
}
