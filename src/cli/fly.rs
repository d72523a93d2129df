//! `intima fly`.

use std::path::PathBuf;

use super::CliError;
use super::centerline::PathArgs;
use super::frames::{LevelArgs, frame_size};
use super::global::Global;
use super::lumen_args::LumenArgs;
use super::surface_args::SurfaceArgs;
use crate::app::{self, AppError, Script, ViewerOptions, WindowOptions};
use crate::device::DeviceChoice;
use crate::flight::Frames;
use crate::formats::{atomic_file, shown};
use crate::session::{FlightSettings, Settings};
use crate::vk::{Choice, Gpu};

/// Cruising speed to begin with, mm/s, and poses a second of the flight's path.
const SPEED_MM_S: f64 = 20.0;
const POSES_PER_S: f64 = 25.0;

/// `intima fly INPUT LUMEN`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask, and for a window in which one is opened
    input: Option<PathBuf>,
    /// Bookmarks and how the window is set: read if it is there, saved as bookmarks are made
    #[arg(long, value_name = "FILE.json")]
    session: Option<PathBuf>,
    /// Another volume or session file, shown beside the first: the other position of the patient, or
    /// another date; its organ is that of the first
    #[arg(long, value_name = "FILE", requires = "input")]
    beside: Option<PathBuf>,
    /// Folder of what is exported from the window: pictures, the flight, the report
    #[arg(long, value_name = "DIR", default_value = "intima-export", conflicts_with = "script")]
    export: PathBuf,
    /// Folder of notes that are kept from one start to the next, and of the cases opened last; of a
    /// window $XDG_STATE_HOME/intima or ~/.local/state/intima, of a script none
    #[arg(long, value_name = "DIR")]
    state: Option<PathBuf>,
    /// Play this script instead of opening a window (intima.script/1)
    #[arg(long, value_name = "FILE.json", requires = "frames_out")]
    script: Option<PathBuf>,
    /// Folder for the pictures of the script
    #[arg(long, value_name = "DIR", requires = "script")]
    frames_out: Option<PathBuf>,
    /// Size of the window; a script has its own
    #[arg(long, value_name = "WxH", default_value = "1280x800")]
    size: String,
    #[command(flatten)]
    levels: LevelArgs,
    #[command(flatten)]
    path: PathArgs,
    #[command(flatten)]
    surface: SurfaceArgs,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl Args {
    /// Opens the window, or plays a script.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let size = frame_size(&self.size)?;
        if let Some(path) = &self.session {
            global.check_output(path, &[".json"])?;
        }
        let flight = FlightSettings {
            frames: Frames::Speed { mm_per_s: SPEED_MM_S, fps: POSES_PER_S },
            size,
            ..FlightSettings::default()
        };
        for (flag, file) in [("--explain", &self.lumen.explain), ("--core", &self.lumen.core)] {
            if file.is_some() {
                let why = format!("{flag} is not for the window; `intima segment` writes it");
                return Err(CliError::Usage(why));
            }
        }
        let settings = Settings {
            lumen: self.lumen.settings()?,
            centerline: self.path.settings()?,
            wall: self.surface.settings()?,
            levels: self.levels.settings()?,
            flight,
            ..global.settings()
        };
        let device = match settings.device {
            DeviceChoice::GpuAt(n) => Choice::Index(n),
            _ => Choice::Any,
        };
        let named = self.input.is_some() || self.lumen.mask.is_some();
        let source = named.then(|| self.lumen.source(self.input.as_deref())).transpose()?;
        let (session_file, beside) = (self.session.clone(), self.beside.clone());
        match (&self.script, &self.frames_out) {
            (Some(script), Some(folder)) => {
                let script = Script::read(script)?;
                let mut gpu = Gpu::open(device).map_err(AppError::from)?;
                let export = folder.clone();
                let state = self.state.clone();
                let options =
                    ViewerOptions { source, settings, session_file, beside, export, state };
                let pictures = app::play(&mut gpu, options, &script)?;
                global.say(format_args!("wrote {} pictures to {}", pictures.len(), shown(folder)))
            }
            _ => {
                let export = self.export.clone();
                let state = self.state.clone().or_else(atomic_file::user_state);
                let viewer =
                    ViewerOptions { source, settings, session_file, beside, export, state };
                Ok(app::open(WindowOptions { size, device, viewer })?)
            }
        }
    }
}
