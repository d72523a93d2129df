//! Tagged fluid in a colon: bright pools below its gas.

use glam::{DVec3, IVec3, UVec3};

use super::head_foot_axis;
use super::numbers::of_colon::fluid::*;
use super::values::{between, quantile, sorted};
use crate::lumen::{BitVolume, dilated, opened, pieces};
use crate::volume::Volume;

/// Fluid with contrast medium.
pub(super) struct Fluid {
    pub mask: BitVolume,
    /// Least value, HU.
    pub threshold: f64,
    pub pools: usize,
    /// Side of the gas on which the fluid lies, in words.
    pub below: &'static str,
    /// Step from gas to fluid, voxels.
    pub down: IVec3,
}

/// Finds the fluid. The side of the gas with the most bright voxels next to it is down.
pub(super) fn fluid(volume: &Volume, gas: &BitVolume) -> Option<Fluid> {
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
        let is_pool = contact as f64 * face_mm2 >= MIN_CONTACT_MM2
            && contact as f64 >= MIN_CONTACT_SHARE * top as f64;
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
    Some(Fluid { mask: pools, threshold, pools: count, below, down })
}

fn axis_of(way: IVec3) -> usize {
    way.abs().max_position()
}
