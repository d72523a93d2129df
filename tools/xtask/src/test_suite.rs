//! `cargo xtask test`: every test, with Vulkan required and its validation fatal.

use crate::process::{cargo, root, run};
use crate::setup::{Purpose, setup};
use crate::{TaskError, timings, vulkan};
use std::path::PathBuf;
use std::process::Command;

/// Features of what the tests build, beside the default ones.
pub const FEATURES: [&str; 2] = ["--features", "faults"];

/// The tests of every package.
pub const ALL: [&str; 5] = ["test", "--workspace", "--locked", FEATURES[0], FEATURES[1]];

/// `cargo xtask test [--gpu] [--timings | -- ARGUMENTS OF CARGO TEST]`
pub fn test(args: &[&str]) -> Result<(), TaskError> {
    let (gpu, rest) = match args {
        ["--gpu", rest @ ..] => (true, rest),
        rest => (false, rest),
    };
    let more = match rest {
        [] => &[],
        ["--", more @ ..] => more,
        ["--timings"] => {
            setup(Purpose::Testing)?;
            return timings::timings(gpu);
        }
        other => return Err(TaskError::Usage(format!("not for test: {}", other.join(" ")))),
    };
    setup(Purpose::Testing)?;
    run(with_device(&mut cargo(&[&ALL, more].concat()), gpu))
}

/// Requires a device and validation, and real volumes where they lie beside the checkout. The software driver is pinned unless a real GPU is wanted or
/// the caller has chosen one: its bytes are the same everywhere.
pub fn with_device(command: &mut Command, gpu: bool) -> &mut Command {
    command.env("INTIMA_REQUIRE_GPU", "1").env("INTIMA_VALIDATE", "1");
    if root().join("../shared/data").is_dir() {
        command.env("INTIMA_REQUIRE_DATA", "1");
    }
    let chosen = DRIVERS.iter().any(|v| std::env::var_os(v).is_some());
    if let Some(manifest) = pin(gpu, chosen, vulkan::detect().software) {
        command.envs(DRIVERS.map(|v| (v, &manifest)));
    }
    command
}

/// Variables that replace the loader's search; the second is the name before loader 1.3.207.
const DRIVERS: [&str; 2] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"];

fn pin(gpu: bool, chosen: bool, software: Option<PathBuf>) -> Option<PathBuf> {
    software.filter(|_| !gpu && !chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_software_driver_is_pinned_unless_a_driver_was_chosen() {
        let lvp = || Some(PathBuf::from("lvp_icd.json"));
        assert_eq!(pin(false, false, lvp()), lvp());
        assert_eq!(pin(true, false, lvp()), None);
        assert_eq!(pin(false, true, lvp()), None);
        assert_eq!(pin(false, false, None), None);
    }

    #[test]
    fn unknown_flags_are_usage_errors() {
        assert!(matches!(test(&["--fast"]), Err(TaskError::Usage(_))));
    }
}
