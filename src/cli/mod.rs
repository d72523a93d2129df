//! The command line: one file a subcommand. This room parses, prints and chooses exit codes; what
//! it calls is in the rooms above.

mod bench;
mod bids;
mod centerline;
mod convert;
mod devices;
mod dicom_args;
mod distance;
mod error;
mod fair;
#[cfg(feature = "window")]
mod fly;
mod frames;
mod generate;
mod global;
mod hessian;
mod info;
mod lumen_args;
mod memory_limit;
mod mode;
mod phantom;
mod progress;
mod record;
mod repeat;
mod run;
mod segment;
mod session_args;
mod simplify;
mod surface;
mod surface_args;
mod version;

pub use error::CliError;

use std::process::ExitCode;

use clap::{CommandFactory, Parser, Subcommand};

use crate::formats::{shown, shown_lines};

use global::Global;

/// Fly through a hollow organ inside a CT or MR volume.
///
/// Research and education only. Not a medical device. Not for diagnosis.
#[derive(Debug, Parser)]
#[command(name = "intima", version, long_version = version::long(), about, long_about)]
#[command(max_term_width = 100)]
pub struct Cli {
    #[command(flatten)]
    global: Global,
    #[command(subcommand)]
    command: CliCommand,
}

#[derive(Debug, Subcommand)]
enum CliCommand {
    /// Describe a volume: series, dimensions, spacing, direction, range
    Info(info::Args),
    /// Write a volume in another format, geometry kept
    Convert(convert::Args),
    /// Vulkan devices and what each can do
    Devices,
    /// Write an analytic phantom
    Phantom(phantom::Args),
    /// Write the lumen: 0 external, 1 internal, 2 boundary
    Segment(segment::Args),
    /// Write the exact distance to the wall, mm
    Distance(distance::Args),
    /// Write a Hessian eigen-analysis of the distance field or the grey values
    Hessian(hessian::Args),
    /// Write the surface of the lumen with smooth normals
    Surface(surface::Args),
    /// Smooth the normals of any mesh; vertices do not move
    Fair(fair::Args),
    /// Simplify any mesh by half-edge collapse
    Simplify(simplify::Args),
    /// Write the centerline: a path, or a tree of all branches
    Centerline(centerline::Args),
    /// Write frames of a flight
    Record(record::Args),
    /// Everything above in one folder
    Run(run::Args),
    /// Everything for each scan of a BIDS dataset or a plain folder, resumed where it stopped
    Bids(Box<bids::Args>),
    /// Open a window and fly by hand
    #[cfg(feature = "window")]
    Fly(fly::Args),
    #[cfg(not(feature = "window"))]
    #[command(hide = true)]
    Fly(NoWindow),
    /// Time kernels and stages on each device
    Bench(bench::Args),
    /// Print shell completions
    Completions(generate::CompletionArgs),
    /// Print the manual pages, or write them into a folder
    Man(generate::ManArgs),
}

/// Arguments of `fly` in a build without the window: any arguments are taken.
#[cfg(not(feature = "window"))]
#[derive(Debug, clap::Args)]
struct NoWindow {
    #[arg(trailing_var_arg = true, allow_hyphen_values = true)]
    _rest: Vec<std::ffi::OsString>,
}

/// The whole grammar, for completions and tests.
pub fn command() -> clap::Command {
    Cli::command()
}

/// Parses the process's arguments and runs them.
pub fn main() -> ExitCode {
    main_with(std::env::args_os())
}

/// Parses arguments (the program's name first) and runs them.
pub fn main_with(args: impl IntoIterator<Item = std::ffi::OsString>) -> ExitCode {
    let args: Vec<_> = args.into_iter().collect();
    let cli = match Cli::try_parse_from(&args) {
        Ok(cli) => cli,
        Err(e) => {
            print_usage_error(&e, &args);
            return ExitCode::from(if e.use_stderr() { 2 } else { 0 });
        }
    };
    let Cli { global, command } = cli;
    let outcome = global.prepare().and_then(|()| command.run(&global));
    // None without validation (INTIMA_VALIDATE).
    let said = crate::vk::all_validation_messages();
    said.iter().for_each(|message| eprintln!("intima: validation: {message}"));
    let code = match outcome {
        Ok(()) => 0,
        // A reader that has seen enough closes the pipe; that is not our failure.
        Err(e) if e.is_broken_pipe() => 0,
        Err(e) => {
            eprintln!("intima: {}", for_terminal(&e.to_string(), &args));
            global.refuse(&e);
            e.exit_code()
        }
    };
    if said.is_empty() {
        return ExitCode::from(code);
    }
    eprintln!("intima: failed: {} message(s) of Vulkan's validation, see above", said.len());
    // An error keeps its own code.
    ExitCode::from(code.max(1))
}

/// Prints what is wrong with the arguments. Those with control characters are parsed again with
/// their escapes, as the parser takes some of them away before it repeats an argument.
fn print_usage_error(error: &clap::Error, args: &[std::ffi::OsString]) {
    let escaped: Vec<_> = args.iter().map(|arg| shown(arg.as_ref())).collect();
    if args.iter().zip(&escaped).all(|(arg, escaped)| arg == escaped.as_str()) {
        return drop(error.print());
    }
    match Cli::try_parse_from(&escaped) {
        Err(error) => drop(error.print()),
        Ok(_) => eprint!("{}", for_terminal(&error.render().to_string(), args)),
    }
}

/// A text with its lines, and with the control characters and line ends of arguments, which names
/// of files may hold, as escapes.
fn for_terminal(text: &str, args: &[std::ffi::OsString]) -> String {
    let mut text = text.to_owned();
    for arg in args {
        let (arg, escaped) = (arg.to_string_lossy(), shown(arg.as_ref()));
        if *arg != escaped {
            text = text.replace(&*arg, &escaped);
        }
    }
    shown_lines(&text)
}

impl CliCommand {
    fn run(self, global: &Global) -> Result<(), CliError> {
        match self {
            Self::Info(a) => a.run(global),
            Self::Convert(a) => a.run(global),
            Self::Devices => devices::run(global),
            Self::Phantom(a) => a.run(global),
            Self::Segment(a) => a.run(global),
            Self::Distance(a) => a.run(global),
            Self::Hessian(a) => a.run(global),
            Self::Surface(a) => a.run(global),
            Self::Fair(a) => a.run(global),
            Self::Simplify(a) => a.run(global),
            Self::Centerline(a) => a.run(global),
            Self::Record(a) => a.run(global),
            Self::Run(a) => a.run(global),
            Self::Bids(a) => a.run(global),
            #[cfg(feature = "window")]
            Self::Fly(a) => a.run(global),
            #[cfg(not(feature = "window"))]
            Self::Fly(_) => Err(CliError::Usage(
                "this build has no window; the feature `window` builds it".into(),
            )),
            Self::Bench(a) => a.run(global),
            Self::Completions(a) => a.run(),
            Self::Man(args) => args.run(),
        }
    }
}
