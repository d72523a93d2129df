//! Ranges of the settings, for every caller: the command line, Python, the window.

use std::fmt::Display;
use std::ops::RangeInclusive;

use super::settings::{FlightSettings, LevelSettings, Lod, LumenSettings, Settings, WallSettings};
use crate::flight::{FOV_DEG, Frames, MAX_FRAMES};
use crate::lod::vds::Scheme;
use crate::organ::Organ;
use crate::render::{MAX_LOCAL_CONTRAST, View};
use crate::surface::{Fairing, Smoothing};

/// Threads of a session.
const THREADS: RangeInclusive<usize> = 1..=1024;
/// Pixels that a drawn wall may be away from the mesh.
const PIXEL_ERROR: RangeInclusive<f32> = 0.01..=100.0;
/// Columns, and rows, of a frame.
const SIDE_PX: RangeInclusive<u32> = 16..=8192;
/// Depth behind the wall, mm.
const BEHIND_MM: RangeInclusive<f32> = 0.5..=25.0;
/// Most steps of normal smoothing.
const MAX_STEPS: u32 = 10_000;
/// Least number of faces of a simplified surface: a tetrahedron's.
const MIN_BASE_FACES: usize = 4;
/// Fastest flight, mm/s, and most frames a second.
const MAX_SPEED: f64 = 10_000.0;
const MAX_FPS: f64 = 1000.0;

/// A setting that is out of its range, or that does not go with another one.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{name} {value}: {allowed}")]
pub struct SettingError {
    /// Name of the setting, in words joined by underscores.
    pub name: &'static str,
    /// Value that was given.
    pub value: String,
    /// Values that are allowed, in words.
    pub allowed: String,
}

/// Fails, where `is_allowed` is false, with the name and value of a setting.
fn ensure(
    is_allowed: bool,
    name: &'static str,
    value: impl Display,
    allowed: impl FnOnce() -> String,
) -> Result<(), SettingError> {
    match is_allowed {
        true => Ok(()),
        false => Err(SettingError { name, value: value.to_string(), allowed: allowed() }),
    }
}

/// Fails with a value that is not in a range.
fn within<T: PartialOrd + Display + Copy>(
    name: &'static str,
    value: T,
    range: &RangeInclusive<T>,
    unit: &str,
) -> Result<(), SettingError> {
    ensure(range.contains(&value), name, value, || {
        format!("{} to {}{unit}", range.start(), range.end())
    })
}

impl Settings {
    /// Checks the range of every setting, and settings that exclude each other.
    ///
    /// # Errors
    /// The first setting that cannot be.
    pub fn check(&self) -> Result<(), SettingError> {
        self.threads.map_or(Ok(()), |n| within("threads", n, &THREADS, ""))?;
        self.lumen.check()?;
        self.wall.check()?;
        self.levels.check()?;
        self.flight.check()
    }
}

impl LumenSettings {
    fn check(&self) -> Result<(), SettingError> {
        let is_chosen = self.select.is_some() || self.seed.is_some() || self.all_components;
        let organ = self.organ.map_or("", |o| o.organ.name());
        ensure(self.organ.is_none() || !is_chosen, "organ", organ, || {
            "chooses threshold, labels, seed and components itself".into()
        })?;
        let is_tagged = self.organ.is_some_and(|o| o.tagged && o.organ != Organ::Colon);
        ensure(!is_tagged, "tagged", true, || "needs the organ colon".into())?;
        ensure(!self.leak_control || self.seed.is_some(), "leak_control", true, || {
            "needs a seed".into()
        })
    }
}

impl Fairing {
    /// Checks steps and lambda.
    ///
    /// # Errors
    /// The setting that cannot be.
    pub fn check(&self) -> Result<(), SettingError> {
        within("smooth", self.steps, &(0..=MAX_STEPS), " steps")?;
        ensure(self.lambda > 0.0 && self.lambda < 1.0, "lambda", self.lambda, || {
            "between 0 and 1; at 1 the steps oscillate".into()
        })
    }
}

impl WallSettings {
    fn check(&self) -> Result<(), SettingError> {
        if let Some(Smoothing::Steps(fairing)) = &self.smoothing {
            fairing.check()?;
        }
        let faces = self.base_faces.unwrap_or(MIN_BASE_FACES);
        ensure(faces >= MIN_BASE_FACES, "decimate", faces, || {
            format!("at least {MIN_BASE_FACES} faces")
        })
    }
}

