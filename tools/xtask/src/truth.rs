//! `cargo xtask truth`: builds intima, installs what is wanted and runs `tools/truth`.

use crate::TaskError;
use crate::compare::{absolute, environment, program, split, system_python, value};
use crate::process::{cargo, command, run};

const SCRIPT: &str = "tools/truth/truth.py";
const WANTED: &str = "tools/truth/requirements.txt";
const HELP: &str = "\
usage: cargo xtask truth [FLAGS]

  --parts A,B          of phantoms, labels, scans, lines, coverage (default: all)
  --cases A,B          only inputs whose title holds A or B
  --sizes quick|full   a few of each input, or all (default: full)
  --wall A,B           a row for each of these `--wall` of `intima surface` (default: none passed)
  --before PATH        a second build of intima, as rows of its own
  --ours               without other programs
  --data DIR           real volumes (default: ../shared/data, where it is)
  --out DIR            where everything lands (default: out/truth)
  --python PATH        an interpreter that has tools/truth/requirements.txt installed
  --intima PATH        this program instead of building one
  --record             also put results and table into benches/results
  --readme             also put the short table into docs/comparison.md
  --render             only write the tables anew from what is in --out
";

/// `cargo xtask truth [--python PATH] [--intima PATH] [ARGUMENTS OF truth.py]`
pub fn truth(args: &[&str]) -> Result<(), TaskError> {
    if args.iter().any(|a| ["-h", "--help"].contains(a)) {
        print!("{HELP}");
        return Ok(());
    }
    judge(SCRIPT, WANTED, "truth-venv", args)
}

/// Runs a script with the release program, built where `--intima` names none, and where `--before`
/// names one another build, in an environment `venv` with the packages of the file `wanted`.
pub fn judge(script: &str, wanted: &str, venv: &str, args: &[&str]) -> Result<(), TaskError> {
    let (python, rest) = split(args)?;
    let (given, rest) = value("--intima", &rest)?;
    let (before, rest) = value("--before", &rest)?;
    let before = before.map(absolute).transpose()?;
    let intima = match given {
        Some(path) => absolute(path)?,
        None if rest.contains(&"--render") => program(),
        None => {
            run(&mut cargo(&["build", "--release", "--locked"]))?;
            program()
        }
    };
    let python = match python {
        Some(given) => given.to_owned(),
        None => environment(venv, wanted, system_python()?)?,
    };
    let before: Vec<&str> = before.iter().flat_map(|path| ["--before", path]).collect();
    run(&mut command(&python, &[&[script, "--intima", &intima], &before[..], &rest[..]].concat()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::process::root;

    fn text(file: &str) -> String {
        std::fs::read_to_string(root().join(file)).unwrap()
    }

    #[test]
    fn every_package_is_pinned() {
        let text = text(WANTED);
        let mut lines = text.lines().filter(|l| !l.starts_with('#')).peekable();
        assert!(lines.peek().is_some());
        lines.for_each(|l| assert!(l.contains("=="), "{l}"));
    }

    #[test]
    fn every_flag_of_the_script_is_in_the_help() {
        let text = text(SCRIPT);
        let flags: Vec<_> = text.split("add_argument(\"").skip(1).collect();
        assert!(flags.len() > 5, "{SCRIPT} parses no flags");
        for flag in flags.iter().filter_map(|f| f.split('"').next()) {
            assert!(HELP.contains(&format!("  {flag} ")), "{flag}");
        }
    }

    #[test]
    fn the_page_has_a_place_for_the_table() {
        let script = text("tools/truth/report.py");
        let marks = script.lines().find_map(|l| l.strip_prefix("MARKS = ")).unwrap();
        let page = text("docs/comparison.md");
        let found: Vec<_> = marks.split('"').skip(1).step_by(2).map(|m| page.find(m)).collect();
        assert!(found.len() == 2 && found[0].is_some() && found[0] < found[1], "{found:?}");
    }
}
