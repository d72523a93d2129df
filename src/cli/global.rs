//! Flags every command takes.

use std::io::Write as _;
use std::path::Path;

use tracing_subscriber::layer::{Layer as _, SubscriberExt as _};
use tracing_subscriber::util::SubscriberInitExt as _;

use super::{CliError, memory_limit};
use crate::device::{Device, DeviceChoice};
use crate::formats::{atomic_file, check_data_file, shown, to_json};
use crate::session::{Settings, peak_memory_mb, refuse_above};

/// Global flags.
#[derive(Clone, Debug, clap::Args)]
pub struct Global {
    /// Device that computes: auto, cpu, gpu, gpu:N or gpu:NAME, a part of its name
    ///
    /// auto takes the first real GPU for everything; without one the CPU computes and software
    /// Vulkan only draws. gpu takes software Vulkan too.
    #[arg(long, global = true, default_value = "auto", value_name = "auto|cpu|gpu|gpu:N|gpu:NAME")]
    pub device: DeviceChoice,
    /// Threads of the CPU and of software Vulkan (default: all cores)
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=1024))]
    pub threads: Option<u32>,
    /// Print the result as JSON on standard output, and nothing else there
    #[arg(long, global = true)]
    pub json: bool,
    /// Say more (repeat for still more)
    #[arg(short, long, global = true, action = clap::ArgAction::Count)]
    pub verbose: u8,
    /// Say only errors
    #[arg(short, long, global = true, conflicts_with = "verbose")]
    pub quiet: bool,
    /// Refuse what would take more memory, MB, and end a run that does
    #[arg(long, global = true, value_name = "MB")]
    pub max_memory: Option<u64>,
    /// Compute N times after a warm-up and report the median; files are written once
    #[arg(long, global = true, value_name = "N", value_parser = clap::value_parser!(u32).range(1..=10_000))]
    pub repeat: Option<u32>,
}

impl Global {
    /// Sets up threads, logging and Ctrl-C before anything else runs.
    pub fn prepare(&self) -> Result<(), CliError> {
        let mut unset = None;
        if let Some(n) = self.threads {
            // Software Vulkan reads its thread count when the first instance is made.
            unset = crate::vk::set_lavapipe_threads(n as usize).err();
            rayon::ThreadPoolBuilder::new()
                .num_threads(n as usize)
                .build_global()
                .map_err(|e| CliError::System(e.to_string()))?;
        }
        let level = match (self.quiet, self.verbose) {
            (true, _) => tracing::Level::ERROR,
            (_, 0) => tracing::Level::WARN,
            (_, 1) => tracing::Level::INFO,
            (_, 2) => tracing::Level::DEBUG,
            _ => tracing::Level::TRACE,
        };
        // Our own messages alone: what libraries say of a file may repeat its text.
        let ours = tracing_subscriber::filter::Targets::new().with_target("intima", level);
        let lines = tracing_subscriber::fmt::layer()
            .with_writer(std::io::stderr)
            .without_time()
            .with_target(false)
            .with_filter(ours);
        let _ = tracing_subscriber::registry().with(lines).try_init();
        if let Some(e) = unset {
            tracing::info!("{e}");
        }
        crate::vk::survive_file_size_limit();
        if let Some(allowed_mb) = self.max_memory {
            memory_limit::watch(self, allowed_mb);
        }
        ctrlc::set_handler(|| {
            #[cfg(feature = "window")]
            if crate::app::close_window() {
                return;
            }
            atomic_file::discard_unfinished();
            crate::vk::exit_now(130);
        })
        .map_err(|e| CliError::System(e.to_string()))
    }

    /// Checks an output's folder and extension before anything is computed.
    pub fn check_output(&self, path: &Path, extensions: &[&str]) -> Result<(), CliError> {
        self.check_name(path, extensions)?;
        let folder = path.parent().filter(|p| !p.as_os_str().is_empty());
        match folder {
            Some(f) if !f.is_dir() => {
                Err(CliError::Usage(format!("{}: there is no folder {}", shown(path), shown(f))))
            }
            _ => Ok(()),
        }
    }

