//! Frames of the flight, drawn one after the other on request while the device draws the next.

use std::sync::{Arc, Mutex};
use std::time::Instant;

use glam::Vec3;

use super::levels::{LodReport, WallForm};
use super::pictures::KeptFrames;
use super::{
    Antialiasing, Clock, FlightRoute, FlightSettings, FramesReport, OpenDevice, Product, Session,
    SessionError, locked, present,
};
use crate::behind::BehindWall;
use crate::device::{Device, DeviceError};
use crate::flight::Flight;
use crate::geometry::{Centerline, CenterlinePoint, Pose};
use crate::render::{
    FrameSequence, FrameStats, Look, MeshHandle, PathHandle, PreparedMesh, RenderError, Renderer,
    Scene, Shot, Spares, TissueHandle, View,
};
use crate::task::CancelToken;
use crate::vk::{Choice, Gpu, VkError, return_freed_memory};

/// The renderer with the device it draws on: the one that computes or, where that is the CPU,
/// what Vulkan there is.
pub(super) struct Display {
    device: Arc<OpenDevice>,
    own: Mutex<Option<Gpu>>,
    /// Taken by what draws with it.
    pub(super) renderer: Mutex<Option<Renderer>>,
    pub(super) name: String,
}

impl Display {
    /// Does something on the device.
    ///
    /// # Errors
    /// Those of `work`, and of opening a device where the one that computes was given up.
    fn on_device<T, E: Into<SessionError>>(
        &self,
        work: impl FnOnce(&mut Gpu) -> Result<T, E>,
    ) -> Result<T, SessionError> {
        let mut own = locked(&self.own);
        if own.is_none() {
            match &mut *self.device.lock() {
                Device::Gpu(gpu) => return work(gpu).map_err(E::into),
                Device::Cpu => *own = Some(Gpu::open(Choice::Any).map_err(DeviceError::from)?),
            }
        }
        work(own.as_mut().expect("opened before")).map_err(E::into)
    }

    /// Opens the device that a renderer was made on again, unless another stage has done so.
    ///
    /// # Errors
    /// [`DeviceError`] if the device cannot be opened again.
    fn reopen(&self, renderer: &Renderer) -> Result<(), DeviceError> {
        let reopen = |gpu: &mut Gpu| -> Result<(), DeviceError> {
            if renderer.is_on(gpu) {
                *gpu = gpu.opened_anew()?;
            }
            Ok(())
        };
        let mut own = locked(&self.own);
        match (own.as_mut(), &mut *self.device.lock()) {
            (Some(gpu), _) => reopen(gpu),
            (None, Device::Gpu(gpu)) => reopen(gpu),
            (None, Device::Cpu) => Ok(()),
        }
    }

    /// Draws something with a renderer.
    ///
    /// # Errors
    /// Those of `work`; [`VkError::DeviceLost`] where the device that the renderer was made on is gone:
    /// a stage has lost it and opened another.
    pub(super) fn draw<T, E: Into<SessionError>>(
        &self,
        renderer: &mut Renderer,
        work: impl FnOnce(&mut Renderer, &mut Gpu) -> Result<T, E>,
    ) -> Result<T, SessionError> {
        self.on_device(|gpu| match renderer.is_on(gpu) {
            true => work(renderer, gpu).map_err(E::into),
            false => Err(RenderError::from(VkError::DeviceLost { during: "another stage" }).into()),
        })
    }
}

impl Session {
    pub(super) fn run_display(&self, clock: &mut Clock) -> Result<Display, SessionError> {
        let start = Instant::now();
        let device = present(&self.slots.device);
        // A device that computes may be at work now: its renderer is opened with the first frames.
        let display = if device.draws {
            let name = device.name.clone();
            Display { device, own: Mutex::new(None), renderer: Mutex::new(None), name }
        } else {
            let mut gpu = Gpu::open(Choice::Any).map_err(DeviceError::from)?;
            let name = gpu.info().name.clone();
            let renderer = Mutex::new(Some(self.new_renderer(&mut gpu)?));
            Display { device, own: Mutex::new(Some(gpu)), renderer, name }
        };
        let [width, height] = self.settings.flight.size;
        let pixels = u64::from(width) * u64::from(height);
        clock.record("renderer", &display.name, start, (pixels, "pixels"), Vec::new());
        Ok(display)
    }

