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
    let files = [
        "airway_label_lidc1.nii.gz",
        "airway_label_atm_305.nii.gz",
        // It was estimated at twice its memory.
        "colon_label_2.nii.gz",
    ];
    for file in files.into_iter().filter_map(shared_file) {
        for command in COMMANDS {
            let tmp = tempfile::tempdir().unwrap();
            assert_estimate(tmp.path(), &[command, &["--mask", file.to_str().unwrap()]].concat());
        }
    }
}

/// The search for an organ and the wall field were added up, and the field of thin vessels, on
/// several times the bricks of their lumen, counted as if it had no more.
#[test]
fn memory_of_organs_is_estimated_within_a_quarter() {
    let files = ["CT_AVM.nii.gz", "aorta_mra.mha", "aneurism.nrrd"];
    for file in files.into_iter().filter_map(shared_file) {
        for command in &COMMANDS[..3] {
            let tmp = tempfile::tempdir().unwrap();
            let input = [file.to_str().unwrap(), "--organ", "vessel"];
            assert_estimate(tmp.path(), &[command, &input[..]].concat());
        }
    }
}

/// Runs a command, whose estimate, MB, is within a quarter of what it takes.
fn assert_estimate(dir: &Path, command: &[&str]) -> f64 {
    let out = intima(dir, &[command, &["-v", "--json"]].concat());
    let err = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{command:?}: {err}");
    let line = String::from_utf8_lossy(&out.stdout);
    let report: Value = serde_json::from_str(line.lines().last().unwrap()).unwrap();
    let peak = report["peak_memory_mb"].as_f64().unwrap();
    let said = err.split("about ").nth(1).and_then(|r| r.split(' ').next()).unwrap();
    let estimate: f64 = said.parse().unwrap();
    eprintln!("{command:?}: {estimate} MB estimated, {peak:.0} MB taken");
    assert!((0.75..=1.25).contains(&(estimate / peak)), "{command:?}: {estimate} {peak}");
    estimate
}

/// They had no estimate: only the watch ended them.
#[test]
fn memory_of_volumes_and_meshes_alone_is_estimated_within_a_quarter() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    let works = |args: &[&str]| assert!(intima(dir, args).status.success(), "{args:?}");
    works(&["phantom", "colon", "--size", "320", "-o", "ct.nrrd", "-q"]);
    works(&["phantom", "colon", "--size", "256", "--mask", "-o", "m.nrrd", "-q"]);
    works(&["surface", "--mask", "m.nrrd", "--wall", "exact", "-o", "s.ply", "-q"]);
    let commands: [&[&str]; 7] = [
        &["info", "ct.nrrd"],
        &["convert", "ct.nrrd", "-o", "o.nii.gz"],
        &["simplify", "s.ply", "--faces", "5000", "-o", "b.ply"],
        &["fair", "s.ply", "-o", "f.ply", "--device", "cpu"],
        // It looks for a GPU first.
        &["fair", "s.ply", "-o", "f.ply", "--device", "auto"],
        &["fair", "s.ply", "-o", "f.ply", "--device", "cpu", "--smooth", "30"],
        &["fair", "s.ply", "-o", "f.ply", "--device", "cpu", "--volume", "ct.nrrd"],
    ];
    for command in commands {
        let limit = (assert_estimate(dir, command) - 1.0).to_string();
        let refused = intima(dir, &[command, &["--max-memory", &limit]].concat());
        let said = String::from_utf8_lossy(&refused.stderr);
        assert!(refused.status.code() == Some(1) && said.contains("estimated for"), "{said}");
    }
}

#[test]
fn a_run_that_grows_beyond_max_memory_is_ended() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    // `phantom` has no estimate: nothing but the watch ends it.
    let phantom = ["phantom", "colon", "--size", "200", "-o", "p.nrrd", "--json"];
    let free = intima(dir, &phantom);
    let line = String::from_utf8_lossy(&free.stdout).into_owned();
    let free: Value = serde_json::from_str(line.lines().last().unwrap()).unwrap();
    let peak = free["peak_memory_mb"].as_f64().unwrap();
    std::fs::remove_file(dir.join("p.nrrd")).unwrap();
    let limit = (0.7 * peak).to_string();
    let limit = limit.split('.').next().unwrap();
    let out = intima(dir, &[&phantom[..], &["--max-memory", limit]].concat());
    let err = String::from_utf8_lossy(&out.stderr);
    assert_eq!(out.status.code(), Some(1), "{peak} {limit} {err}");
    assert!(err.contains("--max-memory"), "{err}");
    let line = String::from_utf8_lossy(&out.stdout).into_owned();
    let answer: Value = serde_json::from_str(line.lines().last().unwrap()).unwrap();
    assert_eq!(answer["error"]["reason"], "memory");
    let left: Vec<_> = std::fs::read_dir(dir).unwrap().flatten().map(|e| e.file_name()).collect();
    assert!(left.is_empty(), "{left:?}");
}
