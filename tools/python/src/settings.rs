//! Settings of a session from a dictionary. Names and meanings are the command line's, with
//! underscores; `None` is as good as a setting that is not there.

use std::f32::consts::PI;
use std::path::PathBuf;

use glam::{DVec3, UVec3};
use intima::centerline::Loops;
use intima::device::DeviceChoice;
use intima::flight::{CameraPath, FOV_DEG, Frames, MAX_FRAMES};
use intima::formats::{Facing, ReadOptions};
use intima::lod::vds::Scheme;
use intima::lumen::IntensitySelection;
use intima::mesh::Metric;
use intima::organ::{Organ, OrganOptions};
use intima::render::View;
use intima::session::{
    CenterlineSettings, EndPoint, FlightRoute, FlightSettings, LevelSettings, Lod, LumenSettings, Mode,
    Seed, Settings, WallMethod, WallSettings,
};
use intima::surface::{Fairing, Smoothing, Weights};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::error::argument;

/// Settings of a session with what reading its files needs.
pub struct Given {
    /// Settings of the engine.
    pub settings: Settings,
    /// Options for reading a file.
    pub read: ReadOptions,
}

/// Settings as they were given, less those that were taken.
struct Remaining<'py>(Bound<'py, PyDict>);

impl<'py> Remaining<'py> {
    /// Takes a setting.
    fn take<T>(&self, name: &str) -> PyResult<Option<T>>
    where
        T: for<'a> FromPyObject<'a, 'py, Error = PyErr>,
    {
        let Some(value) = self.0.get_item(name)? else { return Ok(None) };
        self.0.del_item(name)?;
        if value.is_none() {
            return Ok(None);
        }
        let refused = |e: PyErr| argument(format!("{name}={value}: {}", e.value(value.py())));
        value.extract().map(Some).map_err(refused)
    }

    fn flag(&self, name: &str, default: bool) -> PyResult<bool> {
        Ok(self.take(name)?.unwrap_or(default))
    }

    /// Takes a word of a few.
    fn word<T: Copy>(&self, name: &str, words: &[(&str, T)]) -> PyResult<Option<T>> {
        let Some(given) = self.take::<String>(name)? else { return Ok(None) };
        choice(name, &given, words).map(Some)
    }

    fn point(&self, name: &str) -> PyResult<Option<DVec3>> {
        let point = self.take::<[f64; 3]>(name)?.map(DVec3::from);
        match point {
            Some(p) if !p.is_finite() => Err(argument(format!("{name}={p}: not finite"))),
            point => Ok(point),
        }
    }

    /// Refuses what is left: nobody knows it.
    fn finish(self) -> PyResult<()> {
        match self.0.keys().iter().next() {
            Some(name) => Err(argument(format!("there is no setting `{name}`"))),
            None => Ok(()),
        }
    }
}

/// Value of a word.
pub fn choice<T: Copy>(name: &str, given: &str, words: &[(&str, T)]) -> PyResult<T> {
    words.iter().find(|(word, _)| *word == given).map(|(_, value)| *value).ok_or_else(|| {
        let all: Vec<_> = words.iter().map(|(word, _)| *word).collect();
        argument(format!("{name}=`{given}`: one of {}", all.join(", ")))
    })
}

/// Cost of a collapse by its name.
pub const METRICS: [(&str, Metric); 3] =
    [("qem", Metric::Qem), ("normal-qem", Metric::NormalQem), ("paper", Metric::Paper)];

impl Given {
    /// Reads all settings.
    ///
    /// # Errors
    /// The first that is unknown or cannot be.
    pub fn new(settings: &Bound<'_, PyDict>) -> PyResult<Self> {
        let given = Remaining(settings.copy()?);
        let device = given.take::<String>("device")?;
        let device = device.map(|d| d.parse::<DeviceChoice>().map_err(argument)).transpose()?;
        let modes = [("default", Mode::Default), ("paper", Mode::Paper)];
        let fps = given.take("fps")?.unwrap_or(25.0);
        if !(fps > 0.0 && fps <= 1000.0) {
            return Err(argument(format!("fps={fps}: above 0, at most 1000")));
        }
        let threads: Option<usize> = given.take("threads")?;
        if threads.is_some_and(|n| !(1..=1024).contains(&n)) {
            return Err(argument("threads: 1 to 1024".into()));
        }
        let flight = flight(&given, fps)?;
        let mut centerline = centerline(&given)?;
        centerline.tree |= flight.route != FlightRoute::Trunk;
        let settings = Settings {
            mode: given.word("mode", &modes)?.unwrap_or_default(),
            device: device.unwrap_or_default(),
            threads,
            max_memory_mb: given.take("max_memory")?,
            lumen: lumen(&given)?,
            centerline,
            wall: wall(&given)?,
            levels: levels(&given)?,
            flight,
            ..Settings::default()
        };
        let read = read(&given)?;
        given.finish()?;
        Ok(Self { settings, read })
    }
}

