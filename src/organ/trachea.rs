//! The trachea: a chain of round, air-filled cross sections with soft tissue around them.

use glam::{DVec2, DVec3, UVec3};
use rayon::prelude::*;

use super::values::{LEAST_HU, between, quantile};
use crate::lumen::{BitVolume, closed, open_background};
use crate::volume::Volume;

/// Highest value of the trachea's air in a cross section, HU.
const AIR_HU: f64 = -900.0;
/// Areas of a trachea, mm².
const AREA_MM2: std::ops::Range<f64> = 40.0..1500.0;
/// Least circularity 4πA/P².
const CIRCULARITY: f64 = 0.55;
/// Longest axis over the shortest.
const ASPECT: f64 = 2.2;
/// The ring around a cross section where tissue is looked for: mm, or pixels where those are larger.
const RING: std::ops::Range<f64> = 1.0..3.0;
/// Least median value of the ring, HU.
const RING_HU: f64 = -300.0;
/// Ratio of the areas of neighbouring cross sections.
const AREA_RATIO: std::ops::RangeInclusive<f64> = 0.5..=2.0;
/// Shortest chain that is looked at, mm.
const LEAST_CHAIN_MM: f64 = 15.0;
/// Most chains that are looked at across an axis.
const MOST_CHAINS: usize = 4;
/// Share of the radius in which a cross section is all air.
const CORE: f64 = 0.6;

/// A chain of cross sections.
pub(super) struct Trachea {
    /// The index axis they lie across.
    pub axis: usize,
    /// Length times mean circularity, mm.
    pub score: f64,
    /// Its length, mm.
    pub length_mm: f64,
    /// Voxels about the middle of each cross section.
    pub core: BitVolume,
    /// The middle of the middle one.
    pub seed: UVec3,
    /// Radius of a disc of the mean area, mm.
    pub radius_mm: f64,
}

/// A cross section.
#[derive(Clone, Debug)]
struct Section {
    slice: u32,
    centre_mm: DVec2,
    area_mm2: f64,
    circularity: f64,
}

/// Chains across any index axis, best first: a gut that is full of gas has some too.
pub(super) fn candidates(volume: &Volume) -> Vec<Trachea> {
    let air = between(volume, LEAST_HU, AIR_HU);
    if air.is_empty() {
        return Vec::new();
    }
    let mut out: Vec<Trachea> = (0..3).flat_map(|axis| across(volume, &air, axis)).collect();
    out.sort_by(|a, b| b.score.total_cmp(&a.score));
    out
}

/// Pixels of the slices across an axis.
#[derive(Clone, Copy)]
struct Slices {
    axis: usize,
    u: usize,
    v: usize,
    width: usize,
    height: usize,
    pixel_mm: DVec2,
    step_mm: f64,
}

impl Slices {
    fn of(volume: &Volume, axis: usize) -> Self {
        let (u, v) = [(1, 2), (0, 2), (0, 1)][axis];
        let (dims, h) = (volume.grid.dims, volume.grid.spacing_mm);
        let (width, height) = (dims[u] as usize, dims[v] as usize);
        Self { axis, u, v, width, height, pixel_mm: DVec2::new(h[u], h[v]), step_mm: h[axis] }
    }

    fn voxel(&self, slice: u32, p: usize, q: usize) -> UVec3 {
        let mut at = UVec3::ZERO;
        (at[self.axis], at[self.u], at[self.v]) = (slice, p as u32, q as u32);
        at
    }
}

/// Chains across an axis, the best of what is left each time.
fn across(volume: &Volume, air: &BitVolume, axis: usize) -> Vec<Trachea> {
    let slices = Slices::of(volume, axis);
    // A ball that is flat: noise leaves pinholes in a cross section.
    let mut flat = DVec3::splat(1e9);
    (flat[slices.u], flat[slices.v]) = (1.0, 1.0);
    let air = closed(air, flat, 1.5);
    let mut sections: Vec<Vec<Section>> = (0..volume.grid.dims[axis])
        .into_par_iter()
        .map(|slice| sections(volume, &air, &slices, slice))
        .collect();
    let mut out = Vec::new();
    while out.len() < MOST_CHAINS {
        let chain = longest_chain(&sections, &slices);
        let Some(trachea) = Trachea::of(volume, &slices, &chain) else { break };
        out.push(trachea);
        for s in &chain {
            sections[s.slice as usize].retain(|other| other.centre_mm != s.centre_mm);
        }
    }
    out
}

