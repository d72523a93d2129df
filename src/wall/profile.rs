//! Smoothing, growth up to the ridge of the wall, peaks and offsets.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::contrast::{Contrast, ROUNDS, UNIT, of_hu, values_in};
use super::launches::{BrickCopies, BrickLaunches};
use super::{CleansedFluid, OFFSET, Tissue, WallError, law, select};
use crate::compute::{Array, Buf, DeviceCopy, Outputs, Plan};
use crate::kernels::blur_axis::integer_weights;
use crate::kernels::{least_axis, ridge_grow, wall_level, wall_peak};
use crate::lumen::bricks::near_offset;
use crate::lumen::{BitVolume, Bricks, GreyValues, bits_in, surrounding_bricks};
use crate::volume::Grid;

/// Distance of growth beyond the core, mm, and its bounds in voxels: an edge blurred from gas to
/// tissue has its wall up to 1.2 mm outside a core that was grown without a leak, and its rim
/// beyond that. Farther growth finds paths through the walls of bronchi; a colon's are thick.
const GROWTH_MM: f64 = 1.8;
/// Longest ray to the peak of a wall, mm, and in steps of half a voxel.
const RAY_MM: f64 = 4.0;
const MAX_STEPS: f64 = 14.0;
/// Standard deviations of Gaussians, in least spacings: of gradients, of curvature, of ends (closed
/// and filled share), of peaks (narrow).
const CALM: f64 = 1.0;
const CURVATURE: f64 = 1.5;
const CLOSED: f64 = 1.0;
const FILLED: f64 = 0.8;
const NARROW: f64 = 0.6;
/// Radius of the minimum that counts as a vessel's value, least spacings: the distance from wall to
/// middle in a vessel so thin that no voxel is all blood.
const LUMEN_VOX: f64 = 3.0;
/// Highest value that growth from a vessel accepts, of 4096 from blood to tissue.
const MAX_OF_VESSEL: i32 = 3400;
/// Largest amount, voxels, by which an offset may be less than the distance to the core.
const REACH_VOX: f64 = 2.5;
/// Offset of a strong crest, mean spacings.
const CREST_OFFSET: f64 = 0.12;
/// Thirds of the rise behind it by which a crest of an airway falls on both sides. A colon has thin
/// folds and polyps, which such a rule would wear away.
const AIRWAY_RISE: i32 = 2;
/// Least peak of a wall, as a share of the contrast, from which blur is estimated: lower ones say
/// little about it.
const MIN_PEAK: f64 = 0.5;
/// Off-centre weight of the sharpening filter: a twelfth, of 4096.
const TWELFTH: i32 = 341;
/// Least blur of a scan, mean spacings.
const MIN_SIGMA: f64 = 0.4;

/// A core with the grey values about it.
pub struct WallInput<'a> {
    pub(super) core: &'a BitVolume,
    pub(super) grid: Grid,
    pub(super) tissue: Tissue,
    pub(super) contrast: Contrast,
    pub(super) bricks: Bricks,
    pub(super) brick_copies: BrickCopies,
    core_bits: Vec<u64>,
    values: Vec<i32>,
    pub(super) weights: GaussianWeights,
    /// Mask of the places where thin bridges are cut.
    pub(super) zone: Option<&'a BitVolume>,
    law: Vec<i32>,
    cap: Vec<i32>,
    /// Copy of [`WallProfile::level`].
    pub(super) level_copy: DeviceCopy,
}

/// Integer weights of the Gaussians, by axis.
pub(super) struct GaussianWeights {
    sharp: [Vec<i32>; 3],
    value: [Vec<i32>; 3],
    calm: [Vec<i32>; 3],
    wide: [Vec<i32>; 3],
    narrow: [Vec<i32>; 3],
    pub curvature: [Vec<i32>; 3],
    pub closed: [Vec<i32>; 3],
    pub filled: [Vec<i32>; 3],
}

/// Offsets and marks of a first mask, to be corrected.
pub struct WallProfile<'a> {
    pub(super) input: WallInput<'a>,
    pub(super) mark: Array<u32>,
    pub(super) level: Array<i32>,
    pub(super) mask: BitVolume,
    pub(super) inside: Vec<u64>,
    /// Standard deviation of the scan's blur, mm.
    pub(super) sigma_mm: f64,
}

