//! A quick look at a volume: what part of a patient it seems to show, and which organs may be
//! found there. It counts kinds of value on a coarse grid and decides nothing; the gates of an
//! organ's own search do.

use glam::{IVec3, UVec3};

use super::numbers::of_every_organ::glance::*;
use super::values::MIN_HU;
use super::{Organ, SIDES, head_foot_axis};
use crate::lumen::{BitVolume, pieces};
use crate::volume::Volume;

/// Content that a volume seems to have.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Glance {
    /// Part of the patient or kind of scan, as a noun with its article; `None` where it is none
    /// that is known.
    pub shows: Option<&'static str>,
    /// Organs that may be found, the likeliest first.
    pub organs: Vec<Organ>,
}

/// Looks at every few millimetres of a volume.
pub fn glance(volume: &Volume) -> Glance {
    let samples = Samples::of(volume);
    let (mut low, mut high) = (f64::INFINITY, f64::NEG_INFINITY);
    samples.values.iter().for_each(|v| (low, high) = (low.min(*v), high.max(*v)));
    if low >= CT_HU {
        return samples.angiogram(low, high);
    }
    samples.body()
}

/// Values on a coarse grid, x fastest.
struct Samples {
    dims: UVec3,
    values: Vec<f64>,
    /// Volume that a sample stands for, ml.
    sample_ml: f64,
    /// Axis nearest to head and foot.
    along: usize,
}

impl Samples {
    fn of(volume: &Volume) -> Self {
        let grid = &volume.grid;
        let wanted = (STEP_MM / grid.spacing_mm).round().as_uvec3();
        let step = |i: usize| wanted[i].max(grid.dims[i].div_ceil(MAX_STEPS)).max(1);
        let step = UVec3::from_array([0, 1, 2].map(step));
        let dims = (grid.dims + step - 1) / step;
        let row = |y, z| (0..dims.x).map(move |x| UVec3::new(x, y, z));
        let places = (0..dims.z).flat_map(|z| (0..dims.y).flat_map(move |y| row(y, z)));
        let values = places.map(|v| volume.real(grid.index(v * step))).collect();
        let sample_ml = grid.voxel_mm3() * step.as_dvec3().element_product() / 1000.0;
        Self { dims, values, sample_ml, along: head_foot_axis(grid) }
    }

    fn index(&self, v: UVec3) -> usize {
        (v.x + self.dims.x * (v.y + self.dims.y * v.z)) as usize
    }

