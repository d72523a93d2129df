//! What `record` and `run` have in common: their flags, and the chain from lumen to frames.

use std::path::{Path, PathBuf};

use super::CliError;
use super::centerline::{PathArgs, center};
use super::film::{Film, Filmed, film};
use super::frames::{FrameArgs, Setup};
use super::lumen_args::{Chosen, LumenArgs};
use super::mesh_args::{FromArgs, SurfaceArgs};
use super::surface::{ModeArg, automatic};
use crate::device::Device;
use crate::lumen::{Found, Lumen};
use crate::pipeline::{
    Centered, CenterlineReport, Clock, Fields, InputReport, LumenReport, Mode, Report, Settings,
    SurfaceReport, Wall, wall,
};

/// Flags of a whole chain.
#[derive(Debug, clap::Args)]
pub struct ChainArgs {
    /// Volume; may be left out with --mask
    pub input: Option<PathBuf>,
    /// Folder for the outputs; made if it is not there
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub mode: ModeArg,
    /// grey or mask: where the surface lies; X,Y,Z: where the path starts, LPS mm
    #[arg(long, value_name = "grey|mask|X,Y,Z", allow_hyphen_values = true)]
    pub from: Vec<String>,
    #[command(flatten)]
    pub frames: FrameArgs,
    #[command(flatten)]
    pub path: PathArgs,
    #[command(flatten)]
    pub surface: SurfaceArgs,
    #[command(flatten)]
    pub lumen: LumenArgs,
}

/// What the chain made.
pub struct Flown {
    pub fields: Fields,
    pub centered: Centered,
    pub wall: Wall,
    pub film: Film,
}

impl ChainArgs {
    /// Settings of the centerline in a mode.
    pub fn settings(&self, mode: Mode) -> Result<Settings, CliError> {
        self.path.settings(mode, FromArgs::of(&self.from)?.start)
    }

    /// Centerline, surface and frames of a lumen.
    pub fn fly(
        &self,
        device: &mut Device,
        (chosen, lumen): (&Chosen, &Lumen),
        setup: &Setup,
        folder: &Path,
        clock: &mut Clock,
    ) -> Result<Flown, CliError> {
        let mode = self.mode.main();
        let grey = FromArgs::of(&self.from)?.grey;
        let options = self.surface.options(grey, automatic(mode), chosen.track_from())?;
        let (fields, centered) = center(device, lumen, mode, self.settings(mode)?, clock)?;
        let (volume, window) = (&chosen.volume, &chosen.recipe.window);
        let wall = wall(device, volume, window, lumen, options, clock)?;
        let scene =
            Filmed { lumen, fields: &fields, wall: &wall, open_ends: self.surface.open_ends };
        let film = film(device, &scene, &centered.line, setup, folder, clock)?;
        Ok(Flown { fields, centered, wall, film })
    }
}

impl Flown {
    /// The report of this chain.
    pub fn report(
        self,
        (chosen, lumen, found): (&Chosen, &Lumen, &Found),
        device: &str,
        clock: &Clock,
    ) -> Report {
        Report {
            input: Some(InputReport::of(&chosen.volume)),
            lumen: Some(LumenReport::of(lumen, found)),
            surface: Some(SurfaceReport::of(self.wall.topology, self.wall.mesh.area_mm2())),
            centerline: Some(CenterlineReport::of(&self.centered, lumen)),
            lod: Some(self.film.lod),
            frames: Some(self.film.report),
            warnings: self.film.warnings,
            ..Report::new(device, clock)
        }
    }
}