impl Trachea {
    /// Nothing for a chain that is too short.
    fn of(volume: &Volume, slices: &Slices, chain: &[Section]) -> Option<Self> {
        let (first, last) = (chain.first()?, chain.last()?);
        let length_mm = f64::from(last.slice - first.slice) * slices.step_mm;
        if length_mm < LEAST_CHAIN_MM {
            return None;
        }
        let mean = |of: fn(&Section) -> f64| chain.iter().map(of).sum::<f64>() / chain.len() as f64;
        let (area, circularity) = (mean(|s| s.area_mm2), mean(|s| s.circularity));
        let mut core = BitVolume::new(volume.grid.dims);
        for s in chain {
            let radius = CORE * (s.area_mm2 / std::f64::consts::PI).sqrt();
            let low = ((s.centre_mm - radius) / slices.pixel_mm).ceil().max(DVec2::ZERO);
            let high = ((s.centre_mm + radius) / slices.pixel_mm).floor();
            for q in low.y as usize..=(high.y as usize).min(slices.height - 1) {
                for p in low.x as usize..=(high.x as usize).min(slices.width - 1) {
                    let at = DVec2::new(p as f64, q as f64) * slices.pixel_mm;
                    if at.distance(s.centre_mm) <= radius {
                        let v = slices.voxel(s.slice, p, q);
                        core.set(v.x, v.y, v.z);
                    }
                }
            }
        }
        let middle = &chain[chain.len() / 2];
        let centre = (middle.centre_mm / slices.pixel_mm).round();
        let seed = slices.voxel(middle.slice, centre.x as usize, centre.y as usize);
        let radius_mm = (area / std::f64::consts::PI).sqrt();
        Some(Self {
            axis: slices.axis,
            score: length_mm * circularity,
            length_mm,
            core,
            seed,
            radius_mm,
        })
    }
}

/// The cross sections of a slice that may be a trachea's.
fn sections(volume: &Volume, air: &BitVolume, slices: &Slices, slice: u32) -> Vec<Section> {
    let (width, height) = (slices.width, slices.height);
    let set = |i: usize| {
        let v = slices.voxel(slice, i % width, i / width);
        air.at(v.x, v.y, v.z)
    };
    let mut seen = vec![false; width * height];
    let mut out = Vec::new();
    let pixel = slices.pixel_mm.x * slices.pixel_mm.y;
    for start in 0..width * height {
        if seen[start] || !set(start) {
            continue;
        }
        let (mut stack, mut pixels) = (vec![start], Vec::new());
        seen[start] = true;
        let mut at_edge = false;
        while let Some(i) = stack.pop() {
            pixels.push(i);
            let (p, q) = (i % width, i / width);
            at_edge |= p == 0 || q == 0 || p + 1 == width || q + 1 == height;
            let near = [
                (p > 0).then(|| i - 1),
                (p + 1 < width).then(|| i + 1),
                (q > 0).then(|| i - width),
                (q + 1 < height).then(|| i + width),
            ];
            for j in near.into_iter().flatten().filter(|j| set(*j)) {
                if !std::mem::replace(&mut seen[j], true) {
                    stack.push(j);
                }
            }
        }
        let area = pixels.len() as f64 * pixel;
        if !at_edge && (0.5 * AREA_MM2.start..AREA_MM2.end).contains(&area) {
            let shape = Shape::filled(&pixels, slices);
            out.extend(shape.section(volume, slices, slice));
        }
    }
    out
}

/// A region of a slice without holes, in a frame of its own with a margin.
struct Shape {
    low: [usize; 2],
    width: usize,
    height: usize,
    inside: Vec<bool>,
}

impl Shape {
    fn filled(pixels: &[usize], slices: &Slices) -> Self {
        let place = |i: &usize| (i % slices.width, i / slices.width);
        let of = |f: fn((usize, usize)) -> usize| pixels.iter().map(move |i| f(place(i)));
        let low = [of(|p| p.0).min().unwrap_or(0), of(|p| p.1).min().unwrap_or(0)];
        let high = [of(|p| p.0).max().unwrap_or(0), of(|p| p.1).max().unwrap_or(0)];
        let (width, height) = (high[0] - low[0] + 3, high[1] - low[1] + 3);
        let mut set = vec![false; width * height];
        for (p, q) in pixels.iter().map(place) {
            set[p - low[0] + 1 + width * (q - low[1] + 1)] = true;
        }
        let open = open_background(width, height, |i| set[i]);
        Self { low, width, height, inside: open.iter().map(|o| !o).collect() }
    }