    /// Products that a stream of frames needs.
    pub fn products_of_frames(&self) -> Vec<Product> {
        let mut products = vec![
            Product::ShownWall,
            Product::Shading,
            Product::Flight,
            Product::Display,
            Product::Levels,
        ];
        products.extend(self.settings.shows_tissue().then_some(Product::Behind));
        products
    }

    /// The frames of the flight, in order. Everything they need is computed first; each is drawn
    /// when it is asked for, with the next ones on their way.
    ///
    /// # Errors
    /// What the stages fail with; the renderer's.
    pub fn frames(&self) -> Result<FrameStream, SessionError> {
        self.frames_along(None)
    }

    /// As [`Session::frames`], of another flight along the same centerline, with its route.
    pub(super) fn frames_along(
        &self,
        other: Option<(FlightRoute, Arc<Flight>)>,
    ) -> Result<FrameStream, SessionError> {
        self.prepare(&self.products_of_frames())?;
        // Building levels took more memory than frames do.
        return_freed_memory();
        let drawn = present(&self.slots.shown_wall);
        let centered = self.centerline()?;
        let (route, flight) = match other {
            Some(other) => other,
            None => (self.settings.flight.route, self.flight()?),
        };
        let display = self.display()?;
        let s = &self.settings.flight;
        let mut renderer = self.take_renderer(&display)?;
        let mesh = drawn.mesh();
        let is_overview = matches!(s.view, View::Overview | View::Split);
        let shading = present(&self.slots.shading);
        let levels = self.levels()?;
        let whole = || PreparedMesh::shaded(mesh, Arc::clone(&shading));
        let wall = match &levels.form {
            WallForm::Whole => whole()?,
            WallForm::Culled(wall) => {
                PreparedMesh::culled(mesh, Arc::clone(&shading), Arc::clone(wall))?
            }
            WallForm::Refined(wall) => PreparedMesh::refined(Arc::clone(wall)),
            WallForm::Subdivided(wall) => {
                PreparedMesh::subdivided(Arc::clone(wall), shading.mean_radius_mm)
            }
        };
        let mut upload = |wall: &PreparedMesh| {
            display.draw(&mut renderer, |renderer, gpu| renderer.upload_prepared_mesh(gpu, wall))
        };
        let inside = upload(&wall)?;
        // An overview shows a mesh.
        let overview = match &levels.form {
            WallForm::Subdivided(_) => is_overview.then(|| upload(&whole()?)).transpose()?,
            _ => Some(inside),
        };
        let shows_tissue = self.settings.shows_tissue();
        let behind = shows_tissue.then(|| self.behind()).transpose()?;
        let mut upload = |wall: &BehindWall| {
            display.draw(&mut renderer, |renderer, gpu| renderer.upload_tissue(gpu, wall))
        };
        let tissue = behind.as_deref().map(&mut upload).transpose()?;
        let mut held = vec![inside];
        held.extend(overview.filter(|mesh| *mesh != inside));
        let look = Look { local_contrast: s.local_contrast, ..Look::default() };
        let mut scene = Scene { behind: tissue, look, ..Scene::with(inside, overview) };
        let pieces = self.flown_pieces(&centered.line, route)?;
        if is_overview && pieces.iter().any(|p| p.len() > 1) {
            let path = display.draw(&mut renderer, |r, gpu| r.upload_path(gpu, &pieces))?;
            scene.path = Some(path);
        }
        let shots = shots(&flight, s.view, &share_of_path(&pieces, &flight));
        let path = scene.path;
        Ok(FrameStream {
            size: s.size,
            spares: renderer.spares(),
            kept: KeptFrames::default(),
            renderer: Some(renderer),
            display,
            sequence: Some(FrameSequence::new(scene, shots)),
            held,
            path,
            tissue,
            flight,
            lod: levels.report.clone(),
            cancel: self.cancel.clone(),
            given: 0,
            reopenings: 0,
            started: Instant::now(),
            since: Instant::now(),
            figures: Figures::default(),
        })
    }

