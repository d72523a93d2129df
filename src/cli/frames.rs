//! Frames of a flight: flags, flying, drawing, encoding beside drawing.

use std::io::Read as _;
use std::path::{Path, PathBuf};
use std::sync::mpsc::sync_channel;
use std::time::Instant;

use glam::Vec3;

use super::CliError;
use super::global::Global;
use crate::device::Device;
use crate::flight::{Clearance, Flight, FlightOptions, Frames, Script};
use crate::formats::{FormatError, VideoWriter, encode_png, whole};
use crate::geometry::Centerline;
use crate::lumen::Lumen;
use crate::pipeline::{Clock, Fields, FramesReport, Stage, Wall};
use crate::render::{Renderer, Scene, Shot, View};
use crate::vk::{Choice, Gpu};

/// Flags of the frames.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Frames")]
pub struct FrameArgs {
    /// Number of frames, equal steps in flight time (default 120)
    #[arg(long, value_name = "N", conflicts_with_all = ["speed"])]
    pub frames: Option<usize>,
    /// Cruising speed; the flight is slower where it is narrow or turns
    #[arg(long, value_name = "MM_PER_S")]
    pub speed: Option<f64>,
    /// Frames a second
    #[arg(long, value_name = "F", default_value_t = 25.0)]
    pub fps: f64,
    /// Pixels of a frame
    #[arg(long, value_name = "WxH", default_value = "1280x720")]
    pub size: String,
    /// What a frame shows
    #[arg(long, value_enum, default_value = "inside")]
    pub view: ViewArg,
    /// Vertical field of view, degrees
    #[arg(long, value_name = "DEG", default_value_t = 90.0)]
    pub fov: f32,
    /// Samples a pixel
    #[arg(long, value_name = "1|4", default_value = "4", value_parser = ["1", "4"])]
    pub msaa: String,
    /// Fly from the end to the start
    #[arg(long)]
    pub reverse: bool,
    /// Also write a video: .mp4 or .gif (needs ffmpeg)
    #[arg(long, value_name = "FILE")]
    pub video: Option<PathBuf>,
    /// Fly this camera path instead of our own (intima.path/1)
    #[arg(long, value_name = "FILE.json", conflicts_with_all = ["reverse", "speed"])]
    pub path: Option<PathBuf>,
    /// Write the camera path
    #[arg(long, value_name = "FILE.json")]
    pub write_path: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum ViewArg {
    Inside,
    Overview,
    Split,
}

/// Checked flags.
pub struct Setup {
    size: [u32; 2],
    frames: Frames,
    fps: f64,
    view: View,
    fov_y_rad: f32,
    samples: u32,
    reverse: bool,
    video: Option<PathBuf>,
    script: Option<Script>,
    script_frames: Option<usize>,
    write_path: Option<PathBuf>,
}

impl FrameArgs {
    /// Checks the flags before anything is computed.
    pub fn check(&self, global: &Global) -> Result<Setup, CliError> {
        let size = self.size.split_once(['x', 'X']).and_then(|(w, h)| {
            let side = |s: &str| s.parse::<u32>().ok().filter(|n| (16..=8192).contains(n));
            Some([side(w)?, side(h)?])
        });
        let size = size.ok_or_else(|| {
            CliError::Usage(format!("--size `{}`: WxH, each side 16 to 8192", self.size))
        })?;
        if !(5.0..=170.0).contains(&self.fov) {
            return Err(CliError::Usage(format!("--fov {}: 5 to 170 degrees", self.fov)));
        }
        if self.frames == Some(0) || self.frames.is_some_and(|n| n > 99_999) {
            return Err(CliError::Usage("--frames: 1 to 99999".into()));
        }
        if !(self.fps > 0.0 && self.fps <= 1000.0) {
            return Err(CliError::Usage(format!("--fps {}: above 0, at most 1000", self.fps)));
        }
        if self.speed.is_some_and(|s| !(s > 0.0 && s <= 10_000.0)) {
            return Err(CliError::Usage("--speed: above 0, at most 10000 mm/s".into()));
        }
        if self.video.is_some() && !VideoWriter::available() {
            global.warn("no ffmpeg in PATH: frames are written, the video is not");
        }
        Ok(Setup {
            size,
            frames: match self.speed {
                Some(mm_per_s) => Frames::Speed { mm_per_s, fps: self.fps },
                None => Frames::Count(self.frames.unwrap_or(120)),
            },
            fps: self.fps,
            view: match self.view {
                ViewArg::Inside => View::Inside,
                ViewArg::Overview => View::Overview,
                ViewArg::Split => View::Split,
            },
            fov_y_rad: self.fov.to_radians(),
            samples: if self.msaa == "1" { 1 } else { 4 },
            reverse: self.reverse,
            video: self.video.clone().filter(|_| VideoWriter::available()),
            script: self.path.as_deref().map(read_script).transpose()?,
            script_frames: self.frames,
            write_path: self.write_path.clone(),
        })
    }
}

fn read_script(path: &Path) -> Result<Script, CliError> {
    let io = |e| FormatError::io(path, e);
    let mut bytes = Vec::new();
    let file = std::fs::File::open(path).map_err(io)?;
    file.take(crate::flight::MAX_BYTES as u64 + 1).read_to_end(&mut bytes).map_err(io)?;
    Ok(Script::parse(&bytes)?)
}

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
    pub warnings: Vec<String>,
}

