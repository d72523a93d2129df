//! Flags of a whole session, for `record` and `run`.

use std::path::PathBuf;

use super::CliError;
use super::centerline::PathArgs;
use super::frames::FrameArgs;
use super::global::Global;
use super::lumen_args::LumenArgs;
use super::mode::ModeArg;
use super::surface_args::SurfaceArgs;
use crate::session::{CenterlineSettings, Recording, Session, Settings};

/// Flags of `record` and `run`.
#[derive(Debug, clap::Args)]
pub struct SessionArgs {
    /// Volume; may be left out with --mask
    pub input: Option<PathBuf>,
    /// Folder for the outputs; made if it is not there, and rid of the frames of an earlier flight
    #[arg(long, value_name = "DIR")]
    pub out: PathBuf,
    #[command(flatten)]
    pub mode: ModeArg,
    #[command(flatten)]
    pub frames: FrameArgs,
    #[command(flatten)]
    pub path: PathArgs,
    #[command(flatten)]
    pub surface: SurfaceArgs,
    #[command(flatten)]
    pub lumen: LumenArgs,
}

impl SessionArgs {
    /// Checks all flags and opens a session of them.
    pub fn session(&self, global: &Global) -> Result<Session, CliError> {
        let tree = self.path.tree || self.frames.route.is_some();
        self.mode.check(tree)?;
        let source = self.lumen.source(self.input.as_deref())?;
        let settings = Settings {
            mode: self.mode.main(),
            lumen: self.lumen.settings()?,
            centerline: CenterlineSettings { tree, ..self.path.settings()? },
            wall: self.surface.settings()?,
            levels: self.frames.levels.settings()?,
            flight: self.frames.settings()?,
            ..global.settings()
        };
        Ok(Session::new(source, settings)?)
    }

    /// Where frames go: into `folder`.
    pub fn recording(&self, folder: PathBuf, global: &Global) -> Recording {
        Recording {
            frames: folder,
            video: self.frames.video(global).map(|v| (v, self.frames.fps)),
            camera_path: self.frames.write_path.clone(),
        }
    }
}
