//! intima beside what one would use instead: builds, installs the peers, and lets Python measure.

use crate::Stop;
use crate::run::{cargo, command, loudly, on_path, quietly, root};
use crate::setup::{For, setup};
use std::path::{Path, PathBuf};

const SCRIPT: &str = "tools/compare/compare.py";
const WANTED: &str = "tools/compare/requirements.txt";
const HELP: &str = "\
usage: cargo xtask compare [FLAGS]

  --stages A,B         only these (default: all; a wrong name lists them)
  --sizes quick|full   half the grid, or all of it (default: full)
  --repeat N           rounds, in which all programs of a case take turns (default: 5)
  --vmtk PYTHON        an interpreter that can import vmtk
  --data DIR           real volumes, for times
  --out DIR            where everything lands (default: out/compare)
  --python PATH        an interpreter that has tools/compare/requirements.txt installed
  --readme             also put the short table into README.md
  --render             only write table and plot anew from what is in --out
";

/// `cargo xtask compare [--python PATH] [ARGUMENTS OF compare.py]`
pub fn compare(args: &[&str]) -> Result<(), Stop> {
    if args.iter().any(|a| ["-h", "--help"].contains(a)) {
        print!("{HELP}");
        return Ok(());
    }
    let (python, rest) = split(args)?;
    if let Err(Stop::NoDevice(why) | Stop::Failed(why)) = setup(For::Running) {
        eprintln!("the flight will be missing from the comparison: {why}");
    }
    loudly(&mut cargo(&["build", "--release", "--locked"]))?;
    let python = match python {
        Some(given) => given.to_owned(),
        None => peers()?.to_string_lossy().into_owned(),
    };
    loudly(&mut command(&python, &[&[SCRIPT, "--intima", &program()], &rest[..]].concat()))
}

/// Where the release program is built.
pub fn program() -> String {
    let program = target().join("release").join(format!("intima{}", std::env::consts::EXE_SUFFIX));
    program.to_string_lossy().into_owned()
}

/// The interpreter asked for, and what is left for the script.
pub fn split<'a>(args: &[&'a str]) -> Result<(Option<&'a str>, Vec<&'a str>), Stop> {
    let Some(at) = args.iter().position(|a| *a == "--python") else {
        return Ok((None, args.to_vec()));
    };
    let Some(given) = args.get(at + 1) else {
        return Err(Stop::Usage("--python wants the path of an interpreter".into()));
    };
    Ok((Some(*given), [&args[..at], &args[at + 2..]].concat()))
}

/// Where cargo builds.
fn target() -> PathBuf {
    root().join(std::env::var_os("CARGO_TARGET_DIR").unwrap_or("target".into()))
}

/// Python with every peer in it, installed if that has not been done for these very versions.
fn peers() -> Result<PathBuf, Stop> {
    let home = target().join("compare-venv");
    let bin = if cfg!(windows) { "Scripts" } else { "bin" };
    let python = home.join(bin).join(format!("python{}", std::env::consts::EXE_SUFFIX));
    let (wanted, done) = (root().join(WANTED), home.join("installed.txt"));
    let read = |path: &Path| std::fs::read_to_string(path).ok();
    if read(&wanted).is_some() && read(&wanted) == read(&done) {
        return Ok(python);
    }
    let system = system_python()?;
    let folder = home.to_string_lossy().into_owned();
    loudly(&mut command(system, &["-m", "venv", &folder])).map_err(|_| missing("venv"))?;
    let venv = python.to_string_lossy().into_owned();
    if !quietly(&mut command(&venv, &["-m", "pip", "--version"])) {
        return Err(missing("pip"));
    }
    loudly(&mut command(&venv, &["-m", "pip", "install", "--quiet", "-r", WANTED]))?;
    std::fs::copy(&wanted, &done).map_err(|e| Stop::Failed(format!("{}: {e}", done.display())))?;
    Ok(python)
}

/// A Python of the system that is new enough.
pub fn system_python() -> Result<&'static str, Stop> {
    let found = ["python3", "python"].into_iter().find(|p| on_path(p) && fits(p));
    found.ok_or_else(|| Stop::Failed(NO_PYTHON.into()))
}

/// Whether it is of a version for which all the pinned peers have wheels.
fn fits(python: &str) -> bool {
    quietly(&mut command(python, &["-c", "import sys; sys.exit(sys.version_info < (3, 11))"]))
}

const NO_PYTHON: &str = "no Python 3.11 or newer on PATH; install one with its venv and pip (on Debian \
and Ubuntu: `apt-get install python3 python3-venv python3-pip`), or name one with --python";

fn missing(module: &str) -> Stop {
    Stop::Failed(format!(
        "Python is here without `{module}`; on Debian and Ubuntu: \
         `apt-get install python3-venv python3-pip`. Or name an interpreter that has \
         {WANTED} installed, with --python"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_interpreter_is_taken_out_of_the_arguments() {
        let (python, rest) =
            split(&["--stages", "grow", "--python", "p", "--repeat", "3"]).unwrap();
        assert_eq!((python, rest), (Some("p"), vec!["--stages", "grow", "--repeat", "3"]));
        assert_eq!(split(&["--readme"]).unwrap(), (None, vec!["--readme"]));
        assert!(matches!(split(&["--python"]), Err(Stop::Usage(_))));
    }

    #[test]
    fn what_is_named_here_exists() {
        for file in [SCRIPT, WANTED] {
            assert!(root().join(file).is_file(), "{file}");
        }
    }

    #[test]
    fn every_peer_is_pinned() {
        let text = std::fs::read_to_string(root().join(WANTED)).unwrap();
        let mut lines = text.lines().filter(|l| !l.starts_with('#')).peekable();
        assert!(lines.peek().is_some());
        lines.for_each(|l| assert!(l.contains("=="), "{l}"));
    }

    #[test]
    fn the_readme_has_a_place_for_the_table() {
        let script = std::fs::read_to_string(root().join("tools/compare/report.py")).unwrap();
        let marks = script.lines().find_map(|l| l.strip_prefix("MARKS = ")).unwrap();
        let readme = std::fs::read_to_string(root().join("README.md")).unwrap();
        let found: Vec<_> = marks.split('"').skip(1).step_by(2).map(|m| readme.find(m)).collect();
        assert!(found.len() == 2 && found[0].is_some() && found[0] < found[1], "{found:?}");
    }

    #[test]
    fn what_is_missing_is_said_with_a_way_out() {
        let Stop::Failed(text) = missing("venv") else { panic!("another kind") };
        assert!(text.contains("`venv`") && text.contains("--python"), "{text}");
    }
}
