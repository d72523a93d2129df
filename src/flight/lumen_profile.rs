//! Size of the lumen along a path: radius and cross-section at even steps, and the narrowest places
//! against the lumen about them.

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use super::stenosis::{RadiusSample, ReferenceLine, references};
use super::{CenterlinePlaces, MAX_ASTRAY, cross_section};
use crate::geometry::{CenterlinePoint, Mesh, TriangleBvh};

/// Largest number of samples; a long path has longer steps.
const MAX_SAMPLES: f64 = 500.0;
/// Shortest step, mm.
const MIN_STEP_MM: f64 = 1.0;
/// Number of narrow places that are listed.
const LISTED: usize = 5;
/// Least narrowing that is listed; shallower minima are ripples of the wall.
const MIN_NARROWING: f64 = 0.15;

/// Lumen along a path. Lengths and areas are rounded to a thousandth.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LumenProfile {
    /// Part of the organ that the path starts in, where it is known.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub start: Option<&'static str>,
    /// First point of the path, LPS.
    pub start_mm: [f64; 3],
    /// Last point of the path, LPS.
    pub end_mm: [f64; 3],
    /// Length of the path from its start to each sample; jumps between pieces do not count.
    pub arc_mm: Vec<f64>,
    /// Distance to the wall (maximum inscribed sphere) at each sample.
    pub radius_mm: Vec<f64>,
    /// Area of the section across the path at each sample; null where there is none.
    pub area_mm2: Vec<Option<f64>>,
    /// Indices of the samples that begin another piece.
    pub cuts: Vec<usize>,
    /// Narrowest places against both sides of them, the largest narrowing first; none is narrower
    /// than the scan resolves.
    pub narrowest: Vec<NarrowPlace>,
}

/// A place that is narrower than the lumen about it would be without it.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NarrowPlace {
    /// Length of the path up to it.
    pub arc_mm: f64,
    /// Point of the path, LPS.
    pub center_mm: [f64; 3],
    /// Distance to the wall.
    pub radius_mm: f64,
    /// Share of the reference diameter that is missing, 0 to 1: of discs of the sections' areas.
    pub narrowing: f64,
    /// Share of the reference area that is missing.
    pub narrowing_area: f64,
    /// Radius of the reference: a line through the wider sections of the segment between branches.
    pub reference_radius_mm: f64,
    /// Arc lengths between which the reference was fitted.
    pub reference_arc_mm: [f64; 2],
    /// Area of the section across the path.
    pub area_mm2: Option<f64>,
    /// Least Feret diameter of that section.
    pub smallest_mm: Option<f64>,
    /// Largest Feret diameter of that section.
    pub largest_mm: Option<f64>,
}

/// A point of the path, interpolated.
struct PathSample {
    arc_mm: f64,
    position_mm: DVec3,
    radius_mm: f64,
    tangent: DVec3,
    begins_piece: bool,
}

