//! `Session`: a volume, settings and everything that is made of them.

use std::path::PathBuf;
use std::sync::{Arc, PoisonError, RwLock};

use intima::formats::{VideoWriter, to_json};
use intima::geometry::Centerline;
use intima::report_page::ReportPage;
use intima::session::{
    self as engine, CenterlineReport, LumenReport, OrganReport, Recording, RunOutcome,
    SessionError, Source, VolumeSource, WallReport, read_any_volume, written_mesh,
};
use intima::task::CancelToken;
use intima::volume::Volume;
use numpy::{IntoPyArray, PyArray1};
use pyo3::prelude::*;
use pyo3::types::PyDict;

use crate::array::{self, ArrayInput, rows};
use crate::call::call;
use crate::error;
use crate::frames::{Frames, write_video};
use crate::settings::Given;

/// A volume: a file or folder, or an array.
#[derive(FromPyObject)]
pub enum VolumeInput {
    /// File or DICOM folder.
    Path(PathBuf),
    /// Array with its geometry.
    Array(ArrayInput),
}

impl VolumeInput {
    fn source(self, given: &Given) -> PyResult<VolumeSource> {
        Ok(match self {
            Self::Path(path) => VolumeSource::File { path, options: given.read.clone() },
            Self::Array(array) => VolumeSource::Memory(Arc::new(array.volume()?)),
        })
    }
}

/// The process that made an object. A forked child has the object's memory but none of its
/// threads, and would wait for them for ever.
#[derive(Clone, Copy)]
pub struct Process(u32);

impl Process {
    /// This process.
    pub fn this() -> Self {
        Self(std::process::id())
    }

    /// Refuses another process than the one that made the object.
    pub fn check(self) -> PyResult<()> {
        if std::process::id() == self.0 {
            return Ok(());
        }
        Err(error::failure(format!(
            "this object was made in process {}; a forked process has none of its threads: make \
             one in each process, or start processes by `spawn`",
            self.0
        )))
    }
}

/// A volume with settings; products are computed when they are asked for, and kept.
#[pyclass(frozen, module = "intima._intima")]
pub struct Session {
    inner: RwLock<engine::Session>,
    cancel: CancelToken,
    process: Process,
}

impl Session {
    /// Runs work of the session; see [`call`].
    fn run<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&engine::Session) -> Result<T, SessionError> + Send,
    ) -> PyResult<T> {
        self.process.check()?;
        call(py, &self.cancel, || work(&self.inner.read().unwrap_or_else(PoisonError::into_inner)))
    }
}

fn to_text(value: &impl serde::Serialize) -> Result<String, SessionError> {
    to_json(value).map_err(|e| SessionError::System(e.to_string()))
}

#[pymethods]
impl Session {
    #[new]
    #[pyo3(signature = (image, mask, settings))]
    fn new(
        image: Option<VolumeInput>,
        mask: Option<VolumeInput>,
        settings: &Bound<'_, PyDict>,
    ) -> PyResult<Self> {
        let given = Given::new(settings)?;
        let image = image.map(|image| image.source(&given)).transpose()?;
        let source = match (image, mask) {
            (image, Some(mask)) => Source::Mask { mask: mask.source(&given)?, image },
            (Some(image), None) => Source::Image(image),
            (None, None) => return Err(error::argument("a volume or a mask is needed".into())),
        };
        let inner = engine::Session::new(source, given.settings).map_err(error::session)?;
        let cancel = inner.cancel_token();
        Ok(Self { inner: RwLock::new(inner), cancel, process: Process::this() })
    }

    /// Changes the settings and forgets what they would make otherwise.
    fn apply(&self, py: Python<'_>, settings: &Bound<'_, PyDict>) -> PyResult<()> {
        self.process.check()?;
        let given = Given::new(settings)?;
        let apply = || {
            let mut inner = self.inner.write().unwrap_or_else(PoisonError::into_inner);
            inner.apply(given.settings)
        };
        py.detach(apply).map_err(error::session)
    }

    /// Cancels the work of all threads in this session; it ends with `intima.Cancelled`.
    fn cancel(&self) {
        self.cancel.cancel();
    }

    /// Lets the session go on after `cancel`.
    fn resume(&self) {
        self.cancel.reset();
    }

    /// Stage, share done and seconds of the present work.
    fn progress(&self, py: Python<'_>) -> (&'static str, f32, f64) {
        let read = || self.inner.read().unwrap_or_else(PoisonError::into_inner).progress();
        let progress = py.detach(read);
        (progress.stage, progress.share, progress.elapsed.as_secs_f64())
    }

    /// Notes on the products so far.
    fn warnings(&self, py: Python<'_>) -> Vec<String> {
        py.detach(|| self.inner.read().unwrap_or_else(PoisonError::into_inner).warnings())
    }

