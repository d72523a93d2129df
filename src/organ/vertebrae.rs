//! The spine as the best way through the slices of a coarse copy of a CT, each place of which is scored
//! by how much it looks like the middle of a vertebra.

use glam::{DVec2, UVec3};
use rayon::prelude::*;

pub(super) use super::numbers::of_vessel::vertebrae::VERTEBRA_MM;
use super::numbers::of_vessel::vertebrae::*;
use super::values::quantile;
use crate::volume::{Grid, Volume};

/// Values from where on a voxel counts as bright, and counts in full, HU.
const BRIGHT_HU: (f64, f64) = (90.0, 170.0);
const MUSCLE_OFF_MM: (f64, f64) = (38.0, 32.0);

/// The best way through the slices of a coarse copy.
pub(super) struct SpineColumn {
    /// Turn of the patient.
    pub degrees: f64,
    /// Pixel of the way in each slice, and its score.
    pub places: Vec<[usize; 2]>,
    pub scores: Vec<f64>,
}

impl SpineColumn {
    /// Finds the way and the turn of the patient.
    ///
    /// * `turned`: a coarse copy whose axes lead to left, back and head.
    /// * `is_inside`: whether a voxel of the copy lies in the body.
    /// * `rolls`: turns about the patient's length that are tried, degrees; at least one.
    /// * `is_rough`: whether the way through a few of the slices is enough.
    pub fn of(
        turned: &Volume,
        is_inside: impl Fn(UVec3) -> bool + Sync,
        rolls: &[f64],
        is_rough: bool,
    ) -> Self {
        let grid = &turned.grid;
        let slice = |z| SpineSlice::of(turned, &is_inside, z);
        let slices: Vec<SpineSlice> = (0..grid.dims.z).into_par_iter().map(slice).collect();
        let turn = |degrees: &f64| Self::through(grid, &slices, *degrees, FEW);
        let turns: Vec<Self> = rolls.par_iter().map(turn).collect();
        let worth = |column: &Self| column.median() - ROLL_COST * column.degrees.abs();
        // Of equal ones the first.
        let best = turns.into_iter().reduce(|a, b| if worth(&b) > worth(&a) { b } else { a });
        match best {
            Some(best) if is_rough => best,
            best => Self::through(grid, &slices, best.map_or(0.0, |best| best.degrees), 1),
        }
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
    pub fn median(&self) -> f64 {
        let mut sorted = self.scores.clone();
        sorted.sort_by(f64::total_cmp);
        quantile(&sorted, 0.5)
    }
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
