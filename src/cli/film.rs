//! A flight as frames: flying, drawing, encoding beside drawing.

use std::borrow::Cow;
use std::path::Path;
use std::sync::mpsc::{Receiver, channel, sync_channel};
use std::time::Instant;

use glam::Vec3;

use super::CliError;
use super::frames::Setup;
use super::surface::without_caps;
use crate::device::Device;
use crate::flight::{Clearance, Flight, FlightOptions, Script};
use crate::formats::{FormatError, VideoWriter, encode_png, whole};
use crate::geometry::{Centerline, Mesh};
use crate::lod::{Tolerance, Worker};
use crate::lumen::Lumen;
use crate::pipeline::detail::{LodReport, UPLOAD_BYTES};
use crate::pipeline::{Clock, Detail, Fields, FramesReport, Wall, beside};
use crate::render::{FrameStats, IN_FLIGHT, Renderer, Scene, Shot, View};
use crate::surface::{Shading, shading};
use crate::vk::{Choice, Gpu};

/// Makes a folder for outputs.
fn make_folder(path: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(path).map_err(|e| CliError::Format(FormatError::io(path, e)))
}

/// What is filmed.
pub struct Filmed<'a> {
    pub lumen: &'a Lumen,
    pub fields: &'a Fields,
    pub wall: &'a Wall,
    pub open_ends: bool,
}

/// What came of it.
pub struct Film {
    pub report: FramesReport,
    pub lod: LodReport,
    pub warnings: Vec<String>,
}

/// Flies along the first root-to-tip path and writes every frame. Levels of detail are built
/// beside planning the flight and opening the renderer, and `aside` is done beside all of it. Its
/// [`Go`] says when the folder is there and files may be written.
pub fn film<T: Send>(
    device: &mut Device,
    scene: &Filmed<'_>,
    line: &Centerline,
    setup: &Setup,
    folder: &Path,
    clock: &mut Clock,
    aside: impl FnOnce(Go) -> T + Send,
) -> Result<(Film, T), CliError> {
    let (ready, go) = channel();
    let (aside, film) = beside(
        || aside(Go(go)),
        || -> Result<Film, CliError> {
            // Dropped with an error on the way: whoever waits then hears of it.
            let ready = ready;
            let shown = Shown::of(scene);
            let mut own = None;
            let (set, flight) = prepare(device, &mut own, scene, &shown, line, setup, clock)?;
            // Only now: a machine that cannot draw leaves no empty folder.
            make_folder(folder)?;
            // An `aside` that has ended already does not listen.
            let _ = ready.send(());
            draw(set, line, setup, &flight, folder, clock)
        },
    );
    Ok((film?, aside))
}

/// What waits for a folder.
pub struct Go(Receiver<()>);

impl Go {
    /// Waits until files may be written; `false` when there will be no frames, so that nothing
    /// should be.
    pub fn wait(self) -> bool {
        self.0.recv().is_ok()
    }
}

/// The mesh that is drawn.
struct Shown<'a> {
    mesh: Cow<'a, Mesh>,
    closed: bool,
}

impl<'a> Shown<'a> {
    fn of(scene: &Filmed<'a>) -> Self {
        let mesh = &scene.wall.mesh;
        let open = scene.open_ends && mesh.caps.contains(&true);
        let closed = scene.wall.topology.watertight && !open;
        let mesh = if open { Cow::Owned(without_caps(mesh)) } else { Cow::Borrowed(mesh) };
        Self { mesh, closed }
    }
}

/// All that comes before the first frame.
fn prepare<'a>(
    device: &'a mut Device,
    own: &'a mut Option<Gpu>,
    scene: &Filmed<'_>,
    shown: &Shown<'_>,
    line: &Centerline,
    setup: &Setup,
    clock: &mut Clock,
) -> Result<(Staged<'a>, Flight), CliError> {
    let mut building = clock.beside();
    let (detail, begun) = beside(
        || detailed(&shown.mesh, setup, &mut building),
        || -> Result<_, CliError> {
            let fly = || fly(scene, line, setup);
            let count = |f: &Result<Flight, _>| f.as_ref().map_or(0, |f| f.poses.len() as u64);
            let flight = clock.time("flight", "frames", fly, count)?;
            if let Some(path) = &setup.write_path {
                let json = Script::from(&flight).to_json();
                whole::write_whole(path, |o| o.write_all(json.as_bytes()))?;
            }
            Ok((flight, open_renderer(device, own, setup, clock)?))
        },
    );
    clock.take(building);
    let (flight, opened) = begun?;
    Ok((set(opened, shown, setup, detail?)?, flight))
}