    /// Name of the device that computes.
    fn device(&self, py: Python<'_>) -> PyResult<String> {
        self.run(py, engine::Session::device_name)
    }

    /// Shape, spacing, origin and direction of all products.
    fn geometry<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let grid = self.run(py, |s| Ok(s.volume()?.grid.as_stored()))?;
        array::geometry(py, &grid)
    }

    /// The lumen: classes of its voxels and what choosing it found.
    fn lumen<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (classes, grid, report, notes) = self.run(py, |s| {
            let found = s.lumen()?;
            let organ = OrganReport::of(&found);
            let classes = s.install(|| found.lumen.classes());
            let report = serde_json::json!({
                "lumen": LumenReport::of(&found),
                "wall": WallReport::of(&found),
                "organ": organ,
            });
            Ok((classes, found.lumen.stored_grid(), to_text(&report)?, found.notes.clone()))
        })?;
        let out = array::geometry(py, &grid)?;
        out.set_item("classes", array::dense(py, classes, &grid)?)?;
        out.set_item("report", report)?;
        out.set_item("notes", notes)?;
        Ok(out)
    }

    /// Exact distance to the nearest voxel outside the lumen, mm; 0 outside.
    fn distance<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyAny>> {
        let (field, grid) = self.run(py, |s| {
            let (segmented, distance) = (s.lumen()?, s.distance()?);
            let lumen = &segmented.lumen;
            Ok((s.install(|| lumen.dense(&distance, 0.0f32)), lumen.stored_grid()))
        })?;
        array::dense(py, field, &grid)
    }

    /// The wall with smoothed normals, or with few faces.
    fn wall<'py>(&self, py: Python<'py>, base: bool) -> PyResult<Bound<'py, PyDict>> {
        let (mesh, outward) = self.run(py, |s| {
            let settings = &s.settings().wall;
            let outward = settings.facing == intima::formats::Facing::Out;
            let mesh = match base {
                true => written_mesh(&*s.base()?, settings.open_ends).into_owned(),
                false => written_mesh(&s.wall()?.mesh, settings.open_ends).into_owned(),
            };
            Ok((mesh, outward))
        })?;
        array::mesh(py, &mesh, outward)
    }

    /// Evidence of the wall at each vertex: 0 profile, 1 sheet, 2 limit of growth; `None` where it
    /// does not follow grey values.
    fn evidence<'py>(&self, py: Python<'py>) -> PyResult<Option<Bound<'py, PyArray1<u8>>>> {
        let found = self.run(py, |s| Ok(s.evidence()?))?;
        let codes = found.as_ref().as_ref().map(|all| all.iter().map(|e| *e as u8).collect());
        Ok(codes.map(|codes: Vec<u8>| codes.into_pyarray(py)))
    }

    /// Path or tree: points, radii, attachments.
    fn centerline<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let (line, report) = self.run(py, |s| {
            let (centered, found) = (s.centerline()?, s.lumen()?);
            let tree = s.tree()?;
            let report = CenterlineReport { tree, ..CenterlineReport::of(&centered, &found) };
            Ok((centered.line.clone(), to_text(&report)?))
        })?;
        let out = line_arrays(py, &line)?;
        out.set_item("report", report)?;
        Ok(out)
    }

    /// All branches with their loops as `intima.graph/1`, in JSON.
    fn graph(&self, py: Python<'_>) -> PyResult<String> {
        self.run(py, |s| to_text(&s.graph()?))
    }

    /// Poses of the flight.
    fn flight<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let flight = self.run(py, engine::Session::flight)?;
        let out = PyDict::new(py);
        let positions = flight.poses.iter().map(|p| p.position_mm.to_array()).collect();
        let rotations: Vec<Vec<f32>> =
            flight.poses.iter().map(|p| p.rotation.to_array().to_vec()).collect();
        out.set_item("positions", rows::<f32>(py, positions)?)?;
        out.set_item("rotations", numpy::PyArray2::from_vec2(py, &rotations)?)?;
        out.set_item("seconds", PyArray1::from_slice(py, &flight.seconds))?;
        out.set_item("near_mm", PyArray1::from_slice(py, &flight.near_mm))?;
        out.set_item("clearance_mm", PyArray1::from_slice(py, &flight.clearance_mm))?;
        out.set_item("fov", f64::from(flight.fov_y_rad).to_degrees())?;
        out.set_item("aspect", flight.aspect)?;
        Ok(out)
    }

    /// Share of the wall that the flight sees, and which faces.
    fn coverage<'py>(&self, py: Python<'py>) -> PyResult<Bound<'py, PyDict>> {
        let coverage = self.run(py, engine::Session::coverage)?;
        let out = PyDict::new(py);
        out.set_item("one_way_fraction", coverage.one_way_fraction)?;
        out.set_item("both_ways_fraction", coverage.both_ways_fraction)?;
        out.set_item("area_mm2", coverage.area_mm2)?;
        out.set_item("seen_one_way", PyArray1::from_slice(py, &coverage.seen_one_way))?;
        out.set_item("seen_both_ways", PyArray1::from_slice(py, &coverage.seen_both_ways))?;
        Ok(out)
    }

    /// The report of all products so far, in JSON.
    fn report(&self, py: Python<'_>) -> PyResult<String> {
        self.run(py, |s| to_text(&s.report(None)?))
    }

    /// The frames of the flight, each drawn when it is asked for.
    fn frames(&self, py: Python<'_>) -> PyResult<Frames> {
        let stream = self.run(py, engine::Session::frames)?;
        Ok(Frames::new(stream, self.cancel.clone(), self.process))
    }

    /// Draws all frames into a video; their number.
    fn video(&self, py: Python<'_>, path: PathBuf, fps: f64) -> PyResult<usize> {
        self.run(py, |s| {
            VideoWriter::check(&path, fps)?;
            write_video(s.frames()?, &path, fps)
        })
    }

    /// Draws all frames into a folder of PNG files; their number.
    fn record(&self, py: Python<'_>, folder: PathBuf) -> PyResult<usize> {
        let recording = Recording { frames: folder, ..Recording::default() };
        self.run(py, |s| Ok(s.record(&recording)?.count()))
    }

    /// Writes everything into a folder, as `intima run` does; the report in JSON.
    fn run_to_folder(
        &self,
        py: Python<'_>,
        folder: PathBuf,
        video: Option<PathBuf>,
        fps: f64,
    ) -> PyResult<String> {
        let frames = folder.join("frames");
        let recording = Recording {
            frames,
            video: video.map(|v| (v, fps)),
            pictures: true,
            ..Recording::default()
        };
        self.run(py, |s| {
            // Before files of an earlier run are removed.
            if let Some((video, fps)) = &recording.video {
                VideoWriter::check(video, *fps)?;
            }
            let RunOutcome { report, pictures, stream: _stream } =
                s.run_to_folder(&folder, &recording)?;
            let (of_report, pictures) = (Some(&report), pictures.as_ref());
            let page = ReportPage { report: of_report, pictures, ..ReportPage::default() };
            page.write(&folder).map_err(SessionError::from)?;
            s.write_report(&folder, &report)?;
            to_text(&report)
        })
    }
}

