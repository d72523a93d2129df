//! The files that commands make: their mode, and what is left of runs that were ended.

use std::fs::{File, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Stdio};
use std::time::Duration;

use common::patience::{end_of, until_while_running};

use super::*;

/// A stand-in for ffmpeg that writes some bytes of its output at once, the rest when its input
/// ends.
pub fn ffmpeg(dir: &Path) -> std::ffi::OsString {
    ffmpeg_that(dir, "echo begun > \"$last\"\ncat > /dev/null\necho ended >> \"$last\"")
}

/// A search path whose ffmpeg is a shell script; `$last` is its output.
fn ffmpeg_that(dir: &Path, does: &str) -> std::ffi::OsString {
    let folder = dir.join("bin");
    std::fs::create_dir_all(&folder).unwrap();
    let script = format!("#!/bin/sh\nfor last; do :; done\n{does}\n");
    let program = folder.join("ffmpeg");
    // Written once: a run that was ended may be starting it at this moment, and then it is busy.
    if std::fs::read(&program).ok().as_deref() != Some(script.as_bytes()) {
        std::fs::write(&program, script).unwrap();
        std::fs::set_permissions(&program, Permissions::from_mode(0o755)).unwrap();
    }
    let path = std::env::var_os("PATH").unwrap_or_default();
    let all = std::iter::once(folder).chain(std::env::split_paths(&path));
    std::env::join_paths(all).unwrap()
}

pub fn start(dir: &Path, args: &[&str]) -> Child {
    Command::new(env!("CARGO_BIN_EXE_intima"))
        .args(args)
        .current_dir(dir)
        .env_remove("INTIMA_FAULT")
        .env("PATH", ffmpeg(dir))
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap()
}

pub fn signal(child: &Child, name: &str) {
    let status = Command::new("kill").args([name, &child.id().to_string()]).status();
    assert!(status.unwrap().success(), "{name}");
}

/// Temporary files in a folder and those below it.
pub fn temporary(dir: &Path) -> Vec<std::path::PathBuf> {
    let mut found = Vec::new();
    for entry in std::fs::read_dir(dir).unwrap().flatten() {
        let path = entry.path();
        if path.is_dir() {
            found.extend(temporary(&path));
        } else if entry.file_name().to_string_lossy().starts_with(".intima-") {
            found.push(path);
        }
    }
    found
}

#[test]
fn files_are_made_with_the_users_umask() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 24);
    for (umask, mode) in [("077", 0o600), ("027", 0o640), ("022", 0o644), ("002", 0o664)] {
        for name in ["o.nrrd", "o.mhd"] {
            let program = env!("CARGO_BIN_EXE_intima");
            let line = format!("umask {umask}; exec {program} convert ct.nrrd -o {name}");
            let ran = Command::new("sh").args(["-c", &line]).current_dir(tmp.path()).output();
            assert!(ran.unwrap().status.success());
            let meta = std::fs::metadata(tmp.path().join(name)).unwrap();
            assert_eq!(meta.permissions().mode() & 0o777, mode, "{name} under umask {umask}");
        }
    }
}

#[test]
fn temporary_files_of_a_killed_run_are_removed_and_those_in_use_are_not() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 24);
    let [dead, used, foreign] =
        [".intima-abcdefABCDEF.tmp", ".intima-000000000000.tmp", ".intima-notes.tmp"]
            .map(|name| tmp.path().join(name));
    for path in [&dead, &used, &foreign] {
        std::fs::write(path, "x").unwrap();
    }
    let lock = File::open(&used).unwrap();
    lock.lock().unwrap();
    works(tmp.path(), &["convert", "ct.nrrd", "-o", "o.nrrd"]);
    assert!(!dead.exists(), "a killed run's file stays");
    assert!(used.exists(), "another run's file is removed");
    assert!(foreign.exists(), "a file that is not ours is removed");
}

