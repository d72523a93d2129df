//! Tasks of the project, run as `cargo xtask TASK`.
//!
//! Standard library only, so that a clean clone gets to the first useful message in seconds.

mod accept_gpu;
mod bless;
mod check;
mod demo;
mod dist;
mod judge;
mod process;
mod setup;
mod test_suite;
mod timings;
mod vulkan;

use std::process::ExitCode;

const USAGE: &str = "\
usage: cargo xtask TASK

  demo           set up, build, and fly a phantom: everything lands in out/demo/
  test [--gpu]   set up and run every test, on software Vulkan unless --gpu
                 (what follows `--` goes to `cargo test`)
  test --timings every test, and the longest ten with their seconds
  check          what needs no device: format, lints, docs, builds, project rules
  check --rules  the project rules alone
  bless          write the golden frames anew; then look at them
  judge PART     intima from outside, in out/PART/: speed (beside other programs), walls
                 (beside known walls and grey values), pictures (beside VTK), growth (of time
                 and memory); `judge PART --help` has the flags, tools/judge/README.md the rest
  accept-gpu     proofs and times of a GPU on one page (docs/gpu-acceptance.md); `--pack` leaves
                 the pack in out/accept-gpu for a machine with a card
  dist           a release in out/dist/: archive, Debian package, container recipe, sums
                 (`--dirty` allows files that differ from the commit, and names the build so)
  setup          install a Vulkan loader and driver where none answer
  setup --test   the same, and what the tests need beside it
";

/// Why a task failed; each kind has an exit code.
#[derive(Debug)]
pub enum TaskError {
    /// A command or a rule failed.
    Failed(String),
    /// Bad arguments.
    Usage(String),
    /// No Vulkan, and it could not be installed.
    NoDevice(String),
}

fn main() -> ExitCode {
    let args: Vec<String> = std::env::args().skip(1).collect();
    let (code, message) = match dispatch(&args.iter().map(String::as_str).collect::<Vec<_>>()) {
        Ok(()) => return ExitCode::SUCCESS,
        Err(TaskError::Failed(m)) => (1, m),
        Err(TaskError::Usage(m)) => (2, format!("{m}\n\n{USAGE}")),
        Err(TaskError::NoDevice(m)) => (4, m),
    };
    eprintln!("xtask: {message}");
    ExitCode::from(code)
}

fn dispatch(args: &[&str]) -> Result<(), TaskError> {
    match args {
        ["demo"] => demo::demo(),
        ["test", rest @ ..] => test_suite::test(rest),
        ["check"] => check::check(),
        ["check", "--rules"] => check::rules(),
        ["judge", rest @ ..] => judge::judge(rest),
        ["accept-gpu", rest @ ..] => accept_gpu::accept_gpu(rest),
        ["dist", rest @ ..] => dist::dist(rest),
        ["bless"] => bless::bless(),
        ["setup"] => setup::setup(setup::Purpose::Running),
        ["setup", "--test"] => setup::setup(setup::Purpose::Testing),
        ["help" | "-h" | "--help"] => {
            print!("{USAGE}");
            Ok(())
        }
        [] => Err(TaskError::Usage("which task?".into())),
        other => Err(TaskError::Usage(format!("no such task: {}", other.join(" ")))),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_unknown_task_is_a_usage_error() {
        for args in [&[][..], &["polish"], &["check", "--fast"]] {
            assert!(matches!(dispatch(args), Err(TaskError::Usage(_))), "{args:?}");
        }
    }
}
