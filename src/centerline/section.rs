//! Centre of a section across a curve.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::frames::tangents;
use crate::field::Sampler;

/// Greatest displacement of a point in a round, in distances to the wall: where pockets follow each
/// other, the centres of neighbouring sections lie far apart.
const STRIDE: f64 = 0.15;
/// Distance of a wall, in lower quartiles of the section's distances, above which it is seen
/// through the mouth of a branch; the ends of an oval one and a half times as long as wide are
/// nearer.
const FAR: f64 = 1.6;
/// Least share of far walls in a section that is wholly a mouth.
const OPEN: f64 = 0.08;
/// Distance from an open section within which others count as partly open, in distances to the
/// wall: the rim of a mouth displaces their centres too.
const LIP: f64 = 0.3;

/// Computes the centre of the section at each point of a curve, in the plane across it: where the
/// walls balance, or, at the mouths of branches, where the distance to the wall in space is
/// largest.
///
/// * `u`: ascending parameters of the points, in distances to the wall.
/// * `asked`: whether a point may move; the others stay.
/// * `RAYS`: number of rays that find the wall around each point.
pub(super) fn centres<const RAYS: usize>(
    curve: &[DVec3],
    u: &[f64],
    asked: impl Fn(usize) -> bool + Sync,
    smooth: Sampler<'_>,
) -> Vec<DVec3> {
    let tangents = tangents(curve);
    let points = || (0..curve.len()).into_par_iter().with_min_len(16);
    let balanced: Vec<(DVec3, f64)> = points()
        .map(|i| {
            crate::task::checkpoint();
            if asked(i) { across::<RAYS>(curve[i], tangents[i], smooth) } else { (curve[i], 0.0) }
        })
        .collect();
    let open = near_mouths(&balanced, u);
    points()
        .map(|i| {
            let (middle, _) = balanced[i];
            if open[i] == 0.0 || !asked(i) {
                return middle;
            }
            middle.lerp(deepest(curve[i], tangents[i], smooth), open[i])
        })
        .collect()
}

/// Computes the openness of each section, from 0 (closed wall) to 1 (wholly a mouth); sections
/// beside mouths count in part.
fn near_mouths(sections: &[(DVec3, f64)], u: &[f64]) -> Vec<f64> {
    let mut open = vec![0.0f64; u.len()];
    for (i, (_, here)) in sections.iter().enumerate().filter(|(_, s)| s.1 > 0.0) {
        let (a, b) = around(u, i, LIP);
        for j in a..b {
            let fade = 2.0 * (1.0 - (u[i] - u[j]).abs() / LIP);
            open[j] = open[j].max(here * fade.min(1.0));
        }
    }
    open
}

/// Returns the range of the points whose parameter differs by less than `reach` from that of point
/// `i`.
pub(super) fn around(u: &[f64], i: usize, reach: f64) -> (usize, usize) {
    let a = u.partition_point(|v| u[i] - v >= reach);
    let b = u.partition_point(|v| v - u[i] < reach);
    (a.min(i), b.max(i + 1))
}

/// A wall point hit by a ray: offset in the plane across the curve, and distance.
struct WallHit {
    across: DVec2,
    range: f64,
}

/// Returns the point at which the walls around `p` balance in the plane across `t`, and the
/// openness of the section.
fn across<const RAYS: usize>(p: DVec3, t: DVec3, smooth: Sampler<'_>) -> (DVec3, f64) {
    let h = smooth.lumen.grid.spacing_mm.min_element();
    let level = 0.7 * h; // what the smoothed distance is at a flat wall
    let room = smooth.at(p);
    if room < 2.0 * level {
        return (p, 0.0);
    }
    let (u, v) = t.any_orthonormal_pair();
    let wall: [WallHit; RAYS] = std::array::from_fn(|i| {
        let way = DVec2::from_angle(std::f64::consts::TAU * i as f64 / RAYS as f64);
        let range = reach(p, u * way.x + v * way.y, room, smooth, level);
        WallHit { across: way * range, range }
    });
    let mut ranges = wall.each_ref().map(|w| w.range);
    ranges.sort_by(f64::total_cmp);
    let far = ranges.iter().filter(|r| **r > FAR * ranges[RAYS / 4]).count();
    let open = (far as f64 / RAYS as f64 / OPEN).min(1.0);
    let c = balance(&wall, room).clamp_length_max(STRIDE * room);
    let moved = p + u * c.x + v * c.y;
    (if smooth.at(moved) >= 0.5 * room { moved } else { p }, open)
}