#[test]
fn ctrl_c_leaves_no_temporary_file_of_a_video() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    let args = ["record", "--mask", "mask.nrrd", "--out", "f", "--frames", "5000"];
    let more = ["--size", "64x48", "--video", "v.mp4", "--lod", "off"];
    for name in ["-INT", "-TERM"] {
        let mut child = start(tmp.path(), &[&args[..], &more].concat());
        // The encoder has begun once its file holds something.
        until_while_running(&mut child, "its video has begun", || {
            let files = temporary(tmp.path());
            files.iter().any(|p| std::fs::read(p).is_ok_and(|b| b == b"begun\n"))
        });
        signal(&child, name);
        let status = child.wait().unwrap();
        assert_eq!(status.code(), Some(130), "{name}: {status}");
        // Longer than the encoder takes to notice that its input has ended.
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(temporary(tmp.path()), Vec::<std::path::PathBuf>::new(), "{name}");
        assert!(!tmp.path().join("v.mp4").exists());
    }
}

/// Arguments of a recording with a video.
const VIDEO: [&str; 12] = [
    "record",
    "--mask",
    "mask.nrrd",
    "--out",
    "f",
    "--size",
    "64x48",
    "--video",
    "v.mp4",
    "--lod",
    "off",
    "-q",
];

#[test]
fn a_run_whose_ffmpeg_hangs_ends_on_ctrl_c() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    // It reads nothing, so that a write of frames waits; or all, and does not end; or all with its
    // output closed, so that nothing but its end is waited for.
    for (does, frames) in [
        ("exec sleep 1000", "5000"),
        ("cat > /dev/null\nexec sleep 1000", "3"),
        ("exec >&-\ncat > /dev/null\nexec sleep 1000", "3"),
    ] {
        let hangs = format!("echo begun > \"$last\"\n{does}");
        let mut child = Command::new(env!("CARGO_BIN_EXE_intima"))
            .args(VIDEO)
            .args(["--frames", frames])
            .current_dir(tmp.path())
            .env("PATH", ffmpeg_that(tmp.path(), &hangs))
            .spawn()
            .unwrap();
        until_while_running(&mut child, "its video has begun", || {
            let files = temporary(tmp.path());
            files.iter().any(|p| std::fs::read(p).is_ok_and(|b| b == b"begun\n"))
        });
        // Long enough to fill the pipe, or to draw the last frame.
        std::thread::sleep(Duration::from_secs(2));
        signal(&child, "-INT");
        let status = end_of(&mut child, does);
        assert_eq!(status.code(), Some(130), "{does}: {status}");
        assert_eq!(temporary(tmp.path()), Vec::<std::path::PathBuf>::new(), "{does}");
        assert!(!tmp.path().join("v.mp4").exists());
    }
}

#[test]
fn a_video_that_ffmpeg_did_not_write_is_an_error_and_no_empty_file() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    let nothing = ffmpeg_that(tmp.path(), "cat > /dev/null");
    let failing = ffmpeg_that(&tmp.path().join("failing"), "echo no codec >&2\nexit 3");
    let none = std::ffi::OsString::from("/nowhere");
    for (path, why) in [(nothing, "wrote nothing"), (failing, "no codec"), (none, "no ffmpeg")] {
        let out = Command::new(env!("CARGO_BIN_EXE_intima"))
            .args(VIDEO)
            .args(["--frames", "3"])
            .current_dir(tmp.path())
            .env("PATH", path)
            .output()
            .unwrap();
        let err = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{why}: {err}");
        assert!(err.contains("v.mp4") && err.contains(why), "{err}");
        assert!(!tmp.path().join("v.mp4").exists(), "{why}");
        assert_eq!(temporary(tmp.path()), Vec::<std::path::PathBuf>::new(), "{why}");
        // Without an ffmpeg it is said before anything is drawn.
        assert!(why != "no ffmpeg" || !tmp.path().join("f").exists(), "{why}");
        let _ = std::fs::remove_dir_all(tmp.path().join("f"));
    }
}