impl LumenProfile {
    /// Measures the lumen along the pieces of a path, in the order and direction given.
    ///
    /// * `wall`: closed, LPS mm; `tree` is its hierarchy.
    /// * `places`: points of the whole centerline by place. A section of which more than [`MAX_ASTRAY`] lies beside
    ///   another stretch of it is none across the path.
    /// * `junctions`: places where branches part, LPS mm. Nothing is measured within a radius of them
    ///   and of ends, where sections open into branches.
    /// * `resolved_mm`: side of a voxel. A place with a smaller radius, or narrower by less than half
    ///   of it, is not listed as narrow: that is noise.
    pub fn new(
        pieces: &[Vec<CenterlinePoint>],
        wall: &Mesh,
        tree: &TriangleBvh,
        places: &CenterlinePlaces,
        junctions: &[DVec3],
        resolved_mm: f64,
    ) -> Self {
        let samples = samples(pieces);
        let sections: Vec<_> = samples
            .par_iter()
            .map(|s| {
                crate::task::checkpoint();
                cross_section(wall, tree, s.position_mm, s.tangent)
                    .filter(|section| places.astray(section, s.position_mm) <= MAX_ASTRAY)
            })
            .collect();
        let radius_mm: Vec<f64> = samples.iter().map(|s| rounded(s.radius_mm)).collect();
        let cuts: Vec<usize> = (1..samples.len()).filter(|i| samples[*i].begins_piece).collect();
        let areas: Vec<Option<f64>> =
            sections.iter().map(|s| s.as_ref().map(|s| s.area_mm2)).collect();
        let narrow = |(i, line): (usize, ReferenceLine)| NarrowPlace {
            narrowing: rounded(narrowing(disc_radius(areas[i]), line, samples[i].arc_mm)),
            narrowing_area: rounded(
                1.0 - (disc_radius(areas[i]) / line.radius_mm(samples[i].arc_mm)).powi(2),
            ),
            reference_radius_mm: rounded(line.radius_mm(samples[i].arc_mm)),
            reference_arc_mm: line.arc_mm.map(rounded),
            arc_mm: rounded(samples[i].arc_mm),
            center_mm: samples[i].position_mm.to_array().map(rounded),
            radius_mm: radius_mm[i],
            area_mm2: sections[i].as_ref().map(|s| rounded(s.area_mm2)),
            smallest_mm: sections[i].as_ref().map(|s| rounded(s.smallest_diameter_mm)),
            largest_mm: sections[i].as_ref().map(|s| rounded(s.largest_diameter_mm)),
        };
        let place =
            |s: Option<&PathSample>| s.map_or([0.0; 3], |s| s.position_mm.to_array().map(rounded));
        Self {
            start: None,
            start_mm: place(samples.first()),
            end_mm: place(samples.last()),
            arc_mm: samples.iter().map(|s| rounded(s.arc_mm)).collect(),
            area_mm2: sections.iter().map(|s| Some(rounded(s.as_ref()?.area_mm2))).collect(),
            narrowest: narrowest(&samples, &areas, (&cuts, junctions), resolved_mm)
                .into_iter()
                .map(narrow)
                .collect(),
            radius_mm,
            cuts,
        }
    }

    /// Returns the length of the path, mm.
    pub fn length_mm(&self) -> f64 {
        self.arc_mm.last().copied().unwrap_or(0.0)
    }
}

fn rounded(value: f64) -> f64 {
    (value * 1000.0).round() / 1000.0
}

/// Returns the length of a piece up to each of its points.
fn arcs(piece: &[CenterlinePoint]) -> Vec<f64> {
    let mut arcs = vec![0.0];
    for w in piece.windows(2) {
        arcs.push(arcs[arcs.len() - 1] + w[0].position_mm.distance(w[1].position_mm));
    }
    arcs
}

/// Returns samples at even steps of each piece, its ends among them.
fn samples(pieces: &[Vec<CenterlinePoint>]) -> Vec<PathSample> {
    let pieces: Vec<(&[CenterlinePoint], Vec<f64>)> =
        pieces.iter().filter(|p| p.len() >= 2).map(|p| (&p[..], arcs(p))).collect();
    let length = |arcs: &[f64]| arcs.last().copied().unwrap_or(0.0);
    let whole: f64 = pieces.iter().map(|(_, arcs)| length(arcs)).sum();
    let step = MIN_STEP_MM.max(whole / MAX_SAMPLES);
    let mut out = Vec::new();
    let mut before = 0.0;
    for (points, arcs) in &pieces {
        let length = length(arcs);
        let count = (length / step).round().max(1.0) as usize;
        for k in 0..=count {
            let arc = length * k as f64 / count as f64;
            let (position_mm, radius_mm) = at(points, arcs, arc);
            // Small turns of a path are not turns of the lumen.
            let reach = (2.0 * radius_mm).max(1.0);
            let along = at(points, arcs, arc + reach).0 - at(points, arcs, arc - reach).0;
            let tangent = along.try_normalize().unwrap_or(DVec3::Z);
            let (arc_mm, begins_piece) = (before + arc, k == 0);
            out.push(PathSample { arc_mm, position_mm, radius_mm, tangent, begins_piece });
        }
        before += length;
    }
    out
}

