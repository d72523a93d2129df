//! `cargo xtask test --timings`: the longest tests, by name.
//!
//! Stable Rust reports no times of tests. The programs that `cargo test` builds know how, behind a
//! flag that they take under `RUSTC_BOOTSTRAP=1`. They are started here and not by cargo, so that
//! the variable reaches no compiler and nothing is built anew.

use crate::TaskError;
use crate::process::{cargo, command};
use crate::test_suite::{ALL, with_device};
use std::process::Stdio;

/// How many are listed.
const LISTED: usize = 10;

/// Runs every test program and lists the longest tests.
pub fn timings(gpu: bool) -> Result<(), TaskError> {
    let mut build = cargo(&[&ALL[..], &["--no-run", "--message-format=json"]].concat());
    let out = build.stderr(Stdio::inherit()).output();
    let out = out.map_err(|e| TaskError::Failed(format!("cargo did not start: {e}")))?;
    if !out.status.success() {
        return Err(TaskError::Failed(format!("`cargo test --no-run` ended with {}", out.status)));
    }
    let mut all = Vec::new();
    let mut failed = Vec::new();
    for program in programs(&String::from_utf8_lossy(&out.stdout)) {
        eprintln!("+ {program}");
        let mut tests = command(&program, &["-Zunstable-options", "--report-time"]);
        let out = with_device(&mut tests, gpu).env("RUSTC_BOOTSTRAP", "1").output();
        let out = out.map_err(|e| TaskError::Failed(format!("{program} did not start: {e}")))?;
        let said = String::from_utf8_lossy(&out.stdout);
        if !out.status.success() {
            print!("{said}");
            failed.push(program.clone());
        }
        all.extend(said.lines().filter_map(timed).map(|(s, name)| (s, name.to_owned())));
    }
    all.sort_by(|a, b| b.0.total_cmp(&a.0));
    let total: f64 = all.iter().map(|t| t.0).sum();
    println!("{} tests, {total:.1} s one after another; the longest:", all.len());
    for (seconds, name) in all.iter().take(LISTED) {
        println!("{seconds:8.1} s  {name}");
    }
    if failed.is_empty() {
        Ok(())
    } else {
        Err(TaskError::Failed(format!("failed: {}", failed.join(", "))))
    }
}

/// Test programs among cargo's messages.
fn programs(messages: &str) -> Vec<String> {
    let of = |line: &str| {
        let profile = line.split_once("\"profile\":{")?.1.split_once('}')?.0;
        let executable = line.split_once("\"executable\":\"")?.1.split_once('"')?.0;
        profile.contains("\"test\":true").then(|| executable.replace("\\\\", "\\"))
    };
    messages.lines().filter_map(of).collect()
}

/// Seconds and name of a line `test NAME ... ok <1.234s>`.
fn timed(line: &str) -> Option<(f64, &str)> {
    let (name, rest) = line.strip_prefix("test ")?.split_once(" ... ")?;
    let seconds = rest.rsplit_once('<')?.1.strip_suffix("s>")?;
    Some((seconds.parse().ok()?, name))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_reported_time_is_read_and_other_lines_are_not() {
        assert_eq!(timed("test a::b ... ok <1.250s>"), Some((1.25, "a::b")));
        assert_eq!(timed("test a::b - should panic ... FAILED <0.1s>").unwrap().0, 0.1);
        for other in ["test a::b ... ok", "running 3 tests", "test result: ok. 3 passed"] {
            assert_eq!(timed(other), None, "{other}");
        }
    }

    #[test]
    fn programs_are_those_that_were_built_as_tests() {
        let line = |test: bool, file: &str| {
            format!(
                "{{\"target\":{{\"test\":true}},\"profile\":{{\"opt_level\":\"2\",\"test\":{test}}},\
                 \"executable\":{file}}}\n"
            )
        };
        let messages =
            line(true, "\"/t/gpu-1\"") + &line(false, "\"/t/intima\"") + &line(true, "null");
        assert_eq!(programs(&messages), ["/t/gpu-1"]);
    }
}