impl LevelSettings {
    /// Checks the tolerance.
    ///
    /// # Errors
    /// The setting that cannot be.
    pub fn check(&self) -> Result<(), SettingError> {
        within("pixel_error", self.pixel_error, &PIXEL_ERROR, " pixels")?;
        let is_used = self.lod == Lod::Vds || self.scheme == Scheme::default();
        ensure(is_used, "scheme", self.scheme.name(), || "of lod vds alone".into())
    }
}

impl FlightSettings {
    fn check(&self) -> Result<(), SettingError> {
        check_frame_size(self.size)?;
        // Degrees that were made radians come back within a hair.
        let fov_deg = (f64::from(self.fov_y_rad.to_degrees()) * 1e4).round() / 1e4;
        within("fov", fov_deg, &FOV_DEG, " degrees")?;
        self.behind_mm.map_or(Ok(()), |mm| within("behind", mm, &BEHIND_MM, " mm"))?;
        within("local-contrast", self.local_contrast, &(0.0..=MAX_LOCAL_CONTRAST), "")?;
        let has_inside = self.behind_mm.is_none() || self.view != View::Overview;
        ensure(has_inside, "behind", self.behind_mm.unwrap_or_default(), || {
            "for views from inside, not for the overview".into()
        })?;
        let counts = 1..=MAX_FRAMES;
        self.script_frames.map_or(Ok(()), |n| within("frames", n, &counts, ""))?;
        match self.frames {
            Frames::Count(n) => within("frames", n, &counts, ""),
            Frames::Speed { mm_per_s, fps } => {
                check_frame_rate(fps)?;
                ensure(mm_per_s > 0.0 && mm_per_s <= MAX_SPEED, "speed", mm_per_s, || {
                    format!("above 0, at most {MAX_SPEED} mm/s")
                })
            }
        }
    }
}

/// Checks columns and rows of a frame.
///
/// # Errors
/// The size, where it cannot be.
pub fn check_frame_size(size: [u32; 2]) -> Result<(), SettingError> {
    let [columns, rows] = size;
    ensure(size.iter().all(|n| SIDE_PX.contains(n)), "size", format!("{columns}x{rows}"), || {
        format!("columns and rows, each {} to {}", SIDE_PX.start(), SIDE_PX.end())
    })
}

/// Checks a number of frames a second.
///
/// # Errors
/// The number, where it cannot be.
pub fn check_frame_rate(fps: f64) -> Result<(), SettingError> {
    ensure(fps > 0.0 && fps <= MAX_FPS, "fps", fps, || format!("above 0, at most {MAX_FPS}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::organ::OrganOptions;
    use crate::surface::Weights;

    type Change = fn(&mut Settings);

    #[test]
    fn a_setting_out_of_its_range_is_refused_by_name_and_the_defaults_are_not() {
        assert_eq!(Settings::default().check(), Ok(()));
        let smoothing = |steps, lambda| {
            let weights = Weights::Uniform;
            Some(Smoothing::Steps(Fairing { steps, lambda, weights }))
        };
        let refused: [(&str, Change); 8] = [
            ("threads", |s| s.threads = Some(0)),
            ("pixel_error", |s| s.levels.pixel_error = f32::NAN),
            ("size", |s| s.flight.size = [15, 720]),
            ("fov", |s| s.flight.fov_y_rad = 3.1),
            ("frames", |s| s.flight.frames = Frames::Count(0)),
            ("speed", |s| s.flight.frames = Frames::Speed { mm_per_s: f64::NAN, fps: 25.0 }),
            ("fps", |s| s.flight.frames = Frames::Speed { mm_per_s: 1.0, fps: 0.0 }),
            ("leak_control", |s| s.lumen.leak_control = true),
        ];
        for (name, change) in refused {
            let mut settings = Settings::default();
            change(&mut settings);
            assert_eq!(settings.check().map_err(|e| e.name), Err(name));
        }
        let mut settings = Settings::default();
        settings.wall.smoothing = smoothing(20_000, 0.5);
        assert_eq!(settings.check().unwrap_err().to_string(), "smooth 20000: 0 to 10000 steps");
        settings.wall.smoothing = smoothing(20, 1.0);
        assert_eq!(settings.check().unwrap_err().name, "lambda");
        settings.wall.smoothing = None;
        settings.lumen.organ =
            Some(OrganOptions { organ: Organ::Airway, tagged: true, thin: true });
        assert_eq!(settings.check().unwrap_err().name, "tagged");
        settings.lumen.all_components = true;
        assert_eq!(settings.check().unwrap_err().name, "organ");
    }
}
