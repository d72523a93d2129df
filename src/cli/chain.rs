//! What `record` and `run` have in common: their flags, and the chain from lumen to frames.

use std::borrow::Cow;
use std::path::{Path, PathBuf};

use super::CliError;
use super::centerline::{PathArgs, center};
use super::draw::Film;
use super::film::{Filmed, Go, film};
use super::frames::{FrameArgs, Setup};
use super::global::Global;
use super::lumen_args::{LumenArgs, track_from};
use super::mesh_args::{FromArgs, SurfaceArgs};
use super::surface::{ModeArg, automatic};
use crate::compute::Array;
use crate::device::Device;
use crate::lumen::{Found, Lumen, Recipe};
use crate::pipeline::{
    Centered, CenterlineReport, Clock, InputReport, LumenReport, Mode, Report, Settings,
    SurfaceReport, Wall, beside, fields, return_freed_memory, route, seen, wall,
};
use crate::volume::Volume;

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

/// What a chain begins with.
pub struct Subject<'a> {
    /// Only the surface and the report need it: one that is owned is dropped once they are made.
    pub volume: Cow<'a, Volume>,
    pub recipe: &'a Recipe,
    pub lumen: &'a Lumen,
}

/// The volume for one run: given away where there is no other, lent where there is.
///
/// # Panics
/// If it was given away before.
pub fn for_run<'a>(held: &'a mut Option<Volume>, global: &Global) -> Cow<'a, Volume> {
    let volume = match global.repeat {
        None => held.take().map(Cow::Owned),
        Some(_) => held.as_ref().map(Cow::Borrowed),
    };
    volume.expect("a volume that was not given away")
}

/// What a flight goes through.
pub struct Anatomy {
    /// Exact distance, mm.
    pub distance: Array<f32>,
    pub centered: Centered,
    pub wall: Wall,
    pub input: InputReport,
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

    /// Centerline, surface and frames of a lumen. `made` is made of the surface before anything is
    /// drawn; `aside` takes it and is done beside the frames and what comes before them, see
    /// [`film`].
    pub fn fly<M: Send, T: Send>(
        &self,
        device: &mut Device,
        subject: Subject<'_>,
        (setup, folder): (&Setup, &Path),
        clock: &mut Clock,
        made: impl FnOnce(&Wall, &mut Clock) -> Result<M, CliError>,
        aside: impl FnOnce(&Anatomy, M, Go, &mut Clock) -> T + Send,
    ) -> Result<(Flown, T), CliError> {
        let lumen = subject.lumen;
        let (anatomy, made) = self.anatomy(device, subject, clock, made)?;
        return_freed_memory();
        let Anatomy { distance, centered, wall, .. } = &anatomy;
        let scene = Filmed { lumen, distance, wall, open_ends: self.surface.open_ends };
        let mut other = clock.beside();
        let other_done = |go| aside(&anatomy, made, go, &mut other);
        let (film, aside) = film(device, &scene, &centered.line, setup, folder, clock, other_done)?;
        clock.take(other);
        Ok((Flown { anatomy, film }, aside))
    }

    /// Centerline and surface of a lumen, and what is made of the surface; the route is searched
    /// beside all that. The largest pieces of memory, the volume and what simplification needs, are
    /// never held together, nor beside the building of levels of detail.
    fn anatomy<M>(
        &self,
        device: &mut Device,
        Subject { volume, recipe, lumen }: Subject<'_>,
        clock: &mut Clock,
        made: impl FnOnce(&Wall, &mut Clock) -> Result<M, CliError>,
    ) -> Result<(Anatomy, M), CliError> {
        let mode = self.mode.main();
        let settings = self.settings(mode)?;
        let grey = FromArgs::of(&self.from)?.grey;
        let options = self.surface.options(grey, automatic(mode), track_from(recipe))?;
        let finish = |device: &mut Device, clock: &mut Clock| -> Result<_, CliError> {
            let wall = wall(device, &volume, &recipe.window, lumen, options, clock)?;
            let input = InputReport::of(&volume);
            drop(volume);
            let made = made(&wall, clock)?;
            Ok((wall, input, made))
        };
        if mode == Mode::Paper {
            let (fields, centered) = center(device, lumen, mode, settings, clock)?;
            let (wall, input, made) = finish(device, clock)?;
            return Ok((Anatomy { distance: fields.distance, centered, wall, input }, made));
        }
        let fields = fields(device, lumen, true, clock)?;
        let mut other = clock.beside();
        let (routed, seen) = beside(
            || route(lumen, &fields, settings.route, &mut other),
            || -> Result<_, CliError> {
                let seen = seen(device, lumen, &fields, settings.radius, clock)?;
                Ok((seen, finish(device, clock)?))
            },
        );
        clock.take(other);
        let (routed, (seen, (wall, input, made))) = (routed?, seen?);
        let centered = Centered::new(lumen, &fields, routed, seen);
        Ok((Anatomy { distance: fields.distance, centered, wall, input }, made))
    }
}

impl Flown {
    /// The report of this chain.
    pub fn report(self, (lumen, found): (&Lumen, &Found), device: &str, clock: &Clock) -> Report {
        let Anatomy { centered, wall, input, .. } = self.anatomy;
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