fn read(given: &Remaining<'_>) -> PyResult<ReadOptions> {
    Ok(ReadOptions {
        series: given.take("series")?,
        volume: given.take("volume")?,
        segments: given.take("segment")?.unwrap_or_default(),
        fill_gaps: given.flag("fill_gaps", false)?,
        allow_burned_in: given.flag("allow_burned_in", false)?,
        ..ReadOptions::default()
    })
}

fn lumen(given: &Remaining<'_>) -> PyResult<LumenSettings> {
    let organs = Organ::ALL.map(|organ| (organ.name(), organ));
    let organ = given.word("organ", &organs)?;
    let tagged = given.flag("tagged", false)?;
    let thin = given.flag("thin_bronchi", true)?;
    if tagged && organ != Some(Organ::Colon) {
        return Err(argument("tagged needs organ=\"colon\"".into()));
    }
    let labels = given.take::<Vec<i64>>("labels")?.map(IntensitySelection::Labels);
    let range = given.take::<(Option<f64>, Option<f64>)>("threshold")?;
    let select = match (labels, range) {
        (Some(_), Some(_)) => {
            return Err(argument("labels and threshold are two choices of the same thing".into()));
        }
        (labels, None) => labels,
        (None, Some(range)) => Some(threshold(range)?),
    };
    let seed = seed(given)?;
    let leak_control = given.flag("leak_control", false)?;
    if leak_control && seed.is_none() {
        return Err(argument("leak_control needs seed or seed_mm".into()));
    }
    let all_components = given.flag("all_components", false)?;
    let is_chosen = select.is_some() || seed.is_some() || all_components;
    if organ.is_some() && is_chosen {
        return Err(argument("organ chooses threshold, labels, seed and components itself".into()));
    }
    let walls = [
        ("auto", WallMethod::Auto),
        ("field", WallMethod::Field),
        ("relaxed", WallMethod::Relaxed),
        ("exact", WallMethod::Exact),
    ];
    Ok(LumenSettings {
        organ: organ.map(|organ| OrganOptions { organ, tagged, thin }),
        select,
        seed,
        all_components,
        fill: given.flag("fill", true)?,
        leak_control,
        wall: given.word("wall", &walls)?.unwrap_or_default(),
    })
}

/// A range, inclusive; `None` is an open end.
fn threshold((lo, hi): (Option<f64>, Option<f64>)) -> PyResult<IntensitySelection> {
    let (low, high) = (lo.unwrap_or(f64::NEG_INFINITY), hi.unwrap_or(f64::INFINITY));
    match low <= high && (low.is_finite() || high.is_finite()) {
        true => Ok(IntensitySelection::Range { lo: low, hi: high }),
        false => Err(argument(format!("threshold=({low}, {high}): the lower end, then the upper"))),
    }
}

/// A voxel in the array's order, or a point.
fn seed(given: &Remaining<'_>) -> PyResult<Option<Seed>> {
    match (given.take::<[i64; 3]>("seed")?, given.point("seed_mm")?) {
        (Some(_), Some(_)) => {
            Err(argument("seed and seed_mm are two choices of the same thing".into()))
        }
        (None, point) => Ok(point.map(Seed::Point)),
        (Some([z, y, x]), None) => {
            // A negative index is no voxel; the engine names the seed that is outside.
            let [x, y, z] = [x, y, z].map(|n| u32::try_from(n).unwrap_or(u32::MAX));
            Ok(Some(Seed::Voxel(UVec3::new(x, y, z))))
        }
    }
}

fn centerline(given: &Remaining<'_>) -> PyResult<CenterlineSettings> {
    let loops = [("keep", Loops::Keep), ("cut", Loops::Cut)];
    Ok(CenterlineSettings {
        from: given.point("from_")?.map(EndPoint::Point),
        to: given.point("to")?.map(EndPoint::Point),
        tree: given.flag("tree", false)?,
        loops: given.word("loops", &loops)?.unwrap_or_default(),
    })
}

fn wall(given: &Remaining<'_>) -> PyResult<WallSettings> {
    let sources = [("grey", false), ("mask", true)];
    let facing = [("in", Facing::In), ("out", Facing::Out)];
    let base_faces: Option<usize> = given.take("decimate")?;
    if base_faces.is_some_and(|n| n < 4) {
        return Err(argument("decimate: at least 4 faces".into()));
    }
    Ok(WallSettings {
        from_mask: given.word("surface_from", &sources)?.unwrap_or(false),
        smoothing: smoothing(given)?,
        open_ends: given.flag("open_ends", false)?,
        base_faces,
        facing: given.word("facing", &facing)?.unwrap_or_default(),
    })
}

