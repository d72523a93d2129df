//! Drawing a film: frames in flight, encoders beside them.

use std::path::Path;
use std::sync::mpsc::sync_channel;
use std::time::Instant;

use glam::Vec3;
use thread_priority::{ThreadPriority, set_current_thread_priority};

use super::CliError;
use super::film::frame_name;
use super::frames::Setup;
use super::scene::{Opened, Staged};
use crate::flight::Flight;
use crate::formats::{FormatError, VideoWriter, atomic_file, encode_png};
use crate::geometry::Centerline;
use crate::pipeline::detail::LodReport;
use crate::pipeline::{Clock, FramesReport};
use crate::render::{FrameStats, Shot, View};

/// What came of it.
pub struct Film {
    pub report: FramesReport,
    pub lod: LodReport,
    pub warnings: Vec<String>,
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

/// Frames that may wait for each encoder.
const QUEUED: usize = 6;

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

/// Draws every frame and writes it.
pub fn draw(
    set: Staged<'_>,
    line: &Centerline,
    setup: &Setup,
    flight: &Flight,
    folder: &Path,
    clock: &mut Clock,
) -> Result<Film, CliError> {
    let Staged { on: Opened { gpu, mut renderer, name }, mut scene, mut worker, lod, .. } = set;
    let [width, height] = setup.size;
    let started = Instant::now();
    let path: Vec<Vec3> = line
        .branches
        .first()
        .map(|b| b.points.iter().map(|p| p.position_mm.as_vec3()).collect())
        .unwrap_or_default();
    if path.len() > 1 && setup.view != View::Inside {
        scene.path = Some(renderer.upload_path(gpu, &path)?);
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
    // Encoders run beside the drawing; the short queues bound what waits in memory. Software
    // devices draw on the same cores: encoders take what those leave, and queues of a few frames
    // last until they leave some.
    let encoders = rayon::current_num_threads().clamp(1, 4);
    std::thread::scope(|scope| -> Result<(), CliError> {
        let mut queues = Vec::new();
        let mut handles = Vec::new();
        let spares = renderer.spares();
        for _ in 0..encoders {
            let spares = spares.clone();
            let (send, receive) = sync_channel::<(usize, Vec<u8>)>(QUEUED);
            queues.push(send);
            handles.push(scope.spawn(move || -> Result<(), FormatError> {
                // Where that may not be asked for, frames come out all the same.
                let _ = set_current_thread_priority(ThreadPriority::Min);
                for (i, rgb) in receive {
                    let png = encode_png(width, height, &rgb);
                    spares.give(rgb);
                    let path = folder.join(frame_name(i + 1));
                    atomic_file::write_atomic(&path, |o| o.write_all(&png))?;
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
            Some(worker) => renderer.render_settled(gpu, &scene, worker, shots, sink),
            None => renderer.render_sequence(gpu, &scene, shots, sink),
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
