//! `intima run`: the whole chain into one folder.

use std::path::Path;

use serde::Serialize;

use super::CliError;
use super::centerline::{center, unseen_csv};
use super::chain::{Anatomy, Begun, ChainArgs, Flown, Heard, Subject, for_run};
use super::global::Global;
use super::lumen_args::{Chosen, lumen as choose, notes};
use super::surface::{Modes as ModeChoice, without_caps};
use super::timing::timed;
use crate::formats::{FormatError, atomic_file, write_centerline, write_layers, write_mesh};
use crate::geometry::Mesh;
use crate::lumen::Lumen;
use crate::pipeline::detail::{base, base_faces};
use crate::pipeline::{CenterlineReport, Clock, Mode, Modes, Report, beside};

const REPORT: &str = "report.json";

/// `intima run INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    #[command(flatten)]
    chain: ChainArgs,
}

impl Args {
    /// Computes everything and writes everything, the report last: where there is one, all is there
    /// and of one run. Products are written beside the frames; with `--repeat` once, afterwards.
    /// The volume is held no longer than it is needed, unless it is needed again.
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
        let Chosen { volume, recipe } = chosen;
        let mut held = Some(volume);
        let ((lumen, found, flown, unwritten), timing) =
            timed(global, &mut device, |device, clock| {
                let volume = for_run(&mut held, global);
                let (lumen, found) = clock.time(
                    "segment",
                    "voxels",
                    || choose(&volume, &recipe, global),
                    |r| r.as_ref().map_or(0, |(l, _)| l.inside_voxels()),
                )?;
                let aside = |heard: Heard, clock: &mut Clock| -> Result<_, CliError> {
                    let Some(begun) = heard.go() else { return Ok(None) };
                    self.drop_report()?;
                    let base = self.base(&begun, clock)?;
                    if !once {
                        return Ok(Some(base));
                    }
                    self.write(&lumen, &begun.anatomy, &base, clock)?;
                    Ok(None)
                };
                let subject = Subject { volume, recipe: &recipe, lumen: &lumen };
                let (flown, unwritten) = a.fly(device, subject, (&setup, &frames), clock, aside)?;
                Ok((lumen, found, flown, unwritten?))
            })?;
        clock.take(timing.clock.clone());
        if let Some(base) = unwritten {
            self.write(&lumen, &flown.anatomy, &base, &mut clock)?;
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

        let mut warnings = notes(&recipe, &lumen, &found);
        warnings.extend(doubts(&flown));
        let mut report = flown.report((&lumen, &found), &timing.device, &clock);
        report.modes = modes;
        report.timing = timing.keys();
        warnings.append(&mut report.warnings);
        report.warnings = warnings;
        write_json(&a.out.join(REPORT), &report)?;
        global.say(summary(&report, &a.out))?;
        global.answer_only(&report)
    }

    /// Takes away the report of an earlier run, whose products and frames now go.
    fn drop_report(&self) -> Result<(), CliError> {
        let path = self.chain.out.join(REPORT);
        match std::fs::remove_file(&path) {
            Err(e) if e.kind() != std::io::ErrorKind::NotFound => {
                Err(CliError::Format(FormatError::io(&path, e)))
            }
            _ => Ok(()),
        }
    }

    /// The surface with few faces.
    fn base(&self, begun: &Begun, clock: &mut Clock) -> Result<Mesh, CliError> {
        let a = &self.chain;
        let mesh = &begun.anatomy.wall.mesh;
        let faces = a.surface.decimate.map_or_else(|| base_faces(mesh), |n| n as usize);
        Ok(base(mesh, begun.clusters.as_deref(), faces, a.mode.main(), clock)?)
    }

    /// Writes what is no picture: eight files.
    fn write(
        &self,
        lumen: &Lumen,
        anatomy: &Anatomy,
        base: &Mesh,
        clock: &mut Clock,
    ) -> Result<(), CliError> {
        let a = &self.chain;
        let write = || write_products(&a.out, lumen, anatomy, base, a.surface.open_ends);
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
    let Anatomy { distance, centered, wall, .. } = anatomy;
    let classes = lumen.class_field();
    let grid = &lumen.grid;
    write_layers(&out.join("mask.nrrd"), grid, |put| lumen.each_layer(&classes, 0, put))?;
    write_layers(&out.join("distance.nrrd"), grid, |put| lumen.each_layer(distance, 0.0, put))?;
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
    Ok(atomic_file::write_atomic(&out.join("unseen.csv"), |o| o.write_all(csv.as_bytes()))?)
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
    Ok(atomic_file::write_atomic(path, |o| o.write_all(text.as_bytes()))?)
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
