//! Exact distance between voxel centres of the lumen and of its surroundings, in bricks.
//!
//! Three passes of one-dimensional minima (Saito & Toriwaki 1994, doi:10.1016/0031-3203(94)90133-3),
//! cut at a reach. A point between a voxel and its nearest target is no farther from that target than
//! the voxel is, so the passes need no brick beyond the reach.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::tissue::TissueBricks;
use crate::lumen::bricks::{BRICK, SIDE};

/// Returns the squared distance of each voxel from the nearest voxel whose bit is set, mm²; infinity
/// beyond the reach.
///
/// * `targets`: eight words a brick, one a z-layer, bit x + 8 y.
pub(super) fn squared_distances(
    bricks: &TissueBricks,
    targets: &[[u64; 8]],
    spacing_mm: DVec3,
    reach_mm: f32,
) -> Vec<f32> {
    let set = targets.par_iter().flat_map_iter(|bits| {
        let bit = |i: usize| bits[i / 64] >> (i % 64) & 1 == 1;
        (0..BRICK).map(move |i| if bit(i) { 0.0 } else { f32::INFINITY })
    });
    let mut squared: Vec<f32> = set.collect();
    for axis in 0..3 {
        squared = pass(bricks, &squared, axis, spacing_mm[axis] as f32, reach_mm);
    }
    squared
}

/// Returns the least sum of a voxel's value and its squared distance along an axis.
fn pass(
    bricks: &TissueBricks,
    from: &[f32],
    axis: usize,
    spacing_mm: f32,
    reach_mm: f32,
) -> Vec<f32> {
    let reach = (reach_mm / spacing_mm) as i32;
    let limit = reach_mm * reach_mm;
    let stride = [1, SIDE as usize, (SIDE * SIDE) as usize][axis];
    let mut out = vec![f32::INFINITY; from.len()];
    out.par_chunks_exact_mut(BRICK).zip(bricks.places()).for_each(|(out, place)| {
        crate::task::checkpoint();
        // The brick's line of bricks along the axis, as far as the reach.
        let far = (reach + SIDE - 1) / SIDE;
        for k in -far..=far {
            let mut at = *place;
            at[axis] += k;
            let Some(slot) = bricks.slot(at) else { continue };
            let source = &from[slot * BRICK..][..BRICK];
            for to in 0..SIDE {
                for of in 0..SIDE {
                    let steps = k * SIDE + of - to;
                    if steps.abs() > reach {
                        continue;
                    }
                    let added = (steps as f32 * spacing_mm) * (steps as f32 * spacing_mm);
                    least(out, to as usize * stride, source, of as usize * stride, axis, added);
                }
            }
        }
        out.iter_mut().filter(|d| **d > limit).for_each(|d| *d = f32::INFINITY);
    });
    out
}

/// Takes over the smaller values of one layer across an axis, with a number added.
fn least(out: &mut [f32], to: usize, source: &[f32], of: usize, axis: usize, added: f32) {
    let mut row = |to: usize, of: usize| {
        for (to, of) in out[to..to + 8].iter_mut().zip(&source[of..of + 8]) {
            *to = to.min(of + added);
        }
    };
    match axis {
        0 => {
            for row in 0..64 {
                let (to, of) = (to + 8 * row, of + 8 * row);
                out[to] = out[to].min(source[of] + added);
            }
        }
        1 => (0..8).for_each(|z| row(to + 64 * z, of + 64 * z)),
        _ => (0..8).for_each(|y| row(to + 8 * y, of + 8 * y)),
    }
}

/// Steps to the bricks that hold a voxel no farther than a reach from some voxel of the brick in the
/// middle.
pub(super) fn steps_within(spacing_mm: DVec3, reach_mm: f64) -> Vec<IVec3> {
    let far = (reach_mm / spacing_mm / f64::from(SIDE)).ceil().as_ivec3() + 1;
    let gap = |k: i32, spacing: f64| f64::from((k.abs() * SIDE - SIDE + 1).max(0)) * spacing;
    let mut steps = Vec::new();
    for z in -far.z..=far.z {
        for y in -far.y..=far.y {
            for x in -far.x..=far.x {
                let step = IVec3::new(x, y, z);
                let gaps = DVec3::from_array(std::array::from_fn(|i| gap(step[i], spacing_mm[i])));
                if gaps.length() <= reach_mm {
                    steps.push(step);
                }
            }
        }
    }
    steps
}
