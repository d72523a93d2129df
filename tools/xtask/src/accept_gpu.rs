//! `cargo xtask accept-gpu`: the acceptance of a GPU (tools/gpu/accept.sh), here or on another machine.

use std::fs;
use std::path::{Path, PathBuf};

use crate::TaskError;
use crate::process::{cargo, command, output, root, run};

/// Folder of the pack.
const PACK: &str = "out/accept-gpu";
/// Volumes of the pack, where there are some, each with its name there.
const VOLUMES: [(&str, &str); 2] =
    [("colon_label_1.nii.gz", "colon.nii.gz"), ("airway_label_lidc1.nii.gz", "airway.nii.gz")];

/// `cargo xtask accept-gpu [--pack] [SCRIPT'S FLAGS]`: builds the pack and runs it, or leaves it to be
/// taken to a machine with a card.
pub fn accept_gpu(args: &[&str]) -> Result<(), TaskError> {
    let (packs_only, rest) = match args {
        ["--pack"] => (true, &[][..]),
        rest => (false, rest),
    };
    pack()?;
    if packs_only {
        println!("{PACK} is whole: run {PACK}/accept.sh on the machine with the card");
        return Ok(());
    }
    let out = format!("{PACK}/result");
    run(&mut command(&format!("{PACK}/accept.sh"), &[&["--out", &out], rest].concat()))
}

/// Everything that the script needs, in one folder.
fn pack() -> Result<(), TaskError> {
    let folder = root().join(PACK);
    // What an acceptance left stays.
    let _ = fs::remove_dir_all(folder.join("root"));
    fs::create_dir_all(&folder).map_err(failed(&folder))?;
    run(&mut cargo(&["build", "--release", "--locked", "--features", "faults"]))?;
    let tests = built_tests()?;
    // Where cargo put the tests' program, in the folder above.
    let release = tests.ancestors().nth(2).unwrap_or(&tests).to_owned();
    let target = release.join("intima");
    let script = root().join("tools/gpu/accept.sh");
    for (from, to) in [(&target, "intima"), (&tests, "gpu-tests"), (&script, "accept.sh")] {
        copy(from, &folder.join(to))?;
    }
    for name in ["intima", "gpu-tests"] {
        run(&mut command("strip", &[&format!("{PACK}/{name}")]))?;
    }
    for part in ["tests/golden", "tests/fixtures"] {
        copy_files(&root().join(part), &folder.join("root").join(part))?;
    }
    for (from, to) in VOLUMES {
        let from = root().join("../shared/data").join(from);
        if from.exists() {
            copy(&from, &folder.join(to))?;
        }
    }
    // The script plants faults where the program has them.
    fs::write(folder.join("has-faults"), "").map_err(failed(&folder))
}

/// Builds the tests of the device; their program.
fn built_tests() -> Result<PathBuf, TaskError> {
    let args = ["test", "--release", "--locked", "--features", "faults", "--test", "gpu"];
    let built = [&args[..], &["--no-run", "--message-format", "json"]].concat();
    let messages = output(&mut cargo(&built))?;
    program_of(&messages).ok_or_else(|| TaskError::Failed("the tests have no program".into()))
}

/// Path of the last program that cargo says it built.
fn program_of(messages: &str) -> Option<PathBuf> {
    let of = |line: &str| Some(line.split("\"executable\":\"").nth(1)?.split('"').next()?.into());
    messages.lines().rev().find_map(of)
}

/// Copies the files of a folder and of those in it.
fn copy_files(from: &Path, to: &Path) -> Result<(), TaskError> {
    fs::create_dir_all(to).map_err(failed(to))?;
    for entry in fs::read_dir(from).map_err(failed(from))?.flatten() {
        let (from, to) = (entry.path(), to.join(entry.file_name()));
        if from.is_dir() { copy_files(&from, &to)? } else { copy(&from, &to)? }
    }
    Ok(())
}

fn copy(from: &Path, to: &Path) -> Result<(), TaskError> {
    fs::copy(from, to).map(drop).map_err(failed(from))
}

fn failed(path: &Path) -> impl Fn(std::io::Error) -> TaskError {
    move |e| TaskError::Failed(format!("{}: {e}", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_program_of_a_build_is_found_in_what_cargo_prints() {
        let messages = "{\"reason\":\"a\",\"executable\":null}\n\
            {\"reason\":\"b\",\"executable\":\"/x/gpu-12\"}\n{\"reason\":\"build-finished\"}";
        assert_eq!(program_of(messages), Some("/x/gpu-12".into()));
        assert_eq!(program_of(""), None);
    }
}
