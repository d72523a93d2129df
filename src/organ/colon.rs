//! The colon of CT colonography: large gas segments enclosed by soft tissue, and the tagged fluid
//! that lies below the gas.

use glam::{DVec3, UVec3};

use super::fluid::fluid;
use super::gas::{ColonCandidate, GAS_HU, Gas, MIN_ML};
use super::gates::Gates;
use super::numbers::of_colon::colon::*;
use super::rivals::Rival;
use super::values::{MIN_HU, between};
use super::{FoundOrgan, Organ, OrganError, Segment, TaggedFluid};
use crate::lumen::{BitVolume, IntensitySelection, dilated, fill_cavities, thickened};
use crate::volume::Volume;

pub(super) fn find(volume: &Volume, tagged: bool) -> Result<FoundOrgan, OrganError> {
    let mut gates = Gates::new(Organ::Colon);
    let Some(gas) = Gas::of(volume) else {
        return Err(gates.refuse(format!("no voxel of gas ({MIN_HU} to {GAS_HU} HU)")));
    };
    pass(&gas, &mut gates)?;
    let mut core = BitVolume::new(volume.grid.dims);
    gas.colon.iter().for_each(|c| core.add(&c.mask));
    fill_cavities(&mut core);
    let mut mask = grown_to_wall(volume, &gas);
    let mut bright = None;
    let mut threshold = WALL_HU;
    let mut selection = IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: WALL_HU };
    match fluid(volume, &mask) {
        Some(fluid) if !tagged => gates.note(format!(
            "tagged fluid from {:.0} HU: {:.0} ml, not taken",
            fluid.threshold,
            fluid.mask.count() as f64 * volume.grid.voxel_mm3() / 1000.0
        )),
        Some(fluid) => {
            gates.note(format!(
                "tagged fluid from {:.0} HU, {} of it: {:.0} ml in {} pools",
                fluid.threshold,
                fluid.below,
                fluid.mask.count() as f64 * volume.grid.voxel_mm3() / 1000.0,
                fluid.pools
            ));
            mask.add(&fluid.mask);
            let mut inner = fluid.mask;
            inner.keep(&between(volume, fluid.threshold, f64::INFINITY));
            bright = Some(TaggedFluid { mask: inner, down: fluid.down });
            fill_cavities(&mut mask);
            // Gas and fluid lie on both sides of tissue: no one range of values holds them.
            selection = IntensitySelection::Labels(Vec::new());
            threshold = fluid.threshold;
        }
        None => gates.note("no tagged fluid below the gas".into()),
    }
    let segment = |c: &ColonCandidate| Segment { seed: c.seed, volume_ml: c.features.volume_ml };
    Ok(FoundOrgan {
        root: None,
        organ: Organ::Colon,
        mask,
        core: Some(core),
        fluid: bright,
        selection,
        threshold,
        segments: gas.colon.iter().map(segment).collect(),
        confidence: gates.confidence,
        reasons: gates.reasons,
    })
}

/// Refuses gas that is no colon, and notes by how much it is one.
fn pass(gas: &Gas, gates: &mut Gates) -> Result<(), OrganError> {
    let left_out = &gas.left_out[..gas.left_out.len().min(MAX_NAMED)].join("; ");
    if gas.colon.is_empty() {
        return Err(gates.refuse(match left_out.is_empty() {
            true => format!("no gas of {MIN_ML} ml or more in the body"),
            false => left_out.clone(),
        }));
    }
    for c in &gas.colon {
        let (ml, radius_mm) = (c.features.volume_ml, c.features.radius_mm);
        if let Some(gap) = &c.gap {
            gates.note(gap.line());
        }
        gates.note(format!("{ml:.0} ml of gas, radius {radius_mm:.1} mm, at {}", c.seed));
        for (what, value, limit, sure) in Rival::Colon.rows(&c.features) {
            gates.at_least(what, value, limit, sure)?;
        }
    }
    if !left_out.is_empty() {
        gates.note(format!("left out: {left_out}"));
    }
    for c in &gas.colon {
        if c.name.is_near_tie() {
            let (ml, at, names) = (c.features.volume_ml, c.seed, c.name.line());
            gates.doubt(format!("{ml:.0} ml of gas at {at} may be stomach: {names}"), DOUBTFUL);
        }
    }
    if gas.is_stomach_doubtful {
        gates.note("the stomach that was left out may be colon".into());
    }
    let total: f64 = gas.colon.iter().map(|c| c.features.volume_ml).sum();
    gates.at_least("gas of the colon, ml", total, MIN_TOTAL_ML, 400.0)?;
    let extent = gas.colon.iter().map(|c| c.extent_mm).fold(0.0, f64::max);
    gates.at_least("extent of the longest segment, mm", extent, MIN_EXTENT_MM, 200.0)
}

/// The segments with the voxels at their wall, but none of what touches other gas.
fn grown_to_wall(volume: &Volume, gas: &Gas) -> BitVolume {
    let grid = &volume.grid;
    let mut mask = BitVolume::new(grid.dims);
    gas.colon.iter().for_each(|c| mask.add(&c.mask));
    // Noise leaves specks in the gas.
    fill_cavities(&mut mask);
    let mut wall = between(volume, MIN_HU, WALL_HU);
    wall.remove(&dilated(&gas.others, DVec3::ONE, WALL_VOXELS as f64));
    // Folds are thin: their voxels are mixed with gas from both sides, and darker than the wall
    // elsewhere, but they are no openings.
    if grid.spacing_mm.max_element() <= FOLD_MM {
        return thickened(&mask, &wall, |v: UVec3| volume.real(grid.index(v)), WALL_VOXELS);
    }
    for _ in 0..WALL_VOXELS {
        let mut more = dilated(&mask, DVec3::ONE, 1.0);
        more.keep(&wall);
        mask.add(&more);
    }
    mask
}
