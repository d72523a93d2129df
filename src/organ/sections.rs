//! Cross sections of tubes: regions of a slice with their shape and surroundings, and chains of them
//! from slice to slice.

use std::borrow::Cow;
use std::ops::Range;

use glam::{DVec2, UVec3};

use crate::geometry::DisjointSets;
use crate::lumen::{BitVolume, Run, open_background};
use crate::volume::Volume;

/// A cross section.
#[derive(Clone, Debug)]
pub(super) struct Section {
    pub slice: u32,
    pub centre_mm: DVec2,
    pub area_mm2: f64,
    pub circularity: f64,
    /// Median of its values.
    pub value: f64,
}

impl Section {
    /// Radius of a disc of the section's area.
    pub fn radius_mm(&self) -> f64 {
        (self.area_mm2 / std::f64::consts::PI).sqrt()
    }
}

/// Pixels of the slices across an axis.
#[derive(Clone, Copy)]
pub(super) struct Slices {
    pub axis: usize,
    pub u: usize,
    pub v: usize,
    pub width: usize,
    pub height: usize,
    pub pixel_mm: DVec2,
    pub step_mm: f64,
}

impl Slices {
    pub fn of(volume: &Volume, axis: usize) -> Self {
        let (u, v) = [(1, 2), (0, 2), (0, 1)][axis];
        let (dims, h) = (volume.grid.dims, volume.grid.spacing_mm);
        let (width, height) = (dims[u] as usize, dims[v] as usize);
        Self { axis, u, v, width, height, pixel_mm: DVec2::new(h[u], h[v]), step_mm: h[axis] }
    }

    pub fn voxel(&self, slice: u32, p: usize, q: usize) -> UVec3 {
        let mut at = UVec3::ZERO;
        (at[self.axis], at[self.u], at[self.v]) = (slice, p as u32, q as u32);
        at
    }
}

/// A mask read slice by slice, each row of a slice in runs.
pub(super) struct SlicedMask<'a> {
    /// The mask; with x and y exchanged for slices across x, whose rows lie along y.
    mask: Cow<'a, BitVolume>,
    slices: Slices,
}

impl<'a> SlicedMask<'a> {
    pub fn new(mask: &'a BitVolume, slices: &Slices) -> Self {
        let mask = match slices.axis {
            0 => Cow::Owned(mask.transposed_xy()),
            _ => Cow::Borrowed(mask),
        };
        Self { mask, slices: *slices }
    }

    /// Runs of a row of pixels, ascending.
    fn runs(&self, slice: u32, row: u32) -> impl Iterator<Item = Run> + '_ {
        let (y, z) = if self.slices.axis == 2 { (row, slice) } else { (slice, row) };
        self.mask.runs(y, z)
    }

    /// The 4-connected regions of a slice that do not touch its edge and have an area of half the
    /// least or more and less than the most, in the order of their first pixels.
    ///
    /// Runs of neighbouring rows that overlap are joined in disjoint sets (He, Chao & Suzuki 2008,
    /// doi:10.1109/TIP.2008.919369).
    pub fn regions(&self, slice: u32, area_mm2: &Range<f64>) -> Vec<SectionRegion> {
        let slices = &self.slices;
        let (last_column, last_row) = (slices.width as u32 - 1, slices.height as u32 - 1);
        let mut runs: Vec<(u32, Run)> = Vec::new();
        let mut sets = DisjointSets::default();
        let mut above = 0;
        for q in 0..=last_row {
            let row = runs.len();
            runs.extend(self.runs(slice, q).map(|run| (q, run)));
            let mut first = above;
            for (i, (_, (low, high))) in runs.iter().enumerate().skip(row) {
                sets.push();
                // A run above may reach beyond this one and touch the next one too.
                while first < row && runs[first].1.1 < *low {
                    first += 1;
                }
                let touching = runs[first..row].iter().take_while(|(_, up)| up.0 <= *high);
                (first..).zip(touching).for_each(|(up, _)| {
                    sets.join(up as u32, i as u32);
                });
            }
            above = row;
        }
        // Runs by region: a region's number is that of its first run.
        let mut found: Vec<(Vec<(u32, Run)>, bool)> = vec![Default::default(); runs.len()];
        for (i, (q, run)) in runs.iter().enumerate() {
            let (of, at_edge) = &mut found[sets.root(i as u32) as usize];
            *at_edge |= *q == 0 || *q == last_row || run.0 == 0 || run.1 == last_column;
            of.push((*q, *run));
        }
        let pixel = slices.pixel_mm.x * slices.pixel_mm.y;
        let fits = |of: &[(u32, Run)]| {
            let pixels = of.iter().map(|(_, (low, high))| u64::from(high - low + 1)).sum::<u64>();
            (0.5 * area_mm2.start..area_mm2.end).contains(&(pixels as f64 * pixel))
        };
        let regions = found.iter().filter(|(of, at_edge)| !of.is_empty() && !at_edge && fits(of));
        regions.map(|(of, _)| SectionRegion::filled(of)).collect()
    }
}

