//! The patient's own frame in a CT: where back and head lie and where the spine runs, by shape and
//! content.
//!
//! A vertebra is bright, lies near the middle of the body and not far from the skin of the back, and
//! has a canal and an arch behind it. Each of these is weak alone: marrow may be darker than blood, and
//! blood as bright as cortex; but the aorta has the vertebra behind it and no canal. So each place is
//! scored by all of them, and the spine is the best way through the slices. The header says where the
//! back is; where no spine is seen there, the other directions are tried.

use std::cell::OnceCell;

use glam::{DVec2, DVec3, UVec3};
use rayon::prelude::*;

use super::aorta::block_means;
use super::body::PatientBody;
use super::head_foot_axis;
use crate::lumen::BitVolume;
use crate::volume::{Grid, SampleBuffer, Samples, Volume};

/// Value of soft tissue, HU.
const SOFT_HU: f32 = 40.0;
/// Voxel sides of the coarse copy, mm, about.
const COARSE_MM: f64 = 3.0;
/// Distance of its slices, mm, about; of each so many the turn of the patient is found.
const SLICE_MM: f64 = 5.0;
const FEW: usize = 3;
/// Values from where on a voxel counts as bright, and counts in full, HU.
const BRIGHT_HU: (f64, f64) = (90.0, 170.0);
/// Values of muscle, HU.
const MUSCLE_HU: std::ops::Range<f64> = -50.0..130.0;
/// Least brightness of a vertebra; discs between vertebrae have less.
const MIN_BRIGHT: f64 = 0.05;
/// Radius of a vertebra, of its canal, of arch and muscles, mm.
const VERTEBRA_MM: f64 = 16.0;
const CANAL_MM: f64 = 6.0;
const BESIDE_MM: f64 = 9.0;
/// Radii of a ring about the canal, mm, and its brightness from where on the canal counts as enclosed.
const RING_MM: std::ops::Range<f64> = 8.0..13.0;
const RING_BRIGHT: f64 = 0.35;
/// A place so far behind a vertebra, of such a radius, mm, is not bright; brightness from where on it
/// counts in full, and weight.
const FAR_BEHIND_MM: f64 = 80.0;
const FAR_MM: f64 = 14.0;
const FAR_BRIGHT: f64 = 0.35;
const FAR_WEIGHT: f64 = 0.8;
/// Distance of canal and arch behind the middle of a vertebra, and of the muscles: behind and beside
/// it, mm.
const CANAL_BEHIND_MM: f64 = 25.0;
const ARCH_BEHIND_MM: f64 = 42.0;
const MUSCLE_OFF_MM: (f64, f64) = (38.0, 32.0);
/// Weights of the arch and of the muscles, where the vertebra weighs 1. The brightness of the arch counts
/// up to so many times the brightness of the vertebra.
const ARCH_WEIGHT: f64 = 0.7;
const ARCH_TIMES: f64 = 1.5;
const MUSCLE_WEIGHT: f64 = 0.3;
/// Distance of a vertebra's middle from the skin of the back, mm, and from the middle of the body,
/// at which nothing counts any more.
const FROM_SKIN_MM: std::ops::Range<f64> = 20.0..150.0;
const OFF_MIDDLE_MM: f64 = 60.0;
/// Share of the score that the greatest distance from the skin takes.
const DEEPER: f64 = 0.4;
/// Half axes of a vertebra, to the side and to the front, mm; half the width of arch and processes, and
/// their reach behind the middle of the vertebra, mm.
const BODY_MM: (f64, f64) = (22.0, 17.0);
const ARCH_SIDE_MM: f64 = 35.0;
const BEHIND_MM: f64 = 70.0;
/// Turns of the patient about his length that are tried, degrees.
const ROLLS: [f64; 5] = [0.0, -10.0, 10.0, -20.0, 20.0];
/// Score by which a turn has to be better, for each degree.
const ROLL_COST: f64 = 0.004;
/// Length along the patient over which scores are averaged, mm, and step aside per mm along.
const ALONG_MM: f64 = 15.0;
const SLOPE: f64 = 0.7;
/// Score of a slice in which the spine is seen. Measured: medians of five spines 0.69 to 1.04, of two
/// skulls 0.23 and 0.41.
const SEEN: f64 = 0.25;
/// Median score of a spine, and score at which there is no doubt.
const MEDIAN: (f64, f64) = (0.38, 0.55);
/// Score by which another direction has to exceed the score of the header's direction.
const TURNED: f64 = 0.15;