#[test]
fn a_video_needs_no_folder_of_temporary_files_and_a_gif_at_most_50_frames_a_second() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    let run = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
        command.args(args).current_dir(tmp.path()).env("PATH", ffmpeg(tmp.path()));
        let out = command.env("TMPDIR", "/nowhere").output().unwrap();
        (out.status.code(), String::from_utf8_lossy(&out.stderr).into_owned())
    };
    let (code, err) = run(&[&VIDEO[..], &["--frames", "3", "--fov", "1"]].concat());
    assert_eq!(code, Some(0), "{err}");
    assert!(tmp.path().join("v.mp4").exists());
    let gif: Vec<&str> = VIDEO.iter().map(|a| if *a == "v.mp4" { "v.gif" } else { a }).collect();
    let (code, err) = run(&[&gif[..], &["--frames", "3", "--fps", "60"]].concat());
    assert!(code != Some(0) && err.contains("a GIF holds 50 at most"), "{code:?} {err}");
}

#[test]
fn a_label_map_whose_name_is_not_utf_8_is_a_mask() {
    use std::os::unix::ffi::OsStrExt;
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    let name = std::ffi::OsStr::from_bytes(b"m\xe9.nrrd");
    std::fs::rename(tmp.path().join("mask.nrrd"), tmp.path().join(name)).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["segment", "-o", "out.nrrd", "--mask"]).arg(name).current_dir(tmp.path());
    assert_eq!(command.output().unwrap().status.code(), Some(0));
}

#[test]
fn meshes_and_volumes_in_time_are_described() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Bend, 32);
    works(tmp.path(), &["surface", "--mask", "mask.nrrd", "-o", "wall.ply", "-q"]);
    let mesh = works(tmp.path(), &["info", "wall.ply", "--json"]);
    assert!(mesh["faces"].as_u64().unwrap() > 1000 && mesh["box_mm"][0].as_f64().unwrap() > 5.0);
    let head = "NRRD0004\ntype: uchar\nencoding: raw\ndimension: 4\nsizes: 4 3 2 2\n\
                kinds: domain domain domain time\nspacings: 1 1 1 nan\n\n";
    std::fs::write(tmp.path().join("t.nrrd"), [head.as_bytes(), &[1; 48]].concat()).unwrap();
    let series = works(tmp.path(), &["info", "t.nrrd", "--json"]);
    assert!(series["notes"].to_string().contains("2 volumes one after the other"), "{series}");
    let out = intima(tmp.path(), &["convert", "t.nrrd", "-o", "one.nrrd"]);
    assert_eq!(out.status.code(), Some(3));
    works(tmp.path(), &["convert", "t.nrrd", "-o", "one.nrrd", "--volume", "1"]);
}

#[test]
fn samples_of_another_header_are_not_overwritten() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Tube, 24);
    let header = "NDims = 3\nDimSize = 1 1 1\nElementType = MET_UCHAR\nElementSpacing = 1 1 1\n\
                  ElementDataFile = x.raw\n";
    std::fs::write(dir.join("y.mhd"), header).unwrap();
    std::fs::write(dir.join("x.raw"), "A").unwrap();
    let before = names(dir);
    let convert = ["convert", "ct.nrrd", "-o", "x.mhd"];
    let segment = ["segment", "ct.nrrd", "--threshold", ":-455", "-o", "x.mhd"];
    for args in [&convert[..], &segment] {
        let out = intima(dir, args);
        let err = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{err}");
        assert!(err.contains("x.raw") && err.contains("does not name it"), "{err}");
        assert_eq!(std::fs::read(dir.join("x.raw")).unwrap(), b"A");
        assert_eq!(names(dir), before);
    }
    // Its own it replaces, and any place that is free it takes.
    for _ in 0..2 {
        works(dir, &["convert", "ct.nrrd", "-o", "z.mhd"]);
    }
}