/// Interpolates position and radius at an arc length; beyond an end, those of the end.
fn at(points: &[CenterlinePoint], arcs: &[f64], arc: f64) -> (DVec3, f64) {
    let i = arcs.partition_point(|a| *a <= arc).clamp(1, arcs.len() - 1) - 1;
    let span = arcs[i + 1] - arcs[i];
    let t = if span > 0.0 { ((arc - arcs[i]) / span).clamp(0.0, 1.0) } else { 0.0 };
    let (a, b) = (&points[i], &points[i + 1]);
    (a.position_mm.lerp(b.position_mm, t), a.radius_mm + (b.radius_mm - a.radius_mm) * t)
}

/// Radius of a disc of an area; 0 without one.
fn disc_radius(area_mm2: Option<f64>) -> f64 {
    (area_mm2.unwrap_or(0.0) / std::f64::consts::PI).sqrt()
}

fn narrowing(radius_mm: f64, line: ReferenceLine, arc_mm: f64) -> f64 {
    1.0 - radius_mm / line.radius_mm(arc_mm)
}

/// Returns the indices of the narrowest places, each the deepest of a stretch that is narrower than
/// its reference, with the reference.
fn narrowest(
    samples: &[PathSample],
    areas: &[Option<f64>],
    (cuts, junctions): (&[usize], &[DVec3]),
    resolved_mm: f64,
) -> Vec<(usize, ReferenceLine)> {
    let Some(last) = samples.len().checked_sub(1) else { return Vec::new() };
    // Places that sections are refused about, with the reach: branches, and ends of pieces.
    let nearest = |p: &DVec3| {
        let off = |i: &usize| samples[*i].position_mm.distance_squared(*p);
        let i = (0..=last).min_by(|a, b| off(a).total_cmp(&off(b)))?;
        let is_on_path = off(&i).sqrt() <= 2.0 * samples[i].radius_mm.max(resolved_mm);
        is_on_path.then_some(i)
    };
    let branches: Vec<usize> = junctions.iter().filter_map(nearest).collect();
    let piece_ends = cuts.iter().flat_map(|i| [i - 1, *i]).chain([0, last]);
    let refused: Vec<(f64, f64)> = piece_ends
        .chain(branches.iter().copied())
        .map(|i| (samples[i].arc_mm, disc_radius(areas[i]).max(samples[i].radius_mm)))
        .collect();
    let is_measured = |arc: f64| refused.iter().all(|(at, reach)| (arc - at).abs() > *reach);
    let measured: Vec<RadiusSample> = (0..=last)
        .filter(|i| areas[*i].is_some() && is_measured(samples[*i].arc_mm))
        .map(|index| RadiusSample {
            index,
            arc_mm: samples[index].arc_mm,
            radius_mm: disc_radius(areas[index]),
        })
        .collect();
    let mut ends: Vec<f64> = cuts.iter().chain(&branches).map(|i| samples[*i].arc_mm).collect();
    ends.sort_by(f64::total_cmp);
    let all = references(&measured, &ends);
    // Stretches below the reference; each is as narrow as its deepest place.
    let loss = |s: &RadiusSample, line: &ReferenceLine| narrowing(s.radius_mm, *line, s.arc_mm);
    let is_narrow = |(_, s, line): &(usize, RadiusSample, ReferenceLine)| {
        let missing_mm = line.radius_mm(s.arc_mm) - s.radius_mm;
        let is_resolved = s.radius_mm >= resolved_mm && missing_mm >= 0.5 * resolved_mm;
        is_resolved && loss(s, line) >= MIN_NARROWING
    };
    let mut found: Vec<(usize, f64, ReferenceLine)> = Vec::new();
    for stretch in all.chunk_by(|a, b| is_narrow(a) && is_narrow(b) && b.0 == a.0 + 1) {
        let by = |a: &&(usize, RadiusSample, ReferenceLine),
                  b: &&(usize, RadiusSample, ReferenceLine)| {
            loss(&a.1, &a.2).total_cmp(&loss(&b.1, &b.2)).then(b.0.cmp(&a.0))
        };
        let deepest = stretch.iter().filter(|s| is_narrow(s)).max_by(by);
        found.extend(deepest.map(|(i, s, line)| (*i, loss(s, line), *line)));
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found.truncate(LISTED);
    found.into_iter().map(|(i, _, line)| (i, line)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Branch, Centerline, shapes};

    fn path(points: &[(f64, f64)]) -> Vec<CenterlinePoint> {
        let point = |(x, radius_mm): &(f64, f64)| CenterlinePoint {
            position_mm: DVec3::new(*x, 0.0, 0.0),
            radius_mm: *radius_mm,
            abscissa_mm: 0.0,
        };
        points.iter().map(point).collect()
    }

    #[test]
    fn narrow_places_are_those_below_a_line_and_none_lies_by_a_branch_or_an_end() {
        let samples = samples(&[path(&[(0.0, 4.0), (120.0, 4.0)])]);
        let disc = |r: f64| Some(std::f64::consts::PI * r * r);
        let areas: Vec<Option<f64>> = samples
            .iter()
            .map(|s| match s.arc_mm {
                a if (28.0..33.0).contains(&a) => disc(2.0),
                a if (60.0..62.0).contains(&a) => disc(3.0),
                // By a branch, and at an end.
                a if (88.0..92.0).contains(&a) || a < 3.0 => disc(1.0),
                _ => disc(4.0),
            })
            .collect();
        let junction = DVec3::new(90.0, 3.0, 0.0);
        let found = narrowest(&samples, &areas, (&[], &[junction]), 0.5);
        let arcs: Vec<f64> = found.iter().map(|(i, _)| samples[*i].arc_mm).collect();
        assert_eq!(arcs, [28.0, 60.0]);
        let (i, line) = found[0];
        let got = narrowing(disc_radius(areas[i]), line, samples[i].arc_mm);
        assert!((got - 0.5).abs() < 1e-6 && line.arc_mm[1] < 90.0, "{got} {line:?}");
        assert!(narrowest(&samples, &areas, (&[], &[junction]), 2.5).is_empty(), "below a voxel");
        assert!(narrowest(&[], &[], (&[], &[]), 0.5).is_empty());
    }

    #[test]
    fn samples_are_even_within_each_piece_and_jumps_have_no_length() {
        let pieces =
            [path(&[(0.0, 2.0), (3.0, 5.0)]), path(&[(50.0, 1.0), (50.5, 1.0), (52.0, 4.0)])];
        let all = samples(&pieces);
        let arcs: Vec<f64> = all.iter().map(|s| s.arc_mm).collect();
        assert_eq!(arcs, [0.0, 1.0, 2.0, 3.0, 3.0, 4.0, 5.0]);
        let radii: Vec<f64> = all.iter().map(|s| rounded(s.radius_mm)).collect();
        assert_eq!(radii, [2.0, 3.0, 4.0, 5.0, 1.0, 2.0, 4.0]);
        assert_eq!(all.iter().filter(|s| s.begins_piece).count(), 2);
        assert!(all.iter().all(|s| s.tangent == DVec3::X));
        let long = samples(&[path(&[(0.0, 1.0), (2000.0, 1.0)])]);
        assert_eq!((long.len(), long[1].arc_mm), (501, 4.0));
    }

    #[test]
    fn a_section_of_a_box_has_the_area_of_its_side_and_there_is_none_outside() {
        let wall = shapes::boxed(2);
        let (low, high) = wall.bounds().unwrap();
        let side = (high - low).as_dvec3();
        let centre = (0.5 * (low + high)).as_dvec3();
        let start = DVec3::new(f64::from(low.x) + 0.25 * side.x, centre.y, centre.z);
        let end = DVec3::new(f64::from(high.x) + side.x, centre.y, centre.z);
        let point = |position_mm| CenterlinePoint { position_mm, radius_mm: 0.4, abscissa_mm: 0.0 };
        let points = vec![point(start), point(end)];
        let line =
            Centerline { branches: vec![Branch { points: points.clone(), ..Branch::default() }] };
        let (tree, places) = (TriangleBvh::new(&wall), CenterlinePlaces::new(&line));
        let profile = LumenProfile::new(&[points], &wall, &tree, &places, &[], 0.0);
        assert_eq!(profile.area_mm2[0], Some(rounded(side.y * side.z)));
        assert_eq!(*profile.area_mm2.last().unwrap(), None);
        assert!(profile.length_mm() > 1.7 * side.x && profile.narrowest.is_empty());
    }
}
