//! Runs one test of this very program again in a process of its own: for environment variables
//! that are read once, before anything else, and for counters of the whole process.

use std::process::{Command, Output};

/// Set in a process that runs one test.
const MARK: &str = "INTIMA_TEST_CHILD";

/// Whether this process was started by [`run`].
pub fn is_child() -> bool {
    std::env::var_os(MARK).is_some()
}

/// Runs the test `name` with `env` on top of ours.
pub fn run(name: &str, env: &[(&str, &str)]) -> Output {
    let mut command = Command::new(std::env::current_exe().expect("our own path"));
    command.args(["--exact", name, "--nocapture", "--test-threads=1"]);
    command.env_remove("LP_NUM_THREADS").env(MARK, "1").envs(env.iter().copied());
    command.output().expect("our own program starts")
}

/// Whether the test `name` has this process to itself. If not, it is run in one that it has, and
/// fails here as it fails there.
pub fn alone(name: &str) -> bool {
    if is_child() {
        return true;
    }
    let out = run(name, &[]);
    let (said, errors) =
        (String::from_utf8_lossy(&out.stdout), String::from_utf8_lossy(&out.stderr));
    // A name that no test has is a process in which nothing fails.
    let ran = out.status.success() && said.contains("test result: ok. 1 passed");
    assert!(ran, "{name} in a process of its own, {}:\n{said}\n{errors}", out.status);
    println!("{said}");
    false
}

/// The lines a child printed after `child: `.
pub fn said(out: &Output) -> Vec<String> {
    let text = String::from_utf8_lossy(&out.stdout);
    let lines = text.lines().filter_map(|l| l.split_once("child: ").map(|(_, s)| s.to_owned()));
    let said: Vec<_> = lines.collect();
    let errors = String::from_utf8_lossy(&out.stderr);
    assert!(!said.is_empty(), "the child said nothing:\n{text}\n{errors}");
    said
}