#[test]
fn a_camera_path_goes_into_the_folder_of_a_run_and_never_onto_its_report() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Bend, 32);
    let args = ["--mask", "mask.nrrd", "--frames", "2", "--size", "64x48", "--lod", "off"];
    for (command, files) in [
        ("run", &["--write-path=o/report.json", "--write-path=./o/mask.nrrd"][..]),
        ("run", &["--write-path=o/frames/frame_00002.png", "--core=o/mask.nrrd"]),
        ("run", &["--write-path=x.nrrd --core=x.nrrd", "--explain=nowhere/e.png"]),
        ("record", &["--write-path=o/frame_00001.png", "--video=nowhere/v.mp4"]),
    ] {
        for flags in files {
            let flags: Vec<&str> = flags.split(' ').collect();
            let out = intima(dir, &[&[command], &args[..], &flags, &["--out", "o"]].concat());
            assert_eq!(out.status.code(), Some(2), "{flags:?}");
            assert_eq!(names(dir), ["ct.nrrd", "mask.nrrd"], "{flags:?}");
        }
    }
    if !can_draw() {
        return;
    }
    for (command, path) in [("run", "o/path.json"), ("record", "./f/path.json")] {
        let folder = &path.trim_start_matches("./")[..1];
        let flags = ["--out", folder, "--write-path", path];
        works(dir, &[&[command], &args[..], &flags].concat());
        assert!(dir.join(path).is_file(), "{path}");
    }
}

#[test]
fn a_limit_of_file_size_is_said_and_leaves_no_file() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let before = names(tmp.path());
    for output in ["o.nrrd", "o.mhd", "o.ply"] {
        let program = env!("CARGO_BIN_EXE_intima");
        let command =
            if output == "o.ply" { "surface --mask mask.nrrd" } else { "convert ct.nrrd" };
        let line = format!("ulimit -f 8; exec {program} {command} -o {output}");
        let ran = Command::new("sh").args(["-c", &line]).current_dir(tmp.path()).output().unwrap();
        let err = String::from_utf8_lossy(&ran.stderr);
        assert_eq!(ran.status.code(), Some(1), "{output}: {:?} {err}", ran.status);
        assert!(err.contains("too large"), "{err}");
        assert_eq!(names(tmp.path()), before);
    }
}

#[test]
fn a_pipe_in_the_place_of_a_file_is_refused_and_not_waited_for() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Tube, 24);
    for name in ["p.stl", "p.nrrd", "p.json", "p.dcm"] {
        let made = Command::new("mkfifo").arg(dir.join(name)).status().unwrap();
        assert!(made.success());
    }
    works(dir, &["surface", "--mask", "mask.nrrd", "-o", "s.ply"]);
    let mut commands = vec![
        vec!["fair", "p.stl", "-o", "o.ply"],
        vec!["simplify", "p.stl", "--faces", "50", "-o", "o.ply"],
        vec!["segment", "p.stl", "-o", "o.nrrd"],
        vec!["info", "p.nrrd"],
        vec!["info", "p.dcm"],
        vec!["segment", "--mask", "p.nrrd", "-o", "o.nrrd"],
        vec!["record", "--mask", "mask.nrrd", "--path", "p.json", "--out", "f"],
    ];
    if cfg!(feature = "window") {
        let args = ["fly", "--mask", "mask.nrrd", "--frames-out", "s", "--script"];
        std::fs::write(dir.join("none.json"), r#"{"schema":"intima.script/1","steps":[]}"#)
            .unwrap();
        commands.push([&args[..], &["p.json"]].concat());
        commands.push([&args[..], &["none.json", "--session", "p.json"]].concat());
    }
    for args in commands {
        let mut child = start(dir, &args);
        let status = end_of(&mut child, args[0]);
        assert_eq!(status.code(), Some(3), "{args:?}");
    }
}

