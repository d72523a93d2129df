//! Plays scripts of the window, each in a folder of its own.
#![cfg(feature = "window")]

use std::path::Path;
use std::process::{Command, Output};

use intima::volume::phantom::{Kind, Phantom};

pub fn fly(dir: &Path, args: &[&str]) -> Output {
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["fly", "mask.nrrd"]).args(args).current_dir(dir);
    command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").env_remove("WAYLAND_SOCKET");
    command.env_remove("INTIMA_FAULT").output().expect("the program starts")
}

pub fn folder() -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    let mask = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().mask();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &mask).unwrap();
    tmp
}

/// Plays a script of these steps with a session file; it succeeds.
pub fn play(dir: &Path, more: &[&str], steps: &str) {
    let script =
        format!(r#"{{"schema": "intima.script/1", "size": [640, 400], "steps": [{steps}]}}"#);
    std::fs::write(dir.join("s.json"), script).unwrap();
    let args = ["--script", "s.json", "--frames-out", "out", "--session", "notes.json"];
    let done = fly(dir, &[&args[..], &[], more].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
}

pub fn notes(dir: &Path) -> serde_json::Value {
    serde_json::from_slice(&std::fs::read(dir.join("notes.json")).unwrap()).unwrap()
}

/// Plays a script without a volume or a session file of its own; what the program says.
pub fn play_alone(dir: &Path, args: &[&str], steps: &str) -> String {
    let script =
        format!(r#"{{"schema": "intima.script/1", "size": [900, 600], "steps": [{steps}]}}"#);
    std::fs::write(dir.join("s.json"), script).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["-v", "fly", "--script", "s.json", "--frames-out", "out"]).args(args);
    let done = command.current_dir(dir).env_remove("INTIMA_FAULT").output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr).into_owned();
    assert!(done.status.success(), "{said}");
    said
}
