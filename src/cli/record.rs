//! `intima record`.

use std::path::PathBuf;

use super::CliError;
use super::centerline::{PathArgs, center};
use super::frames::{Filmed, FrameArgs, film};
use super::global::Global;
use super::lumen_args::LumenArgs;
use super::mesh_args::{FromArgs, SurfaceArgs};
use super::surface::{ModeArg, automatic};
use super::timing::timed;
use crate::pipeline::{CenterlineReport, InputReport, LumenReport, Report, SurfaceReport, wall};

/// `intima record INPUT LUMEN --out DIR`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Folder for frame_00001.png and so on; made if it is not there
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
    /// Computes what a flight needs, flies, writes frames.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let setup = self.frames.check(global)?;
        let from = FromArgs::of(&self.from)?;
        let chosen = self.lumen.load(self.input.as_deref(), global)?;
        let (lumen, found) = chosen.lumen(global)?;
        let mode = self.mode.main();
        let settings = self.path.settings(mode, from.start)?;
        let options =
            self.surface.options(from.grey, automatic(mode, &lumen), chosen.track_from())?;
        let mut device = global.open()?;
        let ((centered, wall, filmed), timing) = timed(global, &mut device, |device, clock| {
            let (fields, centered) = center(device, &lumen, mode, settings, clock)?;
            let (volume, window) = (&chosen.volume, &chosen.recipe.window);
            let wall = wall(device, volume, window, &lumen, options, clock)?;
            let open_ends = self.surface.open_ends;
            let scene = Filmed { lumen: &lumen, fields: &fields, wall: &wall, open_ends };
            let filmed = film(device, &scene, &centered.line, &setup, &self.out, clock)?;
            Ok((centered, wall, filmed))
        })?;
        global.say(format_args!(
            "wrote {} frames to {} ({:.1} s of flight)",
            filmed.report.count,
            self.out.display(),
            filmed.report.flight_seconds
        ))?;
        let report = Report {
            input: Some(InputReport::of(&chosen.volume)),
            lumen: Some(LumenReport::of(&lumen, &found)),
            surface: Some(SurfaceReport::of(wall.topology, wall.mesh.area_mm2())),
            centerline: Some(CenterlineReport::of(&centered, &lumen)),
            frames: Some(filmed.report),
            warnings: filmed.warnings,
            timing: timing.keys(),
            ..Report::new(&timing.device, &timing.clock())
        };
        global.answer(&report)
    }
}