    /// The renderer of a display, or a new one while another stream has it.
    pub(super) fn take_renderer(&self, display: &Display) -> Result<Renderer, SessionError> {
        let taken = locked(&display.renderer).take();
        display.on_device(|gpu| match taken {
            Some(renderer) if renderer.is_on(gpu) => Ok(renderer),
            _ => self.new_renderer(gpu),
        })
    }

    fn new_renderer(&self, gpu: &mut Gpu) -> Result<Renderer, RenderError> {
        let FlightSettings { size: [width, height], antialiasing, .. } = self.settings.flight;
        match (antialiasing, gpu.info().is_real()) {
            (Antialiasing::Off, _) => Renderer::new(gpu, width, height, 1),
            (Antialiasing::Samples, _) | (Antialiasing::Auto, true) => {
                Renderer::new(gpu, width, height, 4)
            }
            (Antialiasing::Edges, _) | (Antialiasing::Auto, false) => {
                Renderer::with_smooth_edges(gpu, width, height)
            }
        }
    }

    /// The pieces of the path in the order and direction in which they are flown.
    pub(super) fn flown_pieces(
        &self,
        line: &Centerline,
        route: FlightRoute,
    ) -> Result<Vec<Vec<Vec3>>, SessionError> {
        let places = |p: &Vec<CenterlinePoint>| -> Vec<Vec3> {
            p.iter().map(|p| p.position_mm.as_vec3()).collect()
        };
        Ok(self.route_pieces(line, route)?.iter().map(places).collect())
    }

    /// The pieces of the path with their radii, in the order and direction in which they are flown.
    pub(super) fn route_pieces(
        &self,
        line: &Centerline,
        route: FlightRoute,
    ) -> Result<Vec<Vec<CenterlinePoint>>, SessionError> {
        let mut pieces = route.paths(line)?;
        if self.settings.flight.reverse {
            pieces.reverse();
            pieces.iter_mut().for_each(|p| p.reverse());
        }
        Ok(pieces)
    }

    /// The next frame of a stream that [`Session::frames_along`] has made of the same flight. A device
    /// that is lost meanwhile is opened again, at most [`MAX_REOPENINGS`] times, and draws on from the
    /// frame that was asked for.
    ///
    /// # Errors
    /// As [`FrameStream::next_frame`], and those of [`Session::frames_along`].
    pub(super) fn next_frame(
        &self,
        stream: &mut FrameStream,
        flight: &Option<(FlightRoute, Arc<Flight>)>,
    ) -> Result<Option<DrawnFrame>, SessionError> {
        loop {
            match stream.next_frame() {
                Err(e) if e.is_device_lost() && stream.reopenings < MAX_REOPENINGS => {
                    tracing::warn!("{e}; the device is opened again and draws on");
                    let renderer =
                        stream.renderer.as_ref().expect("held until the stream is dropped");
                    stream.display.reopen(renderer)?;
                    let mut anew = self.frames_along(flight.clone())?;
                    anew.take_over(stream);
                    *stream = anew;
                }
                next => return next,
            }
        }
    }

    /// Adds the drawing of a stream to the clock.
    pub(super) fn record_frames(&self, clock: &mut Clock, stream: &FrameStream) {
        let items = (stream.given as u64, "frames");
        clock.record("frames", &stream.display.name, stream.started, items, Vec::new());
    }
}

/// Number of times that a device that is lost while frames are drawn is opened again: a driver that
/// fails at one frame fails there again.
const MAX_REOPENINGS: u32 = 3;