/// Buffers of the first plan.
pub struct ProfileBuffers {
    value: Buf<i32>,
    mark: Buf<u32>,
    level: Buf<i32>,
}

impl<'a> WallInput<'a> {
    /// Measures contrast and copies the values about a core.
    ///
    /// # Errors
    /// [`WallError::NoContrast`].
    pub fn new(
        grey: GreyValues<'_>,
        core: &'a BitVolume,
        tissue: Tissue,
    ) -> Result<Self, WallError> {
        let contrast = Contrast::measured(grey, core, tissue).ok_or(WallError::NoContrast)?;
        let bricks = surrounding_bricks(core, ROUNDS.1);
        let values = values_in(&bricks, grey, &contrast);
        Ok(Self::of_values(*grey.grid(), core, tissue, contrast, bricks, values))
    }

    /// Takes over a colon whose tagged fluid was converted to gas.
    pub fn cleansed(fluid: &'a CleansedFluid) -> Self {
        let (bricks, values) = (fluid.bricks.clone(), fluid.values.clone());
        let contrast = fluid.contrast;
        let made =
            Self::of_values(fluid.grid, &fluid.core, Tissue::Colon, contrast, bricks, values);
        Self { zone: Some(&fluid.zone), ..made }
    }

    fn of_values(
        grid: Grid,
        core: &'a BitVolume,
        tissue: Tissue,
        contrast: Contrast,
        bricks: Bricks,
        values: Vec<i32>,
    ) -> Self {
        let core_bits = bits_in(&bricks, core);
        let h = grid.spacing_mm;
        let by_axis = |sigma: f64| {
            (h.min_element() / h).to_array().map(|ratio| integer_weights(sigma * ratio))
        };
        let wide = if tissue == Tissue::Colon { 1.0 } else { 1.5 };
        let weights = GaussianWeights {
            sharp: std::array::from_fn(|_| vec![4096 + 2 * TWELFTH, -TWELFTH]),
            value: contrast.sigma_vox.to_array().map(integer_weights),
            calm: by_axis(CALM),
            wide: by_axis(wide),
            narrow: by_axis(NARROW),
            curvature: by_axis(CURVATURE),
            closed: by_axis(CLOSED),
            filled: by_axis(FILLED),
        };
        let least = (3.0 * contrast.noise_units()).max(f64::from(of_hu(40.0))) / UNIT;
        let law = law::table(contrast.beyond, least.min(0.5));
        let cap = (0..10).map(|d| (OFFSET * (f64::from(d).sqrt() - REACH_VOX)) as i32).collect();
        Self {
            core,
            grid,
            tissue,
            contrast,
            bricks,
            brick_copies: BrickCopies::default(),
            core_bits,
            values,
            weights,
            zone: None,
            law,
            cap,
            level_copy: DeviceCopy::default(),
        }
    }

    /// Returns the number of voxels of the bricks that the field is computed on.
    pub fn voxels(&self) -> usize {
        self.bricks.field_len()
    }

    /// Returns the number of rounds of growth, a voxel each.
    fn rounds(&self) -> usize {
        if self.tissue == Tissue::Colon {
            return ROUNDS.1 as usize;
        }
        let voxels = GROWTH_MM / self.grid.spacing_mm.min_element();
        voxels.round().clamp(ROUNDS.0, ROUNDS.1) as usize
    }

    pub(super) fn mean_spacing(&self) -> f64 {
        let h = self.grid.spacing_mm;
        h.element_product().cbrt()
    }

    /// Returns the least spacing over each axis's, times a scale.
    pub(super) fn ratio(&self, scale: f64) -> [i32; 3] {
        let h = self.grid.spacing_mm;
        (h.min_element() / h * scale).round().as_ivec3().to_array()
    }

