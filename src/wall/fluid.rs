//! One lumen of gas and of the tagged fluid under it.

use glam::DVec3;
use rayon::prelude::*;

use super::{Evidence, OFFSET, WallField};
use crate::lumen::bricks::BRICK;
use crate::lumen::{BitVolume, Lumen, dilated, fill_cavities};

/// Voxels between gas and fluid that are neither lie within this many voxels of both.
const LAYER_VOX: f64 = 3.0;

/// One lumen of two that touch: gas, and the fluid under it. Between them values pass through those
/// of tissue; voxels of `whole` that lie near both are lumen too.
pub fn joined(
    (gas, gas_field): (Lumen, WallField),
    (fluid, fluid_field): (Lumen, WallField),
    whole: &BitVolume,
) -> (Lumen, WallField) {
    let grid = gas.grid;
    let [gas_mask, fluid_mask] = [&gas, &fluid].map(Lumen::mask);
    let mut layer = dilated(&gas_mask, DVec3::ONE, LAYER_VOX);
    layer.keep(&dilated(&fluid_mask, DVec3::ONE, LAYER_VOX));
    layer.keep(whole);
    let mut mask = gas_mask;
    mask.add(&fluid_mask);
    mask.add(&layer);
    fill_cavities(&mut mask);
    let lumen = Lumen::new(grid, &mask);
    let unit = (grid.spacing_mm.element_product().cbrt() / OFFSET) as f32;
    let mut offset_mm = vec![0f32; lumen.bricks.field_len()];
    offset_mm.par_iter_mut().enumerate().with_min_len(BRICK).for_each(|(e, out)| {
        let v = lumen.bricks.voxel(e);
        let at = |l: &Lumen, field: &WallField| {
            l.bricks.element(v).map_or(3072.0 * unit, |e| field.offset_mm[e])
        };
        let least = at(&gas, &gas_field).min(at(&fluid, &fluid_field));
        *out = match lumen.is_inside(e) {
            true if least < 0.0 => least,
            true => -512.0 * unit,
            false => least.max(20.0 * unit),
        };
    });
    let evidence = (0..offset_mm.len())
        .into_par_iter()
        .with_min_len(BRICK)
        .map(|e| {
            let v = lumen.bricks.voxel(e);
            let at = |l: &Lumen, field: &WallField| {
                l.bricks.element(v).map(|e| (field.offset_mm[e], field.evidence[e]))
            };
            match (at(&gas, &gas_field), at(&fluid, &fluid_field)) {
                (Some(a), Some(b)) if b.0 < a.0 => b.1,
                (Some(a), _) => a.1,
                (None, b) => b.map_or(Evidence::Limit, |b| b.1),
            }
        })
        .collect();
    (lumen, WallField { offset_mm, evidence, stats: gas_field.stats })
}