/// The patient's frame.
#[derive(Clone)]
pub(super) struct BodyFrame {
    axes: FrameAxes,
    spacing_mm: DVec3,
    /// The spine from slice to slice of the coarse copy, by ascending index along the patient.
    spine: Vec<SpinePoint>,
    /// Turn of the patient about his length, from left to back, radians.
    roll: f64,
    /// Whether back or head lie elsewhere than the header says.
    pub is_turned: bool,
    /// Margin by which the spine was seen, 0 to 1.
    pub confidence: f64,
}

/// The middle of the spine in a slice.
#[derive(Clone, Copy)]
struct SpinePoint {
    /// Place, voxels of the volume.
    at: DVec3,
    score: f64,
}

/// Index axes of the volume along the patient, each with whether its indices fall towards left, back
/// and head.
#[derive(Clone, Copy, PartialEq)]
struct FrameAxes {
    axes: [usize; 3],
    falls: [bool; 3],
}

impl FrameAxes {
    /// The axes nearest to those of the header.
    fn of_header(grid: &Grid) -> Self {
        let head = head_foot_axis(grid);
        let [u, v] = [(1, 2), (0, 2), (0, 1)].map(<[usize; 2]>::from)[head];
        let side = |axis: usize| grid.direction.col(axis).x.abs();
        let (left, back) = if side(u) >= side(v) { (u, v) } else { (v, u) };
        let axes = [left, back, head];
        let falls = [0, 1, 2].map(|k| grid.direction.col(axes[k])[k] < 0.0);
        Self { axes, falls }
    }

    /// The voxel of a copy at a voxel whose indices lead to left, back and head.
    fn stored(self, copy: &Volume, v: UVec3) -> UVec3 {
        let mut at = UVec3::ZERO;
        for (k, axis) in self.axes.into_iter().enumerate() {
            at[axis] = if self.falls[k] { copy.grid.dims[axis] - 1 - v[k] } else { v[k] };
        }
        at
    }

    /// All others: three axes along the patient with four directions to the back each. Nothing tells
    /// head from feet; both keep the sign that they have.
    fn others(self) -> impl Iterator<Item = Self> {
        let all = (0..3).flat_map(move |head| {
            let (u, v) = [(1, 2), (0, 2), (0, 1)][head];
            [(u, v), (v, u)].into_iter().flat_map(move |(left, back)| {
                [false, true].map(|falls| Self {
                    axes: [left, back, head],
                    falls: [self.falls[0], falls, self.falls[2]],
                })
            })
        });
        all.filter(move |other| *other != self)
    }
}

/// A coarse copy of a CT in which a spine is looked for.
pub(super) struct FrameSearch {
    copy: Volume,
    /// Number of the volume's voxels along each side of a voxel of the copy.
    factor: UVec3,
    /// Inside of the body in the copy.
    inside: BitVolume,
    axes: FrameAxes,
    /// Whether back or head lie elsewhere than the header says.
    is_turned: bool,
    spacing_mm: DVec3,
    /// The frame of all that the copy holds.
    whole: OnceCell<Option<BodyFrame>>,
}

impl FrameSearch {
    /// * `means`: of blocks of so many voxels of the volume.
    pub fn new(volume: &Volume, means: &Volume, block: UVec3) -> Self {
        let header = FrameAxes::of_header(&volume.grid);
        let mut sides_mm = DVec3::splat(COARSE_MM);
        sides_mm[header.axes[2]] = SLICE_MM;
        let (copy, factor) = block_means(means, sides_mm);
        let factor = factor * block;
        let mut inside = body_across(&copy, header);
        let median = |axes: FrameAxes, inside: &BitVolume, rolls: &[f64]| {
            Column::of(&copy, inside, axes, (rolls, FEW)).map_or(0.0, |column| column.median())
        };
        let mut axes = header;
        let own = median(header, &inside, &ROLLS);
        if own < MEDIAN.0 {
            let mut best = MEDIAN.0.max(own + TURNED);
            for along in 0..3 {
                let others: Vec<FrameAxes> =
                    header.others().filter(|o| o.axes[2] == along).collect();
                let body = body_across(&copy, others[0]);
                for other in others {
                    let score = median(other, &body, &ROLLS[..1]);
                    if score >= best {
                        (best, axes, inside) = (score, other, body.clone());
                    }
                }
            }
        }
        let spacing_mm = volume.grid.spacing_mm;
        Self {
            copy,
            factor,
            inside,
            axes,
            is_turned: axes != header,
            spacing_mm,
            whole: OnceCell::new(),
        }
    }