    /// Appends smoothing, growth, peaks and offsets.
    pub fn profile<'p>(&'p self, plan: &mut Plan<'p>) -> ProfileBuffers {
        let slots = self.bricks.len() as u32;
        let n = self.bricks.field_len();
        let shape = BrickLaunches::new(plan, &self.bricks, &self.brick_copies, &self.grid);
        let core = plan.upload("core", bytemuck::cast_slice::<u64, u32>(&self.core_bits));
        let raw = plan.upload("grey values", &self.values);
        let spare = [0, 1].map(|_| plan.undefined::<i32>("spare", n));
        let wall = UNIT as i32;
        let value = plan.undefined::<i32>("smoothed values", n);
        shape.blur(plan, &self.weights.value, raw, spare, value, wall);
        let sharp = plan.undefined::<i32>("sharpened values", n);
        shape.blur(plan, &self.weights.sharp, value, spare, sharp, wall);
        let calm = plan.undefined::<i32>("calm values", n);
        shape.blur(plan, &self.weights.calm, value, spare, calm, wall);

        let noise = self.contrast.noise_units();
        let at_least = |noises: f64, hu: f64| ((noises * noise) as i32).max(of_hu(hu));
        let [width, height, depth] = self.grid.dims.as_ivec3().to_array();
        // No path leads anywhere before the first round.
        let paths = [plan.zeroed::<i32>("paths", n), plan.undefined("paths", n)];
        let rounds = self.rounds();
        for round in 0..rounds {
            let (before, after) = (paths[round % 2], paths[(round + 1) % 2]);
            let bindings = ridge_grow::Bindings {
                near: shape.near,
                corner: shape.corner,
                core,
                value,
                before,
                after,
            };
            let params = ridge_grow::Params {
                slots,
                fall: at_least(3.0, 30.0),
                most: if self.is_vessel() { MAX_OF_VESSEL } else { wall / 2 + of_hu(150.0) },
                width,
                height,
                depth,
            };
            plan.launch(&ridge_grow::KERNEL, bindings, params, n, n);
        }
        let path = paths[rounds % 2];

        let mark = plan.undefined::<u32>("marks", n);
        let peak = plan.undefined::<i32>("peaks", n);
        let weight = plan.undefined::<i32>("weights", n);
        let least = self.grid.spacing_mm.min_element();
        let params = wall_peak::Params {
            slope: self.ratio(1024.0),
            slots,
            step: self.ratio(32768.0),
            steps: (2.0 * RAY_MM / least).floor().clamp(4.0, MAX_STEPS) as i32,
            size: [width, height, depth],
            fall: at_least(2.0, 20.0),
            gain: ((266.7 * self.mean_spacing() / least).round() as i32).min(1 << 14),
            crest: at_least(3.0, 40.0),
            strong: at_least(4.0, 60.0),
            rise: if self.tissue == Tissue::Airway { AIRWAY_RISE } else { 0 },
        };
        let (near, corner) = (shape.near, shape.corner);
        let bindings = wall_peak::Bindings {
            near,
            corner,
            core,
            value,
            sharp,
            calm,
            path,
            mark,
            peak,
            weight,
        };
        plan.launch(&wall_peak::KERNEL, bindings, params, n, n);

