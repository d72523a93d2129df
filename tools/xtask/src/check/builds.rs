//! Builds that the tests do not make: the library alone, and the program as it is released. `cargo
//! check` finds their errors on metadata of the dependencies instead of their machine code.

use crate::TaskError;
use crate::process::{cargo, run};

/// Crates of the command line, which the library alone does without.
const CLI_CRATES: &[&str] =
    &["clap", "clap_complete", "clap_mangen", "ctrlc", "indicatif", "tracing-subscriber"];

/// The library without default features compiles, and depends on none of the command line's crates.
pub fn library() -> Result<(), TaskError> {
    let alone = ["--no-default-features", "--locked", "--package", "intima"];
    run(&mut cargo(&[&["check", "--lib"], &alone[..]].concat()))?;
    let listing = ["tree", "--edges", "normal", "--prefix", "none"];
    let out = cargo(&[&listing[..], &alone].concat()).output();
    let out = out.map_err(|e| TaskError::Failed(format!("`cargo tree` did not start: {e}")))?;
    if !out.status.success() {
        return Err(TaskError::Failed(format!("`cargo tree` ended with {}", out.status)));
    }
    match cli_crates(&String::from_utf8_lossy(&out.stdout))[..] {
        [] => Ok(()),
        ref found => Err(TaskError::Failed(format!("the library needs {}", found.join(", ")))),
    }
}

/// Program and examples as they are released: without planted faults, with JPEG of 12 bits.
pub fn released() -> Result<(), TaskError> {
    let targets = ["--package", "intima", "--locked", "--bins", "--examples"];
    run(&mut cargo(&[&["check"], &targets[..], &["--features", "jpeg-12"]].concat()))
}

/// Crates of the command line in a listing with one `name vVERSION` a line.
fn cli_crates(listing: &str) -> Vec<&'static str> {
    let names: Vec<_> = listing.lines().filter_map(|l| l.split(' ').next()).collect();
    CLI_CRATES.iter().copied().filter(|c| names.contains(c)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_library_that_needs_clap_is_caught() {
        let listing = "intima v0.1.0 (/x)\nglam v0.34.0\nclap v4.5.1\nclap_lex v0.7.0\n";
        assert_eq!(cli_crates(listing), ["clap"]);
        assert_eq!(cli_crates("intima v0.1.0\nglam v0.34.0 (*)\n"), [""; 0]);
    }
}