    /// The copy with some voxels of the volume as soft as tissue.
    fn without(&self, mask: &BitVolume) -> Volume {
        let grid = self.copy.grid;
        let mut values: Vec<f32> = (0..grid.len()).map(|i| self.copy.real(i) as f32).collect();
        for v in mask.voxels().map(|v| v / self.factor).filter(|v| v.cmplt(grid.dims).all()) {
            let value = &mut values[grid.index(v)];
            *value = value.min(SOFT_HU);
        }
        Volume::new(grid, Samples::F32(SampleBuffer::from(values)))
    }

    /// Finds the frame of the patient; `None` where no spine is seen.
    ///
    /// * `mask`: counts as soft tissue, as a vessel may be as bright as bone; all is looked at where
    ///   no spine is seen without it.
    pub fn find_without(&self, mask: &BitVolume) -> Option<BodyFrame> {
        let whole = || self.whole.get_or_init(|| self.find(&self.copy)).clone();
        self.find(&self.without(mask)).or_else(whole)
    }

    fn find(&self, copy: &Volume) -> Option<BodyFrame> {
        let (axes, factor) = (self.axes, self.factor);
        let column =
            Column::of(copy, &self.inside, axes, (&ROLLS, 1)).filter(|c| c.median() >= MEDIAN.0)?;
        let to_volume = |p: [usize; 3], slice: usize| {
            let mut at = DVec3::ZERO;
            for (k, i) in [p[0], p[1], slice].into_iter().enumerate() {
                let axis = axes.axes[k];
                let last = copy.grid.dims[axis] as usize - 1;
                let i = if axes.falls[k] { last - i } else { i };
                at[axis] = (i as f64 + 0.5) * f64::from(factor[axis]) - 0.5;
            }
            at
        };
        let mut spine: Vec<SpinePoint> = (0..column.places.len())
            .map(|slice| {
                let [x, y] = column.places[slice];
                SpinePoint { at: to_volume([x, y, 0], slice), score: column.scores[slice] }
            })
            .collect();
        if axes.falls[2] {
            spine.reverse();
        }
        Some(BodyFrame {
            axes,
            spacing_mm: self.spacing_mm,
            spine,
            roll: column.degrees.to_radians(),
            is_turned: self.is_turned,
            confidence: ((column.median() - MEDIAN.0) / (MEDIAN.1 - MEDIAN.0)).clamp(0.0, 1.0),
        })
    }
}

impl BodyFrame {
    /// The index axis along the patient.
    pub fn along(&self) -> usize {
        self.axes.axes[2]
    }

    /// Offset of a place from the middle of the spine at its height, mm: to the left and to the back;
    /// `None` where the spine is not seen.
    ///
    /// * `at`: voxels of the volume.
    pub fn offset_from_spine(&self, at: DVec3) -> Option<DVec2> {
        let [left, back, along] = self.axes.axes;
        let after = self.spine.partition_point(|s| s.at[along] < at[along]);
        let before = &self.spine[after.saturating_sub(1)];
        let after = &self.spine[after.min(self.spine.len() - 1)];
        let span = after.at[along] - before.at[along];
        let t = if span > 0.0 { (at[along] - before.at[along]) / span } else { 0.0 };
        let middle = before.at.lerp(after.at, t.clamp(0.0, 1.0));
        let is_seen = before.score.min(after.score) >= SEEN;
        let off = |k: usize, axis: usize| {
            let mm = (at[axis] - middle[axis]) * self.spacing_mm[axis];
            if self.axes.falls[k] { -mm } else { mm }
        };
        is_seen
            .then(|| DVec2::from_angle(-self.roll).rotate(DVec2::new(off(0, left), off(1, back))))
    }

