//! Settings of a session from a dictionary. Names and meanings are the command line's, with
//! underscores; `None` is as good as a setting that is not there.

use std::path::PathBuf;

use glam::{DVec3, UVec3};
use intima::device::DeviceChoice;
use intima::flight::{CameraPath, Frames};
use intima::formats::ReadOptions;
use intima::lumen::IntensitySelection;
use intima::organ::OrganOptions;
use intima::session::{
    Antialiasing, CenterlineSettings, EndPoint, FlightRoute, FlightSettings, LevelSettings,
    LumenSettings, Seed, SettingError, Settings, WallSettings,
};
use intima::surface::{Fairing, Smoothing};
use pyo3::prelude::*;
use pyo3::types::PyDict;
use serde::Deserialize;
use serde::de::IntoDeserializer as _;

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

    /// Takes a word of those that the engine knows.
    fn word<T: for<'de> Deserialize<'de>>(&self, name: &str) -> PyResult<Option<T>> {
        self.take::<String>(name)?.map(|given| word(name, &given)).transpose()
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

/// Value of a word, by the engine's names.
pub fn word<T: for<'de> Deserialize<'de>>(name: &str, given: &str) -> PyResult<T> {
    let deserializer: serde::de::value::StrDeserializer<'_, serde::de::value::Error> =
        given.into_deserializer();
    T::deserialize(deserializer).map_err(|e| argument(format!("{name}: {e}")))
}

/// Refusal of a setting, by the name it has here.
pub fn refused(e: &SettingError) -> PyErr {
    let name = if e.name == "lambda" { "lambda_" } else { e.name };
    argument(format!("{name}={}: {}", e.value, e.allowed))
}

impl Given {
    /// Reads all settings.
    ///
    /// # Errors
    /// The first that is unknown or cannot be.
    pub fn new(settings: &Bound<'_, PyDict>) -> PyResult<Self> {
        let given = Remaining(settings.copy()?);
        let device = given.take::<String>("device")?;
        let device = device.map(|d| d.parse::<DeviceChoice>().map_err(argument)).transpose()?;
        let flight = flight(&given)?;
        let mut centerline = centerline(&given)?;
        centerline.tree |= flight.route != FlightRoute::Trunk;
        let settings = Settings {
            mode: given.word("mode")?.unwrap_or_default(),
            device: device.unwrap_or_default(),
            threads: given.take("threads")?,
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
        settings.check().map_err(|e| refused(&e))?;
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
    let tagged = given.flag("tagged", false)?;
    let thin = given.flag("thin_bronchi", true)?;
    let organ = given.word("organ")?.map(|organ| OrganOptions { organ, tagged, thin });
    if tagged && organ.is_none() {
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
    Ok(LumenSettings {
        organ,
        select,
        seed: seed(given)?,
        all_components: given.flag("all_components", false)?,
        fill: given.flag("fill", true)?,
        leak_control: given.flag("leak_control", false)?,
        wall: given.word("wall")?.unwrap_or_default(),
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
    Ok(CenterlineSettings {
        from: given.point("from_")?.map(EndPoint::Point),
        to: given.point("to")?.map(EndPoint::Point),
        tree: given.flag("tree", false)?,
        loops: given.word("loops")?.unwrap_or_default(),
    })
}

fn wall(given: &Remaining<'_>) -> PyResult<WallSettings> {
    let source = given.take::<String>("surface_from")?;
    let from_mask = match source.as_deref() {
        None | Some("grey") => false,
        Some("mask") => true,
        Some(other) => return Err(argument(format!("surface_from=`{other}`: grey or mask"))),
    };
    Ok(WallSettings {
        from_mask,
        smoothing: smoothing(given)?,
        open_ends: given.flag("open_ends", false)?,
        base_faces: given.take("decimate")?,
        facing: given.word("facing")?.unwrap_or_default(),
    })
}

fn smoothing(given: &Remaining<'_>) -> PyResult<Option<Smoothing>> {
    let steps: Option<u32> = given.take("smooth")?;
    let lambda: Option<f32> = given.take("lambda_")?;
    let weights = given.word("weights")?;
    if steps.is_none() && lambda.is_none() && weights.is_none() {
        return Ok(None);
    }
    let paper = Fairing::PAPER;
    Ok(Some(Smoothing::Steps(Fairing {
        steps: steps.unwrap_or(paper.steps),
        lambda: lambda.unwrap_or(paper.lambda),
        weights: weights.unwrap_or(paper.weights),
    })))
}

fn levels(given: &Remaining<'_>) -> PyResult<LevelSettings> {
    Ok(LevelSettings {
        lod: given.word("lod")?.unwrap_or_default(),
        scheme: given.word("scheme")?.unwrap_or_default(),
        pixel_error: given.take("pixel_error")?.unwrap_or(1.0),
    })
}

fn flight(given: &Remaining<'_>) -> PyResult<FlightSettings> {
    let fps = given.take("fps")?.unwrap_or(25.0);
    let count: Option<usize> = given.take("frames")?;
    let frames = match (count, given.take("speed")?) {
        (Some(_), Some(_)) => {
            return Err(argument("frames and speed are two choices of the same thing".into()));
        }
        (_, Some(mm_per_s)) => Frames::Speed { mm_per_s, fps },
        (count, None) => Frames::Count(count.unwrap_or(120)),
    };
    let script = given.take::<PathBuf>("path")?.map(|path| read_script(&path)).transpose()?;
    Ok(FlightSettings {
        frames,
        size: given.take("size")?.unwrap_or([1280, 720]),
        view: given.word("view")?.unwrap_or_default(),
        behind_mm: given.take("behind")?,
        local_contrast: given.take("local_contrast")?.unwrap_or(0.0),
        fov_y_rad: given.take::<f32>("fov")?.unwrap_or(90.0).to_radians(),
        antialiasing: antialiasing(given)?.unwrap_or_default(),
        reverse: given.flag("reverse", false)?,
        route: route(given)?,
        script,
        script_frames: count,
    })
}

/// A word, or a number of samples.
fn antialiasing(given: &Remaining<'_>) -> PyResult<Option<Antialiasing>> {
    let samples = given.0.get_item("msaa")?.and_then(|value| value.extract::<u32>().ok());
    match samples {
        Some(samples) => {
            given.0.del_item("msaa")?;
            word("msaa", &samples.to_string()).map(Some)
        }
        None => given.word("msaa"),
    }
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
