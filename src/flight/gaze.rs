//! Viewing direction and up direction along a path.

use glam::DVec3;

use super::profile::{median, place};
use super::{Clearance, beyond, smoothed, smoothed_below};
use crate::centerline::{arc_lengths, frames, resample};
use crate::geometry::CenterlinePoint;

/// Shortest distance to look ahead, mm, unless the wall is nearer.
const MIN_AHEAD_MM: f64 = 5.0;
/// Distance to look ahead in radii.
const AHEAD_RADII: f64 = 2.0;
/// Farthest distance to look ahead, mm.
const MAX_AHEAD_MM: f64 = 40.0;
/// Smoothing of the curve that is looked along, mm; no more than the radius.
const GAZE_SIGMA_MM: f64 = 2.0;
/// Smoothing of the eye's own path, in radii: bends move by a hundredth of a radius, jitter goes.
const EYE_SIGMA_RADII: f64 = 0.15;
/// Most samples of a track.
const MAX_SAMPLES: f64 = 20_000.0;

/// Eye, gaze and up at equal steps of arc length.
#[derive(Clone, Debug, PartialEq)]
pub struct Track {
    /// Arc length between samples, mm.
    pub step_mm: f64,
    /// Position of the eye, LPS mm.
    pub eye: Vec<DVec3>,
    /// Radius of the path at the eye, mm.
    pub radius_mm: Vec<f64>,
    /// Unit viewing direction.
    pub gaze: Vec<DVec3>,
    /// Unit up direction, across the gaze.
    pub up: Vec<DVec3>,
    /// Free distance along the gaze, mm: the point there is seen from the eye.
    pub ahead_mm: Vec<f64>,
}

impl Track {
    /// Lays a track along a path (two points apart at least).
    ///
    /// The gaze goes from the smoothed path to a point of it ahead, so that neither end of the
    /// line of sight jitters. Where the wall is in between, that point comes nearer, gradually.
    /// Up is carried along the gaze without turning about it, so that it cannot flip.
    pub fn new(path: &[CenterlinePoint], wall: &Clearance<'_>, spacing_mm: f64) -> Self {
        let (raw, radius_mm, step_mm) = even(path, spacing_mm);
        let n = raw.len();
        let mut eye = smoothed(&raw, |i| EYE_SIGMA_RADII * radius_mm[i] / step_mm);
        for (e, r) in eye.iter_mut().zip(&raw) {
            if !wall.holds(*e) {
                *e = *r;
            }
        }
        let sigma = |i: usize| GAZE_SIGMA_MM.min(radius_mm[i].max(step_mm)) / step_mm;
        let along = smoothed(&raw, sigma);
        let chord = |i: usize, ahead_mm: f64| {
            let at = i as f64 + ahead_mm / step_mm;
            let k = at as isize;
            beyond(&along, k).lerp(beyond(&along, k + 1), at.fract()) - along[i]
        };
        let ahead: Vec<f64> = (0..n)
            .map(|i| {
                let mut ahead = (AHEAD_RADII * radius_mm[i]).clamp(MIN_AHEAD_MM, MAX_AHEAD_MM);
                while ahead > 2.0 * step_mm && !wall.sees(eye[i], eye[i] + chord(i, ahead)) {
                    ahead *= 0.85;
                }
                ahead
            })
            .collect();
        let ahead = smoothed_below(&ahead, (MIN_AHEAD_MM / step_mm).round() as usize);
        let mut last = DVec3::Z;
        let looked: Vec<DVec3> = (0..n)
            .map(|i| {
                last = chord(i, ahead[i]).try_normalize().unwrap_or(last);
                last
            })
            .collect();
        let gaze: Vec<DVec3> = smoothed(&looked, |_| 1.0 / step_mm)
            .iter()
            .zip(&looked)
            .map(|(s, l)| s.try_normalize().unwrap_or(*l))
            .collect();
        let ahead_mm = (0..n)
            .map(|i| {
                let mut free = ahead[i];
                while free > 1e-3 && !wall.sees(eye[i], eye[i] + free * gaze[i]) {
                    free *= 0.85;
                }
                free
            })
            .collect();
        let up = ups(&gaze, step_mm);
        Self { step_mm, eye, radius_mm, gaze, up, ahead_mm }
    }

