//! The files that commands make: their mode, and what is left of runs that were ended.

use std::fs::{File, Permissions};
use std::os::unix::fs::PermissionsExt;
use std::process::{Child, Stdio};
use std::time::{Duration, Instant};

use super::*;

/// A stand-in for ffmpeg that writes some bytes of its output at once, the rest when its input
/// ends.
pub fn ffmpeg(dir: &Path) -> std::ffi::OsString {
    let folder = dir.join("bin");
    std::fs::create_dir_all(&folder).unwrap();
    let script = "#!/bin/sh\nfor last; do :; done\necho begun > \"$last\"\ncat > /dev/null\n\
                  echo ended >> \"$last\"\n";
    std::fs::write(folder.join("ffmpeg"), script).unwrap();
    std::fs::set_permissions(folder.join("ffmpeg"), Permissions::from_mode(0o755)).unwrap();
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
        let since = Instant::now();
        // The encoder has begun once its file holds something.
        let begun = || {
            let files = temporary(tmp.path());
            files.iter().any(|p| std::fs::read(p).is_ok_and(|b| b == b"begun\n"))
        };
        while !begun() {
            assert!(child.try_wait().unwrap().is_none(), "ended before its video began");
            assert!(since.elapsed() < Duration::from_secs(120));
            std::thread::sleep(Duration::from_millis(5));
        }
        signal(&child, name);
        let status = child.wait().unwrap();
        assert_eq!(status.code(), Some(130), "{name}: {status}");
        // Longer than the encoder takes to notice that its input has ended.
        std::thread::sleep(Duration::from_millis(300));
        assert_eq!(temporary(tmp.path()), Vec::<std::path::PathBuf>::new(), "{name}");
        assert!(!tmp.path().join("v.mp4").exists());
    }
}