        // Scratch buffers of their own: those of the blurs above are free while peaks are found.
        let spare = [0, 1].map(|_| plan.undefined::<i32>("spare", n));
        let [peak1, weight1] = [peak, weight].map(|from| {
            let to = plan.undefined::<i32>("narrow mean", n);
            shape.blur(plan, &self.weights.narrow, from, spare, to, 0);
            to
        });
        for mean in [peak, weight] {
            shape.blur(plan, &self.weights.wide, mean, spare, mean, 0);
        }
        let lumen = if self.is_vessel() {
            let lumen = plan.undefined::<i32>("lumen's values", n);
            self.local_lumen(plan, &shape, value, spare, lumen);
            lumen
        } else {
            plan.zeroed("lumen's values", n)
        };
        let law = plan.upload("law", &self.law);
        let cap = plan.upload("cap", &self.cap);
        let level = plan.undefined::<i32>("levels", n);
        let bindings = wall_level::Bindings {
            near,
            core,
            value,
            mark,
            peak,
            weight,
            peak1,
            weight1,
            lumen,
            law,
            cap,
            level,
        };
        let is_sheet = self.tissue == Tissue::Colon;
        let forced = if is_sheet { (CREST_OFFSET * OFFSET) as i32 } else { -4096 };
        plan.launch(&wall_level::KERNEL, bindings, wall_level::Params { slots, forced }, n, n);
        plan.download(value);
        plan.download(mark);
        plan.download_kept(level, &self.level_copy);
        ProfileBuffers { value, mark, level }
    }

    /// Whether the lumen is blood, whose value falls in thin branches, and not gas.
    fn is_vessel(&self) -> bool {
        self.contrast.beyond == 1.0
    }

    /// Appends the value of the lumen about each voxel: the minimum within [`LUMEN_VOX`], smoothed.
    fn local_lumen<'p>(
        &'p self,
        plan: &mut Plan<'p>,
        shape: &BrickLaunches,
        value: Buf<i32>,
        spare: [Buf<i32>; 2],
        to: Buf<i32>,
    ) {
        let n = value.len();
        let reach = self.ratio(LUMEN_VOX);
        let way = [(value, spare[0]), (spare[0], spare[1]), (spare[1], to)];
        for (axis, (f, g)) in way.into_iter().enumerate() {
            let (slots, radius) = (shape.slots, reach[axis].max(1));
            let params = least_axis::Params { slots, axis: axis as u32, radius };
            let bindings = least_axis::Bindings { near: shape.near, f, g };
            plan.launch(&least_axis::KERNEL, bindings, params, n, n);
        }
        shape.blur(plan, &self.weights.wide, to, spare, to, 0);
    }

    /// Selects the first mask from the offsets.
    ///
    /// # Errors
    /// [`WallError::Empty`].
    pub fn select(
        self,
        buffers: &ProfileBuffers,
        out: &mut Outputs,
    ) -> Result<WallProfile<'a>, WallError> {
        let value = out.take(buffers.value);
        let (mark, level) = (out.take(buffers.mark), out.take(buffers.level));
        let lumen_at =
            |e: usize| mark[e] & wall_peak::JOINED != 0 && wall_level::offset(level[e]) < 0;
        let mask = select::lumen(&self.bricks, self.core, lumen_at).ok_or(WallError::Empty)?;
        let inside = bits_in(&self.bricks, &mask);
        let sigma_mm = self.blur_mm(&value, &mark);
        Ok(WallProfile { input: self, mark, level, mask, inside, sigma_mm })
    }

    /// Estimates the blur of the scan, mm, from the steepest slopes at the wall: a plate's slope is
    /// a function of its peak over σ. A central difference adds a third of a squared voxel.
    fn blur_mm(&self, value: &[i32], mark: &[u32]) -> f64 {
        let h = self.grid.spacing_mm;
        let least = (MIN_PEAK * UNIT) as u32;
        let is_clear =
            |m: &u32| m & (wall_peak::RIM | wall_peak::CREST) == wall_peak::RIM && m >> 8 > least;
        let all: Vec<usize> =
            (0..mark.len()).into_par_iter().filter(|e| is_clear(&mark[*e])).collect();
        let each = all.len().div_ceil(4000).max(1);
        let slopes: Vec<f64> = (0..=64)
            .map(|i| law::greatest_slope(f64::from(i) / 64.0, self.contrast.beyond))
            .collect();
        let slope = |e: usize| -> Option<f64> {
            let mut g = DVec3::ZERO;
            for axis in 0..3 {
                let mut d = IVec3::ZERO;
                d[axis] = 1;
                let (a, b) = (self.bricks.step(e, d)?, self.bricks.step(e, -d)?);
                g[axis] = f64::from(value[a] - value[b]) / (2.0 * h[axis]);
            }
            Some(g.length() / UNIT)
        };
        let sigma = |e: usize| -> Option<f64> {
            let mut most = 0f64;
            for n in 0..27 {
                let d = near_offset(n);
                most = most.max(slope(self.bricks.step(e, d)?)?);
            }
            (most > 0.0).then(|| slopes[(mark[e] >> 14) as usize] / most)
        };
        let mut sigmas: Vec<f64> = all.into_par_iter().step_by(each).filter_map(sigma).collect();
        let mean = self.mean_spacing();
        let middle = sigmas.len() / 2;
        if sigmas.is_empty() {
            return MIN_SIGMA * mean;
        }
        let sigma = *sigmas.select_nth_unstable_by(middle, f64::total_cmp).1;
        (sigma * sigma - mean * mean / 3.0).max(0.0).sqrt().max(MIN_SIGMA * mean)
    }
}