fn smoothing(given: &Remaining<'_>) -> PyResult<Option<Smoothing>> {
    let weights = [("uniform", Weights::Uniform), ("inverse-distance", Weights::InverseDistance)];
    let steps: Option<u32> = given.take("smooth")?;
    let lambda: Option<f32> = given.take("lambda_")?;
    let weights = given.word("weights", &weights)?;
    if steps.is_none() && lambda.is_none() && weights.is_none() {
        return Ok(None);
    }
    let paper = Fairing::PAPER;
    let (steps, lambda) = (steps.unwrap_or(paper.steps), lambda.unwrap_or(paper.lambda));
    if steps > 10_000 {
        return Err(argument(format!("smooth={steps}: 0 to 10000")));
    }
    if !(lambda > 0.0 && lambda < 1.0) {
        return Err(argument(format!("lambda_={lambda}: between 0 and 1")));
    }
    let weights = weights.unwrap_or(paper.weights);
    Ok(Some(Smoothing::Steps(Fairing { steps, lambda, weights })))
}

fn levels(given: &Remaining<'_>) -> PyResult<LevelSettings> {
    let methods = [
        ("auto", Lod::Auto),
        ("vds", Lod::Vds),
        ("culled", Lod::Culled),
        ("off", Lod::Off),
    ];
    let schemes = [
        ("1-to-4", Scheme::OneToFour),
        ("butterfly", Scheme::Butterfly),
        ("sqrt3", Scheme::Sqrt3),
        ("4-8", Scheme::FourEight),
    ];
    let pixel_error = given.take("pixel_error")?.unwrap_or(1.0);
    if !(0.01..=100.0).contains(&pixel_error) {
        return Err(argument(format!("pixel_error={pixel_error}: 0.01 to 100 pixels")));
    }
    let lod = given.word("lod", &methods)?.unwrap_or_default();
    let scheme = given.word("scheme", &schemes)?;
    if scheme.is_some() && lod != Lod::Vds {
        return Err(argument("scheme: of lod=\"vds\" only".into()));
    }
    Ok(LevelSettings { lod, scheme: scheme.unwrap_or_default(), pixel_error })
}

fn flight(given: &Remaining<'_>, fps: f64) -> PyResult<FlightSettings> {
    let views = [
        ("inside", View::Inside),
        ("overview", View::Overview),
        ("split", View::Split),
        ("cube", View::Cube),
        ("panorama", View::Panorama),
    ];
    let count: Option<usize> = given.take("frames")?;
    if count.is_some_and(|n| !(1..=MAX_FRAMES).contains(&n)) {
        return Err(argument(format!("frames: 1 to {MAX_FRAMES}")));
    }
    let speed: Option<f64> = given.take("speed")?;
    let frames = match (count, speed) {
        (Some(_), Some(_)) => {
            return Err(argument("frames and speed are two choices of the same thing".into()));
        }
        (_, Some(mm_per_s)) if mm_per_s > 0.0 && mm_per_s <= 10_000.0 => {
            Frames::Speed { mm_per_s, fps }
        }
        (_, Some(speed)) => {
            return Err(argument(format!("speed={speed}: above 0, at most 10000 mm/s")));
        }
        (count, None) => Frames::Count(count.unwrap_or(120)),
    };
    let size = given.take::<[u32; 2]>("size")?.unwrap_or([1280, 720]);
    if !size.iter().all(|side| (16..=8192).contains(side)) {
        return Err(argument(format!("size={size:?}: width and height, 16 to 8192 each")));
    }
    let fov: f32 = given.take("fov")?.unwrap_or(90.0);
    if !FOV_DEG.contains(&f64::from(fov)) {
        return Err(argument(format!(
            "fov={fov}: {} to {} degrees",
            FOV_DEG.start(),
            FOV_DEG.end()
        )));
    }
    let samples = given.take::<u32>("msaa")?.unwrap_or(4);
    if ![1, 4].contains(&samples) {
        return Err(argument(format!("msaa={samples}: 1 or 4")));
    }
    let script = given.take::<PathBuf>("path")?.map(|path| read_script(&path)).transpose()?;
    Ok(FlightSettings {
        frames,
        size,
        view: given.word("view", &views)?.unwrap_or_default(),
        fov_y_rad: fov * PI / 180.0,
        samples,
        reverse: given.flag("reverse", false)?,
        route: route(given)?,
        script,
        script_frames: count,
    })
}

/// Branches that are flown: `trunk`, `all` or `leaf:N`.
fn route(given: &Remaining<'_>) -> PyResult<FlightRoute> {
    let Some(text) = given.take::<String>("route")? else { return Ok(FlightRoute::Trunk) };
    let leaf = text.strip_prefix("leaf:").and_then(|n| n.parse().ok());
    match (text.as_str(), leaf) {
        ("trunk", _) => Ok(FlightRoute::Trunk),
        ("all", _) => Ok(FlightRoute::All),
        (_, Some(branch)) => Ok(FlightRoute::Leaf(branch)),
        _ => Err(argument(format!(
            "route=`{text}`: trunk, all, or leaf:N with the number of a branch"
        ))),
    }
}

fn read_script(path: &std::path::Path) -> PyResult<CameraPath> {
    let bytes = std::fs::read(path)?;
    CameraPath::parse(&bytes).map_err(|e| crate::error::input(format!("{}: {e}", path.display())))
}