/// A region of a slice without holes, in a frame of its own with a margin.
pub(super) struct SectionRegion {
    low: [usize; 2],
    width: usize,
    height: usize,
    inside: Vec<bool>,
    /// Share of its pixels that were holes.
    pub holes: f64,
}

impl SectionRegion {
    /// * `runs`: of a region, each with its row, ascending.
    fn filled(runs: &[(u32, Run)]) -> Self {
        let columns = || runs.iter().map(|(_, run)| run);
        let rows = || runs.iter().map(|(q, _)| *q as usize);
        let low_p = columns().map(|run| run.0 as usize).min().unwrap_or(0);
        let high_p = columns().map(|run| run.1 as usize).max().unwrap_or(0);
        let (low_q, high_q) = (rows().min().unwrap_or(0), rows().max().unwrap_or(0));
        let (width, height) = (high_p - low_p + 3, high_q - low_q + 3);
        let mut set = vec![false; width * height];
        let mut pixels = 0;
        for (q, (first, last)) in runs {
            let row = width * (*q as usize - low_q + 1);
            let [first, last] = [first, last].map(|p| row + *p as usize - low_p + 1);
            set[first..=last].fill(true);
            pixels += last - first + 1;
        }
        let open = open_background(width, height, |i| set[i]);
        let inside: Vec<bool> = open.iter().map(|o| !o).collect();
        let all = inside.iter().filter(|i| **i).count();
        let holes = 1.0 - pixels as f64 / all.max(1) as f64;
        Self { low: [low_p, low_q], width, height, inside, holes }
    }

    fn at(&self, p: usize, q: usize) -> bool {
        self.inside[p + self.width * q]
    }

