//! One lumen of gas and of the tagged fluid under it.
//!
//! In grey values the wall of gas is a rise and that of fluid a fall, and between gas and fluid all
//! values in between occur. So the values are first converted to those of a lumen full of gas
//! (electronic cleansing, Zalis & Hahn 2001, doi:10.2214/ajr.176.3.1760646): about fluid they are
//! rescaled from the range between the fluid's own value and the wall's, and across the level they
//! are interpolated along gravity. The wall field of the result is computed as for any colon.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::contrast::{Contrast, ROUNDS, UNIT, values_in};
use super::{Tissue, WallError};
use crate::lumen::bricks::BRICK;
use crate::lumen::{
    BitVolume, Bricks, IntensitySelection, bit, bits_in, dilated, eroded, fill_cavities,
    surrounding_bricks,
};
use crate::volume::{Grid, Volume};

/// Upper bound of gas in the mask, HU: half way between gas and tissue.
const GAS_HU: f64 = -450.0;
/// Number of dilations by which voxels are assigned to gas or to fluid, whichever is nearer.
const REACH_STEPS: usize = 5;
/// Largest distance, voxels, from gas down to fluid at a level: a wall between them is thicker.
const LEVEL_VOXELS: i32 = 3;
/// Horizontal margin, voxels, of the layer about a level, for places where level and wall meet.
const ASIDE_VOX: f64 = 2.0;
/// Vertical margin, voxels, of the layer about a level.
const ABOVE_VOX: f64 = 2.0;
/// Largest extent of a layer along gravity, voxels, from its end in gas to its end in fluid: beyond
/// it the layers of two levels have merged.
const MAX_LAYER: i32 = LEVEL_VOXELS + 3 + 2 * ABOVE_VOX as i32;
/// Least value of fluid, of 4096 from gas to tissue: brighter than tissue by a quarter of that.
const MIN_FLUID: i64 = 5 * 1024;
/// Range of cleansed values, of 4096 from gas to tissue: a little beyond lumen and wall.
const CLEANSED: (i32, i32) = (-1024, 4915);
/// Highest cleansed value of voxels about fluid that are added to the core.
const MAX_OF_CORE: i32 = 1024;

/// Grey values about gas and tagged fluid, converted as if all were gas.
pub struct CleansedFluid {
    pub(super) grid: Grid,
    pub(super) contrast: Contrast,
    pub(super) bricks: Bricks,
    pub(super) values: Vec<i32>,
    /// Voxels that are certainly lumen.
    pub(super) core: BitVolume,
    /// Voxels whose values were changed.
    pub(super) zone: BitVolume,
}

impl CleansedFluid {
    /// Cleanses the values about a mask of gas and fluid.
    ///
    /// * `core`: gas away from walls.
    /// * `mask`: gas and fluid.
    /// * `fluid`: voxels of the mask that are fluid; `down`: step from gas to fluid.
    ///
    /// # Errors
    /// [`WallError::NoContrast`].
    pub fn new(
        volume: &Volume,
        core: &BitVolume,
        mask: &BitVolume,
        fluid: &BitVolume,
        down: IVec3,
    ) -> Result<Self, WallError> {
        let contrast =
            Contrast::measured(volume.into(), core, Tissue::Colon).ok_or(WallError::NoContrast)?;
        let grid = volume.grid;
        let mut gas =
            IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: GAS_HU }.select(volume);
        gas.keep(mask);
        let mut fluid = fluid.clone();
        fill_cavities(&mut fluid);
        fluid.remove(&gas);
        let bricks = surrounding_bricks(mask, ROUNDS.1);
        let raw = values_in(&bricks, volume.into(), &contrast);
        let mut zone = nearer_to_fluid(&gas, &fluid);
        let (level, layer) = level_layer(&gas, &fluid, down);
        let own = FluidValues::new(&bricks, &raw, &eroded(&fluid, DVec3::ONE, 1.0));
        let (low, high) = CLEANSED;
        let zone_bits = bits_in(&bricks, &zone);
        let [level_bits, layer_bits] = [&level, &layer].map(|m| bits_in(&bricks, m));
        let mut values = vec![0i32; bricks.field_len()];
        values.par_iter_mut().enumerate().with_min_len(BRICK).for_each(|(e, out)| {
            if bit(&layer_bits, e) {
                let v = bricks.voxel(e);
                let end = |way: IVec3| {
                    let n = (1..=MAX_LAYER).find(|n| !layer.get(v + n * way))?;
                    Some((n, bricks.element(v + n * way)?))
                };
                let ends = end(-down).zip(end(down)).filter(|((above, gas), (below, fluid))| {
                    let is_level = !bit(&zone_bits, *gas) && bit(&zone_bits, *fluid);
                    is_level && above + below <= MAX_LAYER
                });
                if let Some(((above, gas), (below, fluid))) = ends {
                    let a = raw[gas].clamp(low, high);
                    let b = own.counted(&bricks, &raw, fluid).clamp(low, high);
                    *out = a + (b - a) * above / (above + below);
                    return;
                }
            }
            // Layers of two levels meet: what is mixed itself is lumen.
            if bit(&level_bits, e) {
                *out = 0;
            } else if bit(&zone_bits, e) {
                *out = own.counted(&bricks, &raw, e).clamp(low, high);
            } else {
                *out = raw[e];
            }
        });
        zone.add(&layer);
        let mut core = core.clone();
        let mut inner = zone.clone();
        inner.keep(mask);
        for v in inner.voxels() {
            let value = bricks.element(v.as_ivec3()).map(|e| values[e]);
            if value.is_some_and(|value| value <= MAX_OF_CORE) {
                core.set(v.x, v.y, v.z);
            }
        }
        Ok(Self { grid, contrast, bricks, values, core, zone })
    }
}