/// The renderer on the device that computes or, where that is the CPU, on what Vulkan there is,
/// kept in `own`.
fn open_renderer<'a>(
    device: &'a mut Device,
    own: &'a mut Option<Gpu>,
    setup: &Setup,
    clock: &mut Clock,
) -> Result<Opened<'a>, CliError> {
    let start = Instant::now();
    let gpu = match device {
        Device::Gpu(gpu) => &mut **gpu,
        Device::Cpu => {
            own.insert(Gpu::open(Choice::Any).map_err(crate::device::DeviceError::from)?)
        }
    };
    let name = gpu.info().name.clone();
    let [width, height] = setup.size;
    let renderer = Renderer::new(gpu, width, height, setup.samples)?;
    let pixels = u64::from(width) * u64::from(height);
    clock.record("renderer", &name, start, (pixels, "pixels"), Vec::new());
    Ok(Opened { renderer, name })
}

/// A renderer and the name of its device.
struct Opened<'a> {
    renderer: Renderer<'a>,
    name: String,
}

fn fly(scene: &Filmed<'_>, line: &Centerline, setup: &Setup) -> Result<Flight, CliError> {
    let wall = Some(&scene.wall.mesh);
    // In a split view the eye fills half the frame.
    let width = if setup.view == View::Split { setup.size[0] / 2 } else { setup.size[0] };
    let aspect = width as f32 / setup.size[1] as f32;
    if let Some(script) = &setup.script {
        let clearance = Clearance::new(scene.lumen, &scene.fields.distance, wall);
        let flown = match setup.script_frames {
            Some(n) => script.resampled(n).fly(&clearance, aspect)?,
            None => script.fly(&clearance, aspect)?,
        };
        return Ok(flown);
    }
    let points = line.branches.first().map_or(&[][..], |b| &b.points);
    Ok(Flight::new(
        points,
        scene.lumen,
        &scene.fields.distance,
        FlightOptions {
            frames: setup.frames,
            fov_y_rad: setup.fov_y_rad,
            aspect,
            reverse: setup.reverse,
            wall,
        },
    )?)
}

/// Share of the path's length behind each eye: that of the nearest point of the path, looked for
/// about the one before, since a path may pass close to itself.
fn along(path: &[Vec3], flight: &Flight) -> Vec<f32> {
    let mut length = 0.0;
    let arc: Vec<f32> = (0..path.len())
        .map(|i| {
            length += if i > 0 { path[i].distance(path[i - 1]) } else { 0.0 };
            length
        })
        .collect();
    let mut at = None;
    let nearest = |p: Vec3, among: std::ops::Range<usize>| {
        among.min_by(|&i, &j| path[i].distance_squared(p).total_cmp(&path[j].distance_squared(p)))
    };
    let window = (path.len() / 10).max(50);
    flight
        .poses
        .iter()
        .map(|pose| {
            let among = match at {
                None => 0..path.len(),
                Some(i) => usize::saturating_sub(i, window)..(i + window).min(path.len()),
            };
            at = nearest(pose.position_mm, among).or(at);
            at.map_or(0.0, |i| arc[i] / length.max(f32::MIN_POSITIVE))
        })
        .collect()
}

/// What is drawn, where, and by what it is refined.
struct Staged<'a> {
    on: Opened<'a>,
    scene: Scene,
    worker: Option<Worker>,
    lod: LodReport,
}

/// The wall at many levels and the mean radius of its lumen, mm; `None` where the whole mesh is to
/// be drawn.
fn detailed(
    mesh: &Mesh,
    setup: &Setup,
    clock: &mut Clock,
) -> Result<Option<(Detail, f32)>, CliError> {
    if setup.view == View::Overview {
        return Ok(None);
    }
    let count = |s: &Shading| s.vertices.len() as u64;
    let shading = clock.time("shading", "vertices", || shading(mesh), count);
    let built = setup.detail.build(mesh, &shading.vertices, clock)?;
    Ok(built.map(|d| (d, shading.mean_radius_mm)))
}

/// Puts the wall on the device: whole, or as pages that a worker fills.
fn set<'a>(
    mut on: Opened<'a>,
    Shown { mesh, closed }: &Shown<'_>,
    setup: &Setup,
    detail: Option<(Detail, f32)>,
) -> Result<Staged<'a>, CliError> {
    let renderer = &mut on.renderer;
    let Some((detail, radius_mm)) = detail else {
        let faces = mesh.faces.len() as u64;
        let lod =
            LodReport { mode: "off", base_faces: faces, finest_faces: faces, ..Default::default() };
        let scene = Scene::of(renderer.upload_mesh(mesh, false)?);
        return Ok(Staged { on, scene, worker: None, lod });
    };
    let overview = match setup.view {
        View::Inside => None,
        _ => Some(renderer.upload_mesh(mesh, false)?),
    };
    let pages = renderer.open_pages(detail.pages, radius_mm)?;
    let tolerance = Tolerance { pixels: setup.detail.pixel_error };
    let worker =
        Worker::spawn(detail.refine, tolerance, detail.pages, UPLOAD_BYTES, IN_FLIGHT as u32);
    let mut scene = Scene::paged(pages, overview);
    // Through an open end the back of a wall can be seen.
    scene.wall = crate::render::Wall::Pages { pages, backs: !closed };
    let worker = Some(worker.map_err(|e| CliError::System(e.to_string()))?);
    Ok(Staged { on, scene, worker, lod: detail.report })
}