    /// Checks that the name of an output has one of these extensions.
    pub fn check_name(&self, path: &Path, extensions: &[&str]) -> Result<(), CliError> {
        let name = path.file_name().unwrap_or_default().to_string_lossy().to_lowercase();
        if !extensions.iter().any(|e| name.len() > e.len() && name.ends_with(e)) {
            return Err(CliError::Usage(format!(
                "{}: the output is one of {}",
                shown(path),
                extensions.join(", ")
            )));
        }
        if is_segments(path) && !extensions.contains(&SEGMENTS) {
            let why = "a .seg.nrrd holds segments, which `intima segment` and --core write";
            return Err(CliError::Usage(format!("{}: {why}; use .nrrd", shown(path))));
        }
        Ok(check_data_file(path)?)
    }

    /// Settings that every session takes from here.
    pub fn settings(&self) -> Settings {
        Settings {
            device: self.device,
            threads: self.threads.map(|n| n as usize),
            max_memory_mb: self.max_memory,
            ..Settings::default()
        }
    }

    /// Says how much memory a command will need, and refuses what is more than allowed.
    pub fn check_memory(&self, bytes: u64, what: &'static str) -> Result<(), CliError> {
        tracing::info!("about {} MB will be needed", bytes / 1_000_000);
        Ok(refuse_above(self.max_memory, bytes, what)?)
    }

    /// Whether an estimate of memory is asked for.
    pub fn asks_memory(&self) -> bool {
        self.max_memory.is_some() || tracing::enabled!(tracing::Level::INFO)
    }

    /// Opens the device chosen, for commands that drive no session.
    pub fn open(&self) -> Result<Device, CliError> {
        let device = Device::open(self.device)?;
        tracing::info!("computing on {}", device.name());
        Ok(device)
    }

    /// Prints a line for people unless `--json` or `-q` ask for silence. Where the reader has closed
    /// the pipe, nothing is printed, and the command goes on to write its files.
    pub fn say(&self, line: impl std::fmt::Display) -> Result<(), CliError> {
        if self.json || self.quiet {
            return Ok(());
        }
        match writeln!(std::io::stdout(), "{line}").map_err(CliError::Output) {
            Err(e) if e.is_broken_pipe() => Ok(()),
            said => said,
        }
    }

    /// Prints a warning on standard error, unless quiet.
    pub fn warn(&self, line: impl std::fmt::Display) {
        tracing::warn!("{line}");
    }

    /// Prints the JSON result with the most memory that was held, if asked for.
    pub fn answer(&self, value: &impl serde::Serialize) -> Result<(), CliError> {
        #[derive(serde::Serialize)]
        struct Answer<'a, T> {
            /// Fields of the result.
            #[serde(flatten)]
            value: &'a T,
            /// Largest resident size so far, MB.
            peak_memory_mb: f64,
        }
        self.answer_only(&Answer { value, peak_memory_mb: peak_memory_mb() })
    }

    /// Prints the JSON result and nothing beside it, if asked for: a list, or a report that says
    /// how much memory there was.
    pub fn answer_only(&self, value: &impl serde::Serialize) -> Result<(), CliError> {
        if !self.json {
            return Ok(());
        }
        let line = to_json(value).map_err(|e| CliError::System(e.to_string()))?;
        writeln!(std::io::stdout(), "{line}").map_err(CliError::Output)
    }

    /// Prints why there is no result as JSON, if asked for.
    pub fn refuse(&self, error: &CliError) {
        // A cohort has given its answer: each case with its own reason.
        if self.json && !matches!(error, CliError::CasesFailed { .. }) {
            let answer = serde_json::json!({ "error": {
                "reason": error.reason(),
                "message": error.to_string(),
                "exit_code": error.exit_code(),
            }});
            // Standard error has the message; a closed standard output changes nothing.
            let _ = writeln!(std::io::stdout(), "{answer}");
        }
    }
}

/// Extensions of volumes that are written.
pub const VOLUMES: &[&str] = &[".nrrd", ".nii", ".nii.gz", ".mha", ".mhd"];
/// Extension of a segmentation of 3D Slicer.
pub const SEGMENTS: &str = ".seg.nrrd";
/// Extensions of masks that are written.
pub const MASKS: &[&str] = &[".nrrd", ".nii", ".nii.gz", ".mha", ".mhd", SEGMENTS];
/// Extensions of meshes that are written.
pub const MESHES: &[&str] = &[".ply", ".stl", ".obj", ".vtp", ".glb"];
/// Extensions of centerlines that are written.
pub const LINES: &[&str] = &[".vtp", ".csv", ".swc", ".mrk.json"];

/// Whether a file is a segmentation of 3D Slicer by its name.
pub fn is_segments(path: &Path) -> bool {
    path.to_string_lossy().to_lowercase().ends_with(SEGMENTS)
}