/// Names that colour a terminal, clear it, turn the text around or forge a line of their own.
#[test]
fn no_control_character_of_a_file_name_reaches_the_terminal() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Tube, 24);
    let name = "a\u{1b}[31m\nintima: forged\r\u{9b}2J\u{202e}\u{7f}.nrrd";
    std::fs::copy(dir.join("ct.nrrd"), dir.join(name)).unwrap();
    std::fs::write(dir.join(format!("bad{name}")), "no volume").unwrap();
    std::fs::write(dir.join(format!("bad{name}.stl")), "no mesh").unwrap();
    let folder = format!("{name}.d");
    let (bad, mesh) = (format!("bad{name}"), format!("bad{name}.stl"));
    let unknown = format!("--{name}");
    let within = format!("{folder}/o.nrrd");
    for args in [
        vec!["info", name],
        vec!["info", &bad],
        vec!["info", &folder],
        vec!["convert", "ct.nrrd", "-o", name],
        vec!["convert", name, "-o", &within],
        vec!["segment", name, "-o", "o.nrrd"],
        vec!["segment", "--mask", &bad, "-o", "o.nrrd"],
        vec!["surface", "ct.nrrd", "--threshold", ":-455", "-o", name],
        vec!["fair", &mesh, "-o", "o.ply"],
        vec!["info", "ct.nrrd", name],
        vec!["info", &unknown],
        vec!["info", "ct.nrrd", "--device", name],
        vec!["record", "ct.nrrd", "--threshold", name, "--out", "f"],
        vec!["record", "ct.nrrd", "--size", name, "--out", "f"],
    ] {
        let out = intima(dir, &args);
        for bytes in [&out.stdout, &out.stderr] {
            let text = String::from_utf8_lossy(bytes);
            let is_bad = |c: &char| (c.is_control() && *c != '\n') || *c == '\u{202e}';
            assert_eq!(text.chars().find(is_bad), None, "{args:?}: {text:?}");
            assert!(!text.lines().any(|l| l.starts_with("intima: forged")), "{args:?}: {text:?}");
        }
    }
}

#[test]
fn a_second_run_into_a_folder_is_refused_until_the_first_is_gone() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Bend, 32);
    let args = ["--mask", "mask.nrrd", "--size", "64x48", "--lod", "off", "--out", "o", "--frames"];
    let call = |command, frames| [&[command], &args[..], &[frames]].concat();
    // (first, its frames, second); frames of a run are in a folder below.
    for (first, frames, second) in [("run", "o/frames", "run"), ("record", "o", "record")] {
        let mut child = start(dir, &call(first, "90000"));
        let third = dir.join(frames).join("frame_00003.png");
        until_while_running(&mut child, "it has drawn frames", || third.exists());
        let out = intima(dir, &[&call(second, "2")[..], &["--json"]].concat());
        let err = String::from_utf8_lossy(&out.stderr);
        assert_eq!(out.status.code(), Some(1), "{err}");
        assert!(err.contains("o: another run is writing into this folder"), "{err}");
        let answer: Value = serde_json::from_slice(&out.stdout).unwrap();
        assert_eq!(answer["error"]["reason"], "folder-in-use");
        assert!(dir.join(frames).join("frame_00003.png").exists(), "its frames were removed");
        assert!(child.try_wait().unwrap().is_none());
        // However the first ends, its lock ends with it.
        signal(&child, "-KILL");
        child.wait().unwrap();
        works(dir, &call(second, "2"));
        let left = names(&dir.join(frames)).iter().filter(|n| n.starts_with("frame_")).count();
        assert_eq!(left, 2);
        std::fs::remove_dir_all(dir.join("o")).unwrap();
    }
}

#[test]
fn samples_whose_header_a_killed_run_did_not_name_are_replaced() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    phantom(dir, Kind::Tube, 24);
    works(dir, &["convert", "ct.nrrd", "-o", "v.mhd"]);
    // What is left between the two names: samples, and the header by its temporary name.
    std::fs::rename(dir.join("v.mhd"), dir.join(".intima-abcdefABCDEF.tmp")).unwrap();
    works(dir, &["convert", "ct.nrrd", "-o", "v.mhd"]);
    assert_eq!(temporary(dir), Vec::<std::path::PathBuf>::new());
    // Samples that were written since are somebody else's.
    std::fs::rename(dir.join("v.mhd"), dir.join(".intima-abcdefABCDEF.tmp")).unwrap();
    std::thread::sleep(Duration::from_millis(20));
    std::fs::write(dir.join("v.raw"), "A").unwrap();
    let out = intima(dir, &["convert", "ct.nrrd", "-o", "v.mhd"]);
    assert_eq!(out.status.code(), Some(1));
    assert_eq!(std::fs::read(dir.join("v.raw")).unwrap(), b"A");
}
