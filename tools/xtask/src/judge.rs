//! `cargo xtask judge PART`: builds intima, installs what a part wants and runs its script in
//! `tools/judge`.

use crate::TaskError;
use crate::process::{cargo, command, on_path, root, run, succeeds};
use crate::setup::{Purpose, setup};
use std::path::{Path, PathBuf};

const WANTED: &str = "tools/judge/requirements.txt";
const WANTED_VMTK: &str = "tools/judge/requirements-vmtk.txt";

/// A part of the judgement.
struct Part {
    /// Its name, and that of its folder.
    name: &'static str,
    /// Needs of its script beside intima.
    needs: Needs,
    /// Flags of its script.
    help: &'static str,
}

/// Needs of a script.
#[derive(Clone, Copy, PartialEq, Eq)]
enum Needs {
    /// No packages.
    Nothing,
    /// The packages.
    Packages,
    /// The packages, and Vulkan.
    Drawing,
    /// The packages, Vulkan where there is one, and VMTK where there is one.
    Peers,
}

const PARTS: [Part; 4] = [
    Part {
        name: "speed",
        needs: Needs::Peers,
        help: "  --stages A,B         only these (default: all; a wrong name lists them)
  --cases A,B          only inputs whose name holds A or B
  --sizes quick|full   half the grid, or all of it (default: full)
  --repeat N           rounds, in which all programs of a case take turns (default: 5)
  --without A,B        leave out rows whose program's name holds A or B
  --vmtk PYTHON        an interpreter with tools/judge/requirements-vmtk.txt installed
                       (default: one made of a Python 3.12 or newer, where there is one)
  --data DIR           real volumes (default with full sizes: ../shared/data, where it is)
  --out DIR            where everything lands (default: out/speed)
  --readme             also put the short table into docs/comparison.md
  --render             only write table and plot anew from what is in --out
",
    },
    Part {
        name: "walls",
        needs: Needs::Packages,
        help: "  --parts A,B          of phantoms, labels, scans, lines, coverage (default: all)
  --cases A,B          only inputs whose title holds A or B
  --sizes quick|full   a few of each input, or all (default: full)
  --wall A,B           a row for each of these `--wall` of `intima surface` (default: none passed)
  --before PATH        a second build of intima, as rows of its own
  --ours               without other programs
  --data DIR           real volumes (default: ../shared/data, where it is)
  --out DIR            where everything lands (default: out/walls)
  --record             also put results and table into benches/results
  --readme             also put the short table into docs/comparison.md
  --render             only write the tables anew from what is in --out
",
    },
    Part {
        name: "pictures",
        needs: Needs::Drawing,
        help: "  --cases A,B          only cases whose name holds A or B (a wrong name lists them)
  --before PATH        a second build of intima, as a column of its own
  --data DIR           the volumes (default: ../shared/data)
  --out DIR            where everything lands (default: out/pictures)
  --docs               also write docs/pictures.md and its sheets, of volumes whose licence
                       allows it
",
    },
    Part {
        name: "growth",
        needs: Needs::Nothing,
        help: "  --parts A,B          only these of threads, growth, box, memory, device (default: all)
  --rounds N           what is compared takes turns N times (default: 5)
  --sizes N,N,N,N      sides of the phantom whose growth is fitted (default: 160,216,296,400)
  --size N             side of the phantom of threads, box and device (default: 256)
  --large N            side of the phantom whose memory is measured (default: 512)
  --memory-rounds N    runs of each command whose memory is measured (default: 1)
  --device DEVICE      of growth, box and memory (default: cpu)
  --out DIR            where everything lands (default: out/growth)

Ends with 1 where a limit is missed.
",
    },
];

/// Flags of every part.
const COMMON: &str =
    "  --python PATH        an interpreter that has tools/judge/requirements.txt installed
  --intima PATH        this program instead of building one
";

impl Part {
    fn script(&self) -> String {
        format!("tools/judge/{}/main.py", self.name)
    }

    fn help(&self) -> String {
        format!("usage: cargo xtask judge {} [FLAGS]\n\n{COMMON}{}", self.name, self.help)
    }
}

