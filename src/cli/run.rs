//! `intima run`: the whole chain into one folder.

use std::path::{Path, PathBuf};

use serde::Serialize;

use super::CliError;
use super::centerline::{PathArgs, center, unseen_csv};
use super::frames::{Filmed, FrameArgs, film};
use super::global::Global;
use super::lumen_args::{LumenArgs, notes};
use super::mesh_args::{FromArgs, SurfaceArgs};
use super::surface::{ModeArg, Modes as ModeChoice, automatic, without_caps};
use super::timing::timed;
use crate::formats::{whole, write_centerline, write_mesh, write_volume};
use crate::pipeline::{
    CenterlineReport, Clock, InputReport, LumenReport, Mode, Modes, Report, SurfaceReport, wall,
};
use crate::volume::{Samples, Volume};

/// `intima run INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Folder for mask, distance, surface, centerline, frames and report; made if it is not there
    #[arg(long, value_name = "DIR")]
    out: PathBuf,
    #[command(flatten)]
    mode: ModeArg,
    /// grey or mask: where the surface lies; X,Y,Z: where the path starts, LPS mm
    #[arg(long, value_name = "grey|mask|X,Y,Z", allow_hyphen_values = true)]
    from: Vec<String>,
    #[command(flatten)]
    frames: FrameArgs,
    #[command(flatten)]
    path: PathArgs,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl Args {
    /// Computes everything, then writes everything.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let setup = self.frames.check(global)?;
        let from = FromArgs::of(&self.from)?;
        let mut reading = Clock::default();
        let chosen = reading.time(
            "read",
            "voxels",
            || self.lumen.load(self.input.as_deref(), global),
            |c| c.as_ref().map_or(0, |c| c.volume.grid.len() as u64),
        )?;
        let mode = self.mode.main();
        let settings = self.path.settings(mode, from.start)?;
        let frames = self.out.join("frames");
        let mut device = global.open()?;
        let (products, timing) = timed(global, &mut device, |device, clock| {
            let (lumen, found) = clock.time(
                "segment",
                "voxels",
                || chosen.lumen(global),
                |r| r.as_ref().map_or(0, |(l, _)| l.inside_voxels()),
            )?;
            let (fields, centered) = center(device, &lumen, mode, settings, clock)?;
            let options =
                self.surface.options(from.grey, automatic(mode, &lumen), chosen.track_from())?;
            let (volume, window) = (&chosen.volume, &chosen.recipe.window);
            let wall = wall(device, volume, window, &lumen, options, clock)?;
            let open_ends = self.surface.open_ends;
            let scene = Filmed { lumen: &lumen, fields: &fields, wall: &wall, open_ends };
            let film = film(device, &scene, &centered.line, &setup, &frames, clock)?;
            Ok((lumen, found, fields, centered, wall, film))
        })?;
        let (lumen, found, fields, centered, wall, film) = products;
        let report = CenterlineReport::of(&centered, &lumen);
        let modes = if self.mode.mode == ModeChoice::Both {
            let settings = self.path.settings(Mode::Paper, from.start)?;
            let mut clock = Clock::default();
            let (_, paper) = center(&mut device, &lumen, Mode::Paper, settings, &mut clock)?;
            let paper = CenterlineReport::of(&paper, &lumen);
            Some(Modes { default: report.clone(), paper })
        } else {
            None
        };

        let mut writing = Clock::default();
        let out = |name: &str| self.out.join(name);
        writing.time(
            "write",
            "files",
            || -> Result<(), CliError> {
                let classes = Samples::U8(lumen.classes());
                write_volume(&out("mask.nrrd"), &Volume::new(lumen.grid, classes))?;
                let dense = Samples::F32(lumen.dense(&fields.distance, 0.0));
                write_volume(&out("distance.nrrd"), &Volume::new(lumen.grid, dense))?;
                if self.surface.open_ends && !wall.mesh.caps.is_empty() {
                    write_mesh(&out("surface.ply"), &without_caps(&wall.mesh))?;
                } else {
                    write_mesh(&out("surface.ply"), &wall.mesh)?;
                }
                for name in ["centerline.vtp", "centerline.csv", "centerline.mrk.json"] {
                    write_centerline(&out(name), &centered.line)?;
                }
                let csv = unseen_csv(&lumen, &centered.unseen);
                whole::write_whole(&out("unseen.csv"), |o| o.write_all(csv.as_bytes()))?;
                Ok(())
            },
            |_| 7,
        )?;

        let mut warnings = notes(&chosen.recipe, &lumen, &found);
        warnings.extend(film.warnings);
        let surface = SurfaceReport::of(wall.topology, wall.mesh.area_mm2());
        if surface.tunnels > 0 {
            warnings.push(format!(
                "the lumen has {} tunnels (touching folds, loops, noise); the centerline follows a tree through them",
                surface.tunnels
            ));
        }
        if centered.unreachable > 0 {
            warnings.push(format!(
                "{} inside voxels are joined to the rest by edges or corners only; no path goes there",
                centered.unreachable
            ));
        }
        let mut clock = reading;
        clock.stages.extend(timing.stages.iter().cloned());
        clock.stages.extend(writing.stages);
        let report = Report {
            input: Some(InputReport::of(&chosen.volume)),
            lumen: Some(LumenReport::of(&lumen, &found)),
            surface: Some(surface),
            centerline: Some(report),
            modes,
            frames: Some(film.report),
            warnings,
            timing: timing.keys(),
            ..Report::new(&timing.device, &clock)
        };
        write_json(&out("report.json"), &report)?;
        global.say(format_args!("{}", summary(&report, &self.out)))?;
        global.answer(&report)
    }
}

fn write_json(path: &Path, value: &impl Serialize) -> Result<(), CliError> {
    let text = serde_json::to_string_pretty(value).map_err(|e| CliError::System(e.to_string()))?;
    Ok(whole::write_whole(path, |o| o.write_all(text.as_bytes()))?)
}

fn summary(r: &Report, out: &Path) -> String {
    let mut s = format!("wrote {}\n", out.display());
    if let (Some(l), Some(w), Some(c), Some(f)) = (&r.lumen, &r.surface, &r.centerline, &r.frames) {
        s += &format!(
            "  lumen       {} voxels, {:.2} ml, {} bricks\n",
            l.internal_voxels + l.boundary_voxels,
            l.volume_ml,
            l.bricks
        );
        s += &format!(
            "  surface     {} vertices, {} faces, Euler number {}, {}\n",
            w.vertices,
            w.faces,
            w.euler,
            if w.watertight { "watertight" } else { "NOT watertight" }
        );
        s += &format!(
            "  centerline  {} branch(es), {:.1} mm, clearance at least {:.2} mm, {:.2} % of the boundary seen\n",
            c.branches,
            c.length_mm,
            c.min_clearance_mm,
            100.0 * c.boundary_seen_fraction
        );
        s += &format!(
            "  frames      {} of {} x {}, {:.0} ms each (median), {:.1} s of flight\n",
            f.count, f.width, f.height, f.p50_ms, f.flight_seconds
        );
    }
    let total: f64 = r.stages.iter().map(|s| s.ms).sum();
    s + &format!("  {:.2} s in all, {:.0} MB at most", total / 1000.0, r.peak_memory_mb)
}
