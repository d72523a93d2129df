//! Order of the segments of a colon, and what the scan shows between them.

use glam::{DVec3, UVec3};

use super::SIDES;
use super::gas::{ColonCandidate, GAS_HU};
use super::numbers::of_colon::colon_order::*;
use crate::volume::Volume;

/// Values between the segments with their names, each up to a value, HU.
const CONTENTS: [(f64, &str); 5] = [
    (GAS_HU, "gas"),
    (-150.0, "gas mixed with stool or wall"),
    (-20.0, "fat"),
    (150.0, "tissue, stool or fluid"),
    (f64::INFINITY, "tagged content or bone"),
];

/// The straight way between two segments that follow each other.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct SegmentGap {
    pub length_mm: f64,
    /// Share of the way in each kind of [`CONTENTS`].
    shares: [f64; CONTENTS.len()],
}

impl SegmentGap {
    /// * `ends`: nearest places of two segments, LPS mm.
    fn of(volume: &Volume, ends: [DVec3; 2]) -> Self {
        let to_voxel = volume.grid.world_from_voxel().inverse();
        let length_mm = ends[0].distance(ends[1]);
        let steps = (length_mm / STEP_MM).ceil().max(1.0) as usize;
        let mut shares = [0.0; CONTENTS.len()];
        for step in 0..steps {
            let place = ends[0].lerp(ends[1], (step as f64 + 0.5) / steps as f64);
            let voxel = to_voxel.transform_point3(place).round().as_ivec3();
            let value = volume.real(volume.grid.index(voxel.as_uvec3()));
            let kind = CONTENTS.iter().position(|(most, _)| value <= *most);
            shares[kind.unwrap_or(0)] += 1.0 / steps as f64;
        }
        Self { length_mm, shares }
    }

    /// Describes the way: its length and its contents, the most frequent first.
    pub fn line(&self) -> String {
        let mut parts: Vec<_> = self.shares.iter().zip(CONTENTS).filter(|p| *p.0 >= 0.05).collect();
        parts.sort_by(|a, b| b.0.total_cmp(a.0));
        let words: Vec<String> = parts
            .iter()
            .map(|(share, (_, name))| format!("{:.0} % {name}", 100.0 * **share))
            .collect();
        format!("{:.0} mm between them: {}", self.length_mm, words.join(", "))
    }
}

/// Segments from the feet-most one on, each followed by the one with the narrowest gap to it.
pub(super) fn in_order(volume: &Volume, mut left: Vec<ColonCandidate>) -> Vec<ColonCandidate> {
    let mut rims: Vec<Vec<DVec3>> = left.iter().map(|c| rim(volume, c)).collect();
    let lowest = |r: &Vec<DVec3>| r.iter().map(|p| p.z).fold(f64::INFINITY, f64::min);
    let first = (0..left.len()).min_by(|a, b| lowest(&rims[*a]).total_cmp(&lowest(&rims[*b])));
    let mut out: Vec<ColonCandidate> = Vec::new();
    let mut next = first.map(|first| (first, None));
    while let Some((i, gap)) = next {
        let here = rims.remove(i);
        out.push(ColonCandidate { gap, ..left.remove(i) });
        let ends = rims.iter().map(|there| nearest(&here, there)).enumerate();
        let length = |(_, ends): &(usize, [DVec3; 2])| ends[0].distance_squared(ends[1]);
        let narrowest = ends.min_by(|a, b| length(a).total_cmp(&length(b)));
        next = narrowest.map(|(i, ends)| (i, Some(SegmentGap::of(volume, ends))));
    }
    out
}

/// A sample of a segment's rim, LPS mm.
fn rim(volume: &Volume, segment: &ColonCandidate) -> Vec<DVec3> {
    let to_world = volume.grid.world_from_voxel();
    let on_rim = |v: &UVec3| SIDES.iter().any(|d| !segment.mask.get(v.as_ivec3() + d));
    let all: Vec<UVec3> = segment.mask.voxels().filter(on_rim).collect();
    let each = all.len().div_ceil(RIM_PLACES).max(1);
    all.iter().step_by(each).map(|v| to_world.transform_point3(v.as_dvec3())).collect()
}

/// The places of two rims that are nearest to each other.
fn nearest(here: &[DVec3], there: &[DVec3]) -> [DVec3; 2] {
    let to_here = |q: &DVec3| {
        let near =
            here.iter().min_by(|a, b| a.distance_squared(*q).total_cmp(&b.distance_squared(*q)));
        [near.copied().unwrap_or(*q), *q]
    };
    let pairs = there.iter().map(to_here);
    let length = |ends: &[DVec3; 2]| ends[0].distance_squared(ends[1]);
    pairs.min_by(|a, b| length(a).total_cmp(&length(b))).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::{Grid, Samples};

    #[test]
    fn a_gap_names_its_contents_by_their_share() {
        let grid = Grid::axis_aligned([60, 9, 9], [1.0, 1.0, 1.0]);
        let value = |i: usize| match grid.voxel(i).x {
            ..20 => -1000,
            20..35 => 40,
            35..45 => 400,
            _ => -100,
        };
        let stored: Vec<i16> = (0..grid.len()).map(value).collect();
        let volume = Volume::new(grid, Samples::I16(stored.into()));
        let place = |x: f64| DVec3::new(x, 4.0, 4.0);
        let gap = SegmentGap::of(&volume, [place(19.5), place(49.5)]);
        let wanted = "30 mm between them: 50 % tissue, stool or fluid, 33 % tagged content or bone, 17 % fat";
        assert_eq!(gap.line(), wanted);
    }
}