/// A drawn frame.
#[derive(Clone, Debug, PartialEq)]
pub struct DrawnFrame {
    /// Index of the frame in the flight, from 0.
    pub index: usize,
    /// Columns and rows.
    pub size: [u32; 2],
    /// Eight bits each of red, green and blue; rows from the top.
    pub rgb: Vec<u8>,
    /// Statistics of the drawing.
    pub stats: FrameStats,
}

/// Figures of every frame given so far.
#[derive(Default)]
struct Figures {
    ms: Vec<f64>,
    stats: Vec<FrameStats>,
}

/// Frames of a flight, drawn as they are asked for. They depend on cameras alone, not on timing or
/// number of threads.
pub struct FrameStream {
    renderer: Option<Renderer>,
    display: Arc<Display>,
    sequence: Option<FrameSequence>,
    /// Meshes that the stream holds on the device.
    held: Vec<MeshHandle>,
    path: Option<PathHandle>,
    tissue: Option<TissueHandle>,
    flight: Arc<Flight>,
    size: [u32; 2],
    spares: Spares,
    lod: LodReport,
    /// Frames for the report.
    pub(super) kept: KeptFrames,
    cancel: CancelToken,
    given: usize,
    /// Number of times that the device was opened again.
    reopenings: u32,
    started: Instant,
    since: Instant,
    figures: Figures,
}

impl FrameStream {
    /// Goes on behind the last frame of a stream of the same flight, whose device was lost.
    fn take_over(&mut self, lost: &mut Self) {
        if let Some(sequence) = &mut self.sequence {
            sequence.skip(lost.given);
        }
        (self.given, self.reopenings) = (lost.given, lost.reopenings + 1);
        (self.started, self.since) = (lost.started, lost.since);
        self.figures = std::mem::take(&mut lost.figures);
        self.kept = std::mem::take(&mut lost.kept);
    }

    /// Frames of the whole flight.
    pub fn count(&self) -> usize {
        self.flight.poses.len()
    }

    /// Returns the pool for pictures that are not needed any more; it takes them from any thread.
    pub fn spares(&self) -> Spares {
        self.spares.clone()
    }

    /// Levels of detail, as they were when the stream was opened.
    pub fn lod(&self) -> &LodReport {
        &self.lod
    }

    /// The next frame; `None` after the last.
    ///
    /// # Errors
    /// The renderer's; [`SessionError::Cancelled`]. After an error there are no more frames.
    pub fn next_frame(&mut self) -> Result<Option<DrawnFrame>, SessionError> {
        if self.cancel.is_cancelled() {
            return Err(SessionError::Cancelled);
        }
        let display = Arc::clone(&self.display);
        let Some((sequence, renderer)) = self.sequence.as_mut().zip(self.renderer.as_mut()) else {
            return Ok(None);
        };
        let next = display.draw(renderer, |renderer, gpu| sequence.next_frame(renderer, gpu))?;
        let Some((rgb, stats)) = next else { return Ok(None) };
        self.figures.ms.push(self.since.elapsed().as_secs_f64() * 1000.0);
        self.figures.stats.push(stats);
        self.since = Instant::now();
        self.given += 1;
        Ok(Some(DrawnFrame { index: self.given - 1, size: self.size, rgb, stats }))
    }

    /// Figures of the frames given so far.
    pub fn report(&self) -> FramesReport {
        let f = &self.figures;
        let [width, height] = self.size;
        let [p50_ms, p99_ms] = f.both(|i| f.ms[i]);
        let [triangles_p50, triangles_p99] = f.both(|i| f.stats[i].triangles);
        FramesReport {
            count: self.given,
            width,
            height,
            p50_ms,
            p99_ms,
            triangles_p50,
            triangles_p99,
            total_ms: self.since.duration_since(self.started).as_secs_f64() * 1000.0,
            min_near_clearance_mm: self.flight.min_margin_mm(),
            flight_seconds: self.flight.seconds.last().copied().unwrap_or(0.0),
            cuts: self.flight.cuts.clone(),
            device: self.display.name.clone(),
        }
    }