    /// Voxels of the vertebrae, their arches and the muscles behind them, where the spine is seen.
    pub fn spine(&self, dims: UVec3) -> BitVolume {
        let [left, back, along] = self.axes.axes;
        let mut out = BitVolume::new(dims);
        for slice in 0..dims[along] {
            let mut origin = DVec3::ZERO;
            origin[along] = f64::from(slice);
            let Some(first) = self.offset_from_spine(origin) else { continue };
            let turn = DVec2::from_angle(-self.roll);
            let step = |k: usize, axis: usize, way: DVec2| {
                let sign = if self.axes.falls[k] { -1.0 } else { 1.0 };
                turn.rotate(way * sign * self.spacing_mm[axis])
            };
            let (across, down) = (step(0, left, DVec2::X), step(1, back, DVec2::Y));
            for q in 0..dims[back] {
                for p in 0..dims[left] {
                    let off = first + across * f64::from(p) + down * f64::from(q);
                    let is_body = (off / DVec2::from(BODY_MM)).length_squared() < 1.0;
                    let is_behind = off.abs().x < ARCH_SIDE_MM && (0.0..BEHIND_MM).contains(&off.y);
                    if is_body || is_behind {
                        let mut at = UVec3::ZERO;
                        (at[left], at[back], at[along]) = (p, q, slice);
                        out.set(at.x, at.y, at.z);
                    }
                }
            }
        }
        out
    }

    /// Describes the frame in a line of a report.
    pub fn line(&self) -> String {
        let seen = self.spine.iter().filter(|s| s.score >= SEEN).count();
        let header = match self.is_turned {
            true => "not where the header says the back is",
            false => "where the header says the back is",
        };
        format!(
            "spine seen in {:.0} % of the slices, {header}, turned by {:.0} degrees (confidence {:.2})",
            100.0 * seen as f64 / self.spine.len().max(1) as f64,
            self.roll.to_degrees(),
            self.confidence
        )
    }
}

/// The best way through the slices of a coarse copy whose axes lead to left, back and head.
struct Column {
    /// Turn of the patient.
    degrees: f64,
    places: Vec<[usize; 2]>,
    scores: Vec<f64>,
}

impl Column {
    /// * `rolls`: turns about the patient's length that are tried, degrees.
    /// * `every`: the way leads through each of so many slices.
    fn of(
        copy: &Volume,
        inside: &BitVolume,
        axes: FrameAxes,
        (rolls, every): (&[f64], usize),
    ) -> Option<Self> {
        let turned = turned(copy, axes);
        let slices: Vec<SpineSlice> = (0..turned.grid.dims.z)
            .into_par_iter()
            .map(|z| SpineSlice::of(&turned, |v| inside.get(axes.stored(copy, v).as_ivec3()), z))
            .collect();
        // The turn from some of the slices, the way through all of them.
        let turn = |degrees: &f64| Self::through(&turned.grid, &slices, *degrees, FEW);
        let turns: Vec<Self> = rolls.par_iter().map(turn).collect();
        let worth = |column: &Self| column.median() - ROLL_COST * column.degrees.abs();
        // Of equal ones the first.
        let best = turns.into_iter().reduce(|a, b| if worth(&b) > worth(&a) { b } else { a })?;
        Some(Self::through(&turned.grid, &slices, best.degrees, every))
    }

    /// The best way through each of so many slices.
    fn through(grid: &Grid, slices: &[SpineSlice], degrees: f64, every: usize) -> Self {
        crate::task::checkpoint();
        let roll = degrees.to_radians();
        let scores: Vec<Vec<f32>> =
            slices.par_iter().step_by(every).map(|s| s.scores(roll)).collect();
        let step_mm = grid.spacing_mm.z * every as f64;
        let scores = smoothed_along(step_mm, scores);
        let places = best_way(grid, step_mm, &scores);
        let width = grid.dims.x as usize;
        let own = places.iter().zip(&scores).map(|([x, y], s)| f64::from(s[x + width * y]));
        Self { degrees, scores: own.collect(), places }
    }

    /// Median of the slices' scores.
    fn median(&self) -> f64 {
        let mut sorted = self.scores.clone();
        sorted.sort_by(f64::total_cmp);
        sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
    }
}

/// The copy with its axes to left, back and head.
fn turned(copy: &Volume, axes: FrameAxes) -> Volume {
    let from = &copy.grid;
    let dims = axes.axes.map(|axis| from.dims[axis]);
    let grid = Grid::axis_aligned(dims, axes.axes.map(|axis| from.spacing_mm[axis]));
    let value = |i: usize| copy.real(from.index(axes.stored(copy, grid.voxel(i)))) as f32;
    let values: Vec<f32> = (0..grid.len()).into_par_iter().map(value).collect();
    Volume::new(grid, Samples::F32(SampleBuffer::from(values)))
}

