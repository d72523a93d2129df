//! The program with faults planted in it: full disks, short reads, lost devices.

use super::*;

fn with_fault(dir: &Path, fault: &str, args: &[&str]) -> (i32, String) {
    let out = Command::new(env!("CARGO_BIN_EXE_intima"))
        .args(args)
        .current_dir(dir)
        .env("INTIMA_FAULT", fault)
        .output()
        .unwrap();
    let err = String::from_utf8_lossy(&out.stderr).into_owned();
    assert!(!err.contains("panicked"), "{fault}: {err}");
    (out.status.code().unwrap_or(-1), err)
}

#[test]
fn a_full_disk_leaves_no_file_behind() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let before = names(tmp.path());
    for (command, output) in [("distance", "o.nrrd"), ("surface", "o.ply"), ("centerline", "o.vtp")]
    {
        let args = [command, "--mask", "mask.nrrd", "-o", output];
        let (code, err) = with_fault(tmp.path(), "write:1", &args);
        assert_eq!(code, 1, "{err}");
        assert!(err.contains(output), "{err}");
        assert_eq!(names(tmp.path()), before);
    }
}

#[test]
fn an_old_output_survives_a_full_disk() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    std::fs::write(tmp.path().join("o.nrrd"), "old").unwrap();
    let args = ["distance", "--mask", "mask.nrrd", "-o", "o.nrrd"];
    assert_eq!(with_fault(tmp.path(), "write:1", &args).0, 1);
    assert_eq!(std::fs::read(tmp.path().join("o.nrrd")).unwrap(), b"old");
}

#[test]
fn a_short_read_names_the_file() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let args = ["distance", "--mask", "mask.nrrd", "-o", "o.nrrd"];
    for n in 1..4 {
        let (code, err) = with_fault(tmp.path(), &format!("read:{n}"), &args);
        assert_eq!(code, 3, "{err}");
        assert!(err.contains("mask.nrrd"), "{err}");
    }
}

#[test]
fn a_lost_device_and_exhausted_memory_end_in_one_line() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let before = names(tmp.path());
    let args = ["distance", "--mask", "mask.nrrd", "-o", "o.nrrd", "--device", "gpu"];
    for (fault, code) in [("submit:1", 1), ("allocate:1", 1), ("instance:1", 4)] {
        let (got, err) = with_fault(tmp.path(), fault, &args);
        assert_eq!(got, code, "{fault}: {err}");
        assert_eq!(names(tmp.path()), before);
    }
}

#[test]
fn without_vulkan_everything_that_draws_nothing_still_runs() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let args = ["centerline", "--mask", "mask.nrrd", "-o", "o.csv"];
    let (code, err) = with_fault(tmp.path(), "instance:1", &args);
    assert_eq!(code, 0, "{err}");
    let args = ["record", "--mask", "mask.nrrd", "--out", "f", "--frames", "1"];
    assert_eq!(with_fault(tmp.path(), "instance:1", &args).0, 4);
    assert!(!tmp.path().join("f").exists(), "no empty folder is left");
}
