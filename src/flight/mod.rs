//! The flight: speed and viewing direction along a path, and the proof that no near plane cuts the
//! wall. Millimetres and patient space (LPS) throughout, seconds for time.

mod camera_path;
mod centerline_distances;
mod centerline_places;
mod clearance;
mod collide_and_slide;
mod coverage;
mod cross_section;
mod gaze;
mod keyed_gaze;
mod lesion_diameter;
mod lumen_profile;
mod path;
mod plan;
mod profile;
mod stenosis;

pub use camera_path::{CameraPath, CameraPathError, CameraPathPose, MAX_BYTES, SCHEMA};
pub use centerline_distances::CenterlineDistances;
pub use centerline_places::{CenterlinePlace, CenterlinePlaces, MAX_ASTRAY};
pub use clearance::{Clearance, MIN_NEAR_MM, SAFETY, WallDistance};
pub use collide_and_slide::collide_and_slide;
pub use coverage::{Coverage, CoverageMap, LISTED_FROM_MM2, MissedPatch, coverage, unseen_voxels};
pub use cross_section::{CrossSection, cross_section};
pub use gaze::Track;
pub use keyed_gaze::KeyedGaze;
pub use lesion_diameter::LesionDiameter;
pub use lumen_profile::{LumenProfile, NarrowPlace};
pub use path::{FlightPath, NoSection, SectionFigures, sections_along};
pub use plan::{FOV_DEG, Flight, FlightError, FlightOptions, Frames, MAX_FRAMES};
pub use profile::{MAX_TURN_RAD_PER_S, Profile};

/// Averages each value with its neighbours by a Gaussian of its own width.
///
/// * `sigma`: standard deviation in samples, one a value; 0 keeps the value.
///
/// Beyond the ends the values go on mirrored in the end point, which keeps ends and end slopes.
fn smoothed(values: &[glam::DVec3], sigma: impl Fn(usize) -> f64) -> Vec<glam::DVec3> {
    (0..values.len())
        .map(|i| {
            let w = sigma(i);
            let reach = (3.0 * w).ceil() as isize;
            let mut sum = (values[i], 1.0);
            for k in 1..=reach {
                let g = (-0.5 * (k as f64 / w).powi(2)).exp();
                let i = i as isize;
                sum.0 += g * (beyond(values, i - k) + beyond(values, i + k));
                sum.1 += 2.0 * g;
            }
            sum.0 / sum.1
        })
        .collect()
}

/// Returns a value by index; past an end, its mirror image in the end value.
fn beyond(values: &[glam::DVec3], i: isize) -> glam::DVec3 {
    let last = values.len() as isize - 1;
    let at = |i: isize| values[i.clamp(0, last) as usize];
    if i < 0 {
        2.0 * at(0) - at(-i)
    } else if i > last {
        2.0 * at(last) - at(2 * last - i)
    } else {
        at(i)
    }
}

/// Smooths from below: a windowed minimum, then an average no wider than the window, so that no
/// result exceeds its own value.
///
/// * `reach`: half width in samples.
fn smoothed_below(values: &[f64], reach: usize) -> Vec<f64> {
    let span = |v: &[f64], i: usize, w: usize| (i.saturating_sub(w), (i + w + 1).min(v.len()));
    let least: Vec<f64> = (0..values.len())
        .map(|i| {
            let (a, b) = span(values, i, reach);
            values[a..b].iter().copied().fold(f64::INFINITY, f64::min)
        })
        .collect();
    // Two boxes make a hat as wide as the window.
    let half = reach / 2;
    let average = |v: &[f64]| -> Vec<f64> {
        (0..v.len())
            .map(|i| {
                let (a, b) = span(v, i, half);
                v[a..b].iter().sum::<f64>() / (b - a) as f64
            })
            .collect()
    };
    average(&average(&least))
}
