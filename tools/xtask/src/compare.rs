//! `cargo xtask compare`: builds intima, installs the peers and runs `tools/compare`.

use crate::TaskError;
use crate::process::{cargo, command, on_path, root, run, succeeds};
use crate::setup::{Purpose, setup};
use std::path::{Path, PathBuf};

const SCRIPT: &str = "tools/compare/compare.py";
const WANTED: &str = "tools/compare/requirements.txt";
const WANTED_VMTK: &str = "tools/compare/requirements-vmtk.txt";
const HELP: &str = "\
usage: cargo xtask compare [FLAGS]

  --stages A,B         only these (default: all; a wrong name lists them)
  --cases A,B          only inputs whose name holds A or B
  --sizes quick|full   half the grid, or all of it (default: full)
  --repeat N           rounds, in which all programs of a case take turns (default: 5)
  --without A,B        leave out rows whose program's name holds A or B
  --vmtk PYTHON        an interpreter with tools/compare/requirements-vmtk.txt installed
                       (default: one made of a Python 3.12 or newer, where there is one)
  --data DIR           real volumes (default with full sizes: ../shared/data, where it is)
  --out DIR            where everything lands (default: out/compare)
  --python PATH        an interpreter that has tools/compare/requirements.txt installed
  --intima PATH        this program instead of building one
  --readme             also put the short table into docs/comparison.md
  --render             only write table and plot anew from what is in --out
";

/// `cargo xtask compare [--python PATH] [--intima PATH] [ARGUMENTS OF compare.py]`
pub fn compare(args: &[&str]) -> Result<(), TaskError> {
    if args.iter().any(|a| ["-h", "--help"].contains(a)) {
        print!("{HELP}");
        return Ok(());
    }
    let (python, rest) = split(args)?;
    let (given, rest) = value("--intima", &rest)?;
    if let Err(TaskError::NoDevice(why) | TaskError::Failed(why)) = setup(Purpose::Running) {
        eprintln!("the flight will be missing from the comparison: {why}");
    }
    let intima = match given {
        Some(path) => absolute(path)?,
        None => {
            run(&mut cargo(&["build", "--release", "--locked"]))?;
            program()
        }
    };
    let python = match python {
        Some(given) => given.to_owned(),
        None => environment("compare-venv", WANTED, system_python()?)?,
    };
    let vmtk = if rest.contains(&"--vmtk") { None } else { vmtk() };
    let vmtk: Vec<&str> = vmtk.iter().flat_map(|python| ["--vmtk", python]).collect();
    let args = [&[SCRIPT, "--intima", &intima], &vmtk[..], &rest[..]].concat();
    run(&mut command(&python, &args))
}

/// A path as given, from where we were started: the script runs in the repository's root.
pub fn absolute(path: &str) -> Result<String, TaskError> {
    let found =
        std::fs::canonicalize(path).map_err(|e| TaskError::Failed(format!("{path}: {e}")))?;
    Ok(found.to_string_lossy().into_owned())
}

/// Where the release program is built.
pub fn program() -> String {
    let program = target().join("release").join(format!("intima{}", std::env::consts::EXE_SUFFIX));
    program.to_string_lossy().into_owned()
}

/// The interpreter asked for, and what is left for the script.
pub fn split<'a>(args: &[&'a str]) -> Result<(Option<&'a str>, Vec<&'a str>), TaskError> {
    value("--python", args)
}

/// The path after `flag`, and the other arguments.
pub fn value<'a>(
    flag: &str,
    args: &[&'a str],
) -> Result<(Option<&'a str>, Vec<&'a str>), TaskError> {
    let Some(at) = args.iter().position(|a| *a == flag) else {
        return Ok((None, args.to_vec()));
    };
    let Some(given) = args.get(at + 1) else {
        return Err(TaskError::Usage(format!("{flag} wants a path")));
    };
    Ok((Some(*given), [&args[..at], &args[at + 2..]].concat()))
}

/// Where cargo builds.
fn target() -> PathBuf {
    root().join(std::env::var_os("CARGO_TARGET_DIR").unwrap_or("target".into()))
}

/// The interpreter of an environment `name` made with `system`, with the packages of the file
/// `wanted` installed unless that has been done for these very versions.
pub fn environment(name: &str, wanted: &str, system: &str) -> Result<String, TaskError> {
    let home = target().join(name);
    let bin = if cfg!(windows) { "Scripts" } else { "bin" };
    let python = home.join(bin).join(format!("python{}", std::env::consts::EXE_SUFFIX));
    let python = python.to_string_lossy().into_owned();
    let (list, done) = (root().join(wanted), home.join("installed.txt"));
    let read = |path: &Path| std::fs::read_to_string(path).ok();
    if read(&list).is_some() && read(&list) == read(&done) {
        return Ok(python);
    }
    let folder = home.to_string_lossy().into_owned();
    run(&mut command(system, &["-m", "venv", &folder])).map_err(|_| missing("venv", wanted))?;
    if !succeeds(&mut command(&python, &["-m", "pip", "--version"])) {
        return Err(missing("pip", wanted));
    }
    run(&mut command(&python, &["-m", "pip", "install", "--quiet", "-r", wanted]))?;
    std::fs::copy(&list, &done)
        .map_err(|e| TaskError::Failed(format!("{}: {e}", done.display())))?;
    Ok(python)
}

