//! Leak control: one minimax flood gives the grown volume for every threshold at once, and the
//! threshold just below the first explosion.
//!
//! c(v) is the least, over 6-paths from the seed, of the largest level on the path; V(T), the
//! number of voxels with c ≤ T, is what growing at T would fill. After the explosion control of
//! Mori et al. 2000, done here in one pass for all thresholds.

use glam::UVec3;

use super::intensity_selection::check_seed;
use super::{BitVolume, IntensitySelection, LumenError};
use crate::volume::{Grid, Volume, with_samples};

/// Threshold chosen by leak control, and the volumes around it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct LeakReport {
    /// Chosen end of the selection, real units.
    pub threshold: f64,
    /// Requested end of the selection, real units.
    pub asked: f64,
    /// Volume at `threshold`, ml.
    pub volume_ml: f64,
    /// Volume at the first step that leaks, ml, if there was one.
    pub leak_ml: Option<f64>,
}

/// Width of a step of the volume curve, real units (HU).
const STEP: f64 = 8.0;
/// Least number of steps of a selection.
const STEPS: usize = 16;
/// A step explodes when it adds more than this share of the volume before it …
const SHARE: f64 = 0.2;
/// … and more than this, ml.
const MIN_ML: f64 = 5.0;
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
    let flood = Flood::new(volume, selection, seed, f64::INFINITY)?;
    let (level, leak_ml) = flood.before_leak(flood.median_around(volume, seed), CALM);
    let report = LeakReport {
        threshold: flood.threshold(level),
        asked: flood.end,
        volume_ml: flood.volume_ml(level),
        leak_ml,
    };
    Ok((flood.mask(level), report))
}

/// Minimax flood from a seed: every voxel with the threshold level at which region growing reaches
/// it. Level 0 is the lowest value of the selection's closed side.
pub struct Flood {
    grid: Grid,
    sign: f64,
    /// Value of level 0 times the sign, and of the end that moves.
    start: f64,
    end: f64,
    /// Real units a level.
    unit: f64,
    /// Voxels first reached at each level.
    filled: Vec<u64>,
    /// Voxels in the order they were reached.
    order: Vec<(u64, u32)>,
    levels: usize,
}

impl Flood {
    /// Floods from a seed.
    ///
    /// * `most_ml`: no more than this is filled; the levels end there.
    ///
    /// # Errors
    /// As [`grow_controlled`].
    pub fn new(
        volume: &Volume,
        selection: &IntensitySelection,
        seed: UVec3,
        most_ml: f64,
    ) -> Result<Self, LumenError> {
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
        // Level of a value: its distance from the seed's side of the selection, rising towards the
        // end that moves. The flood starts at the seed's own value.
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
        let mut flood = Self {
            grid: volume.grid,
            sign,
            start,
            end,
            unit,
            filled: vec![0; levels],
            order: Vec::new(),
            levels,
        };
        let most = most_ml / flood.voxel_ml();
        flood.fill(volume, selection, seed, most);
        Ok(flood)
    }

    /// Level of a value in the selection.
    fn level(&self, selection: &IntensitySelection, real: f64) -> Option<u32> {
        let l = ((self.sign * real - self.start) / self.unit + 1e-9).floor();
        let inside = selection.holds(real) && l >= 0.0;
        inside.then_some(l.min(self.levels as f64 - 1.0) as u32)
    }