    fn places(&self) -> impl Iterator<Item = UVec3> + '_ {
        let [x, y, _] = self.dims.to_array();
        (0..self.values.len() as u32).map(move |i| UVec3::new(i % x, i / x % y, i / (x * y)))
    }

    /// Volume of the samples that have a property, ml.
    fn ml(&self, has: impl Fn(UVec3) -> bool) -> f64 {
        self.places().filter(|v| has(*v)).count() as f64 * self.sample_ml
    }

    /// Whether a sample and those beside it all have such values.
    fn is_even(&self, v: UVec3, fits: impl Fn(f64) -> bool) -> bool {
        let near = SIDES.iter().map(|side| v.as_ivec3() + *side);
        near.chain([v.as_ivec3()]).all(|w| {
            let is_there = w.cmpge(IVec3::ZERO).all() && w.cmplt(self.dims.as_ivec3()).all();
            is_there && fits(self.values[self.index(w.as_uvec3())])
        })
    }

    /// Samples with tissue of the body on all four sides of them across it, one flag each. A table
    /// and blankets, whose air is no gas of a patient, are other components of tissue.
    fn enclosed(&self) -> Vec<bool> {
        let mut tissue = BitVolume::new(self.dims);
        for v in self.places().filter(|v| self.values[self.index(*v)] >= TISSUE_HU) {
            tissue.set(v.x, v.y, v.z);
        }
        let body = pieces(&tissue, 1).first().map(|piece| piece.mask(self.dims));
        let body = body.unwrap_or(tissue);
        let mut inside = vec![true; self.values.len()];
        for axis in (0..3).filter(|axis| *axis != self.along) {
            let mut ends = vec![(u32::MAX, 0); self.values.len()];
            // The first and last tissue of each line, at the line's own first sample.
            let line = |mut v: UVec3| {
                v[axis] = 0;
                self.index(v)
            };
            for v in body.voxels() {
                let (first, last) = &mut ends[line(v)];
                (*first, *last) = ((*first).min(v[axis]), (*last).max(v[axis]));
            }
            for v in self.places() {
                let (first, last) = ends[line(v)];
                inside[self.index(v)] &= first < v[axis] && v[axis] < last;
            }
        }
        inside
    }

    /// A CT: lungs, gas without lung, contrast medium.
    fn body(&self) -> Glance {
        let inside = self.enclosed();
        let value = |v: UVec3| self.values[self.index(v)];
        let is_in = |v: UVec3| inside[self.index(v)];
        let lung = self.ml(|v| is_in(v) && LUNG_HU.contains(&value(v)));
        let is_gas = |v: f64| (MIN_HU..GAS_HU).contains(&v);
        let gas = self.ml(|v| is_in(v) && self.is_even(v, is_gas));
        let is_blood = |v: f64| CONTRAST_HU.contains(&v);
        let blood = self.ml(|v| is_in(v) && self.is_even(v, is_blood));
        // Mixed values at the wall of a distended bowel are as those of lung.
        let (has_lung, has_gas) = (lung >= LUNG_ML.max(gas), gas >= GAS_ML);
        let shows = match (has_lung, has_gas) {
            (true, true) => Some("a trunk with gas in the bowel"),
            (true, false) => Some("a chest"),
            (false, true) => Some("an abdomen with gas in the bowel"),
            (false, false) => None,
        };
        let found = [
            (has_lung && !has_gas, Organ::Airway),
            (has_gas, Organ::Colon),
            (has_lung && has_gas, Organ::Airway),
            (blood >= CONTRAST_ML && (has_lung || has_gas), Organ::Vessel),
        ];
        let organs = found.into_iter().filter(|f| f.0).map(|f| f.1).collect();
        Glance { shows, organs }
    }

    /// A scan without air in HU: an angiogram is dark but for its vessels.
    fn angiogram(&self, low: f64, high: f64) -> Glance {
        let mut sorted = self.values.clone();
        sorted.sort_by(f64::total_cmp);
        let nothing = Glance::default();
        let values = sorted.windows(2).filter(|w| w[0] != w[1]).count() + 1;
        if values <= LABELS {
            return nothing;
        }
        let median = sorted.get(sorted.len() / 2).copied().unwrap_or(low);
        let is_dark = high > low && median - low <= DARK * (high - low);
        match is_dark {
            true => Glance { shows: Some("an angiogram"), organs: vec![Organ::Vessel] },
            false => nothing,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Grid, Samples as Stored};

    /// A CT of 200 mm: air, a body of tissue 160 mm wide, and a box inside it of such a value.
    fn scan(inner: impl Fn(UVec3) -> i16) -> Volume {
        let grid = Grid::axis_aligned([50; 3], [4.0; 3]);
        let value = |i: usize| {
            let v = grid.voxel(i);
            let off = (v.as_ivec3() - 25).abs();
            match (off.x.max(off.y), off.max_element()) {
                (20.., _) => -1000,
                (_, ..15) => inner(v),
                _ => 40,
            }
        };
        let stored: Vec<i16> = (0..grid.len()).map(value).collect();
        Volume::new(grid, Stored::I16(stored.into()))
    }

    #[test]
    fn lung_gas_and_contrast_medium_inside_a_body_suggest_their_organs() {
        let of = |inner: &dyn Fn(UVec3) -> i16| glance(&scan(inner));
        // As noise of lung has it, deep values are never even.
        let lung = |v: UVec3| if (v.x + v.y + v.z).is_multiple_of(2) { -820 } else { -930 };
        assert_eq!(of(&lung), Glance { shows: Some("a chest"), organs: vec![Organ::Airway] });
        let bowel = of(&|_| -1000);
        assert_eq!(bowel.shows, Some("an abdomen with gas in the bowel"));
        assert_eq!(bowel.organs, [Organ::Colon]);
        let both = of(&|v| {
            if v.z < 22 {
                -1000
            } else if v.x < 28 {
                lung(v)
            } else {
                300
            }
        });
        assert_eq!(both.organs, [Organ::Colon, Organ::Airway, Organ::Vessel]);
        // The air about a patient is no gas, and a body of tissue shows nothing.
        assert_eq!(of(&|_| 40), Glance { shows: None, organs: Vec::new() });
    }

    #[test]
    fn a_dark_scan_without_air_is_an_angiogram_and_a_bright_one_is_nothing_known() {
        let grid = Grid::axis_aligned([40; 3], [1.0; 3]);
        let of = |value: &dyn Fn(usize) -> u16| {
            let stored: Vec<u16> = (0..grid.len()).map(value).collect();
            glance(&Volume::new(grid, Stored::U16(stored.into()))).organs
        };
        assert_eq!(
            of(&|i| if i % 97 == 0 { 900 } else { (i * 7919 % 211) as u16 }),
            [Organ::Vessel]
        );
        assert_eq!(of(&|i| (i % 900) as u16), []);
        assert_eq!(of(&|_| 7), [], "one value");
        assert_eq!(of(&|i| u16::from(i % 97 == 0)), [], "a label map");
    }
}