/// Inside of the body in a copy, by slices across the patient.
fn body_across(copy: &Volume, axes: FrameAxes) -> BitVolume {
    let mut out = BitVolume::new(copy.grid.dims);
    let body = PatientBody::of(&turned(copy, axes));
    for v in body.iter().flat_map(|body| body.inside.voxels()) {
        let v = axes.stored(copy, v);
        out.set(v.x, v.y, v.z);
    }
    out
}

/// A slice of a coarse copy whose rows lead to the left and whose columns to the back.
struct SpineSlice {
    width: usize,
    height: usize,
    pixel_mm: DVec2,
    bright: RowSums,
    muscle: RowSums,
    inside: Vec<bool>,
}

impl SpineSlice {
    /// * `is_inside`: whether a voxel of the turned copy lies in the body.
    fn of(turned: &Volume, is_inside: impl Fn(UVec3) -> bool, z: u32) -> Self {
        let grid = &turned.grid;
        let value = |x: u32, y: u32| turned.real(grid.index(UVec3::new(x, y, z)));
        let (width, height) = (grid.dims.x, grid.dims.y);
        let pixels = (0..height).flat_map(|y| (0..width).map(move |x| (x, y)));
        let inside: Vec<bool> = pixels.map(|(x, y)| is_inside(UVec3::new(x, y, z))).collect();
        let bright = |x: u32, y: u32| {
            let share = (value(x, y) - BRIGHT_HU.0) / (BRIGHT_HU.1 - BRIGHT_HU.0);
            if inside[(x + width * y) as usize] { share.clamp(0.0, 1.0) } else { 0.0 }
        };
        let muscle = |x, y| f64::from(u8::from(MUSCLE_HU.contains(&value(x, y))));
        Self {
            width: width as usize,
            height: height as usize,
            pixel_mm: grid.spacing_mm.truncate(),
            bright: RowSums::of(grid, bright),
            muscle: RowSums::of(grid, muscle),
            inside,
        }
    }

    /// Score of each pixel as the middle of a vertebra.
    ///
    /// * `roll`: turn of the patient, radians.
    fn scores(&self, roll: f64) -> Vec<f32> {
        let Self { width, height, pixel_mm, .. } = *self;
        let mut out = vec![0.0; width * height];
        // The skin of the back in each column, and the middle of the body.
        let skin = |x: usize| (0..height).rev().find(|y| self.inside[x + width * y]);
        let columns: Vec<(usize, usize)> = (0..width).filter_map(|x| Some((x, skin(x)?))).collect();
        let middle =
            columns.iter().map(|c| c.0).sum::<usize>() as f64 / columns.len().max(1) as f64;
        for (x, last) in columns {
            let central = 1.0 - (x as f64 - middle).abs() * pixel_mm.x / OFF_MIDDLE_MM;
            for y in (0..=last).filter(|y| central > 0.0 && self.inside[x + width * y]) {
                let from_skin = (last - y) as f64 * pixel_mm.y;
                if FROM_SKIN_MM.contains(&from_skin) {
                    let near = 1.0 - DEEPER * (from_skin / FROM_SKIN_MM.end);
                    let at = DVec2::new(x as f64, y as f64);
                    out[x + width * y] = (central * near * self.vertebra(at, roll)) as f32;
                }
            }
        }
        out
    }

    /// Likeness of a place to the middle of a vertebra.
    fn vertebra(&self, at: DVec2, roll: f64) -> f64 {
        let turn = DVec2::from_angle(roll);
        let mean = |of: &RowSums, off_mm: DVec2, radius_mm: f64| {
            of.mean(at + turn.rotate(off_mm) / self.pixel_mm, radius_mm / self.pixel_mm)
        };
        let bright = |behind_mm: f64, radius_mm: f64| {
            mean(&self.bright, DVec2::new(0.0, behind_mm), radius_mm)
        };
        let body = bright(0.0, VERTEBRA_MM);
        if body < MIN_BRIGHT {
            return 0.0;
        }
        let arch = bright(ARCH_BEHIND_MM, BESIDE_MM).min(ARCH_TIMES * body);
        let canal = 1.0 - bright(CANAL_BEHIND_MM, CANAL_MM);
        // Marrow behind a vessel may be as dark as a canal, but bone lies farther about it.
        let disc = |r: f64| r * r * bright(CANAL_BEHIND_MM, r);
        let ring_mm2 = RING_MM.end * RING_MM.end - RING_MM.start * RING_MM.start;
        let ring = (disc(RING_MM.end) - disc(RING_MM.start)) / ring_mm2;
        let enclosed = 0.5 + 0.5 * (ring / RING_BRIGHT).min(1.0);
        let (back, side) = MUSCLE_OFF_MM;
        let muscles = [-side, side].map(|x| mean(&self.muscle, DVec2::new(x, back), BESIDE_MM));
        // Behind a vessel the arch lies as far again as behind a vertebra.
        let far = (bright(FAR_BEHIND_MM, FAR_MM) / FAR_BRIGHT).min(1.0);
        let bone = (body + ARCH_WEIGHT * arch) * canal * canal * enclosed;
        let beside = MUSCLE_WEIGHT * 0.5 * (muscles[0] + muscles[1]);
        (bone + beside) * (1.0 - FAR_WEIGHT * far)
    }
}