    fn fill(&mut self, volume: &Volume, selection: &IntensitySelection, seed: UVec3, most: f64) {
        let dims = self.grid.dims;
        let strides = [1usize, dims.x as usize, dims.x as usize * dims.y as usize];
        let mut done = BitVolume::new(dims);
        let mut buckets: Vec<Vec<u64>> = vec![Vec::new(); self.levels];
        let seed_index = self.grid.index(seed);
        let first = self.level(selection, volume.real(seed_index)).unwrap_or(0);
        buckets[first as usize].push(seed_index as u64);
        done.set(seed.x, seed.y, seed.z);
        with_samples!(&volume.samples, |samples| {
            use crate::volume::Sample;
            for c in first as usize..self.levels {
                while let Some(i) = buckets[c].pop() {
                    self.filled[c] += 1;
                    self.order.push((i, c as u32));
                    let v = self.grid.voxel(i as usize).to_array();
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
                            let stored = samples[j].to_f64();
                            if volume.is_padding(stored) {
                                continue;
                            }
                            let real = volume.rescale.real(stored);
                            if let Some(l) = self.level(selection, real) {
                                done.set(w[0], w[1], w[2]);
                                // Levels only rise along a path: that is the minimax.
                                buckets[c.max(l as usize)].push(j as u64);
                            }
                        }
                    }
                }
                buckets[c] = Vec::new();
                if self.order.len() as f64 > most {
                    self.filled.truncate(c + 1);
                    return;
                }
            }
        });
    }

    fn voxel_ml(&self) -> f64 {
        self.grid.voxel_mm3() / 1000.0
    }

    /// Threshold of a level, real units.
    pub fn threshold(&self, level: usize) -> f64 {
        if level + 1 >= self.levels {
            return self.end;
        }
        self.sign * (self.start + level as f64 * self.unit)
    }

    /// Volume grown at a level, ml.
    pub fn volume_ml(&self, level: usize) -> f64 {
        self.filled[..=level.min(self.filled.len() - 1)].iter().sum::<u64>() as f64
            * self.voxel_ml()
    }

    /// Returns the region grown at a level.
    pub fn mask(&self, level: usize) -> BitVolume {
        let mut bits = BitVolume::new(self.grid.dims);
        for &(i, _) in self.order.iter().take_while(|o| o.1 as usize <= level) {
            let v = self.grid.voxel(i as usize);
            bits.set(v.x, v.y, v.z);
        }
        bits
    }

    /// Voxels first reached above one level and up to another, in the order they were reached.
    pub fn joined(&self, above: usize, up_to: usize) -> impl Iterator<Item = UVec3> + '_ {
        let end = |level: usize| self.order.partition_point(|o| o.1 as usize <= level);
        let joined = &self.order[end(above)..end(up_to).max(end(above))];
        joined.iter().map(|o| self.grid.voxel(o.0 as usize))
    }

    /// The level a step of leak control above one, if the flood went on from there.
    pub fn next_level(&self, level: usize) -> Option<usize> {
        let next = (level + self.step()).min(self.filled.len() - 1);
        (next > level).then_some(next)
    }

    /// The level at which a share of some voxels has been reached, if it ever is.
    pub fn level_of_share(&self, voxels: &BitVolume, share: f64) -> Option<usize> {
        let wanted = (share * voxels.count() as f64).ceil().max(1.0) as usize;
        let among = |o: &&(u64, u32)| voxels.get(self.grid.voxel(o.0 as usize).as_ivec3());
        self.order.iter().filter(among).nth(wanted - 1).map(|o| o.1 as usize)
    }

    /// Largest level before the first explosion, and the volume (ml) the exploding step reaches.
    ///
    /// * `first`: up to here the lumen is still joining up.
    /// * `calm`: steps without one before an explosion counts.
    fn before_leak(&self, first: usize, calm: usize) -> (usize, Option<f64>) {
        let first = first.min(self.filled.len() - 1);
        settle(&self.filled, first, self.step(), calm, self.voxel_ml())
    }

    /// Levels of a step of the volume curve; a narrow selection, as of values from 0 to 1, has
    /// [`STEPS`] steps.
    fn step(&self) -> usize {
        let most = self.levels / STEPS;
        ((STEP / self.unit).round() as usize).min(most).max(1)
    }

    /// Median level of the 5³ voxels about the seed that are in the selection. Below it a noisy
    /// lumen is still joining up (sites percolate in 3D at a share of 0.31), and a jump there is no
    /// leak.
    fn median_around(&self, volume: &Volume, seed: UVec3) -> usize {
        let (lo, hi) =
            if self.sign > 0.0 { (f64::NEG_INFINITY, self.end) } else { (self.end, f64::INFINITY) };
        let side = IntensitySelection::Range { lo, hi };
        let mut around: Vec<u32> = (0..125)
            .map(|n| seed.as_ivec3() + glam::IVec3::new(n % 5 - 2, n / 5 % 5 - 2, n / 25 - 2))
            .filter(|&v| self.grid.contains(v))
            .filter_map(|v| self.level(&side, volume.real(self.grid.index(v.as_uvec3()))))
            .collect();
        around.sort_unstable();
        let first = self.order.first().map_or(0, |o| o.1);
        around.get(around.len() / 2).copied().unwrap_or(0).max(first) as usize
    }
}

/// Largest level before the first explosion, and the volume (ml) the exploding step reaches.
fn settle(
    filled: &[u64],
    first: usize,
    step: usize,
    least_calm: usize,
    ml: f64,
) -> (usize, Option<f64>) {
    let sum = |range: std::ops::Range<usize>| filled[range].iter().sum::<u64>() as f64 * ml;
    let (mut at, mut volume, mut calm) = (first, sum(0..first + 1), 0);
    while at + 1 < filled.len() {
        let next = (at + step).min(filled.len() - 1);
        let added = sum(at + 1..next + 1);
        let explodes = added > (SHARE * volume).max(MIN_ML);
        if explodes && calm >= least_calm {
            return (at, Some(volume + added));
        }
        calm = if explodes { 0 } else { calm + 1 };
        volume += added;
        at = next;
    }
    (filled.len() - 1, None)
}
