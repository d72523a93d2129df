//! The colon of CT colonography: large gas segments enclosed by soft tissue, and the tagged fluid
//! that lies below the gas.

use glam::{DVec3, IVec3, UVec3};

use super::airway;
use super::depth::Depth;
use super::gates::Gates;
use super::lungs::{Lungs, lung_of};
use super::values::{LEAST_HU, between, quantile, share, sorted};
use super::{FoundOrgan, Organ, OrganError, SIDES, Segment, head_foot_axis};
use crate::lumen::{
    BitVolume, IntensitySelection, Piece, dilated, fill_cavities, inside_body, opened, pieces,
    thickened,
};
use crate::volume::{Grid, Volume};

/// Highest value of gas, HU.
const GAS_HU: f64 = -800.0;
/// Highest value of gas away from walls, HU, and the share of a segment that has it.
const DEEP_GAS_HU: f64 = -900.0;
const LEAST_DEEP: f64 = 0.8;
/// Least volume of a segment, ml.
const LEAST_ML: f64 = 15.0;
/// Least value of what encloses the colon, HU, and the share of a segment's shell that has it.
const TISSUE_HU: f64 = -300.0;
const LEAST_TISSUE: f64 = 0.9;
/// Least radius of the largest sphere in a segment, mm.
const LEAST_RADIUS_MM: f64 = 6.0;
/// Least volume of all segments, ml: sinuses and a trachea hold less.
const LEAST_TOTAL_ML: f64 = 60.0;
/// Least extent of the longest segment, mm.
const LEAST_EXTENT_MM: f64 = 80.0;
/// Segments grow to here, HU, by so many voxels: half way between gas and tissue.
const WALL_HU: f64 = -450.0;
const WALL_VOXELS: usize = 2;
/// Longest voxel side at which a fold can be told from the gas beside it, mm: folds are about as thick.
const FOLD_MM: f64 = 3.0;
/// A stomach is shorter than this many of its own radii …
const STOMACH_RADII: f64 = 6.0;
/// … and lies no lower below the lungs than this, mm.
const BELOW_LUNG_MM: f64 = 40.0;

/// A piece of gas that may be colon.
struct Candidate {
    mask: BitVolume,
    volume_ml: f64,
    seed: UVec3,
    radius_mm: f64,
    /// Longest side of its box, mm.
    extent_mm: f64,
    deep: f64,
    tissue: f64,
}