/// Figures of every frame.
#[derive(Default)]
struct Tally {
    ms: Vec<f64>,
    stats: Vec<FrameStats>,
}

impl Tally {
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

fn draw(
    set: Staged<'_>,
    line: &Centerline,
    setup: &Setup,
    flight: &Flight,
    folder: &Path,
    clock: &mut Clock,
) -> Result<Film, CliError> {
    let Staged { on: Opened { mut renderer, name }, mut scene, mut worker, lod } = set;
    let [width, height] = setup.size;
    let started = Instant::now();
    let path: Vec<Vec3> = line
        .branches
        .first()
        .map(|b| b.points.iter().map(|p| p.position_mm.as_vec3()).collect())
        .unwrap_or_default();
    if path.len() > 1 && setup.view != View::Inside {
        scene.path = Some(renderer.upload_path(&path)?);
    }
    let n = flight.poses.len();
    let progress = along(&path, flight);
    let shots = (0..n).map(|i| Shot {
        view: setup.view,
        pose: flight.poses[i],
        lens: flight.lens(i),
        progress: progress[i],
    });
    let mut video = match &setup.video {
        Some(path) => Some(VideoWriter::create(path, width, height, setup.fps)?),
        None => None,
    };
    let mut tally = Tally::default();
    // Encoders run beside the drawing; the short queues bound what waits in memory.
    let encoders = rayon::current_num_threads().clamp(1, 4);
    std::thread::scope(|scope| -> Result<(), CliError> {
        let mut queues = Vec::new();
        let mut handles = Vec::new();
        for _ in 0..encoders {
            let (send, receive) = sync_channel::<(usize, Vec<u8>)>(2);
            queues.push(send);
            handles.push(scope.spawn(move || -> Result<(), FormatError> {
                for (i, rgb) in receive {
                    let png = encode_png(width, height, &rgb);
                    let path = folder.join(format!("frame_{:05}.png", i + 1));
                    whole::write_whole(&path, |o| o.write_all(&png))?;
                }
                Ok(())
            }));
        }
        let mut since = Instant::now();
        let sink = |i: usize, rgb: Vec<u8>, stats: FrameStats| -> Result<(), CliError> {
            if let Some(v) = &mut video {
                v.frame(&rgb)?;
            }
            // An encoder that failed has closed its queue; its error is read below.
            let _ = queues[i % encoders].send((i, rgb));
            tally.ms.push(since.elapsed().as_secs_f64() * 1000.0);
            tally.stats.push(stats);
            since = Instant::now();
            Ok(())
        };
        let mut result = match &mut worker {
            Some(worker) => renderer.render_settled(&scene, worker, shots, sink),
            None => renderer.render_sequence(&scene, shots, sink),
        };
        drop(queues);
        for h in handles {
            let encoder =
                h.join().map_err(|_| CliError::System("a PNG encoder panicked".into()))?;
            result = result.and(encoder.map_err(CliError::from));
        }
        result
    })?;
    if let Some(v) = video {
        v.finish()?;
    }
    let total_ms = started.elapsed().as_secs_f64() * 1000.0;
    clock.record("frames", &name, started, (n as u64, "frames"), Vec::new());
    let mut warnings = Vec::new();
    if flight.moved > 0 {
        warnings.push(format!(
            "{} frames had no room and stand at the nearest place that has",
            flight.moved
        ));
    }
    let degraded = tally.stats.iter().filter(|s| s.degraded).count();
    if degraded > 0 {
        warnings.push(format!(
            "{degraded} frames needed more patches than there is room for and are coarser than asked for"
        ));
    }
    let stats = &tally.stats;
    let [p50_ms, p99_ms] = tally.both(|i| tally.ms[i]);
    let [triangles_p50, triangles_p99] = tally.both(|i| stats[i].triangles);
    let [uploaded_bytes_p50, uploaded_bytes_p99] = tally.both(|i| stats[i].uploaded_bytes);
    let [leaves_changed_p50, leaves_changed_p99] = tally.both(|i| stats[i].leaves_changed);
    Ok(Film {
        report: FramesReport {
            count: n,
            width,
            height,
            p50_ms,
            p99_ms,
            triangles_p50,
            triangles_p99,
            uploaded_bytes_p50,
            uploaded_bytes_p99,
            leaves_changed_p50,
            leaves_changed_p99,
            degraded,
            total_ms,
            min_near_clearance_mm: flight.min_margin_mm(),
            flight_seconds: flight.seconds.last().copied().unwrap_or(0.0),
            device: name,
        },
        lod,
        warnings,
    })
}