/// Points of all branches one after the other, and where they begin and are attached.
fn line_arrays<'py>(py: Python<'py>, line: &Centerline) -> PyResult<Bound<'py, PyDict>> {
    let out = PyDict::new(py);
    let points = || line.branches.iter().flat_map(|b| &b.points);
    out.set_item("points", rows::<f64>(py, points().map(|p| p.position_mm.to_array()).collect())?)?;
    let radius: Vec<f64> = points().map(|p| p.radius_mm).collect();
    let abscissa: Vec<f64> = points().map(|p| p.abscissa_mm).collect();
    out.set_item("radius", radius.into_pyarray(py))?;
    out.set_item("abscissa", abscissa.into_pyarray(py))?;
    let counts: Vec<usize> = line.branches.iter().map(|b| b.points.len()).collect();
    out.set_item("counts", counts)?;
    let starts: Vec<_> =
        line.branches.iter().map(|b| b.start.map(|a| (a.branch, a.point))).collect();
    let ends: Vec<_> = line.branches.iter().map(|b| b.end.map(|a| (a.branch, a.point))).collect();
    out.set_item("starts", starts)?;
    out.set_item("ends", ends)?;
    Ok(out)
}

/// Reads a volume: its samples as an array of z, y, x in their stored type, with geometry and
/// rescale.
#[pyfunction]
pub fn read<'py>(
    py: Python<'py>,
    path: PathBuf,
    settings: &Bound<'_, PyDict>,
) -> PyResult<Bound<'py, PyDict>> {
    let given = Given::new(settings)?;
    let (limit, options) = (given.settings.max_memory_mb, given.read);
    let source = VolumeSource::File { path, options };
    let work = || read_any_volume(&source, limit);
    let volume = call(py, &CancelToken::default(), work)?;
    let volume: Volume = Arc::try_unwrap(volume).unwrap_or_else(|shared| (*shared).clone());
    let out = array::geometry(py, &volume.grid)?;
    out.set_item("rescale", (volume.rescale.slope, volume.rescale.intercept))?;
    out.set_item("array", array::samples(py, volume)?)?;
    Ok(out)
}
