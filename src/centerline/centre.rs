//! From a voxel route to a smooth, centred curve.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::frames::tangents;
use super::prove::safe;
use super::sample::Sampler;
use super::spline::Spline;

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

/// What stays where it is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Fixed {
    /// The first point (a branch that starts on its parent).
    pub start: bool,
    /// The last point.
    pub end: bool,
}

/// Centres a route: every point moves to where the walls around it balance in the plane across the
/// curve, then a least-squares spline smooths what voxels left uneven.
///
/// * `route`: local mm, inside the lumen.
/// * `distance`: exact distance, mm; `smooth`: the same after a Gaussian of a voxel.
///
/// Returns points half a voxel apart at most.
pub fn centre(
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
    for knots in KNOTS {
        let t = tangents(&curve);
        let n = curve.len();
        moved = (0..n)
            .into_par_iter()
            .with_min_len(16)
            .map(|i| {
                let keep = (i == 0 && fixed.start) || (i == n - 1 && fixed.end);
                if keep { curve[i] } else { across(curve[i], t[i], smooth) }
            })
            .collect();
        curve = smoothed(&moved, &u, knots);
    }
    resample(&tightened(curve, &moved, &track, distance), 0.5 * h)
}

/// Fits the last round's points again with closer knots wherever the curve cannot be proven
/// inside, and only there.
fn tightened(
    mut curve: Vec<DVec3>,
    moved: &[DVec3],
    track: &[DVec3],
    distance: Sampler<'_>,
) -> Vec<DVec3> {
    let h = distance.lumen.grid.spacing_mm.min_element();
    let n = curve.len();
    let mut tight = vec![1.0; n];
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
        curve = smoothed(moved, &parameters(track, &tight, distance), KNOTS[KNOTS.len() - 1]);
    }
    curve
}

/// Knot spacing of each round, in distances to the wall, and stiffness. Wide ones first: a section
/// across a tangent that follows every bump is askew and would move the point to where the next is
/// worse. Close knots follow the bends at forks; stiffness keeps them from following noise, and the
/// curve from depending on where the knots fall.
const KNOTS: [(f64, f64); 5] = [(2.0, 0.0), (2.0, 0.0), (1.25, 0.0), (0.7, 0.002), (0.7, 0.001)];
/// Farthest a point moves in a round, in distances to the wall: where pockets follow each other
/// the best places of neighbouring sections lie far apart.
const STRIDE: f64 = 0.15;
/// Rays in a ring around a point.
const RAYS: usize = 32;
/// A wall this many lower quartiles of the section away is seen through the mouth of a branch.
const FAR: f64 = 1.8;
/// A section with this share of far walls, or more, is wholly a mouth.
const OPEN: f64 = 0.08;
/// Where it is one, rays that rise and fall by this angle (radians) join in: the ball they find
/// stays where the section alone would slide into the branch. Elsewhere the section is better, for
/// it has no bias in bends.
const RISE: f64 = 0.7;

/// A wall point seen along a ray: across the curve, along it (squared), and how far it is.
struct Wall {
    across: DVec2,
    along2: f64,
    range: f64,
}

/// Where the walls around `p` balance in the plane across `t`.
fn across(p: DVec3, t: DVec3, smooth: Sampler<'_>) -> DVec3 {
    let h = smooth.lumen.grid.spacing_mm.min_element();
    let level = 0.7 * h; // what the smoothed distance is at a flat wall
    let room = smooth.at(p);
    if room < 2.0 * level {
        return p;
    }
    let (u, v) = t.any_orthonormal_pair();
    let ring = |rise: f64, turn: f64, wall: &mut Vec<Wall>| {
        let (up, flat) = rise.sin_cos();
        for i in 0..RAYS {
            let a = std::f64::consts::TAU * (i as f64 + turn) / RAYS as f64;
            let way = DVec2::from_angle(a) * flat;
            let range = reach(p, u * way.x + v * way.y + t * up, room, smooth, level);
            wall.push(Wall { across: way * range, along2: (up * range).powi(2), range });
        }
    };
    let mut wall = Vec::with_capacity(3 * RAYS);
    ring(0.0, 0.0, &mut wall);
    let mut ranges: Vec<f64> = wall.iter().map(|w| w.range).collect();
    ranges.sort_by(f64::total_cmp);
    let far = ranges.iter().filter(|r| **r > FAR * ranges[RAYS / 4]).count();
    let open = (far as f64 / RAYS as f64 / OPEN).min(1.0);
    let mut c = balance(&wall, room);
    if open > 0.0 {
        ring(RISE, 0.5, &mut wall);
        ring(-RISE, 0.5, &mut wall);
        c = c.lerp(balance(&wall, room), open);
    }
    let c = c.clamp_length_max(STRIDE * room);
    let moved = p + u * c.x + v * c.y;
    if smooth.at(moved) >= 0.5 * room { moved } else { p }
}

/// The least of the sum of 1/ρ^8 over wall points, ρ their distance. The nearest walls count most,
/// so that the mouth of a branch hardly matters; all of them count, which averages the voxels'
/// steps.
fn balance(wall: &[Wall], room: f64) -> DVec2 {
    let mut c = DVec2::ZERO;
    for _ in 0..8 {
        let (mut g, mut xx, mut xy, mut yy) = (DVec2::ZERO, 0.0, 0.0, 0.0);
        for w in wall {
            let d = c - w.across;
            let near = room * room / (d.length_squared() + w.along2).max(1e-6 * room * room);
            let push = w.range * near.powi(5);
            g -= push * d;
            let bend = 10.0 / (room * room) * near * push;
            xx += bend * d.x * d.x - push;
            xy += bend * d.x * d.y;
            yy += bend * d.y * d.y - push;
        }
        // Newton, with the weaker curvature kept from vanishing.
        let (mean, half) = (0.5 * (xx + yy), 0.5 * (xx - yy));
        let split = half.hypot(xy);
        let lift = (0.05 * (mean + split) - (mean - split)).max(0.0);
        let (xx, yy) = (xx + lift, yy + lift);
        let det = xx * yy - xy * xy;
        let step = DVec2::new(yy * g.x - xy * g.y, xx * g.y - xy * g.x) / -det;
        let step = step.clamp_length_max(0.25 * room);
        c += step;
        if step.length() < 1e-4 * room {
            break;
        }
    }
    c
}

/// Distance to the wall along a ray, no more than a few times the room.
fn reach(p: DVec3, way: DVec3, room: f64, smooth: Sampler<'_>, level: f64) -> f64 {
    let (most, least) = (4.0 * room, 0.3 * level);
    let (mut s, mut over) = (0.0, room - level);
    while s < most {
        let step = (0.8 * over).max(least);
        let next = smooth.at(p + way * (s + step)) - level;
        if next <= 0.0 {
            return s + step * over / (over - next);
        }
        s += step;
        over = next;
    }
    most
}

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
        let here = smooth.at(at);
        let next = (0..27usize)
            .filter(|n| *n != 13)
            .map(|n| at + super::graph::offset(n).as_dvec3() * h)
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
