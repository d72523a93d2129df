//! Leak control: one minimax flood gives the grown volume for every threshold at once, and the
//! threshold just below the first explosion.
//!
//! c(v) is the least, over 6-paths from the seed, of the largest level on the path; V(T), the
//! number of voxels with c ≤ T, is what growing at T would fill. After the explosion control of
//! Mori et al. 2000, done here in one pass for all thresholds.

use glam::UVec3;

use super::intensity_selection::check_seed;
use super::{BitVolume, IntensitySelection, LumenError};
use crate::volume::{Volume, with_samples};

/// What leak control chose.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeakReport {
    /// The end of the selection it settled on, real units.
    pub threshold: f64,
    /// The end it was given.
    pub asked: f64,
    /// Volume at `threshold`, ml.
    pub volume_ml: f64,
    /// Volume at the first step that leaks, ml, if there was one.
    pub leak_ml: Option<f64>,
}

/// Width of a step of the volume curve, real units (HU).
const STEP: f64 = 8.0;
/// A step explodes when it adds more than this share of the volume before it …
const SHARE: f64 = 0.2;
/// … and more than this, ml.
const LEAST_ML: f64 = 5.0;
/// Steps under the limit before an explosion counts: the first steps of any lumen explode.
const CALM: usize = 3;
/// Most levels of the flood; wider windows are quantised.
const LEVELS: f64 = 65_536.0;

/// Grows from `seed` inside `selection`, its open side drawn in to the largest threshold that does
/// not leak. The side that moves is the one farther from the seed's value in a two-sided selection,
/// or the only finite one.
///
/// # Errors
/// [`LumenError::SeedOutside`], [`LumenError::SeedValue`]; [`LumenError::LeakWindow`] for labels
/// and for a selection open on both sides.
pub fn grow_controlled(
    volume: &Volume,
    selection: &IntensitySelection,
    seed: UVec3,
) -> Result<(BitVolume, LeakReport), LumenError> {
    check_seed(volume, selection, seed)?;
    let IntensitySelection::Range { lo, hi } = *selection else {
        return Err(LumenError::LeakWindow);
    };
    let at_seed = volume.real(volume.grid.index(seed));
    let upper = match (lo.is_finite(), hi.is_finite()) {
        (_, true) if !lo.is_finite() => true,
        (true, false) => false,
        (true, true) => hi - at_seed >= at_seed - lo,
        _ => return Err(LumenError::LeakWindow),
    };
    // Level of a value: its distance from the seed's side of the selection, rising towards the end
    // that moves. The flood starts at the seed's own value.
    let end = if upper { hi } else { lo };
    let sign = if upper { 1.0 } else { -1.0 };
    let (low, high) = volume.range().unwrap_or((0.0, 0.0));
    let start = if upper { low.max(lo) } else { -high.min(hi) };
    let span = (sign * end - start).max(0.0);
    let unit = if volume.samples.sample_type().is_integer() {
        volume.rescale.slope.abs()
    } else {
        span / (LEVELS - 1.0)
    };
    let unit = unit.max(span / (LEVELS - 1.0)).max(f64::MIN_POSITIVE);
    let levels = (span / unit).floor() as usize + 1;
    let level = |real: f64| -> Option<u32> {
        let l = ((sign * real - start) / unit + 1e-9).floor();
        (selection.holds(real) && l >= 0.0).then_some(l.min(levels as f64 - 1.0) as u32)
    };

    let grid = &volume.grid;
    let dims = grid.dims;
    let strides = [1usize, dims.x as usize, dims.x as usize * dims.y as usize];
    let mut done = BitVolume::new(dims);
    let mut buckets: Vec<Vec<u64>> = vec![Vec::new(); levels];
    let mut filled = vec![0u64; levels];
    let mut order: Vec<(u64, u32)> = Vec::new();
    let seed_index = grid.index(seed);
    let first = level(at_seed).unwrap_or(0);
    buckets[first as usize].push(seed_index as u64);
    done.set(seed.x, seed.y, seed.z);
    with_samples!(&volume.samples, |samples| {
        use crate::volume::Sample;
        for c in first as usize..levels {
            while let Some(i) = buckets[c].pop() {
                filled[c] += 1;
                order.push((i, c as u32));
                let v = grid.voxel(i as usize).to_array();
                for axis in 0..3 {
                    for step in [-1i64, 1] {
                        let to = i64::from(v[axis]) + step;
                        if to < 0 || to >= i64::from(dims[axis]) {
                            continue;
                        }
                        let mut w = v;
                        w[axis] = to as u32;
                        if done.at(w[0], w[1], w[2]) {
                            continue;
                        }
                        let j = (i as i64 + step * strides[axis] as i64) as usize;
                        let real = volume.rescale.real(samples[j].to_f64());
                        if let Some(l) = level(real) {
                            done.set(w[0], w[1], w[2]);
                            // Levels only rise along a path: that is the minimax.
                            buckets[c.max(l as usize)].push(j as u64);
                        }
                    }
                }
            }
            buckets[c] = Vec::new();
        }
    });

    let step = ((STEP / unit).round() as usize).max(1);
    let ml = grid.voxel_mm3() / 1000.0;
    let trusted = median_level(volume, seed, &level).max(first) as usize;
    let (chosen, leak) = settle(&filled, trusted, step, ml);
    let mut bits = BitVolume::new(dims);
    let mut voxels = 0u64;
    for &(i, c) in &order {
        if c as usize <= chosen {
            let v = grid.voxel(i as usize);
            bits.set(v.x, v.y, v.z);
            voxels += 1;
        }
    }
    let threshold = if chosen + 1 >= levels { end } else { sign * (start + chosen as f64 * unit) };
    let report = LeakReport { threshold, asked: end, volume_ml: voxels as f64 * ml, leak_ml: leak };
    Ok((bits, report))
}

/// Median level of the 5³ voxels about the seed that are in the selection. Below it a noisy lumen
/// is still joining up (sites percolate in 3D at a share of 0.31), and a jump there is no leak.
fn median_level(volume: &Volume, seed: UVec3, level: &dyn Fn(f64) -> Option<u32>) -> u32 {
    let grid = &volume.grid;
    let mut around: Vec<u32> = (0..125)
        .map(|n| seed.as_ivec3() + glam::IVec3::new(n % 5 - 2, n / 5 % 5 - 2, n / 25 - 2))
        .filter(|&v| grid.contains(v))
        .filter_map(|v| level(volume.real(grid.index(v.as_uvec3()))))
        .collect();
    around.sort_unstable();
    around.get(around.len() / 2).copied().unwrap_or(0)
}

/// Largest level before the first explosion, and the volume (ml) the exploding step reaches.
fn settle(filled: &[u64], first: usize, step: usize, ml: f64) -> (usize, Option<f64>) {
    let sum = |range: std::ops::Range<usize>| filled[range].iter().sum::<u64>() as f64 * ml;
    let (mut at, mut volume, mut calm) = (first, sum(0..first + 1), 0);
    while at + 1 < filled.len() {
        let next = (at + step).min(filled.len() - 1);
        let added = sum(at + 1..next + 1);
        let explodes = added > (SHARE * volume).max(LEAST_ML);
        if explodes && calm >= CALM {
            return (at, Some(volume + added));
        }
        calm = if explodes { 0 } else { calm + 1 };
        volume += added;
        at = next;
    }
    (filled.len() - 1, None)
}