/// `cargo xtask judge PART [--python PATH] [--intima PATH] [ARGUMENTS OF THE SCRIPT]`
pub fn judge(args: &[&str]) -> Result<(), TaskError> {
    let names = PARTS.map(|part| part.name).join(", ");
    let Some((name, args)) = args.split_first() else {
        return Err(TaskError::Usage(format!("judge what: {names}?")));
    };
    let Some(part) = PARTS.iter().find(|part| part.name == *name) else {
        return Err(TaskError::Usage(format!("no such part: {name}; there are {names}")));
    };
    if args.iter().any(|a| ["-h", "--help"].contains(a)) {
        print!("{}", part.help());
        return Ok(());
    }
    let (python, rest) = value("--python", args)?;
    let (intima, rest) = value("--intima", &rest)?;
    let (before, rest) = value("--before", &rest)?;
    match (part.needs, setup_for(part.needs)) {
        (Needs::Peers, Err(TaskError::NoDevice(why) | TaskError::Failed(why))) => {
            eprintln!("the flight will be missing: {why}");
        }
        (_, done) => done?,
    }
    let intima = match intima {
        Some(path) => absolute(path)?,
        None if rest.contains(&"--render") => program(),
        None => {
            run(&mut cargo(&["build", "--release", "--locked"]))?;
            program()
        }
    };
    let python = match python {
        Some(given) => given.to_owned(),
        None if part.needs == Needs::Nothing => system_python()?.to_owned(),
        None => environment("judge-venv", WANTED, system_python()?)?,
    };
    let before = before.map(absolute).transpose()?;
    let has_vmtk = part.needs == Needs::Peers && !rest.contains(&"--vmtk");
    let vmtk = if has_vmtk { vmtk() } else { None };
    let flags = [("--before", &before), ("--vmtk", &vmtk)];
    let flags = flags.iter().filter_map(|(flag, value)| Some([*flag, value.as_deref()?]));
    let flags: Vec<&str> = flags.flatten().collect();
    let script = part.script();
    run(&mut command(&python, &[&[&script, "--intima", &intima], &flags[..], &rest[..]].concat()))
}

fn setup_for(needs: Needs) -> Result<(), TaskError> {
    match needs {
        Needs::Drawing | Needs::Peers => setup(Purpose::Running),
        Needs::Nothing | Needs::Packages => Ok(()),
    }
}

/// A path as given, from where we were started: the script runs in the repository's root.
fn absolute(path: &str) -> Result<String, TaskError> {
    let found =
        std::fs::canonicalize(path).map_err(|e| TaskError::Failed(format!("{path}: {e}")))?;
    Ok(found.to_string_lossy().into_owned())
}

/// Where the release program is built.
fn program() -> String {
    let program = target().join("release").join(format!("intima{}", std::env::consts::EXE_SUFFIX));
    program.to_string_lossy().into_owned()
}

/// The path after `flag`, and the other arguments.
fn value<'a>(flag: &str, args: &[&'a str]) -> Result<(Option<&'a str>, Vec<&'a str>), TaskError> {
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
fn environment(name: &str, wanted: &str, system: &str) -> Result<String, TaskError> {
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
    let made = environment("judge-vmtk-venv", WANTED_VMTK, &system);
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
fn system_python() -> Result<&'static str, TaskError> {
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

    fn text(file: &str) -> String {
        std::fs::read_to_string(root().join(file)).unwrap()
    }

    #[test]
    fn interpreter_and_program_are_taken_out_of_the_arguments() {
        let (intima, rest) = value("--intima", &["--intima", "p", "--sizes", "quick"]).unwrap();
        assert_eq!((intima, rest), (Some("p"), vec!["--sizes", "quick"]));
        let (python, rest) =
            value("--python", &["--stages", "grow", "--python", "p", "--repeat", "3"]).unwrap();
        assert_eq!((python, rest), (Some("p"), vec!["--stages", "grow", "--repeat", "3"]));
        assert!(matches!(value("--python", &["--python"]), Err(TaskError::Usage(_))));
    }

    #[test]
    fn a_part_that_is_not_there_is_a_usage_error_with_the_parts_there_are() {
        for args in [&[][..], &["taste"]] {
            let Err(TaskError::Usage(said)) = judge(args) else { panic!("{args:?}") };
            assert!(said.contains("speed, walls, pictures, growth"), "{said}");
        }
    }

    #[test]
    fn every_package_is_pinned() {
        for wanted in [WANTED, WANTED_VMTK] {
            let text = text(wanted);
            let mut lines = text.lines().filter(|l| !l.starts_with('#')).peekable();
            assert!(lines.peek().is_some());
            lines.for_each(|l| assert!(l.contains("=="), "{l}"));
        }
    }

    #[test]
    fn every_flag_of_every_script_is_in_its_help() {
        for part in &PARTS {
            let (text, help) = (text(&part.script()), part.help());
            let flags: Vec<_> = text.split("add_argument(\"").skip(1).collect();
            assert!(flags.len() > 4, "{} parses no flags", part.name);
            for flag in flags.iter().filter_map(|f| f.split('"').next()) {
                assert!(help.contains(&format!("  {flag} ")), "{} {flag}", part.name);
            }
        }
    }

    #[test]
    fn pages_have_places_for_tables_and_sheets() {
        for (script, page) in [
            ("speed/report.py", "comparison.md"),
            ("walls/report.py", "comparison.md"),
            ("pictures/sheets.py", "pictures.md"),
        ] {
            let script = text(&format!("tools/judge/{script}"));
            let marks = script.lines().find_map(|l| l.strip_prefix("MARKS = ")).unwrap();
            let page = text(&format!("docs/{page}"));
            let found: Vec<_> = marks.split('"').skip(1).step_by(2).map(|m| page.find(m)).collect();
            assert!(found.len() == 2 && found[0].is_some() && found[0] < found[1], "{found:?}");
        }
    }

    #[test]
    fn what_is_missing_is_said_with_a_way_out() {
        let TaskError::Failed(text) = missing("venv", WANTED) else { panic!("another kind") };
        assert!(text.contains("`venv`") && text.contains("--python"), "{text}");
    }
}
