//! `cargo xtask scaling`: builds intima and runs `tools/scaling`.

use crate::TaskError;
use crate::compare::{program, split, system_python};
use crate::process::{cargo, command, run};

const SCRIPT: &str = "tools/scaling/scaling.py";
const HELP: &str = "\
usage: cargo xtask scaling [FLAGS]

  --parts A,B          only these of threads, growth, box, memory, device (default: all)
  --rounds N           what is compared takes turns N times (default: 5)
  --sizes N,N,N,N      sides of the phantom whose growth is fitted (default: 160,216,296,400)
  --size N             side of the phantom of threads, box and device (default: 256)
  --large N            side of the phantom whose memory is measured (default: 512)
  --memory-rounds N    runs of each command whose memory is measured (default: 1)
  --device DEVICE      of growth, box and memory (default: cpu)
  --out DIR            where everything lands (default: out/scaling)
  --python PATH        a Python 3.11 or newer; it needs no packages

Ends with 1 where a limit is missed.
";

/// `cargo xtask scaling [--python PATH] [ARGUMENTS OF scaling.py]`
pub fn scaling(args: &[&str]) -> Result<(), TaskError> {
    if args.iter().any(|a| ["-h", "--help"].contains(a)) {
        print!("{HELP}");
        return Ok(());
    }
    let (python, rest) = split(args)?;
    let python = match python {
        Some(given) => given,
        None => system_python()?,
    };
    run(&mut cargo(&["build", "--release", "--locked"]))?;
    run(&mut command(python, &[&[SCRIPT, "--intima", &program()], &rest[..]].concat()))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::process::root;

    #[test]
    fn every_flag_of_the_script_is_in_the_help() {
        let text = std::fs::read_to_string(root().join(SCRIPT)).unwrap();
        let flags: Vec<_> = text.split("add_argument(\"").skip(1).collect();
        assert!(flags.len() > 5, "{SCRIPT} parses no flags");
        for flag in flags.iter().filter_map(|f| f.split('"').next()).filter(|f| *f != "--intima") {
            assert!(HELP.contains(&format!("  {flag} ")), "{flag}");
        }
    }
}