    /// Returns the rotation of the gaze between consecutive samples, radians.
    pub fn turns_rad(&self) -> Vec<f64> {
        self.gaze.windows(2).map(|w| w[0].angle_between(w[1])).collect()
    }

    /// Returns the mean radius within a radius along the path, mm, which does not jump.
    pub fn room_mm(&self, arc_mm: f64) -> f64 {
        let (.., radius) = self.at(arc_mm);
        let at = |arc: f64| (arc / self.step_mm).max(0.0) as usize;
        let last = self.radius_mm.len() - 1;
        let near = &self.radius_mm[at(arc_mm - radius).min(last)..=at(arc_mm + radius).min(last)];
        near.iter().sum::<f64>() / near.len() as f64
    }

    /// Returns eye, gaze, up and radius at an arc length.
    pub fn at(&self, arc_mm: f64) -> (DVec3, DVec3, DVec3, f64) {
        let (i, t) = place(arc_mm / self.step_mm, self.eye.len());
        let j = (i + 1).min(self.eye.len() - 1);
        let between = |v: &[DVec3]| v[i].lerp(v[j], t);
        // Along the arc: on the chord the gaze would turn faster in the middle of a sharp turn.
        let gaze = self.gaze[i].slerp(self.gaze[j], t).normalize_or(self.gaze[i]);
        let up = between(&self.up).reject_from_normalized(gaze).normalize_or(self.up[i]);
        let r = &self.radius_mm;
        (between(&self.eye), gaze, up, r[i] + t * (r[j] - r[i]))
    }
}

/// Computes up along a gaze: rotation-minimising frames of the curve whose tangent is the gaze.
///
/// The first up points to the head (+z), or to the front (-y) where the gaze runs along z.
fn ups(gaze: &[DVec3], step_mm: f64) -> Vec<DVec3> {
    let mut at = DVec3::ZERO;
    let drawn: Vec<DVec3> = (0..gaze.len())
        .map(|i| {
            if i > 0 {
                at += 0.5 * step_mm * (gaze[i - 1] + gaze[i]);
            }
            at
        })
        .collect();
    let along_z = gaze.first().is_some_and(|g| g.z.abs() > 0.75);
    let first = if along_z { DVec3::NEG_Y } else { DVec3::Z };
    frames(&drawn, gaze, first).iter().map(|f| f.normal).collect()
}

/// Resamples a path at equal steps: positions, radii, step. Its ends are left out where they are
/// narrower than half the median, up to a twentieth of the length each.
fn even(path: &[CenterlinePoint], spacing_mm: f64) -> (Vec<DVec3>, Vec<f64>, f64) {
    let points: Vec<DVec3> = path.iter().map(|p| p.position_mm).collect();
    let radii: Vec<f64> = path.iter().map(|p| p.radius_mm).collect();
    let s = arc_lengths(&points);
    let total = s[s.len() - 1];
    let wide = 0.5 * median(&radii);
    let trim = |i: &usize| radii[*i] >= wide;
    let a = (0..s.len()).take_while(|&i| s[i] <= 0.05 * total).find(trim).unwrap_or(0);
    let b = (a + 1..s.len()).rev().take_while(|&i| s[i] >= 0.95 * total).find(trim);
    let b = b.unwrap_or(s.len() - 1);
    let length = s[b] - s[a];
    let step = (0.5 * spacing_mm).min(0.5).max(length / MAX_SAMPLES);
    let positions = resample(&points[a..=b], step);
    let n = positions.len();
    let step = length / (n - 1) as f64;
    let mut i = a;
    let radius = (0..n)
        .map(|k| {
            let at = s[a] + step * k as f64;
            while i + 1 < b && s[i + 1] < at {
                i += 1;
            }
            let span = s[i + 1] - s[i];
            let t = if span > 0.0 { ((at - s[i]) / span).clamp(0.0, 1.0) } else { 0.0 };
            radii[i] + t * (radii[i + 1] - radii[i])
        })
        .collect();
    (positions, radius, step)
}