/// Finds the point with the least sum of 1/ρ^8 over wall points, ρ their distance. The nearest
/// walls count most, so that the mouth of a branch hardly matters; all of them count, which
/// averages the voxels' steps.
fn balance(wall: &[WallHit], room: f64) -> DVec2 {
    let mut c = DVec2::ZERO;
    for _ in 0..8 {
        let (mut g, mut xx, mut xy, mut yy) = (DVec2::ZERO, 0.0, 0.0, 0.0);
        for w in wall {
            let d = c - w.across;
            let near = room * room / d.length_squared().max(1e-6 * room * room);
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

/// Returns the distance to the wall along a ray, at most four times `room`.
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

/// Returns the deepest point near `p` in the plane across `t`. Sections through a mouth have no
/// wall on its side and would balance askew; the distance field also takes the walls before and
/// behind the mouth into account.
fn deepest(p: DVec3, t: DVec3, smooth: Sampler<'_>) -> DVec3 {
    /// Difference in depth, in voxels, up to which points count: their mean is steadier than the
    /// deepest point.
    const AS_GOOD: f64 = 0.2;
    let h = smooth.lumen.grid.spacing_mm.min_element();
    let (u, v) = t.any_orthonormal_pair();
    let at = |c: DVec2| smooth.at(p + u * c.x + v * c.y);
    let room = at(DVec2::ZERO);
    let c = climb(at, 0.1 * room, 0.2 * h, 0.5 * room);
    let least = at(c) - AS_GOOD * h;
    let (mut sum, mut weight) = (DVec2::ZERO, 0.0);
    for k in 0..169 {
        let q = c + DVec2::new(f64::from(k % 13 - 6), f64::from(k / 13 - 6)) * (0.5 * h);
        let w = (at(q) - least).max(0.0);
        sum += w * q;
        weight += w;
    }
    let c = if weight > 0.0 { sum / weight } else { c };
    let c = c.clamp_length_max(STRIDE * room);
    p + u * c.x + v * c.y
}

/// Climbs from the origin of a plane, in steps halved down to `least` where none leads higher.
pub(super) fn climb(height: impl Fn(DVec2) -> f64, first: f64, least: f64, most: f64) -> DVec2 {
    let (mut at, mut here, mut step) = (DVec2::ZERO, height(DVec2::ZERO), first);
    while step > least && at.length() < most {
        let ways = (0..8).map(|k| at + DVec2::from_angle(f64::from(k) * 0.25 * PI) * step);
        let seen = ways.map(|q| (height(q), q));
        let best = seen.fold((here, at), |a, b| if b.0 > a.0 { b } else { a });
        if best.0 > here {
            (here, at) = best;
        } else {
            step *= 0.5;
        }
    }
    at
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn hill_climbing_stops_at_the_maximum_or_the_search_radius() {
        let top = DVec2::new(1.3, -0.7);
        let near = climb(|q| -q.distance(top), 0.5, 0.01, 10.0);
        assert!(near.distance(top) < 0.05, "{near}");
        assert_eq!(climb(|_| 1.0, 0.5, 0.01, 10.0), DVec2::ZERO);
        let cut = climb(|q| -q.distance(top), 0.5, 0.01, 1.0).length();
        assert!((1.0..1.6).contains(&cut), "{cut}");
    }

    #[test]
    fn sections_near_a_branch_mouth_count_as_partly_open() {
        let u: Vec<f64> = (0..21).map(|i| f64::from(i) * 0.05).collect();
        let mut sections = vec![(DVec3::ZERO, 0.0); 21];
        sections[10].1 = 0.8;
        let open = near_mouths(&sections, &u);
        assert_eq!((open[10], open[8], open[3], open[17]), (0.8, 0.8, 0.0, 0.0));
        assert!(open[5] > 0.0 && open[5] < open[6] && (open[5] - open[15]).abs() < 1e-9);
    }
}
