//! What `record` and `run` have in common: their flags, and the chain from lumen to frames.

use std::path::{Path, PathBuf};

use super::CliError;
use super::centerline::{PathArgs, center};
use super::draw::Film;
use super::film::{Filmed, Go, film};
use super::frames::{FrameArgs, Setup};
use super::lumen_args::{Chosen, LumenArgs};
use super::mesh_args::{FromArgs, SurfaceArgs};
use super::surface::{ModeArg, automatic};
use crate::device::Device;
use crate::lumen::{Found, Lumen};
use crate::pipeline::{
    Centered, CenterlineReport, Clock, Fields, InputReport, LumenReport, Mode, Report, Settings,
    SurfaceReport, Wall, beside, fields, route, seen, wall,
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

/// What a flight goes through.
pub struct Anatomy {
    pub fields: Fields,
    pub centered: Centered,
    pub wall: Wall,
}

/// What the chain made.
pub struct Flown {
    pub anatomy: Anatomy,
    pub film: Film,
}

impl ChainArgs {
    /// Settings of the centerline in a mode.
    pub fn settings(&self, mode: Mode) -> Result<Settings, CliError> {
        self.path.settings(mode, FromArgs::of(&self.from)?.start)
    }

    /// Centerline, surface and frames of a lumen. `aside` is done beside the
    /// frames and what comes before them, see [`film`].
    pub fn fly<T: Send>(
        &self,
        device: &mut Device,
        (chosen, lumen): (&Chosen, &Lumen),
        setup: &Setup,
        folder: &Path,
        clock: &mut Clock,
        aside: impl FnOnce(&Anatomy, Go, &mut Clock) -> T + Send,
    ) -> Result<(Flown, T), CliError> {
        let anatomy = self.anatomy(device, (chosen, lumen), clock)?;
        let Anatomy { fields, centered, wall } = &anatomy;
        let scene = Filmed { lumen, fields, wall, open_ends: self.surface.open_ends };
        let mut other = clock.beside();
        let other_done = |go| aside(&anatomy, go, &mut other);
        let (film, aside) = film(device, &scene, &centered.line, setup, folder, clock, other_done)?;
        clock.take(other);
        Ok((Flown { anatomy, film }, aside))
    }

    /// Centerline and surface of a lumen; the route is searched beside the surface.
    fn anatomy(
        &self,
        device: &mut Device,
        (chosen, lumen): (&Chosen, &Lumen),
        clock: &mut Clock,
    ) -> Result<Anatomy, CliError> {
        let mode = self.mode.main();
        let settings = self.settings(mode)?;
        let grey = FromArgs::of(&self.from)?.grey;
        let options = self.surface.options(grey, automatic(mode), chosen.track_from())?;
        let (volume, window) = (&chosen.volume, &chosen.recipe.window);
        if mode == Mode::Paper {
            let (fields, centered) = center(device, lumen, mode, settings, clock)?;
            let wall = wall(device, volume, window, lumen, options, clock)?;
            return Ok(Anatomy { fields, centered, wall });
        }
        let fields = fields(device, lumen, true, clock)?;
        let mut other = clock.beside();
        let (routed, seen) = beside(
            || route(lumen, &fields, settings.route, &mut other),
            || -> Result<_, CliError> {
                let seen = seen(device, lumen, &fields, settings.radius, clock)?;
                Ok((seen, wall(device, volume, window, lumen, options, clock)?))
            },
        );
        clock.take(other);
        let (routed, (seen, wall)) = (routed?, seen?);
        let centered = Centered::new(lumen, &fields, routed, seen);
        Ok(Anatomy { fields, centered, wall })
    }
}

impl Flown {
    /// The report of this chain.
    pub fn report(
        self,
        input: InputReport,
        (lumen, found): (&Lumen, &Found),
        device: &str,
        clock: &Clock,
    ) -> Report {
        let Anatomy { centered, wall, .. } = self.anatomy;
        Report {
            input: Some(input),
            lumen: Some(LumenReport::of(lumen, found)),
            surface: Some(SurfaceReport::of(wall.topology, wall.mesh.area_mm2())),
            centerline: Some(CenterlineReport::of(&centered, lumen)),
            lod: Some(self.film.lod),
            frames: Some(self.film.report),
            warnings: self.film.warnings,
            ..Report::new(device, clock)
        }
    }
}
