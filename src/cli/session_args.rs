//! Flags of a whole session, for `record` and `run`.

use std::path::{Path, PathBuf};

use super::CliError;
use super::centerline::PathArgs;
use super::frames::FrameArgs;
use super::global::{Global, MASKS};
use super::lumen_args::{LumenArgs, split_labels};
use super::mode::ModeArg;
use super::surface_args::SurfaceArgs;
use crate::formats::{VideoWriter, shown};
use crate::session::{CenterlineSettings, RUN_FILES, Recording, Session, Settings, is_frame_file};

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
            mode: self.mode.mode,
            lumen: self.lumen.settings()?,
            centerline: CenterlineSettings { tree, ..self.path.settings()? },
            wall: self.surface.settings()?,
            levels: self.frames.levels.settings()?,
            flight: self.frames.settings()?,
            ..global.settings()
        };
        Ok(Session::new(source, settings)?)
    }

    /// Checks, before anything is computed, where the files beside the frames go: into a folder
    /// that is there or will be, and not in the place of an input or of another output; and that no
    /// output takes the place of an input.
    ///
    /// * `frames`: the folder of the frames, the one of the outputs or within it.
    pub fn check_files(&self, global: &Global, frames: &Path) -> Result<(), CliError> {
        let within = |folder: &Path, name| place(&folder.join(name));
        // Through a file in it, so that a link to a folder is followed.
        let folder_of = |folder: &Path| within(folder, "file").parent().map(Path::to_owned);
        let (out, frames_at) = (folder_of(&self.out), folder_of(frames));
        let mask = self.lumen.mask.as_deref().map(|spec| split_labels(spec).0);
        let inputs = self.input.iter().chain(&mask).chain(&self.frames.path);
        let mut taken: Vec<PathBuf> = Vec::new();
        if frames != self.out {
            taken.extend(RUN_FILES.map(|name| within(&self.out, name)));
        }
        for input in inputs {
            let at = place(input);
            if taken.contains(&at) {
                let why = "an output of this run would take the place of this input";
                return Err(CliError::Usage(format!("{}: {why}", shown(input))));
            }
            taken.push(at);
        }
        self.lumen.core.iter().try_for_each(|file| global.check_name(file, MASKS))?;
        self.lumen.explain.iter().try_for_each(|file| global.check_name(file, &[".png"]))?;
        let files = [
            ("--write-path", &self.frames.write_path),
            ("--video", &self.frames.video),
            ("--core", &self.lumen.core),
            ("--explain", &self.lumen.explain),
        ];
        for (flag, file) in files.into_iter().filter_map(|(flag, f)| Some((flag, f.as_ref()?))) {
            let at = place(file);
            let folder = at.parent().unwrap_or(&at);
            let name = at.file_name().and_then(|n| n.to_str()).unwrap_or_default();
            let fail = |why: &str| Err(CliError::Usage(format!("{flag} {}: {why}", shown(file))));
            if !folder.is_dir() && !out.as_ref().is_some_and(|out| folder.starts_with(out)) {
                return fail("there is no such folder");
            }
            if taken.contains(&at) || (frames_at.as_deref() == Some(folder) && is_frame_file(name))
            {
                return fail("an input or another output of this run has that place");
            }
            taken.push(at);
        }
        // The last check: on a machine without ffmpeg errors of the command line are reported first.
        let check = |video| VideoWriter::check(video, self.frames.fps);
        Ok(self.frames.video.as_deref().map_or(Ok(()), check)?)
    }

    /// Returns the files of a recording with its frames in `folder`.
    pub fn recording(&self, folder: PathBuf) -> Recording {
        Recording {
            frames: folder,
            video: self.frames.video.clone().map(|v| (v, self.frames.fps)),
            camera_path: self.frames.write_path.clone(),
            ..Recording::default()
        }
    }
}

/// A file's place, by which two names of it compare: links of the folders that are there are
/// followed.
fn place(path: &Path) -> PathBuf {
    let whole = std::path::absolute(path).unwrap_or_else(|_| path.to_owned());
    for folder in whole.ancestors().skip(1) {
        if let (Ok(real), Ok(rest)) = (folder.canonicalize(), whole.strip_prefix(folder)) {
            return real.join(rest);
        }
    }
    whole
}