/// Sums of a slice's rows from their first pixels on, for means over discs.
struct RowSums {
    width: usize,
    height: usize,
    sums: Vec<f64>,
}

impl RowSums {
    fn of(grid: &Grid, value: impl Fn(u32, u32) -> f64) -> Self {
        let (width, height) = (grid.dims.x, grid.dims.y);
        let mut sums = Vec::with_capacity((width as usize + 1) * height as usize);
        for y in 0..height {
            let mut sum = 0.0;
            sums.push(sum);
            for x in 0..width {
                sum += value(x, y);
                sums.push(sum);
            }
        }
        Self { width: width as usize, height: height as usize, sums }
    }

    /// Mean over a disc, whose pixels beyond the slice count as 0.
    ///
    /// * `radius`: along rows and columns, pixels.
    fn mean(&self, centre: DVec2, radius: DVec2) -> f64 {
        let (mut sum, mut count) = (0.0, 0.0);
        for y in (centre.y - radius.y).ceil() as i64..=(centre.y + radius.y).floor() as i64 {
            let off = (y as f64 - centre.y) / radius.y;
            let half = radius.x * (1.0 - off * off).max(0.0).sqrt();
            let (first, end) =
                ((centre.x - half).ceil() as i64, (centre.x + half).floor() as i64 + 1);
            count += (end - first) as f64;
            if (0..self.height as i64).contains(&y) {
                let row = (self.width + 1) * y as usize;
                let at = |x: i64| self.sums[row + x.clamp(0, self.width as i64) as usize];
                sum += at(end) - at(first);
            }
        }
        if count > 0.0 { sum / count } else { 0.0 }
    }
}

/// Means over neighbouring slices.
fn smoothed_along(step_mm: f64, scores: Vec<Vec<f32>>) -> Vec<Vec<f32>> {
    let reach = (0.5 * ALONG_MM / step_mm).round() as usize;
    let mean = |z: usize| {
        let near = &scores[z.saturating_sub(reach)..(z + reach + 1).min(scores.len())];
        let mut out = vec![0.0; scores[z].len()];
        for slice in near {
            out.iter_mut().zip(slice).for_each(|(sum, s)| *sum += s / near.len() as f32);
        }
        out
    };
    (0..scores.len()).into_par_iter().map(mean).collect()
}

