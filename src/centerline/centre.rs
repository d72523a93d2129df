//! From a voxel route to a smooth, centred curve.

use glam::{DVec2, DVec3};
use rayon::prelude::*;

use super::frames::tangents;
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

/// Centres a route: every point moves to the middle of the high ground of the distance map in the
/// plane across the curve, then a least-squares spline smooths what voxels left uneven.
///
/// * `route`: local mm, inside the lumen.
/// * `distance`: exact distance, mm; `smooth`: the same after a Gaussian of a voxel.
/// * `tightness`: knot spacing as a share of the distance to the wall.
///
/// Returns points half a voxel apart at most.
pub fn centre(
    route: &[DVec3],
    distance: Sampler<'_>,
    smooth: Sampler<'_>,
    fixed: Fixed,
    tightness: f64,
) -> Vec<DVec3> {
    let h = distance.lumen.grid.spacing_mm.min_element();
    let mut curve = resample(route, h);
    if curve.len() < 4 {
        return resample(&curve, 0.5 * h);
    }
    // The route's corners are voxels wide: a first spline gives tangents worth following.
    curve = smoothed(&curve, distance, 2.0, h);
    for round in 0..3 {
        let t = tangents(&curve);
        let n = curve.len();
        let moved: Vec<DVec3> = (0..n)
            .into_par_iter()
            .with_min_len(16)
            .map(|i| {
                let keep = (i == 0 && fixed.start) || (i == n - 1 && fixed.end);
                if keep { curve[i] } else { across(curve[i], t[i], distance, smooth) }
            })
            .collect();
        let knots = if round < 2 { 1.5 } else { 1.0 };
        curve = smoothed(&moved, distance, knots * tightness, h);
        curve = resample(&curve, h);
    }
    resample(&curve, 0.5 * h)
}

/// Middle of the high ground of the distance map in the plane through `p` across `t`.
fn across(p: DVec3, t: DVec3, distance: Sampler<'_>, smooth: Sampler<'_>) -> DVec3 {
    let (u, v) = t.any_orthonormal_pair();
    let h = distance.lumen.grid.spacing_mm.min_element();
    let mut c = p;
    for _ in 0..4 {
        let d = distance.at(c);
        if d < h {
            return c;
        }
        // A disc well inside the inscribed ball: all of it is lumen.
        let reach = (0.75 * d).max(h);
        let rings = ((reach / (0.8 * h)).ceil() as usize).clamp(2, 8);
        let top = smooth.at(c);
        let floor = top - 0.6 * reach;
        let mut sum = (0.0, DVec2::ZERO);
        for r in 1..=rings {
            let radius = reach * r as f64 / rings as f64;
            let spokes = 6 * r;
            for k in 0..spokes {
                let a = std::f64::consts::TAU * (k as f64 + 0.5 * (r % 2) as f64) / spokes as f64;
                let q = DVec2::from_angle(a) * radius;
                let f = smooth.at(c + u * q.x + v * q.y);
                let w = (f - floor).max(0.0).powi(2);
                sum.0 += w;
                sum.1 += w * q;
            }
        }
        if sum.0 <= 0.0 {
            return c;
        }
        let shift = 2.0 * sum.1 / sum.0; // the centroid moves by about half the offset
        let shift = shift.clamp_length_max(0.5 * d);
        let next = c + u * shift.x + v * shift.y;
        if distance.at(next) < 0.8 * d {
            return c;
        }
        c = next;
        if shift.length() < 0.02 * h {
            break;
        }
    }
    c
}

/// Least-squares spline through points, knots about `knots` × the distance to the wall apart.
pub fn smoothed(points: &[DVec3], distance: Sampler<'_>, knots: f64, h: f64) -> Vec<DVec3> {
    let n = points.len();
    // Parameter speed: one span per knot spacing, itself smoothed so that it varies slowly.
    let raw: Vec<f64> = points.iter().map(|p| (knots * distance.at(*p)).max(2.5 * h)).collect();
    let window = 4usize;
    let spacing = |i: usize| {
        let (a, b) = (i.saturating_sub(window), (i + window + 1).min(n));
        raw[a..b].iter().sum::<f64>() / (b - a) as f64
    };
    let mut u = vec![0.0; n];
    for i in 1..n {
        let ds = points[i].distance(points[i - 1]);
        u[i] = u[i - 1] + ds / (0.5 * (spacing(i) + spacing(i - 1)));
    }
    let total = u[n - 1];
    if total <= 0.0 {
        return points.to_vec();
    }
    let spans = (total.ceil() as usize).clamp(1, n.saturating_sub(1).max(1));
    let scale = spans as f64 / total;
    u.iter_mut().for_each(|u| *u *= scale);
    let spline = Spline::fit(points, &u, spans);
    u.iter().map(|u| spline.at(*u).0).collect()
}

/// Climbs from a voxel to the local maximum of the smoothed distance, staying where the inscribed
/// ball still reaches the start: the centre of the cap that ends a tube.
pub fn cap_centre(start_mm: DVec3, distance: Sampler<'_>, smooth: Sampler<'_>) -> DVec3 {
    let h = distance.lumen.grid.spacing_mm;
    let step = h.min_element();
    let mut at = start_mm;
    loop {
        let here = smooth.at(at);
        let next = (0..27usize)
            .filter(|n| *n != 13)
            .map(|n| at + super::graph::offset(n).as_dvec3() * h)
            .filter(|p| p.distance(start_mm) <= distance.at(*p) + 0.5 * step)
            .map(|p| (smooth.at(p), p))
            .fold(None, |best: Option<(f64, DVec3)>, c| match best {
                Some(b) if b.0 >= c.0 => Some(b),
                _ => Some(c),
            });
        match next {
            Some((f, p)) if f > here + 1e-6 => at = p,
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
