//! Runs one test of this very program again in a process of its own: for environment variables
//! that are read once, before anything else.
#![allow(dead_code)]

use std::process::{Command, Output};

/// Runs the ignored test `name` with `env` on top of ours.
pub fn run(name: &str, env: &[(&str, &str)]) -> Output {
    let mut command = Command::new(std::env::current_exe().expect("our own path"));
    command.args(["--exact", name, "--ignored", "--nocapture", "--test-threads=1"]);
    command.env_remove("LP_NUM_THREADS").envs(env.iter().copied());
    command.output().expect("our own program starts")
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
