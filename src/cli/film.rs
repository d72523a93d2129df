//! A flight as frames: what must be there before the first, and what is done beside them.

use std::path::Path;
use std::sync::Arc;

use super::CliError;
use super::detail::Keep;
use super::draw::{Film, draw};
use super::frames::Setup;
use super::scene::{Levels, Opened, Shown, levels, open_renderer, set};
use crate::device::Device;
use crate::flight::{Clearance, Flight, FlightOptions, Script};
use crate::formats::{FormatError, atomic_file};
use crate::geometry::Centerline;
use crate::lod::clusters::Clusters;
use crate::lumen::Lumen;
use crate::pipeline::{Clock, Wall, beside, return_freed_memory};
use crate::render::View;
use crate::vk::Gpu;

/// Makes a folder for outputs.
fn make_folder(path: &Path) -> Result<(), CliError> {
    std::fs::create_dir_all(path).map_err(|e| CliError::Format(FormatError::io(path, e)))
}

/// Takes the frames of an earlier flight out of a folder: a shorter one would leave the rest of
/// them, perhaps of another patient, behind its own.
fn clear_frames(folder: &Path) -> Result<(), CliError> {
    let failed = |path: &Path, e| CliError::Format(FormatError::io(path, e));
    for entry in std::fs::read_dir(folder).map_err(|e| failed(folder, e))? {
        let path = entry.map_err(|e| failed(folder, e))?.path();
        let name = path.file_name().and_then(|n| n.to_str());
        if name.is_some_and(is_frame) && !path.is_dir() {
            std::fs::remove_file(&path).map_err(|e| failed(&path, e))?;
        }
    }
    Ok(())
}

/// Name of a frame, counted from 1.
pub fn frame_name(number: usize) -> String {
    format!("frame_{number:05}.png")
}

fn is_frame(name: &str) -> bool {
    let number = name.strip_prefix("frame_").and_then(|n| n.strip_suffix(".png"));
    number.is_some_and(|n| n.len() == 5 && n.bytes().all(|b| b.is_ascii_digit()))
}

/// What is filmed.
pub struct Filmed<'a> {
    pub lumen: &'a Lumen,
    /// Exact distance, mm.
    pub distance: &'a [f32],
    pub wall: &'a Wall,
    pub open_ends: bool,
}

/// Flies along the first root-to-tip path and writes every frame. Levels of detail are built
/// beside planning the flight and opening the renderer. `ready` hears of their clusters once the
/// folder is there and files may be written.
pub fn film(
    device: &mut Device,
    scene: &Filmed<'_>,
    line: &Centerline,
    (setup, folder): (&Setup, &Path),
    clock: &mut Clock,
    ready: impl FnOnce(Option<Arc<Clusters>>),
) -> Result<Film, CliError> {
    let shown = Shown::of(scene.wall, scene.open_ends);
    let mut own = None;
    let (opened, levels, flight) = prepare(device, &mut own, scene, &shown, line, setup, clock)?;
    let clusters = levels.as_ref().and_then(Levels::clusters);
    let mut set = set(opened, &shown, setup, levels)?;
    // Only now: a machine that cannot draw leaves no empty folder.
    make_folder(folder)?;
    clear_frames(folder)?;
    ready(clusters);
    let keep = set.keep.take();
    let draw = || draw(set, line, setup, &flight, folder, clock);
    beside(|| keep.into_iter().for_each(Keep::write), draw).1
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
) -> Result<(Opened<'a>, Option<Levels>, Flight), CliError> {
    let mut building = clock.beside();
    let (levels, begun) = beside(
        || levels(shown, setup, &mut building),
        || -> Result<_, CliError> {
            let fly = || fly(scene, line, setup);
            let count = |f: &Result<Flight, _>| f.as_ref().map_or(0, |f| f.poses.len() as u64);
            let flight = clock.time("flight", "frames", fly, count)?;
            if let Some(path) = &setup.write_path {
                let json = Script::from(&flight).to_json();
                atomic_file::write_atomic(path, |o| o.write_all(json.as_bytes()))?;
            }
            Ok((flight, open_renderer(device, own, setup, clock)?))
        },
    );
    clock.take(building);
    let (flight, opened) = begun?;
    let levels = levels?;
    // What building them took is larger than the pages that come now.
    return_freed_memory();
    Ok((opened, levels, flight))
}

fn fly(scene: &Filmed<'_>, line: &Centerline, setup: &Setup) -> Result<Flight, CliError> {
    let wall = Some(&scene.wall.mesh);
    // In a split view the eye fills half the frame.
    let width = if setup.view == View::Split { setup.size[0] / 2 } else { setup.size[0] };
    let aspect = width as f32 / setup.size[1] as f32;
    if let Some(script) = &setup.script {
        let clearance = Clearance::new(scene.lumen, scene.distance, wall);
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
        scene.distance,
        FlightOptions {
            frames: setup.frames,
            fov_y_rad: setup.fov_y_rad,
            aspect,
            reverse: setup.reverse,
            wall,
        },
    )?)
}
