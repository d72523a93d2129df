//! The wall of the colon phantom: a radius about a winding axis.

use std::f64::consts::TAU;

use super::path::Path;

/// Corners of the axis: rectum, sigmoid, descending, transverse and ascending colon, cecum.
pub(super) const AXIS: [[f64; 3]; 9] = [
    [0.0, 0.36, -0.36],
    [-0.06, 0.08, -0.18],
    [0.13, -0.2, -0.35],
    [0.33, 0.12, -0.16],
    [0.35, 0.08, 0.36],
    [0.04, -0.22, 0.08],
    [-0.31, 0.0, 0.36],
    [-0.33, 0.06, -0.12],
    [-0.26, -0.06, -0.36],
];
/// Radius of the axis's bends: greater than that of any section.
pub(super) const BEND: f64 = 0.11;
/// Mean radius between folds.
const R0: f64 = 0.055;
/// Relative amplitude of the radius along the axis.
const SWING: f64 = 0.2;
/// Depth of a fold, as a share of the radius.
const FOLD_DEPTH: f64 = 0.38;
/// Distance between folds and their half width.
const FOLD_STEP: f64 = 2.1 * R0;
const FOLD_WIDTH: f64 = 0.16 * FOLD_STEP;
/// Bounds of the wall's radius.
pub(super) const MAX: f64 = R0 * (1.0 + SWING);
pub(super) const MIN: f64 = R0 * (1.0 - SWING) * (1.0 - FOLD_DEPTH);

/// Returns the radius of the colon's wall at arc length `s` in the direction (a, b) across, `rho`
/// from the axis: folds are deepest at the three taeniae.
pub(super) fn radius(path: &Path, s: f64, a: f64, b: f64, rho: f64) -> f64 {
    // Cosine of three times the angle as a polynomial, so that it fades smoothly at the axis.
    let taenia = (a * a * a - 3.0 * a * b * b) / rho.max(MIN).powi(3);
    let x = (s.rem_euclid(FOLD_STEP) - 0.5 * FOLD_STEP) / FOLD_WIDTH;
    let calibre = 1.0 + SWING * (TAU * s / (0.37 * path.length) + 0.5).sin();
    R0 * calibre * (1.0 - FOLD_DEPTH * (-x * x).exp() * (0.72 + 0.28 * taenia))
}

/// Returns the distance from the axis at arc length `s` to the wall, by search over the wall.
pub(super) fn inscribed(path: &Path, s: f64) -> f64 {
    let here = path.at(s);
    let mut best = f64::INFINITY;
    for k in -60..=60 {
        let at = (s + f64::from(k) * MAX / 60.0).clamp(0.0, path.length);
        let (centre, (u, v)) = (path.at(at), path.frame(at));
        for j in 0..36 {
            let (sin, cos) = (TAU * f64::from(j) / 36.0).sin_cos();
            // A unit offset scaled by the wall's own radius: the taenia term sees its full depth.
            let r = radius(path, at, cos, sin, 1.0);
            best = best.min(here.distance_squared(centre + r * (cos * u + sin * v)));
        }
    }
    best.sqrt()
}
