//! Refinement of a curve's clearance: no point stays much nearer to the wall than its section
//! allows.

use std::f64::consts::PI;

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::frames::tangents;
use super::section::{around, climb};
use crate::field::Sampler;

/// Least distance of a point to the wall, as a share of the largest one near by in its section.
const SHARE: f64 = 0.95;
/// Reach within which a point that must move displaces its neighbours, in distances to the wall.
const ALONG: f64 = 1.8;
/// Greatest displacement of a point in a round, in its distances to the wall: where more would be
/// needed, sections disagree and the curve is a compromise.
const MAX_MOVE: f64 = 0.04;
const ROUNDS: usize = 3;

/// Moves a curve towards the deepest places of sections in which it keeps less than its share of
/// the distance to the wall there: where walls balance need not be where the nearest is farthest.
/// It moves as little as will do, and smoothly. The ends stay.
///
/// * `u`: ascending parameters of the points, in distances to the wall.
/// * `distance`: exact distance, mm.
pub(super) fn refine_clearance(
    mut curve: Vec<DVec3>,
    u: &[f64],
    distance: Sampler<'_>,
) -> Vec<DVec3> {
    for _ in 0..ROUNDS {
        let t = tangents(&curve);
        let points = (0..curve.len()).into_par_iter().with_min_len(64);
        let ways: Vec<DVec3> = points.map(|i| wanting(curve[i], t[i], distance)).collect();
        if ways.iter().all(|w| *w == DVec3::ZERO) {
            break;
        }
        curve.iter_mut().zip(spread(&ways, u)).for_each(|(p, way)| *p += way);
    }
    curve
}

/// Returns the weighted mean of the displacements about each point; nearer ones weigh more, and the
/// mean fades with the distance of the nearest.
fn spread(ways: &[DVec3], u: &[f64]) -> Vec<DVec3> {
    let n = ways.len();
    // Weighted sum, sum and largest of the weights.
    let mut all = vec![(DVec3::ZERO, 0.0f64, 0.0f64); n];
    for i in (0..n).filter(|&i| ways[i] != DVec3::ZERO) {
        let reach = ALONG.min(u[i] - u[0]).min(u[n - 1] - u[i]);
        if reach < ALONG / 3.0 {
            continue;
        }
        let (a, b) = around(u, i, reach);
        for j in a..b {
            let weight = 0.5 + 0.5 * (PI * (u[j] - u[i]) / reach).cos();
            all[j].0 += weight * ways[i];
            all[j].1 += weight;
            all[j].2 = all[j].2.max(weight);
        }
    }
    let mean = |(sum, weights, most): (DVec3, f64, f64)| {
        if weights > 0.0 { sum * (most / weights) } else { DVec3::ZERO }
    };
    let mut out: Vec<DVec3> = all.into_iter().map(mean).collect();
    (out[0], out[n - 1]) = (DVec3::ZERO, DVec3::ZERO);
    out
}

/// Returns the least displacement of `p` in the plane across `t` that gives it its share of the
/// clearance; zero if none is needed, or if it would be too far.
fn wanting(p: DVec3, t: DVec3, distance: Sampler<'_>) -> DVec3 {
    let h = distance.lumen.grid.spacing_mm.min_element();
    let (u, v) = t.any_orthonormal_pair();
    let at = |c: DVec2| distance.at(p + u * c.x + v * c.y);
    let here = at(DVec2::ZERO);
    let best = climb(at, 0.2 * here, 0.1 * h, here);
    let wanted = SHARE * at(best);
    if here >= wanted {
        return DVec3::ZERO;
    }
    let (mut short, mut enough) = (0.0, 1.0);
    for _ in 0..8 {
        let half = 0.5 * (short + enough);
        *if at(best * half) < wanted { &mut short } else { &mut enough } = half;
    }
    let way = best * enough;
    if way.length() > MAX_MOVE * here {
        return DVec3::ZERO;
    }
    u * way.x + v * way.y
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_local_displacement_spreads_smoothly_and_keeps_the_ends() {
        let u: Vec<f64> = (0..200).map(|i| f64::from(i) * 0.05).collect();
        let mut ways = vec![DVec3::ZERO; 200];
        (ways[100], ways[2]) = (DVec3::X, DVec3::Y);
        let out = spread(&ways, &u);
        assert_eq!(
            (out[100], out[0], out[2], out[199]),
            (DVec3::X, DVec3::ZERO, DVec3::ZERO, DVec3::ZERO)
        );
        assert!(out.windows(2).all(|w| w[0].distance(w[1]) < 0.05));
        assert!(out[130].x > 0.0 && out[137] == DVec3::ZERO);
    }
}