    fn at(&self, p: usize, q: usize) -> bool {
        self.inside[p + self.width * q]
    }

    /// Its pixels in its own frame.
    fn pixels(&self) -> impl Iterator<Item = (usize, usize)> + '_ {
        let all = (0..self.height).flat_map(|q| (0..self.width).map(move |p| (p, q)));
        all.filter(|(p, q)| self.at(*p, *q))
    }

    fn section(&self, volume: &Volume, slices: &Slices, slice: u32) -> Option<Section> {
        let h = slices.pixel_mm;
        let count = self.pixels().count() as f64;
        let area_mm2 = count * h.x * h.y;
        let circularity =
            4.0 * std::f64::consts::PI * area_mm2 / self.perimeter_mm(h).powi(2).max(1e-9);
        if !AREA_MM2.contains(&area_mm2) || circularity < CIRCULARITY {
            return None;
        }
        let place = |(p, q): (usize, usize)| DVec2::new(p as f64, q as f64) * h;
        let centre = self.pixels().map(place).sum::<DVec2>() / count;
        let (mut xx, mut xy, mut yy) = (0.0, 0.0, 0.0);
        for d in self.pixels().map(|p| place(p) - centre) {
            (xx, xy, yy) = (xx + d.x * d.x, xy + d.x * d.y, yy + d.y * d.y);
        }
        let (mean, off) = (0.5 * (xx + yy), (0.25 * (xx - yy).powi(2) + xy * xy).sqrt());
        let aspect = ((mean + off) / (mean - off).max(1e-9)).sqrt();
        if aspect > ASPECT || self.ring_median(volume, slices, slice) < RING_HU {
            return None;
        }
        let low = DVec2::new(self.low[0] as f64 - 1.0, self.low[1] as f64 - 1.0) * h;
        Some(Section { slice, centre_mm: low + centre, area_mm2, circularity })
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

    /// Median value of the slice's pixels in a ring about the shape, HU.
    fn ring_median(&self, volume: &Volume, slices: &Slices, slice: u32) -> f64 {
        let h = slices.pixel_mm;
        let rim: Vec<DVec2> = self
            .pixels()
            .filter(|&(p, q)| {
                !(self.at(p - 1, q) && self.at(p + 1, q) && self.at(p, q - 1) && self.at(p, q + 1))
            })
            .map(|(p, q)| DVec2::new(p as f64, q as f64) * h)
            .collect();
        let ring = RING.start * h.max_element().max(1.0)..RING.end * h.max_element().max(1.0);
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
        if values.is_empty() { f64::NEG_INFINITY } else { quantile(&values, 0.5) }
    }
}

/// The chain with the largest sum of circularity over its length: each section follows one of the
/// slice before, or of the one before that, which lies near it and has about its area.
fn longest_chain(sections: &[Vec<Section>], slices: &Slices) -> Vec<Section> {
    let reach_mm = (3.0 * slices.step_mm).max(1.5 * slices.pixel_mm.max_element()) + 1.0;
    // Best score that ends with a section, and the section before it.
    let mut best: Vec<Vec<(f64, Option<[usize; 2]>)>> = Vec::with_capacity(sections.len());
    for (z, here) in sections.iter().enumerate() {
        let mut scores = Vec::with_capacity(here.len());
        for s in here {
            let own = s.circularity * slices.step_mm;
            let mut score = (own, None);
            // One slice may be missing: noise, or lung that reaches the trachea's wall.
            for back in (1..=2).filter(|back| *back <= z) {
                for (i, b) in sections[z - back].iter().enumerate() {
                    let near = s.centre_mm.distance(b.centre_mm) <= back as f64 * reach_mm;
                    let joined = own + best[z - back][i].0;
                    if near && AREA_RATIO.contains(&(s.area_mm2 / b.area_mm2)) && joined > score.0 {
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
