//! Conversion of a voxel route to a smooth, centred curve.

use glam::DVec3;

use super::clearance_refine::refine_clearance;
use super::containment::safe;
use super::section::{around, centres};
use super::spline::Spline;
use crate::field::Sampler;
use crate::lumen::bricks::near_offset;

/// Points a fixed arc length apart along a polyline, ends included.
pub fn resample(points: &[DVec3], step_mm: f64) -> Vec<DVec3> {
    let s = arc_lengths(points);
    let total = s.last().copied().unwrap_or(0.0);
    if points.len() < 2 || total == 0.0 {
        return points.to_vec();
    }
    let n = (total / step_mm).ceil().max(1.0) as usize;
    let mut i = 0;
    (0..=n)
        .map(|k| {
            let at = total * k as f64 / n as f64;
            while i + 2 < s.len() && s[i + 1] < at {
                i += 1;
            }
            let span = s[i + 1] - s[i];
            let t = if span > 0.0 { ((at - s[i]) / span).clamp(0.0, 1.0) } else { 0.0 };
            points[i].lerp(points[i + 1], t)
        })
        .collect()
}

/// Arc length at each point.
pub fn arc_lengths(points: &[DVec3]) -> Vec<f64> {
    let mut s = 0.0;
    (0..points.len())
        .map(|i| {
            if i > 0 {
                s += points[i].distance(points[i - 1]);
            }
            s
        })
        .collect()
}

/// Ends of a route that are not moved.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fixed {
    /// Whether the first point is fixed (a branch that starts on its parent).
    pub start: bool,
    /// Whether the last point is fixed.
    pub end: bool,
}

/// Centres a route: every point moves to where the walls around it balance in the plane across the
/// curve, then a least-squares spline smooths the steps of voxels.
///
/// * `route`: local mm, inside the lumen.
/// * `distance`: exact distance, mm; `smooth`: the same after a Gaussian of a voxel.
///
/// Returns points half a voxel apart at most.
pub fn recenter(
    route: &[DVec3],
    distance: Sampler<'_>,
    smooth: Sampler<'_>,
    fixed: Fixed,
) -> Vec<DVec3> {
    let h = distance.lumen.grid.spacing_mm.min_element();
    let (mut curve, mut moved) = (resample(route, h), Vec::new());
    if curve.len() < 4 {
        return resample(route, 0.5 * h);
    }
    // The route's corners are voxels wide: a first spline gives tangents worth following. Points
    // keep their parameters from here on, so that no fold can grow by drawing more points into it.
    let loose = vec![1.0; curve.len()];
    let track = smoothed(&curve, &parameters(&curve, &loose, distance), (1.0, 0.0));
    let u = parameters(&track, &loose, distance);
    curve.clone_from(&track);
    let last = curve.len() - 1;
    let free = |i: usize| !(i == 0 && fixed.start || i == last && fixed.end);
    for (round, knots) in KNOTS.into_iter().enumerate() {
        // Wide knots need no more: they average.
        moved = if round < COARSE {
            centres::<16>(&curve, &u, free, smooth)
        } else {
            centres::<32>(&curve, &u, free, smooth)
        };
        curve = smoothed(&moved, &u, knots);
    }
    let mut tight = vec![1.0; u.len()];
    curve = corners(curve, &mut moved, (&track, &u, &mut tight), distance, smooth);
    let curve = tightened(curve, &moved, (&track, &mut tight), distance);
    resample(&refine_clearance(curve, &u, distance), 0.5 * h)
}

/// Number of first rounds with half the rays.
const COARSE: usize = 3;
/// Mean displacement of a curve to one side of its sections' centres, in voxels, above which it
/// cuts a corner.
const ASTRAY: f64 = 0.1;
/// Half the length over which that displacement is averaged, and half the length that is fitted
/// more closely about such a point, in distances to the wall.
const WHILE: f64 = 0.25;
const ABOUT: f64 = 0.5;
/// Greatest ratio of the displacements from the sections' centres, with closer knots to without,
/// for closer knots to be kept. Where pockets follow each other it is always exceeded.
const AGREE: f64 = 0.7;