/// An interpreter with VMTK, where it can be had; without it only its rows are missing.
fn vmtk() -> Option<String> {
    let names = ["python3", "python3.14", "python3.13", "python3.12"];
    let named = names.into_iter().filter(|p| on_path(p)).map(str::to_owned);
    let Some(system) = named.chain(pyenv()).find(|p| fits(p, VMTK_PYTHON)) else {
        eprintln!(
            "VMTK will be missing: it wants a Python 3.12 to 3.14 on PATH or of pyenv, or --vmtk"
        );
        return None;
    };
    let made = environment("compare-vmtk-venv", WANTED_VMTK, &system);
    made.inspect_err(|_| eprintln!("VMTK will be missing: its packages do not install")).ok()
}

/// The interpreters that pyenv has installed; those it has not chosen are not on PATH.
fn pyenv() -> Vec<String> {
    let home = std::env::home_dir().map(|h| h.join(".pyenv"));
    let Some(root) = std::env::var_os("PYENV_ROOT").map(PathBuf::from).or(home) else {
        return Vec::new();
    };
    let folders = std::fs::read_dir(root.join("versions")).into_iter().flatten().flatten();
    let found = folders.map(|f| f.path().join("bin/python3").to_string_lossy().into_owned());
    let mut found: Vec<_> = found.collect();
    found.sort();
    found
}

/// A Python of the system that is new enough.
pub fn system_python() -> Result<&'static str, TaskError> {
    let found = ["python3", "python"].into_iter().find(|p| on_path(p) && fits(p, PYTHON));
    found.ok_or_else(|| TaskError::Failed(NO_PYTHON.into()))
}

/// For which versions all the pinned peers have wheels, as a condition in Python.
const PYTHON: &str = "sys.version_info >= (3, 11)";
const VMTK_PYTHON: &str = "(3, 12) <= sys.version_info < (3, 15)";

/// Whether its version is one of `versions`.
fn fits(python: &str, versions: &str) -> bool {
    succeeds(&mut command(python, &["-c", &format!("import sys; sys.exit(not ({versions}))")]))
}

const NO_PYTHON: &str = "no Python 3.11 or newer on PATH; install one with its venv and pip (on Debian \
and Ubuntu: `apt-get install python3 python3-venv python3-pip`), or name one with --python";

fn missing(module: &str, wanted: &str) -> TaskError {
    TaskError::Failed(format!(
        "Python is here without `{module}`; on Debian and Ubuntu: \
         `apt-get install python3-venv python3-pip`. Or name an interpreter that has \
         {wanted} installed, with --python"
    ))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn interpreter_and_program_are_taken_out_of_the_arguments() {
        let (intima, rest) = value("--intima", &["--intima", "p", "--sizes", "quick"]).unwrap();
        assert_eq!((intima, rest), (Some("p"), vec!["--sizes", "quick"]));
        let (python, rest) =
            split(&["--stages", "grow", "--python", "p", "--repeat", "3"]).unwrap();
        assert_eq!((python, rest), (Some("p"), vec!["--stages", "grow", "--repeat", "3"]));
        assert_eq!(split(&["--readme"]).unwrap(), (None, vec!["--readme"]));
        assert!(matches!(split(&["--python"]), Err(TaskError::Usage(_))));
    }

    #[test]
    fn what_is_named_here_exists() {
        for file in [SCRIPT, WANTED, WANTED_VMTK] {
            assert!(root().join(file).is_file(), "{file}");
        }
    }

    #[test]
    fn every_peer_is_pinned() {
        for wanted in [WANTED, WANTED_VMTK] {
            let text = std::fs::read_to_string(root().join(wanted)).unwrap();
            let mut lines = text.lines().filter(|l| !l.starts_with('#')).peekable();
            assert!(lines.peek().is_some());
            lines.for_each(|l| assert!(l.contains("=="), "{l}"));
        }
    }

    #[test]
    fn every_flag_of_the_script_is_in_the_help() {
        let text = std::fs::read_to_string(root().join(SCRIPT)).unwrap();
        let flags: Vec<_> = text.split("add_argument(\"").skip(1).collect();
        assert!(flags.len() > 5, "{SCRIPT} parses no flags");
        for flag in flags.iter().filter_map(|f| f.split('"').next()) {
            assert!(HELP.contains(&format!("  {flag} ")), "{flag}");
        }
    }

    #[test]
    fn the_page_has_a_place_for_the_table() {
        let script = std::fs::read_to_string(root().join("tools/compare/report.py")).unwrap();
        let marks = script.lines().find_map(|l| l.strip_prefix("MARKS = ")).unwrap();
        let page = std::fs::read_to_string(root().join("docs/comparison.md")).unwrap();
        let found: Vec<_> = marks.split('"').skip(1).step_by(2).map(|m| page.find(m)).collect();
        assert!(found.len() == 2 && found[0].is_some() && found[0] < found[1], "{found:?}");
    }

    #[test]
    fn what_is_missing_is_said_with_a_way_out() {
        let TaskError::Failed(text) = missing("venv", WANTED) else { panic!("another kind") };
        assert!(text.contains("`venv`") && text.contains("--python"), "{text}");
    }
}
