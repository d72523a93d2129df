//! `intima run`: the whole chain into one folder.

use std::path::Path;

use serde::Serialize;

use super::CliError;
use super::centerline::{center, unseen_csv};
use super::chain::{Anatomy, ChainArgs, Flown};
use super::film::Go;
use super::global::Global;
use super::lumen_args::notes;
use super::surface::{Modes as ModeChoice, without_caps};
use super::timing::timed;
use crate::formats::{whole, write_centerline, write_mesh, write_volume};
use crate::geometry::Mesh;
use crate::lumen::Lumen;
use crate::pipeline::detail::{base, base_faces};
use crate::pipeline::{CenterlineReport, Clock, InputReport, Mode, Modes, Report, beside};
use crate::volume::{Samples, Volume};

/// `intima run INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    chain: ChainArgs,
}

impl Args {
    /// Computes everything and writes everything, the report last. Products are written beside
    /// the frames; with `--repeat` once, afterwards.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let a = &self.chain;
        let setup = a.frames.check(global)?;
        a.settings(a.mode.main())?;
        let mut clock = Clock::default();
        let read = || {
            clock.time(
                "read",
                "voxels",
                || a.lumen.load(a.input.as_deref(), global),
                |c| c.as_ref().map_or(0, |c| c.volume.grid.len() as u64),
            )
        };
        let (device, chosen) = beside(|| global.open(), read);
        let (chosen, mut device) = (chosen?, device?);
        let frames = a.out.join("frames");
        let once = global.repeat.is_none();
        let ((lumen, found, flown, written, input), timing) =
            timed(global, &mut device, |device, clock| {
                let (lumen, found) = clock.time(
                    "segment",
                    "voxels",
                    || chosen.lumen(global),
                    |r| r.as_ref().map_or(0, |(l, _)| l.inside_voxels()),
                )?;
                let aside = |anatomy: &Anatomy, go: Go, clock: &mut Clock| {
                    let input = InputReport::of(&chosen.volume);
                    let products = || self.products(&lumen, anatomy, Some(go), clock);
                    (once.then(products), input)
                };
                let what = (&chosen, &lumen);
                let (flown, (written, input)) =
                    a.fly(device, what, &setup, &frames, clock, aside)?;
                Ok((lumen, found, flown, written.transpose()?, input))
            })?;
        clock.take(timing.clock.clone());
        if written.is_none() {
            self.products(&lumen, &flown.anatomy, None, &mut clock)?;
        }
        let modes = if a.mode.mode == ModeChoice::Both {
            let mut aside = Clock::default();
            let settings = a.settings(Mode::Paper)?;
            let (_, paper) = center(&mut device, &lumen, Mode::Paper, settings, &mut aside)?;
            Some(Modes {
                default: CenterlineReport::of(&flown.anatomy.centered, &lumen),
                paper: CenterlineReport::of(&paper, &lumen),
            })
        } else {
            None
        };

        let mut warnings = notes(&chosen.recipe, &lumen, &found);
        warnings.extend(doubts(&flown));
        let mut report = flown.report(input, (&lumen, &found), &timing.device, &clock);
        report.modes = modes;
        report.timing = timing.keys();
        warnings.append(&mut report.warnings);
        report.warnings = warnings;
        write_json(&a.out.join("report.json"), &report)?;
        global.say(summary(&report, &a.out))?;
        global.answer(&report)
    }

    /// Makes what is no picture, and writes it once `go` allows: eight files.
    fn products(
        &self,
        lumen: &Lumen,
        anatomy: &Anatomy,
        go: Option<Go>,
        clock: &mut Clock,
    ) -> Result<(), CliError> {
        let a = &self.chain;
        let mesh = &anatomy.wall.mesh;
        let faces = a.surface.decimate.map_or_else(|| base_faces(mesh), |n| n as usize);
        let base = base(mesh, faces, a.mode.main(), clock)?;
        if !go.is_none_or(Go::wait) {
            return Ok(());
        }
        let write = || write_products(&a.out, lumen, anatomy, &base.mesh, a.surface.open_ends);
        clock.time("write", "files", write, |_| 8)
    }
}

fn write_products(
    out: &Path,
    lumen: &Lumen,
    anatomy: &Anatomy,
    base: &Mesh,
    open_ends: bool,
) -> Result<(), CliError> {
    let Anatomy { fields, centered, wall } = anatomy;
    let volume = |samples: Samples| Volume::new(lumen.grid, samples);
    write_volume(&out.join("mask.nrrd"), &volume(Samples::U8(lumen.classes())))?;
    let dense = lumen.dense(&fields.distance, 0.0f32);
    write_volume(&out.join("distance.nrrd"), &volume(Samples::F32(dense)))?;
    for (name, mesh) in [("surface.ply", &wall.mesh), ("base.ply", base)] {
        if open_ends && !mesh.caps.is_empty() {
            write_mesh(&out.join(name), &without_caps(mesh))?;
        } else {
            write_mesh(&out.join(name), mesh)?;
        }
    }
    for name in ["centerline.vtp", "centerline.csv", "centerline.mrk.json"] {
        write_centerline(&out.join(name), &centered.line)?;
    }
    let csv = unseen_csv(lumen, &centered.unseen);
    Ok(whole::write_whole(&out.join("unseen.csv"), |o| o.write_all(csv.as_bytes()))?)
}

/// What a reader of the centerline should know.
fn doubts(flown: &Flown) -> Vec<String> {
    let tunnels = flown.anatomy.wall.topology.tunnels();
    let mut out = Vec::new();
    if tunnels > 0 {
        out.push(format!(
            "the lumen has {tunnels} tunnels (touching folds, loops, noise); the centerline \
             follows a tree through them"
        ));
    }
    if flown.anatomy.centered.unreachable > 0 {
        out.push(format!(
            "{} inside voxels are joined to the rest by edges or corners only; no path goes there",
            flown.anatomy.centered.unreachable
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
    s + &format!("  {:.2} s in all, {:.0} MB at most", r.total_ms / 1000.0, r.peak_memory_mb)
}
