//! `intima run`: the whole chain into one folder.

use std::path::Path;

use serde::Serialize;

use super::CliError;
use super::centerline::{center, unseen_csv};
use super::chain::{ChainArgs, Flown};
use super::global::Global;
use super::lumen_args::notes;
use super::surface::{Modes as ModeChoice, without_caps};
use super::timing::timed;
use crate::formats::{whole, write_centerline, write_mesh, write_volume};
use crate::geometry::Mesh;
use crate::lumen::Lumen;
use crate::pipeline::detail::{base, base_faces};
use crate::pipeline::{CenterlineReport, Clock, Mode, Modes, Report};
use crate::volume::{Samples, Volume};

/// `intima run INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    chain: ChainArgs,
}

impl Args {
    /// Computes everything, then writes everything.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let a = &self.chain;
        let setup = a.frames.check(global)?;
        a.settings(a.mode.main())?;
        let mut clock = Clock::default();
        let chosen = clock.time(
            "read",
            "voxels",
            || a.lumen.load(a.input.as_deref(), global),
            |c| c.as_ref().map_or(0, |c| c.volume.grid.len() as u64),
        )?;
        let mut device = global.open()?;
        let frames = a.out.join("frames");
        let ((lumen, found, flown), timing) = timed(global, &mut device, |device, clock| {
            let (lumen, found) = clock.time(
                "segment",
                "voxels",
                || chosen.lumen(global),
                |r| r.as_ref().map_or(0, |(l, _)| l.inside_voxels()),
            )?;
            let flown = a.fly(device, (&chosen, &lumen), &setup, &frames, clock)?;
            Ok((lumen, found, flown))
        })?;
        clock.stages.extend(timing.stages.iter().cloned());
        let modes = if a.mode.mode == ModeChoice::Both {
            let mut aside = Clock::default();
            let settings = a.settings(Mode::Paper)?;
            let (_, paper) = center(&mut device, &lumen, Mode::Paper, settings, &mut aside)?;
            Some(Modes {
                default: CenterlineReport::of(&flown.centered, &lumen),
                paper: CenterlineReport::of(&paper, &lumen),
            })
        } else {
            None
        };
        let base = {
            let mesh = &flown.wall.mesh;
            let faces = a.surface.decimate.map_or_else(|| base_faces(mesh), |n| n as usize);
            base(mesh, faces, a.mode.main(), &mut clock)?
        };
        let write = || write_products(&a.out, &lumen, &flown, &base.mesh, a.surface.open_ends);
        clock.time("write", "files", write, |_| 8)?;

        let mut warnings = notes(&chosen.recipe, &lumen, &found);
        warnings.extend(doubts(&flown));
        let what = (&chosen, &lumen, &found);
        let mut report = flown.report(what, &timing.device, &clock);
        report.modes = modes;
        report.timing = timing.keys();
        warnings.append(&mut report.warnings);
        report.warnings = warnings;
        write_json(&a.out.join("report.json"), &report)?;
        global.say(summary(&report, &a.out))?;
        global.answer(&report)
    }
}

fn write_products(
    out: &Path,
    lumen: &Lumen,
    flown: &Flown,
    base: &Mesh,
    open_ends: bool,
) -> Result<(), CliError> {
    let volume = |samples: Samples| Volume::new(lumen.grid, samples);
    write_volume(&out.join("mask.nrrd"), &volume(Samples::U8(lumen.classes())))?;
    let dense = lumen.dense(&flown.fields.distance, 0.0f32);
    write_volume(&out.join("distance.nrrd"), &volume(Samples::F32(dense)))?;
    for (name, mesh) in [("surface.ply", &flown.wall.mesh), ("base.ply", base)] {
        if open_ends && !mesh.caps.is_empty() {
            write_mesh(&out.join(name), &without_caps(mesh))?;
        } else {
            write_mesh(&out.join(name), mesh)?;
        }
    }
    for name in ["centerline.vtp", "centerline.csv", "centerline.mrk.json"] {
        write_centerline(&out.join(name), &flown.centered.line)?;
    }
    let csv = unseen_csv(lumen, &flown.centered.unseen);
    Ok(whole::write_whole(&out.join("unseen.csv"), |o| o.write_all(csv.as_bytes()))?)
}

/// What a reader of the centerline should know.
fn doubts(flown: &Flown) -> Vec<String> {
    let tunnels = flown.wall.topology.tunnels();
    let mut out = Vec::new();
    if tunnels > 0 {
        out.push(format!(
            "the lumen has {tunnels} tunnels (touching folds, loops, noise); the centerline \
             follows a tree through them"
        ));
    }
    if flown.centered.unreachable > 0 {
        out.push(format!(
            "{} inside voxels are joined to the rest by edges or corners only; no path goes there",
            flown.centered.unreachable
        ));
    }
    out
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