    /// Pixels of the region in its own frame.
    pub fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let all = (0..self.height).flat_map(|q| (0..self.width).map(move |p| (p, q)));
        all.filter(|(p, q)| self.at(*p, *q))
    }

    /// Voxels of the region.
    pub fn voxels<'a>(
        &'a self,
        slices: &'a Slices,
        slice: u32,
    ) -> impl Iterator<Item = UVec3> + 'a {
        let [low_p, low_q] = self.low;
        self.pixels().map(move |(p, q)| slices.voxel(slice, p + low_p - 1, q + low_q - 1))
    }

    /// The cross section in the slice's frame; nothing where its ends are pointed.
    ///
    /// * `most_aspect`: longest axis over the shortest.
    pub fn section(&self, slices: &Slices, slice: u32, most_aspect: f64) -> Option<Section> {
        let h = slices.pixel_mm;
        let count = self.pixels().count() as f64;
        let area_mm2 = count * h.x * h.y;
        let circularity =
            4.0 * std::f64::consts::PI * area_mm2 / self.perimeter_mm(h).powi(2).max(1e-9);
        let place = |(p, q): (usize, usize)| DVec2::new(p as f64, q as f64) * h;
        let centre = self.pixels().map(place).sum::<DVec2>() / count;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for d in self.pixels().map(|p| place(p) - centre) {
            (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
        }
        let (mean, off) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        let aspect = ((mean + off) / (mean - off).max(1e-9)).sqrt();
        let low = DVec2::new(self.low[0] as f64 - 1.0, self.low[1] as f64 - 1.0) * h;
        (aspect <= most_aspect).then(|| Section {
            slice,
            centre_mm: low + centre,
            area_mm2,
            circularity,
            value: 0.0,
        })
    }

    /// Values of its pixels none of whose neighbours lies outside, sorted.
    pub fn inner_values(&self, volume: &Volume, slices: &Slices, slice: u32) -> Vec<f64> {
        let inner = |&(p, q): &(usize, usize)| {
            self.at(p - 1, q) && self.at(p + 1, q) && self.at(p, q - 1) && self.at(p, q + 1)
        };
        let value = |(p, q): (usize, usize)| {
            let v = slices.voxel(slice, p + self.low[0] - 1, q + self.low[1] - 1);
            volume.real(volume.grid.index(v))
        };
        let mut values: Vec<f64> = self.pixels().filter(inner).map(value).collect();
        values.sort_by(f64::total_cmp);
        values
    }

    /// Perimeter by the Cauchy–Crofton formula, from crossings in four directions; each stands for
    /// the angles nearest to it.
    fn perimeter_mm(&self, h: DVec2) -> f64 {
        let crossings = |dp: usize, dq: usize, back: bool| {
            let mut n = 0;
            for q in 0..self.height - dq {
                for p in 0..self.width - dp {
                    let (a, b) = if back { (p + dp, p) } else { (p, p + dp) };
                    n += u32::from(self.at(a, q) != self.at(b, q + dq));
                }
            }
            f64::from(n)
        };
        let slant = h.y.atan2(h.x);
        let half_pi = std::f64::consts::FRAC_PI_2;
        let between = h.x * h.y / h.length();
        0.5 * (slant * h.y * crossings(1, 0, false)
            + (half_pi - slant) * h.x * crossings(0, 1, false)
            + 0.5 * half_pi * between * (crossings(1, 1, false) + crossings(1, 1, true)))
    }

    /// Values of the slice's pixels in a ring about the shape, sorted.
    ///
    /// * `ring`: its distance, mm, or pixels where those are larger.
    pub fn ring_values(
        &self,
        volume: &Volume,
        slices: &Slices,
        slice: u32,
        ring: &Range<f64>,
    ) -> Vec<f64> {
        let h = slices.pixel_mm;
        let rim: Vec<DVec2> = self
            .pixels()
            .filter(|&(p, q)| {
                !(self.at(p - 1, q) && self.at(p + 1, q) && self.at(p, q - 1) && self.at(p, q + 1))
            })
            .map(|(p, q)| DVec2::new(p as f64, q as f64) * h)
            .collect();
        let ring = ring.start * h.max_element().max(1.0)..ring.end * h.max_element().max(1.0);
        let far = (ring.end / h).ceil();
        let (px, py) = (far.x as i64, far.y as i64);
        let mut values = Vec::new();
        for q in -py..self.height as i64 + py {
            for p in -px..self.width as i64 + px {
                let (i, j) = (p + self.low[0] as i64 - 1, q + self.low[1] as i64 - 1);
                let inside =
                    (0..slices.width as i64).contains(&i) && (0..slices.height as i64).contains(&j);
                let at = DVec2::new(p as f64, q as f64) * h;
                let own = (0..self.width as i64).contains(&p)
                    && (0..self.height as i64).contains(&q)
                    && self.at(p as usize, q as usize);
                if !inside || own {
                    continue;
                }
                let off = rim.iter().map(|r| r.distance_squared(at)).fold(f64::INFINITY, f64::min);
                if ring.contains(&off.sqrt()) {
                    let v = slices.voxel(slice, i as usize, j as usize);
                    values.push(volume.real(volume.grid.index(v)));
                }
            }
        }
        values.sort_by(f64::total_cmp);
        values
    }
}

