//! What `record` and `run` have in common: their flags, and the chain from lumen to frames.

use std::borrow::Cow;
use std::path::{Path, PathBuf};
use std::sync::Arc;
use std::sync::mpsc::{Receiver, channel};

use super::CliError;
use super::centerline::{PathArgs, center};
use super::draw::Film;
use super::film::{Filmed, film};
use super::frames::{FrameArgs, Setup};
use super::global::Global;
use super::lumen_args::{LumenArgs, track_from};
use super::mesh_args::{FromArgs, SurfaceArgs};
use super::surface::{ModeArg, automatic};
use crate::compute::Array;
use crate::device::Device;
use crate::lod::clusters::Clusters;
use crate::lumen::{Found, Lumen, Recipe};
use crate::pipeline::{
    Centered, CenterlineReport, Clock, InputReport, LumenReport, Mode, Report, Settings,
    SurfaceReport, Wall, beside, fields, route, seen, wall,
};
use crate::volume::Volume;

/// Flags of a whole chain.
#[derive(Debug, clap::Args)]
pub struct ChainArgs {
    /// Volume; may be left out with --mask
    pub input: Option<PathBuf>,
    /// Folder for the outputs; made if it is not there, and rid of the frames of an earlier flight
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
    pub anatomy: Arc<Anatomy>,
    pub film: Film,
}

impl ChainArgs {
    /// Settings of the centerline in a mode.
    pub fn settings(&self, mode: Mode) -> Result<Settings, CliError> {
        self.path.settings(mode, FromArgs::of(&self.from)?.start)
    }

    /// Centerline, surface and frames of a lumen. `aside` is done beside all of it; what it does is
    /// up to what it hears.
    pub fn fly<T: Send>(
        &self,
        device: &mut Device,
        subject: Subject<'_>,
        (setup, folder): (&Setup, &Path),
        clock: &mut Clock,
        aside: impl FnOnce(Heard, &mut Clock) -> T + Send,
    ) -> Result<(Flown, T), CliError> {
        let (ready, go) = channel();
        let mut other = clock.beside();
        let (aside, flown) = beside(
            || aside(Heard(go), &mut other),
            || -> Result<Flown, CliError> {
                // Dropped with an error on the way: whoever waits then hears of it.
                let ready = ready;
                let lumen = subject.lumen;
                let anatomy = Arc::new(self.anatomy(device, subject, clock)?);
                let Anatomy { distance, centered, wall, .. } = &*anatomy;
                let scene = Filmed { lumen, distance, wall, open_ends: self.surface.open_ends };
                let go = |clusters| {
                    // One who does not listen needs nothing.
                    let _ = ready.send(Begun { anatomy: Arc::clone(&anatomy), clusters });
                };
                let film = film(device, &scene, &centered.line, (setup, folder), clock, go)?;
                Ok(Flown { anatomy, film })
            },
        );
        clock.take(other);
        Ok((flown?, aside))
    }

    /// Centerline and surface of a lumen; the route is searched beside the surface, and the volume
    /// goes when that is there.
    fn anatomy(
        &self,
        device: &mut Device,
        Subject { volume, recipe, lumen }: Subject<'_>,
        clock: &mut Clock,
    ) -> Result<Anatomy, CliError> {
        let mode = self.mode.main();
        let settings = self.settings(mode)?;
        let grey = FromArgs::of(&self.from)?.grey;
        let options = self.surface.options(grey, automatic(mode), track_from(recipe))?;
        let finish = |device: &mut Device, clock: &mut Clock| -> Result<_, CliError> {
            let (input, wall) = beside(
                || InputReport::of(&volume),
                || wall(device, &volume, &recipe.window, lumen, options, clock),
            );
            drop(volume);
            Ok((wall?, input))
        };
        if mode == Mode::Paper {
            let (fields, centered) = center(device, lumen, mode, settings, clock)?;
            let (wall, input) = finish(device, clock)?;
            return Ok(Anatomy { distance: fields.distance, centered, wall, input });
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
        let (routed, (seen, (wall, input))) = (routed?, seen?);
        let centered = Centered::new(lumen, &fields, routed, seen);
        Ok(Anatomy { distance: fields.distance, centered, wall, input })
    }
}

/// What is done beside a chain hears this of it.
pub struct Heard(Receiver<Begun>);

/// A chain that has come to its frames.
pub struct Begun {
    pub anatomy: Arc<Anatomy>,
    /// Of its wall, if that is how it is drawn.
    pub clusters: Option<Arc<Clusters>>,
}

impl Heard {
    /// Waits until files may be written; `None` when there will be no frames, so that nothing
    /// should be.
    pub fn go(self) -> Option<Begun> {
        // A chain that has failed has let go of its end.
        self.0.recv().ok()
    }
}

impl Flown {
    /// The report of this chain.
    pub fn report(self, (lumen, found): (&Lumen, &Found), device: &str, clock: &Clock) -> Report {
        let Anatomy { centered, wall, input, .. } = &*self.anatomy;
        Report {
            input: Some(input.clone()),
            lumen: Some(LumenReport::of(lumen, found)),
            surface: Some(SurfaceReport::of(wall.topology, wall.mesh.area_mm2())),
            centerline: Some(CenterlineReport::of(centered, lumen)),
            lod: Some(self.film.lod),
            frames: Some(self.film.report),
            warnings: self.film.warnings,
            ..Report::new(device, clock)
        }
    }
}