/// Flies along the first root-to-tip path and writes every frame.
pub fn film(
    device: &mut Device,
    scene: &Filmed<'_>,
    line: &Centerline,
    setup: &Setup,
    folder: &Path,
    clock: &mut Clock,
) -> Result<Film, CliError> {
    let flight = clock.time(
        "flight",
        "frames",
        || fly(scene, line, setup),
        |f| f.as_ref().map_or(0, |f| f.poses.len() as u64),
    )?;
    if let Some(path) = &setup.write_path {
        let json = Script::from(&flight).to_json();
        whole::write_whole(path, |o| o.write_all(json.as_bytes()))?;
    }
    match device {
        Device::Gpu(gpu) => draw(gpu, scene, line, setup, &flight, folder, clock),
        Device::Cpu => {
            // Drawing needs Vulkan, real or software; computing stays where it was.
            let mut gpu = Gpu::open(Choice::Any).map_err(crate::device::DeviceError::from)?;
            draw(&mut gpu, scene, line, setup, &flight, folder, clock)
        }
    }
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

fn draw(
    gpu: &mut Gpu,
    filmed: &Filmed<'_>,
    line: &Centerline,
    setup: &Setup,
    flight: &Flight,
    folder: &Path,
    clock: &mut Clock,
) -> Result<Film, CliError> {
    let started = Instant::now();
    let name = gpu.info().name.clone();
    let [width, height] = setup.size;
    let mut renderer = Renderer::new(gpu, width, height, setup.samples)?;
    // Only now: a machine that cannot draw leaves no empty folder.
    make_folder(folder)?;
    let mesh = renderer.upload_mesh(&filmed.wall.mesh, filmed.open_ends)?;
    let path: Vec<Vec3> = line
        .branches
        .first()
        .map(|b| b.points.iter().map(|p| p.position_mm.as_vec3()).collect())
        .unwrap_or_default();
    let mut scene = Scene::of(mesh);
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
    let mut frame_ms = Vec::with_capacity(n);
    // Encoders run beside the drawing; the short queues bound what waits in memory.
    let workers = rayon::current_num_threads().clamp(1, 4);
    std::thread::scope(|scope| -> Result<(), CliError> {
        let mut queues = Vec::new();
        let mut handles = Vec::new();
        for _ in 0..workers {
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
        let drawn = renderer.render_sequence(&scene, shots, |i, rgb| -> Result<(), CliError> {
            if let Some(v) = &mut video {
                v.frame(&rgb)?;
            }
            // A worker that failed has closed its queue; its error is read below.
            let _ = queues[i % workers].send((i, rgb));
            frame_ms.push(since.elapsed().as_secs_f64() * 1000.0);
            since = Instant::now();
            Ok(())
        });
        drop(queues);
        let mut result = drawn;
        for h in handles {
            let worker = h.join().map_err(|_| CliError::System("a PNG encoder panicked".into()))?;
            result = result.and(worker.map_err(CliError::from));
        }
        result
    })?;
    if let Some(v) = video {
        v.finish()?;
    }
    let total_ms = started.elapsed().as_secs_f64() * 1000.0;
    clock.stages.push(Stage {
        name: "frames",
        device: name.clone(),
        ms: total_ms,
        items: n as u64,
        unit: "frames",
        kernels: Vec::new(),
    });
    frame_ms.sort_by(f64::total_cmp);
    let at = |q: f64| frame_ms.get(((frame_ms.len().max(1) - 1) as f64 * q).round() as usize);
    let caps = filmed.wall.mesh.caps.iter().filter(|c| **c && filmed.open_ends).count();
    let mut warnings = Vec::new();
    if flight.moved > 0 {
        warnings.push(format!(
            "{} frames had no room and stand at the nearest place that has",
            flight.moved
        ));
    }
    Ok(Film {
        report: FramesReport {
            count: n,
            width,
            height,
            p50_ms: at(0.5).copied().unwrap_or(0.0),
            p99_ms: at(0.99).copied().unwrap_or(0.0),
            triangles_p50: (filmed.wall.mesh.faces.len() - caps) as u64,
            total_ms,
            min_near_clearance_mm: flight.min_margin_mm(),
            flight_seconds: flight.seconds.last().copied().unwrap_or(0.0),
            device: name,
        },
        warnings,
    })
}