pub(super) fn find(volume: &Volume, tagged: bool) -> Result<FoundOrgan, OrganError> {
    let grid = &volume.grid;
    let mut gates = Gates::new(Organ::Colon);
    let gas = between(volume, LEAST_HU, GAS_HU);
    if gas.is_empty() {
        return Err(gates.refuse(format!("no voxel of gas ({LEAST_HU} to {GAS_HU} HU)")));
    }
    let inside = inside_body(&gas, grid);
    let ml = grid.voxel_mm3() / 1000.0;
    let least = (LEAST_ML / ml).ceil() as u64;
    let airway = airway::find(volume, false).ok();
    let deep_gas = between(volume, LEAST_HU, DEEP_GAS_HU);
    let tissue = between(volume, TISSUE_HU, f64::INFINITY);
    let mut kept: Vec<Candidate> = Vec::new();
    let mut refused = Vec::new();
    let mut others = inside.clone();
    let mut parts = Vec::new();
    // No colon.
    let mut other_parts = Vec::new();
    for piece in pieces(&inside, least) {
        let mut mask = piece.mask(grid.dims);
        match lung_of(volume, &mask) {
            None => parts.push(piece),
            Some(lung) => {
                refused.push(format!(
                    "{:.0} ml of gas: lung, joined to other gas",
                    lung.count() as f64 * ml
                ));
                mask.remove(&lung);
                parts.extend(pieces(&mask, least));
                other_parts.extend(pieces(&lung, least));
            }
        }
    }
    for piece in parts {
        let candidate = Candidate::new(volume, &piece, &gas, &deep_gas, &tissue);
        let is_airway = airway.as_ref().is_some_and(|a| share(&candidate.mask, &a.mask) > 0.1);
        let why = if is_airway { Some("airway".to_owned()) } else { candidate.refusal() };
        match why {
            None => {
                others.remove(&candidate.mask);
                kept.push(candidate);
            }
            Some(why) => {
                refused.push(format!("{:.0} ml of gas: {why}", candidate.volume_ml));
                other_parts.push(piece);
            }
        }
    }
    let lungs = Lungs::of(grid, &other_parts);
    kept.retain(|c| {
        let stomach = c.looks_like_stomach(grid, lungs);
        if stomach {
            refused.push(format!(
                "{:.0} ml of gas: short, left, under the lung: stomach",
                c.volume_ml
            ));
            others.add(&c.mask);
        }
        !stomach
    });
    let mentioned = refused.iter().take(4).cloned().collect::<Vec<_>>().join("; ");
    if kept.is_empty() {
        let seen = if refused.is_empty() {
            format!("no gas of {LEAST_ML} ml or more in the body")
        } else {
            mentioned
        };
        return Err(gates.refuse(seen));
    }
    let kept = in_order(grid, kept);
    for c in &kept {
        let (v, r, d, t) = (c.volume_ml, c.radius_mm, c.deep, c.tissue);
        gates.note(format!("{v:.0} ml of gas, radius {r:.1} mm, at {}", c.seed));
        gates.at_least("its share below -900 HU", d, LEAST_DEEP, 0.95)?;
        gates.at_least("share of its shell that is tissue", t, LEAST_TISSUE, 0.97)?;
        gates.at_least("its radius in mm", r, LEAST_RADIUS_MM, 12.0)?;
    }
    if !mentioned.is_empty() {
        gates.note(format!("left out: {mentioned}"));
    }
    let total: f64 = kept.iter().map(|c| c.volume_ml).sum();
    gates.at_least("ml of gas in all", total, LEAST_TOTAL_ML, 400.0)?;
    let extent = kept.iter().map(|c| c.extent_mm).fold(0.0, f64::max);
    gates.at_least("extent of the longest segment in mm", extent, LEAST_EXTENT_MM, 200.0)?;

    let mut mask = BitVolume::new(grid.dims);
    kept.iter().for_each(|c| mask.add(&c.mask));
    let away = dilated(&others, DVec3::ONE, WALL_VOXELS as f64);
    let mut wall = between(volume, LEAST_HU, WALL_HU);
    wall.remove(&away);
    // Noise leaves specks in the gas. Folds are thin: their voxels are mixed with gas from both sides,
    // and darker than the wall elsewhere, but they are no openings.
    fill_cavities(&mut mask);
    if grid.spacing_mm.max_element() <= FOLD_MM {
        let value = |v: UVec3| volume.real(grid.index(v));
        mask = thickened(&mask, &wall, value, WALL_VOXELS);
    } else {
        for _ in 0..WALL_VOXELS {
            let mut more = dilated(&mask, DVec3::ONE, 1.0);
            more.keep(&wall);
            mask.add(&more);
        }
    }
    let mut threshold = WALL_HU;
    let mut selection = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: WALL_HU };
    if tagged {
        match fluid(volume, &mask) {
            Some(fluid) => {
                gates.note(format!(
                    "tagged fluid from {:.0} HU, {} of it: {:.0} ml in {} pools",
                    fluid.threshold,
                    fluid.below,
                    fluid.mask.count() as f64 * ml,
                    fluid.pools
                ));
                mask.add(&fluid.mask);
                fill_cavities(&mut mask);
                // Gas and fluid lie on both sides of tissue: no one range of values holds them.
                selection = IntensitySelection::Labels(Vec::new());
                threshold = fluid.threshold;
            }
            None => gates.note("no tagged fluid below the gas".into()),
        }
    }
    let segments = kept.iter().map(|c| Segment { seed: c.seed, volume_ml: c.volume_ml }).collect();
    Ok(FoundOrgan {
        organ: Organ::Colon,
        mask,
        selection,
        threshold,
        segments,
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

impl Candidate {
    fn new(
        volume: &Volume,
        piece: &Piece,
        gas: &BitVolume,
        deep_gas: &BitVolume,
        tissue: &BitVolume,
    ) -> Self {
        let grid = &volume.grid;
        let mask = piece.mask(grid.dims);
        let mut shell = dilated(&mask, DVec3::ONE, 3.0);
        shell.remove(&dilated(&mask, DVec3::ONE, 2.0));
        // Other gas is judged by itself.
        shell.remove(gas);
        let (seed, radius_mm) = Depth::of(*grid, &mask).deepest();
        let (lo, hi) = piece.bounds();
        let extent_mm = ((hi - lo).as_dvec3() * grid.spacing_mm).max_element();
        Self {
            volume_ml: piece.component.volume_ml(grid),
            deep: share(&mask, deep_gas),
            tissue: share(&shell, tissue),
            mask,
            seed,
            radius_mm,
            extent_mm,
        }
    }

    /// Why it is no colon.
    fn refusal(&self) -> Option<String> {
        let Self { deep, tissue, radius_mm, .. } = self;
        if *deep < LEAST_DEEP {
            return Some(format!("only {:.0} % below {DEEP_GAS_HU} HU", 100.0 * deep));
        }
        if *tissue < LEAST_TISSUE {
            return Some(format!("only {:.0} % of its shell is tissue", 100.0 * tissue));
        }
        let narrow = *radius_mm < LEAST_RADIUS_MM;
        narrow.then(|| format!("its widest place has a radius of {radius_mm:.1} mm"))
    }

    /// A wide, short pocket on the patient's left, right below the lungs.
    fn looks_like_stomach(&self, grid: &Grid, lungs: Option<Lungs>) -> bool {
        let Some(lungs) = lungs else { return false };
        let at = grid.world_from_voxel().transform_point3(self.seed.as_dvec3());
        let is_short = self.extent_mm < STOMACH_RADII * self.radius_mm;
        let below = lungs.lowest_mm - (at.z + self.radius_mm);
        is_short && at.x > lungs.middle_mm && below < BELOW_LUNG_MM
    }
}

/// Segments from the feet-most one on, each followed by the one with the narrowest gap to it.
fn in_order(grid: &Grid, mut left: Vec<Candidate>) -> Vec<Candidate> {
    let to_world = grid.world_from_voxel();
    // A few voxels of the rim stand for it.
    let rim = |c: &Candidate| -> Vec<DVec3> {
        let on_rim = |v: &UVec3| SIDES.iter().any(|d| !c.mask.get(v.as_ivec3() + d));
        let all: Vec<UVec3> = c.mask.voxels().filter(on_rim).collect();
        let each = all.len().div_ceil(1000).max(1);
        let some = all.iter().step_by(each);
        some.map(|v| to_world.transform_point3(v.as_dvec3())).collect()
    };
    let mut rims: Vec<Vec<DVec3>> = left.iter().map(rim).collect();
    let lowest = |r: &Vec<DVec3>| r.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    let first = (0..left.len()).min_by(|a, b| lowest(&rims[*a]).total_cmp(&lowest(&rims[*b])));
    let mut out = Vec::new();
    let mut next = first;
    while let Some(i) = next {
        let here = rims.remove(i);
        out.push(left.remove(i));
        let gap = |r: &Vec<DVec3>| {
            let to = |p: &DVec3| {
                here.iter().map(|q| p.distance_squared(*q)).fold(f64::INFINITY, f64::min)
            };
            r.iter().map(to).fold(f64::INFINITY, f64::min)
        };
        let gaps: Vec<f64> = rims.iter().map(gap).collect();
        next = (0..gaps.len()).min_by(|a, b| gaps[*a].total_cmp(&gaps[*b]));
    }
    out
}

/// Fluid with contrast medium.
struct Fluid {
    mask: BitVolume,
    /// Least value, HU.
    threshold: f64,
    pools: usize,
    /// On which side of the gas it lies.
    below: &'static str,
}

/// Least value at which fluid is looked for, HU.
const FLUID_HU: f64 = 200.0;
/// Soft tissue, HU: the threshold lies half way between it and the fluid.
const SOFT_TISSUE_HU: f64 = 40.0;
/// Fluid begins within so many voxels below gas: in between lie mixed values.
const LAYER_VOXELS: i32 = 3;
/// Least area in which a pool meets the gas, mm² …
const LEAST_CONTACT_MM2: f64 = 100.0;
/// … and least share of its top: bones and small bowel only touch.
const LEAST_CONTACT_SHARE: f64 = 0.25;

/// Fluid lies on the side of the gas that most bright voxels are on: that is down.
fn fluid(volume: &Volume, gas: &BitVolume) -> Option<Fluid> {
    let grid = &volume.grid;
    let bright = between(volume, FLUID_HU, f64::INFINITY);
    let through = head_foot_axis(grid);
    let sides = (0..3).filter(|axis| *axis != through).flat_map(|axis| {
        let mut way = IVec3::ZERO;
        way[axis] = 1;
        [way, -way]
    });
    let contacts = |down: IVec3| -> Vec<UVec3> {
        let last = |v: &UVec3| !gas.get(v.as_ivec3() + down);
        let meets = |v: UVec3| {
            let below = (1..=LAYER_VOXELS).map(|k| v.as_ivec3() + k * down);
            below.into_iter().find(|w| bright.get(*w)).map(|w| w.as_uvec3())
        };
        gas.voxels().filter(last).filter_map(meets).collect()
    };
    let found = sides.map(|down| (contacts(down), down));
    let (met, down) = found.max_by_key(|(met, _)| met.len())?;
    if met.is_empty() {
        return None;
    }
    let threshold = 0.5 * (quantile(&sorted(volume, met.into_iter()), 0.5) + SOFT_TISSUE_HU);
    let bright = between(volume, threshold, f64::INFINITY);
    let thick = opened(&bright, DVec3::ONE, 2.0);
    let face_mm2 = grid.voxel_mm3() / grid.spacing_mm[axis_of(down)];
    let mut pools = BitVolume::new(grid.dims);
    let mut count = 0;
    for pool in pieces(&thick, 8) {
        let (mut top, mut contact) = (0u64, 0u64);
        let mask = pool.mask(grid.dims);
        for v in pool.voxels().filter(|v| !mask.get(v.as_ivec3() - down)) {
            let meets = (1..=LAYER_VOXELS + 2).any(|k| gas.get(v.as_ivec3() - k * down));
            top += 1;
            contact += u64::from(meets);
        }
        let is_pool = contact as f64 * face_mm2 >= LEAST_CONTACT_MM2
            && contact as f64 >= LEAST_CONTACT_SHARE * top as f64;
        if is_pool {
            pools.add(&mask);
            count += 1;
        }
    }
    if count == 0 {
        return None;
    }
    // The pool's rim, where values are mixed with those of the wall.
    for _ in 0..3 {
        let mut more = dilated(&pools, DVec3::ONE, 1.0);
        more.keep(&bright);
        pools.add(&more);
    }
    // The layer of mixed values between gas and fluid.
    let layers: Vec<UVec3> = gas
        .voxels()
        .filter(|v| !gas.get(v.as_ivec3() + down))
        .filter_map(|v| {
            (1..=LAYER_VOXELS + 2).find(|k| pools.get(v.as_ivec3() + k * down)).map(|k| (v, k))
        })
        .flat_map(|(v, k)| (1..k).map(move |i| (v.as_ivec3() + i * down).as_uvec3()))
        .collect();
    for v in layers {
        pools.set(v.x, v.y, v.z);
    }
    let world = grid.direction * down.as_dvec3();
    let below = match (world.abs().max_position(), world.max_element() > -world.min_element()) {
        (0, true) => "to the left",
        (0, false) => "to the right",
        (1, true) => "behind",
        (1, false) => "in front",
        (_, true) => "above",
        (_, false) => "below",
    };
    Some(Fluid { mask: pools, threshold, pools: count, below })
}

fn axis_of(way: IVec3) -> usize {
    way.abs().max_position()
}