/// Fits with closer knots where the curve cuts corners and that reduces it: at forks.
fn corners(
    mut curve: Vec<DVec3>,
    moved: &mut [DVec3],
    (track, u, tight): (&[DVec3], &[f64], &mut [f64]),
    distance: Sampler<'_>,
    smooth: Sampler<'_>,
) -> Vec<DVec3> {
    let h = distance.lumen.grid.spacing_mm.min_element();
    for _ in 0..3 {
        let astray = astray(&curve, moved, u, ASTRAY * h);
        if astray.iter().all(|a| !a) {
            break;
        }
        let close: Vec<f64> =
            tight.iter().zip(&astray).map(|(t, a)| if *a { 0.5 * t } else { *t }).collect();
        let closer = smoothed(moved, &parameters(track, &close, distance), KNOTS[KNOTS.len() - 1]);
        let again = centres::<32>(&closer, u, |i| astray[i], smooth);
        let mut better = false;
        let mut end = 0;
        for run in astray.chunk_by(|a, b| a == b) {
            let range = end..end + run.len();
            end = range.end;
            let gap = |a: &[DVec3], b: &[DVec3]| -> f64 {
                range.clone().map(|i| a[i].distance(b[i])).sum()
            };
            if run[0] && gap(&again, &closer) < AGREE * gap(moved, &curve) {
                better = true;
                moved[range.clone()].copy_from_slice(&again[range.clone()]);
                tight[range.clone()].copy_from_slice(&close[range.clone()]);
            }
        }
        if !better {
            break;
        }
        curve = smoothed(moved, &parameters(track, tight, distance), KNOTS[KNOTS.len() - 1]);
    }
    curve
}

/// Marks the points near those where a curve keeps to one side of its sections' centres.
fn astray(curve: &[DVec3], moved: &[DVec3], u: &[f64], least: f64) -> Vec<bool> {
    let n = curve.len();
    let mut out = vec![false; n];
    for i in 1..n - 1 {
        let (a, b) = around(u, i, WHILE);
        let k = (i - a).min(b - 1 - i); // as many on either side
        let sum: DVec3 = (i - k..=i + k).map(|j| moved[j] - curve[j]).sum();
        if sum.length() > least * (2 * k + 1) as f64 {
            let (a, b) = around(u, i, ABOUT);
            // The ends are met as they are.
            out[a.max(1)..b.min(n - 1)].fill(true);
        }
    }
    out
}

/// Fits the last round's points again with closer knots wherever the curve cannot be proven
/// inside, and only there.
fn tightened(
    mut curve: Vec<DVec3>,
    moved: &[DVec3],
    (track, tight): (&[DVec3], &mut [f64]),
    distance: Sampler<'_>,
) -> Vec<DVec3> {
    let h = distance.lumen.grid.spacing_mm.min_element();
    let n = curve.len();
    for _ in 0..3 {
        let mut near = vec![false; n];
        for i in (0..n - 1).filter(|&i| !safe(curve[i], curve[i + 1], distance)) {
            let reach = (2.0 * distance.at(track[i]) / h).ceil() as usize + 2;
            near[i.saturating_sub(reach)..(i + reach).min(n)].fill(true);
        }
        if near.iter().all(|n| !n) {
            break;
        }
        tight.iter_mut().zip(near).filter(|(_, n)| *n).for_each(|(t, _)| *t *= 0.5);
        curve = smoothed(moved, &parameters(track, tight, distance), KNOTS[KNOTS.len() - 1]);
    }
    curve
}

