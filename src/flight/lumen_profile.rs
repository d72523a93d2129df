//! Size of the lumen along a path: radius and cross-section at even steps, and the narrowest places.

use glam::DVec3;
use rayon::prelude::*;
use serde::Serialize;

use crate::geometry::{
    CenterlinePlaces, CenterlinePoint, MAX_ASTRAY, Mesh, TriangleBvh, cross_section,
};

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

/// A place where the radius has a minimum.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct NarrowPlace {
    /// Length of the path up to it.
    pub arc_mm: f64,
    /// Point of the path, LPS.
    pub center_mm: [f64; 3],
    /// Distance to the wall.
    pub radius_mm: f64,
    /// Share of the radius beside it that is missing, 0 to 1. The radius beside it is the smaller of
    /// the largest ones on either side before the lumen is narrower again.
    pub narrowing: f64,
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
    /// * `resolved_mm`: side of a voxel. A place with a smaller radius, or narrower by less than half
    ///   of it, is not listed as narrow: that is noise.
    pub fn new(
        pieces: &[Vec<CenterlinePoint>],
        wall: &Mesh,
        tree: &TriangleBvh,
        places: &CenterlinePlaces,
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
        let narrow = |(i, narrowing): (usize, f64)| NarrowPlace {
            narrowing: rounded(narrowing),
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
            narrowest: narrowest(&radius_mm, &cuts, resolved_mm).into_iter().map(narrow).collect(),
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

/// Returns the indices of the deepest minima and their narrowing. Ends of a path, which run into the
/// wall, are none.
fn narrowest(radius: &[f64], cuts: &[usize], resolved_mm: f64) -> Vec<(usize, f64)> {
    let starts = std::iter::once(0).chain(cuts.iter().copied());
    let ends = cuts.iter().copied().chain(std::iter::once(radius.len()));
    let mut found: Vec<(usize, f64)> = Vec::new();
    for (start, end) in starts.zip(ends) {
        for i in start..end {
            let here = radius[i];
            let widest = |side: &mut dyn Iterator<Item = &f64>| side.fold(here, |a, b| a.max(*b));
            // The first of equal radii is the minimum.
            let before = widest(&mut radius[start..i].iter().rev().take_while(|r| **r > here));
            let after = widest(&mut radius[i + 1..end].iter().take_while(|r| **r >= here));
            let narrowing = 1.0 - here / before.min(after);
            let missing_mm = before.min(after) - here;
            let is_resolved = here >= resolved_mm && missing_mm >= 0.5 * resolved_mm;
            if is_resolved && narrowing >= MIN_NARROWING {
                found.push((i, narrowing));
            }
        }
    }
    found.sort_by(|a, b| b.1.total_cmp(&a.1).then(a.0.cmp(&b.0)));
    found.truncate(LISTED);
    found
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
    fn minima_between_wider_places_are_narrow_and_the_ends_of_a_path_are_not() {
        //            0    1    2    3    4    5    6    7    8    9   10
        let radius = [1.0, 5.0, 4.0, 6.0, 5.9, 6.0, 3.0, 3.0, 6.0, 2.0, 1.0];
        let of = |radius: &[f64], cuts: &[usize], resolved| -> Vec<usize> {
            narrowest(radius, cuts, resolved).into_iter().map(|n| n.0).collect()
        };
        assert_eq!(of(&radius, &[], 0.5), [6, 2], "not the ripple at 4, nor the ends");
        assert_eq!(narrowest(&radius, &[], 0.5)[0].1, 0.5, "half of the radius is missing");
        assert_eq!(of(&radius, &[7], 0.5), [2], "a cut is an end too");
        assert_eq!(of(&radius, &[], 2.5), [6], "a narrowing by less than half a voxel is noise");
        assert!(of(&radius, &[], 3.5).is_empty(), "a radius below a voxel is noise");
        assert!(of(&[], &[], 0.5).is_empty() && of(&[1.0], &[], 0.5).is_empty());
        // Within a narrow place the lowest dip is the one that is listed.
        assert_eq!(of(&[9.0, 2.0, 2.1, 1.9, 9.0], &[], 0.5), [3]);
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
        let profile = LumenProfile::new(&[points], &wall, &tree, &places, 0.0);
        assert_eq!(profile.area_mm2[0], Some(rounded(side.y * side.z)));
        assert_eq!(*profile.area_mm2.last().unwrap(), None);
        assert!(profile.length_mm() > 1.7 * side.x && profile.narrowest.is_empty());
    }
}
