//! Runs other programs from the repository's root.

use crate::TaskError;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};

/// The repository's root, two folders above this package. Cargo says where that is now; where the
/// program is started by hand, it is where it was built.
pub fn root() -> PathBuf {
    let now = std::env::var("CARGO_MANIFEST_DIR").ok();
    let here = now.filter(|d| d.ends_with("xtask")).unwrap_or(env!("CARGO_MANIFEST_DIR").into());
    Path::new(&here).ancestors().nth(2).expect("tools/xtask is two folders deep").to_owned()
}

/// `program` with `args`, to be run in the repository's root.
pub fn command(program: &str, args: &[&str]) -> Command {
    let mut command = Command::new(program);
    command.args(args).current_dir(root());
    command
}

/// The cargo that runs us, so that toolchain overrides hold for what we start.
pub fn cargo(args: &[&str]) -> Command {
    let program = std::env::var("CARGO").unwrap_or_else(|_| "cargo".into());
    command(&program, args)
}

/// Prints and runs a command; an error names it.
pub fn run(command: &mut Command) -> Result<(), TaskError> {
    let line = line(command);
    eprintln!("+ {line}");
    match command.status() {
        Ok(status) if status.success() => Ok(()),
        Ok(status) => Err(TaskError::Failed(format!("`{line}` ended with {status}"))),
        Err(e) => Err(TaskError::Failed(format!("`{line}` did not start: {e}"))),
    }
}

/// Runs a command and returns what it prints on standard output; an error names it.
pub fn output(command: &mut Command) -> Result<String, TaskError> {
    let line = line(command);
    match command.stderr(Stdio::inherit()).output() {
        Ok(out) if out.status.success() => String::from_utf8(out.stdout)
            .map_err(|_| TaskError::Failed(format!("`{line}` printed what is not UTF-8"))),
        Ok(out) => Err(TaskError::Failed(format!("`{line}` ended with {}", out.status))),
        Err(e) => Err(TaskError::Failed(format!("`{line}` did not start: {e}"))),
    }
}

/// Whether it starts and succeeds; prints nothing.
pub fn succeeds(command: &mut Command) -> bool {
    let silent = command.stdin(Stdio::null()).stdout(Stdio::null()).stderr(Stdio::null());
    silent.status().is_ok_and(|s| s.success())
}

/// Whether `program` lies in a folder of `PATH`.
pub fn on_path(program: &str) -> bool {
    let path = std::env::var_os("PATH").unwrap_or_default();
    let names = [program.to_owned(), format!("{program}{}", std::env::consts::EXE_SUFFIX)];
    std::env::split_paths(&path).any(|dir| names.iter().any(|n| dir.join(n).is_file()))
}

/// The command as one would type it, with only the variables we set.
fn line(command: &Command) -> String {
    let program = Path::new(command.get_program());
    let name = program.file_stem().unwrap_or(program.as_os_str()).to_string_lossy();
    let set = command.get_envs().filter_map(|(k, v)| {
        let (k, v) = (k.to_string_lossy(), v?.to_string_lossy());
        Some(format!("{k}={v} "))
    });
    let args = command.get_args().map(|a| format!(" {}", a.to_string_lossy()));
    set.collect::<String>() + &name + &args.collect::<String>()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_root_holds_the_workspace() {
        let manifest = std::fs::read_to_string(root().join("Cargo.toml")).unwrap();
        assert!(manifest.contains("[workspace]"));
    }

    #[test]
    fn a_command_prints_as_typed() {
        let mut c = command("/usr/bin/cargo", &["test", "--locked"]);
        assert_eq!(line(c.env("A", "1")), "A=1 cargo test --locked");
    }

    #[test]
    fn an_error_names_the_command() {
        let Err(TaskError::Failed(m)) = run(&mut command("no-such-program", &["x"])) else {
            panic!("it ran");
        };
        assert!(m.starts_with("`no-such-program x`"), "{m}");
        assert!(!on_path("no-such-program"));
    }
}