/// The chain with the largest sum of circularity over its length: each section follows one of the
/// slice before, or of the one before that, which lies near it and fits.
///
/// * `reach_mm`: largest distance between centres in neighbouring slices.
/// * `fits`: whether two may follow each other.
pub(super) fn longest_chain(
    sections: &[Vec<Section>],
    slices: &Slices,
    reach_mm: f64,
    fits: impl Fn(&Section, &Section) -> bool,
) -> Vec<Section> {
    // Best score that ends with a section, and the section before it.
    let mut best: Vec<Vec<(f64, Option<[usize; 2]>)>> = Vec::with_capacity(sections.len());
    for (z, here) in sections.iter().enumerate() {
        let mut scores = Vec::with_capacity(here.len());
        for s in here {
            let own = s.circularity * slices.step_mm;
            let mut score = (own, None);
            // One slice may be missing: noise, or a neighbour that reaches the tube's wall.
            for back in (1..=2).filter(|back| *back <= z) {
                for (i, b) in sections[z - back].iter().enumerate() {
                    let near = s.centre_mm.distance(b.centre_mm) <= back as f64 * reach_mm;
                    let joined = own + best[z - back][i].0;
                    if near && joined > score.0 && fits(s, b) {
                        score = (joined, Some([z - back, i]));
                    }
                }
            }
            scores.push(score);
        }
        best.push(scores);
    }
    let score = |at: &[usize; 2]| best[at[0]][at[1]].0;
    let ends = (0..best.len()).flat_map(|z| (0..best[z].len()).map(move |i| [z, i]));
    let mut at = ends.reduce(|a, b| if score(&b) > score(&a) { b } else { a });
    let mut chain = Vec::new();
    while let Some([z, i]) = at {
        chain.push(sections[z][i].clone());
        at = best[z][i].1;
    }
    chain.reverse();
    chain
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::volume::Grid;

    /// Regions of a slice by a queue over pixels.
    fn by_queue(mask: &BitVolume, slices: &Slices, slice: u32) -> Vec<(Vec<[usize; 2]>, bool)> {
        let (w, h) = (slices.width, slices.height);
        let set = |p: usize, q: usize| {
            let v = slices.voxel(slice, p, q);
            mask.at(v.x, v.y, v.z)
        };
        let mut seen = vec![false; w * h];
        let mut out = Vec::new();
        for start in (0..w * h).filter(|i| set(i % w, i / w)) {
            let (mut pixels, mut next) = (Vec::new(), vec![start]);
            while let Some(i) = next.pop() {
                let (p, q) = (i % w, i / w);
                if !set(p, q) || std::mem::replace(&mut seen[i], true) {
                    continue;
                }
                pixels.push([q, p]);
                next.extend((p > 0).then(|| i - 1).into_iter().chain((p + 1 < w).then(|| i + 1)));
                next.extend((q > 0).then(|| i - w).into_iter().chain((q + 1 < h).then(|| i + w)));
            }
            if !pixels.is_empty() {
                pixels.sort_unstable();
                let edge = |[q, p]: &[usize; 2]| *p == 0 || *q == 0 || p + 1 == w || q + 1 == h;
                let at_edge = pixels.iter().any(edge);
                out.push((pixels, at_edge));
            }
        }
        out
    }

    #[test]
    fn regions_by_runs_are_those_of_a_queue_across_every_axis() {
        let dims = UVec3::new(83, 37, 70);
        let (mut seed, mut mask) = (7u64, BitVolume::new(dims));
        for z in 0..dims.z {
            for y in 0..dims.y {
                for x in 0..dims.x {
                    seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                    // More and more dense: specks first, regions with holes and arms later.
                    if (seed >> 33) % 100 < u64::from(20 + z) && (x + y + z) % 23 > 2 {
                        mask.set(x, y, z);
                    }
                }
            }
        }
        let grid = Grid::axis_aligned(dims.to_array(), [1.0; 3]);
        let volume = Volume::new(grid, vec![0u8; grid.len()].into());
        let (mut all, mut with_holes) = (0, 0);
        for axis in 0..3 {
            let slices = Slices::of(&volume, axis);
            let sliced = SlicedMask::new(&mask, &slices);
            for slice in 0..dims[axis] {
                let (least, most) = (6.0, 400.0);
                let wanted = by_queue(&mask, &slices, slice).into_iter();
                let size = |n: usize| n as f64 >= 0.5 * least && (n as f64) < most;
                let wanted: Vec<_> = wanted.filter(|(p, e)| !e && size(p.len())).collect();
                let found = sliced.regions(slice, &(least..most));
                assert_eq!(found.len(), wanted.len(), "axis {axis}, slice {slice}");
                for (region, (pixels, _)) in found.iter().zip(&wanted) {
                    let own: Vec<[usize; 2]> = region
                        .pixels()
                        .map(|(p, q)| [q + region.low[1] - 1, p + region.low[0] - 1])
                        .collect();
                    assert!(pixels.iter().all(|p| own.contains(p)), "axis {axis}, slice {slice}");
                    let holes = 1.0 - pixels.len() as f64 / own.len() as f64;
                    assert!((region.holes - holes).abs() < 1e-12);
                    all += 1;
                    with_holes += usize::from(holes > 0.0);
                }
            }
        }
        assert!(all > 2000 && with_holes > 100, "{all} regions, {with_holes} with holes");
    }
}