    /// Returns the warnings for a viewer of the frames.
    pub fn warnings(&self) -> Vec<String> {
        let mut warnings = Vec::new();
        if self.flight.moved > 0 {
            warnings.push(format!(
                "{} frames had no room and stand at the nearest place that has",
                self.flight.moved
            ));
        }
        if self.flight.left_out > 0 {
            let n = self.flight.left_out;
            warnings.push(format!("{n} pieces or branches are too narrow to be flown"));
        }
        warnings
    }

    /// Ends the drawing of frames, whose meshes are freed, and returns the renderer.
    pub(super) fn end(&mut self) -> &mut Renderer {
        let renderer = self.renderer.as_mut().expect("held until the stream is dropped");
        if let Some(mut sequence) = self.sequence.take() {
            // A device that is gone has no frame in flight.
            let _ = self.display.draw(renderer, |renderer, gpu| {
                sequence.finish(renderer, gpu);
                Ok::<_, SessionError>(())
            });
        }
        self.held.drain(..).for_each(|m| renderer.remove_mesh(m));
        self.path.take().into_iter().for_each(|path| renderer.remove_path(path));
        self.tissue.take().into_iter().for_each(|tissue| renderer.remove_tissue(tissue));
        renderer
    }
}

impl Drop for FrameStream {
    fn drop(&mut self) {
        self.end();
        *locked(&self.display.renderer) = self.renderer.take();
    }
}

impl Figures {
    /// The value below which a share of the frames lies.
    fn at<T: Copy + PartialOrd + Default>(&self, q: f64, of: impl Fn(usize) -> T) -> T {
        let mut all: Vec<T> = (0..self.ms.len()).map(of).collect();
        all.sort_by(|a, b| a.partial_cmp(b).expect("numbers"));
        all.get(((all.len().max(1) - 1) as f64 * q).round() as usize).copied().unwrap_or_default()
    }

    fn both<T: Copy + PartialOrd + Default>(&self, of: impl Fn(usize) -> T + Copy) -> [T; 2] {
        [self.at(0.5, of), self.at(0.99, of)]
    }
}

/// One shot a pose. `progress`: share of the path behind each eye.
fn shots(flight: &Flight, view: View, progress: &[f32]) -> Vec<Shot> {
    let shot = |i: usize| Shot {
        view,
        pose: flight.poses[i],
        lens: flight.lens(i),
        progress: progress[i],
        room_mm: Some(flight.room_mm[i]),
    };
    (0..flight.poses.len()).map(shot).collect()
}

/// Share of the pieces' length behind each eye: that of the nearest point, searched about the one
/// before, since a path may pass close to itself; behind a cut, everywhere.
fn share_of_path(pieces: &[Vec<Vec3>], flight: &Flight) -> Vec<f32> {
    let mut length = 0.0;
    let mut arc: Vec<(Vec3, f32)> = Vec::new();
    for piece in pieces {
        for (i, p) in piece.iter().enumerate() {
            length += if i > 0 { p.distance(piece[i - 1]) } else { 0.0 };
            arc.push((*p, length));
        }
    }
    let mut at = None;
    let nearest = |p: Vec3, among: std::ops::Range<usize>| {
        let off = |i: usize| arc[i].0.distance_squared(p);
        among.min_by(|&i, &j| off(i).total_cmp(&off(j)))
    };
    let reach = (arc.len() / 10).max(50);
    let share = |(k, pose): (usize, &Pose)| {
        let among = match at.filter(|_| !flight.cuts.contains(&k)) {
            None => 0..arc.len(),
            Some(i) => usize::saturating_sub(i, reach)..(i + reach).min(arc.len()),
        };
        at = nearest(pose.position_mm, among).or(at);
        at.map_or(0.0, |i| arc[i].1 / length.max(f32::MIN_POSITIVE))
    };
    flight.poses.iter().enumerate().map(share).collect()
}