/// Knot spacing of each round, in distances to the wall, and stiffness. Wide ones first: a section
/// across a tangent that follows every bump is askew and would move the point to where the next is
/// worse. Close knots follow the bends at forks; stiffness keeps them from following noise, and the
/// curve from depending on where the knots fall.
const KNOTS: [(f64, f64); 5] = [(2.0, 0.0), (2.0, 0.0), (1.25, 0.0), (0.7, 0.002), (0.7, 0.001)];
/// Curve parameter of each point: distance along the curve in distances to the wall, times `tight`.
fn parameters(points: &[DVec3], tight: &[f64], distance: Sampler<'_>) -> Vec<f64> {
    let n = points.len();
    let h = distance.lumen.grid.spacing_mm.min_element();
    let raw: Vec<f64> =
        points.iter().zip(tight).map(|(p, t)| t * distance.at(*p).max(3.0 * h)).collect();
    // Smoothed so that the curve's speed varies slowly.
    let window = 4usize;
    let unit = |i: usize| {
        let (a, b) = (i.saturating_sub(window), (i + window + 1).min(n));
        raw[a..b].iter().sum::<f64>() / (b - a) as f64
    };
    let mut u = vec![0.0; n];
    for i in 1..n {
        u[i] = u[i - 1] + points[i].distance(points[i - 1]) / (0.5 * (unit(i) + unit(i - 1)));
    }
    u
}

/// Least-squares spline through points, its ends exactly, with knots so far apart and so stiff.
fn smoothed(points: &[DVec3], u: &[f64], (knots, stiffness): (f64, f64)) -> Vec<DVec3> {
    let total = u[u.len() - 1];
    if total <= 0.0 {
        return points.to_vec();
    }
    let spans = ((total / knots).ceil() as usize).clamp(1, points.len() - 1);
    let scale = spans as f64 / total;
    let u: Vec<f64> = u.iter().map(|u| u * scale).collect();
    let spline = Spline::fit(points, &u, spans, stiffness);
    let mut curve: Vec<DVec3> = u.iter().map(|u| spline.at(*u).0).collect();
    (curve[0], curve[points.len() - 1]) = (points[0], points[points.len() - 1]);
    curve
}

/// Steepest-ascent steps must gain this much distance a mm: on the plateau of a tube's axis noise
/// would carry the climb along.
const CLIMB: f64 = 0.1;
/// An inscribed ball may miss the start by this factor of its radius: √2 reaches the corner of a
/// flat end, where the volume cuts a tube.
const CAP_REACH: f64 = 1.5;

/// Climbs from a wall voxel to the middle of the end it lies on: along the smoothed distance, as
/// long as that rises and the inscribed ball stays near the start.
pub fn cap_centre(start_mm: DVec3, distance: Sampler<'_>, smooth: Sampler<'_>) -> DVec3 {
    let h = distance.lumen.grid.spacing_mm;
    let step = h.min_element();
    let mut at = start_mm;
    loop {
        crate::task::checkpoint();
        let here = smooth.at(at);
        let next = (0..27usize)
            .filter(|n| *n != 13)
            .map(|n| at + near_offset(n).as_dvec3() * h)
            .filter(|p| p.distance(start_mm) <= CAP_REACH * distance.at(*p) + 0.5 * step)
            .map(|p| ((smooth.at(p) - here) / p.distance(at), p))
            .fold(None, |best: Option<(f64, DVec3)>, c| match best {
                Some(b) if b.0 >= c.0 => Some(b),
                _ => Some(c),
            });
        match next {
            Some((slope, p)) if slope > CLIMB => at = p,
            _ => return at,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn resampling_keeps_the_ends_and_spaces_evenly() {
        let p = [DVec3::ZERO, DVec3::new(3.0, 0.0, 0.0), DVec3::new(3.0, 4.0, 0.0)];
        let r = resample(&p, 0.5);
        assert_eq!((r.len(), r[0], r[14]), (15, p[0], p[2]));
        assert!(r.windows(2).all(|w| w[0].distance(w[1]) < 0.5 + 1e-9));
        assert_eq!(resample(&p[..1], 0.5), p[..1]);
    }
}
