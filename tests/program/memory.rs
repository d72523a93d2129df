//! Memory: estimates beside peaks, and `--max-memory` as a bound.

use std::path::Path;
use std::process::{Command, Output};

use common::volumes::shared_file;
use serde_json::Value;

fn intima(dir: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_intima"))
        .args(args)
        .current_dir(dir)
        .env("XDG_CACHE_HOME", dir.join("cache"))
        // Validation takes memory of its own.
        .env_remove("INTIMA_VALIDATE")
        .output()
        .unwrap()
}

/// Commands with their outputs; the input is added.
const COMMANDS: [&[&str]; 5] = [
    &["segment", "-o", "m.nrrd"],
    &["distance", "-o", "d.nrrd"],
    &["surface", "-o", "s.ply"],
    &["centerline", "-o", "c.csv"],
    &["run", "--out", "o", "--frames", "4", "--size", "640x480"],
];

#[test]
fn memory_is_estimated_within_a_quarter() {
    let files = ["airway_label_lidc1.nii.gz", "airway_label_atm_305.nii.gz"];
    for file in files.into_iter().filter_map(shared_file) {
        for command in COMMANDS {
            let tmp = tempfile::tempdir().unwrap();
            let input = ["--mask", file.to_str().unwrap(), "-v", "--json"];
            let out = intima(tmp.path(), &[command, &input].concat());
            let err = String::from_utf8_lossy(&out.stderr);
            assert!(out.status.success(), "{command:?}: {err}");
            let line = String::from_utf8_lossy(&out.stdout);
            let report: Value = serde_json::from_str(line.lines().last().unwrap()).unwrap();
            let peak = report["peak_memory_mb"].as_f64().unwrap();
            let said = err.split("about ").nth(1).and_then(|r| r.split(' ').next()).unwrap();
            let estimate: f64 = said.parse().unwrap();
            eprintln!(
                "{} {}: {estimate} MB estimated, {peak:.0} MB taken",
                file.display(),
                command[0]
            );
            assert!((0.75..=1.25).contains(&(estimate / peak)), "{command:?}: {estimate} {peak}");
        }
    }
}

#[test]
fn a_run_that_grows_beyond_max_memory_is_ended() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    let made = intima(dir, &["phantom", "colon", "--size", "160", "-o", "p.nrrd", "-q"]);
    assert!(made.status.success());
    // `simplify` has no estimate: nothing but the watch ends it.
    let made = intima(dir, &["surface", "p.nrrd", "--threshold", ":-455", "-o", "s.ply", "-q"]);
    assert!(made.status.success());
    let simplify = ["simplify", "s.ply", "--faces", "2000", "-o", "b.ply", "--json"];
    let free = intima(dir, &simplify);
    let line = String::from_utf8_lossy(&free.stdout).into_owned();
    let free: Value = serde_json::from_str(line.lines().last().unwrap()).unwrap();
    let peak = free["peak_memory_mb"].as_f64().unwrap();
    std::fs::remove_file(dir.join("b.ply")).unwrap();
    let limit = (0.7 * peak).to_string();
    let limit = limit.split('.').next().unwrap();
    let out = intima(dir, &[&simplify[..], &["--max-memory", limit]].concat());
    let err = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{peak} {limit} {err}");
    assert!(err.contains("--max-memory"), "{err}");
    let line = String::from_utf8_lossy(&out.stdout).into_owned();
    let answer: Value = serde_json::from_str(line.lines().last().unwrap()).unwrap();
    assert_eq!(answer["error"]["reason"], "memory");
    let left: Vec<_> = std::fs::read_dir(dir).unwrap().flatten().map(|e| e.file_name()).collect();
    assert_eq!(left.len(), 2, "{left:?}");
}