/// The way through all slices with the greatest sum of scores, in steps aside of `SLOPE`.
fn best_way(grid: &Grid, step_mm: f64, scores: &[Vec<f32>]) -> Vec<[usize; 2]> {
    let (width, height) = (grid.dims.x as usize, grid.dims.y as usize);
    let steps = |axis: usize| (SLOPE * step_mm / grid.spacing_mm[axis]).ceil() as usize;
    let (across, down) = (steps(0), steps(1));
    let near =
        |i: usize, reach: usize, end: usize| i.saturating_sub(reach)..(i + reach + 1).min(end);
    // Best sum that ends at each pixel of each slice.
    let mut sums: Vec<Vec<f32>> = Vec::with_capacity(scores.len());
    for own in scores {
        let Some(before) = sums.last() else {
            sums.push(own.clone());
            continue;
        };
        let most = |i: usize, pick: &dyn Fn(usize) -> f32, reach: usize, end: usize| {
            near(i, reach, end).map(pick).fold(f32::NEG_INFINITY, f32::max)
        };
        let rows: Vec<f32> = (0..width * height)
            .map(|i| {
                let row = i / width * width;
                most(i % width, &|x| before[row + x], across, width)
            })
            .collect();
        let next = (0..width * height).map(|i| {
            let x = i % width;
            own[i] + most(i / width, &|y| rows[x + width * y], down, height)
        });
        sums.push(next.collect());
    }
    let greatest = |all: &mut dyn Iterator<Item = (f32, [usize; 2])>| {
        all.reduce(|a, b| if b.0 > a.0 { b } else { a }).map_or([0; 2], |best| best.1)
    };
    let mut out: Vec<[usize; 2]> = Vec::with_capacity(sums.len());
    for sums in sums.iter().rev() {
        let (xs, ys) = match out.last() {
            None => (0..width, 0..height),
            Some([x, y]) => (near(*x, across, width), near(*y, down, height)),
        };
        let mut all = ys.flat_map(|y| xs.clone().map(move |x| [x, y]));
        out.push(greatest(&mut all.by_ref().map(|[x, y]| (sums[x + width * y], [x, y]))));
    }
    out.reverse();
    out
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A body with a spine at its back, and a bright vessel in front of it; discs are as soft tissue.
    fn torso(vessel_hu: i16, marrow_hu: i16) -> Volume {
        let grid = Grid::axis_aligned([70, 50, 60], [4.0, 4.0, 3.0]);
        let value = |i: usize| {
            let v = grid.voxel(i).as_dvec3() * grid.spacing_mm;
            let off = DVec2::new(v.x - 140.0, v.y - 100.0);
            let (spine, vessel) =
                ((off - DVec2::new(0.0, 45.0)).length(), off.distance(DVec2::new(12.0, 12.0)));
            let arch = (off - DVec2::new(0.0, 86.0)).length();
            let is_disc = v.z.rem_euclid(33.0) < 9.0;
            match () {
                () if (off.x / 125.0).powi(2) + (off.y / 98.0).powi(2) > 1.0 => -1000,
                () if vessel < 11.0 => vessel_hu,
                () if spine < 17.0 && !is_disc => {
                    if spine > 14.0 {
                        380
                    } else {
                        marrow_hu
                    }
                }
                () if arch < 9.0 && !is_disc => 400,
                () => 40,
            }
        };
        Volume::new(grid, (0..grid.len()).map(value).collect::<Vec<i16>>().into())
    }

    fn frame_of(volume: &Volume) -> Option<BodyFrame> {
        let search = FrameSearch::new(volume, volume, UVec3::ONE);
        search.find(&search.copy)
    }

    #[test]
    fn the_spine_lies_behind_a_vessel_as_bright_as_its_cortex() {
        for (vessel, marrow) in [(150, 200), (300, 230), (500, 110), (160, 160)] {
            let frame = frame_of(&torso(vessel, marrow)).unwrap();
            assert!(!frame.is_turned && frame.along() == 2);
            // The middle of the vessel, half way up.
            let off = frame.offset_from_spine(DVec3::new(38.0, 28.0, 30.0)).unwrap();
            assert!(off.distance(DVec2::new(12.0, -33.0)) < 9.0, "{vessel} {marrow}: {off}");
        }
    }

    #[test]
    fn a_back_that_is_not_where_the_header_says_is_found() {
        let right = torso(300, 200);
        let grid = Grid::axis_aligned([50, 60, 70], [4.0, 3.0, 4.0]);
        // Stored with the back to the right and the head to the back.
        let values: Vec<f32> = (0..grid.len())
            .map(|i| {
                let v = grid.voxel(i);
                right.real(right.grid.index(UVec3::new(v.z, 49 - v.x, v.y))) as f32
            })
            .collect();
        let turned = Volume::new(grid, Samples::F32(SampleBuffer::from(values)));
        let frame = frame_of(&turned).unwrap();
        assert!(frame.is_turned && frame.along() == 1);
        let off = frame.offset_from_spine(DVec3::new(21.0, 30.0, 38.0)).unwrap();
        assert!(off.x.abs() < 25.0 && (off.y + 33.0).abs() < 9.0, "{off}");
    }

    #[test]
    fn a_body_without_bone_has_no_frame() {
        let soft = torso(40, 40);
        let values: Vec<f32> =
            (0..soft.grid.len()).map(|i| soft.real(i).min(60.0) as f32).collect();
        let soft = Volume::new(soft.grid, Samples::F32(SampleBuffer::from(values)));
        assert!(frame_of(&soft).is_none());
    }
}
