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

use super::body::PatientBody;
use super::coarse::block_means;
use super::head_foot_axis;
use super::numbers::of_every_organ::frame::*;
use super::vertebrae::SpineColumn;
use crate::lumen::BitVolume;
use crate::volume::{Grid, SampleBuffer, Samples, Volume};

/// Half axes of a vertebra, to the side and to the front, mm; half the width of arch and processes, and
/// their reach behind the middle of the vertebra, mm.
const BODY_MM: (f64, f64) = (22.0, 17.0);
/// Median score of a spine, and score at which there is no doubt.
const MEDIAN: (f64, f64) = (0.38, 0.55);

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
    confidence: f64,
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
        let (u, v) = [(1, 2), (0, 2), (0, 1)][head];
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
            column(&copy, inside, axes, (rolls, true)).median()
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
        let column = column(copy, &self.inside, axes, (&ROLLS, false));
        let median = column.median();
        if median < MEDIAN.0 {
            return None;
        }
        let mut spine: Vec<SpinePoint> = (0..column.places.len())
            .map(|slice| {
                let [x, y] = column.places[slice];
                let at = axes.stored(copy, UVec3::new(x as u32, y as u32, slice as u32));
                let at = (at.as_dvec3() + 0.5) * factor.as_dvec3() - 0.5;
                SpinePoint { at, score: column.scores[slice] }
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
            confidence: ((median - MEDIAN.0) / (MEDIAN.1 - MEDIAN.0)).clamp(0.0, 1.0),
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

/// The copy with its axes to left, back and head.
fn turned(copy: &Volume, axes: FrameAxes) -> Volume {
    let from = &copy.grid;
    let dims = axes.axes.map(|axis| from.dims[axis]);
    let grid = Grid::axis_aligned(dims, axes.axes.map(|axis| from.spacing_mm[axis]));
    let value = |i: usize| copy.real(from.index(axes.stored(copy, grid.voxel(i)))) as f32;
    let values: Vec<f32> = (0..grid.len()).into_par_iter().map(value).collect();
    Volume::new(grid, Samples::F32(SampleBuffer::from(values)))
}

/// The best way through a copy.
///
/// * `rolls`: turns of the patient that are tried, degrees, and whether a rough way is enough.
fn column(
    copy: &Volume,
    inside: &BitVolume,
    axes: FrameAxes,
    (rolls, is_rough): (&[f64], bool),
) -> SpineColumn {
    let is_inside = |v| inside.get(axes.stored(copy, v).as_ivec3());
    SpineColumn::of(&turned(copy, axes), is_inside, rolls, is_rough)
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
