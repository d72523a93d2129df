//! Every test, with Vulkan required and its validation fatal.

use crate::run::{cargo, loudly};
use crate::setup::{For, setup};
use crate::{Stop, check, vulkan};
use std::path::PathBuf;
use std::process::Command;

/// `cargo xtask test [--gpu] [-- ARGUMENTS OF CARGO TEST]`
pub fn test(args: &[&str]) -> Result<(), Stop> {
    let (gpu, rest) = match args {
        ["--gpu", rest @ ..] => (true, rest),
        rest => (false, rest),
    };
    let more = match rest {
        [] => &[],
        ["--", more @ ..] => more,
        other => return Err(Stop::Usage(format!("not for test: {}", other.join(" ")))),
    };
    setup(For::Testing)?;
    check::check()?;
    let all = ["test", "--workspace", "--locked", "--features", "faults"];
    loudly(with_device(&mut cargo(&[&all, more].concat()), gpu))
}

/// What the tests ask of their surroundings: a device that is there, and validation. The software
/// driver is pinned unless a real GPU is wanted or the caller has chosen: its bytes are the same
/// everywhere, and hardware drivers installed without hardware only add noise.
pub fn with_device(command: &mut Command, gpu: bool) -> &mut Command {
    command.env("INTIMA_REQUIRE_GPU", "1").env("INTIMA_VALIDATE", "1");
    let chosen = DRIVERS.iter().any(|v| std::env::var_os(v).is_some());
    if let Some(manifest) = pin(gpu, chosen, vulkan::look().software) {
        command.envs(DRIVERS.map(|v| (v, &manifest)));
    }
    command
}

/// What the loader reads instead of searching; the second is what loaders before 1.3.207 know.
const DRIVERS: [&str; 2] = ["VK_DRIVER_FILES", "VK_ICD_FILENAMES"];

fn pin(gpu: bool, chosen: bool, software: Option<PathBuf>) -> Option<PathBuf> {
    software.filter(|_| !gpu && !chosen)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_software_driver_is_pinned_unless_someone_chose() {
        let lvp = || Some(PathBuf::from("lvp_icd.json"));
        assert_eq!(pin(false, false, lvp()), lvp());
        assert_eq!(pin(true, false, lvp()), None);
        assert_eq!(pin(false, true, lvp()), None);
        assert_eq!(pin(false, false, None), None);
    }

    #[test]
    fn what_cargo_test_should_get_stands_after_two_dashes() {
        assert!(matches!(test(&["--fast"]), Err(Stop::Usage(_))));
    }
}