/// Returns the voxels that are nearer to fluid than to gas, and fluid itself.
fn nearer_to_fluid(gas: &BitVolume, fluid: &BitVolume) -> BitVolume {
    let (mut gas, mut fluid) = (gas.clone(), fluid.clone());
    for _ in 0..REACH_STEPS {
        crate::task::checkpoint();
        let [mut more_gas, mut more_fluid] = [&gas, &fluid].map(|m| dilated(m, DVec3::ONE, 1.5));
        more_gas.remove(&fluid);
        more_fluid.remove(&more_gas);
        gas.add(&more_gas);
        fluid.add(&more_fluid);
    }
    fluid
}

/// Returns the levels, and the layer about them in which values of gas, fluid and wall are mixed.
fn level_layer(gas: &BitVolume, fluid: &BitVolume, down: IVec3) -> (BitVolume, BitVolume) {
    let mut level = BitVolume::new(gas.dims());
    for v in gas.voxels().map(|v| v.as_ivec3()) {
        let below = |k: &i32| !gas.get(v + k * down);
        let gap = (1..=LEVEL_VOXELS).take_while(below).find(|k| fluid.get(v + k * down));
        for k in gap.into_iter().flat_map(|gap| 0..=gap) {
            let at = (v + k * down).as_uvec3();
            level.set(at.x, at.y, at.z);
        }
    }
    // Balls that are flat, or a line.
    let along = down.abs().as_dvec3();
    let flat = dilated(&level, DVec3::ONE + 99.0 * along, ASIDE_VOX);
    let layer = dilated(&flat, DVec3::splat(100.0) - 99.0 * along, ABOVE_VOX);
    (level, layer)
}

/// Value of the fluid by place: tagging is uneven.
struct FluidValues {
    /// Sum and number of values in each brick.
    sums: Vec<(i64, i64)>,
    mean: i64,
}

impl FluidValues {
    /// Averages the fluid's values in each brick.
    ///
    /// * `inner`: fluid away from its rim.
    fn new(bricks: &Bricks, raw: &[i32], inner: &BitVolume) -> Self {
        let bits = bits_in(bricks, inner);
        let sum = |slot: usize| {
            let all = (slot * BRICK..(slot + 1) * BRICK).filter(|e| bit(&bits, *e));
            all.fold((0i64, 0i64), |(sum, n), e| (sum + i64::from(raw[e]), n + 1))
        };
        let sums: Vec<(i64, i64)> = (0..bricks.len()).into_par_iter().map(sum).collect();
        let (sum, n) = sums.iter().fold((0, 0), |a, b| (a.0 + b.0, a.1 + b.1));
        Self { sums, mean: if n > 0 { sum / n } else { 2 * MIN_FLUID } }
    }

    /// Rescales a value such that the fluid's is 0 and the wall's 4096. The fluid's value is the
    /// mean in the bricks around, weighted by a tent function.
    fn counted(&self, bricks: &Bricks, raw: &[i32], e: usize) -> i32 {
        let l = (e % BRICK) as i64;
        // Halves of voxels from the brick's middle; the middles of bricks are 16 apart.
        let off = [l & 7, l >> 3 & 7, l >> 6].map(|p| 2 * p - 7);
        let near = &bricks.near()[e / BRICK];
        let (mut sum, mut n) = (0i64, 0i64);
        for corner in 0..8 {
            let (mut weight, mut at) = (1i64, 13i64);
            for axis in 0..3 {
                let over = off[axis].abs();
                let is_beside = corner >> axis & 1 == 1;
                weight *= if is_beside { over } else { 16 - over };
                at += if is_beside { off[axis].signum() * [1, 3, 9][axis] } else { 0 };
            }
            if let Some((s, k)) = self.sums.get(near[at as usize] as usize) {
                sum += weight * s;
                n += weight * k;
            }
        }
        let fluid = if n > 0 { sum / n } else { self.mean }.max(MIN_FLUID);
        let counted = (i64::from(raw[e]) - fluid) * UNIT as i64 / (UNIT as i64 - fluid);
        counted.clamp(-1 << 14, 1 << 14) as i32
    }
}
