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

/// Both parts of a `.mhd` change together: what is read after any failure is the old volume, the
/// new one, or nothing.
#[test]
fn no_failed_write_leaves_an_old_mhd_header_beside_new_samples() {
    let tmp = tempfile::tempdir().unwrap();
    let dir = tmp.path();
    // The new volume is larger, so that the old header would fit its samples.
    for (size, name) in [(24, "old.nrrd"), (32, "new.nrrd")] {
        let p = Phantom::new(Kind::Tube, size, [1.0; 3]).unwrap();
        write_volume(&dir.join(name), &p.grey(None, 1)).unwrap();
    }
    let read = |name: &str| read_volume(&dir.join(name), &ReadOptions::default());
    let (old, new) = (read("old.nrrd").unwrap(), read("new.nrrd").unwrap());
    let mut failures = 0;
    for point in ["write", "rename", "syncfolder"] {
        for n in 1..6 {
            works(dir, &["convert", "old.nrrd", "-o", "v.mhd"]);
            let args = ["convert", "new.nrrd", "-o", "v.mhd"];
            let (code, err) = with_fault(dir, &format!("{point}:{n}"), &args);
            match read("v.mhd") {
                Ok(v) if code == 0 => assert_eq!(v, new, "{point}:{n}"),
                Ok(v) => assert!(v == old || v == new, "{point}:{n}: {err}"),
                Err(_) => assert!(!dir.join("v.mhd").exists(), "{point}:{n}: {err}"),
            }
            failures += usize::from(code == 1);
            let left = names(dir).into_iter().filter(|n| n.starts_with('.')).count();
            assert_eq!(left, 0, "{point}:{n}");
            // Samples without a header are nobody's to replace.
            if !dir.join("v.mhd").exists() {
                let _ = std::fs::remove_file(dir.join("v.raw"));
            }
        }
    }
    // Two files are filled and renamed, and the folder is synced three times.
    assert!(failures >= 2 + 2 + 3, "{failures}");
}

#[test]
fn a_folder_that_cannot_be_synced_is_said() {
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 24);
    let args = ["convert", "ct.nrrd", "-o", "o.nrrd"];
    let (code, err) = with_fault(tmp.path(), "syncfolder:1", &args);
    assert_eq!(code, 1, "{err}");
    assert!(err.contains("o.nrrd"), "{err}");
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
fn without_its_device_a_program_ends_in_one_line() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let before = names(tmp.path());
    let args = ["distance", "--mask", "mask.nrrd", "-o", "o.nrrd", "--device", "gpu"];
    let (code, err) = with_fault(tmp.path(), "instance:1", &args);
    assert_eq!(code, 4, "{err}");
    assert_eq!(names(tmp.path()), before);
}

/// After a driver reset every later stage of a session failed, until the program was started again.
#[test]
fn a_device_that_is_lost_is_opened_again_and_if_lost_again_the_cpu_goes_on() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let run = |device: &str, fault: &str| {
        let out = format!("{device}-{}.nrrd", fault.replace(':', "-"));
        let args = ["distance", "--mask", "mask.nrrd", "-o", &out, "--device", device];
        let (code, err) = with_fault(tmp.path(), fault, &args);
        assert_eq!(code, 0, "{fault}: {err}");
        (std::fs::read(tmp.path().join(out)).unwrap(), err)
    };
    let (wanted, _) = run("cpu", "none:1");
    let (once, err) = run("gpu", "submit:1-1");
    assert!(err.contains("opened again") && !err.contains("the CPU computes"), "{err}");
    let (for_ever, err) = run("gpu", "submit:1");
    assert!(err.contains("the CPU computes from now on"), "{err}");
    assert!(once == wanted && for_ever == wanted);
}

/// A flight whose device was lost at one frame ended there.
#[test]
fn frames_go_on_where_a_lost_device_is_opened_again_with_the_same_bytes() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let record = |device: &str, fault: &str| {
        let out = format!("{device}-{}", fault.replace(':', "-"));
        let args = ["record", "--mask", "mask.nrrd", "--device", device, "--out", &out];
        let args = [&args[..], &["--frames", "40", "--size", "96x64"]].concat();
        let (code, err) = with_fault(tmp.path(), fault, &args);
        let frames = std::fs::read_dir(tmp.path().join(&out)).into_iter().flatten();
        let mut frames: Vec<_> = frames.map(|f| f.unwrap().path()).collect();
        frames.sort();
        let bytes: Vec<Vec<u8>> = frames.iter().map(|f| std::fs::read(f).unwrap()).collect();
        (code, err, bytes)
    };
    for device in ["cpu", "gpu"] {
        let (_, _, wanted) = record(device, "none:1");
        assert_eq!(wanted.len(), 40);
        // Plans and uploads take the first submissions.
        for fault in ["submit:25-25", "submit:35-35"] {
            let (code, err, frames) = record(device, fault);
            assert_eq!(code, 0, "{fault}: {err}");
            assert!(err.contains("opened again"), "{fault}: {err}");
            assert!(frames == wanted, "{device}, {fault}: other frames");
        }
        let (code, err, _) = record(device, "submit:25");
        assert_eq!((code, err.trim().lines().last().is_some()), (1, true), "{err}");
    }
}

#[test]
fn what_device_memory_has_no_room_for_is_computed_on_the_cpu() {
    if !can_draw() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    phantom(tmp.path(), Kind::Tube, 48);
    let distance = |device: &str, fault: &str| {
        let out = format!("{device}.nrrd");
        let args = ["distance", "--mask", "mask.nrrd", "-o", &out, "--device", device];
        let (code, err) = with_fault(tmp.path(), fault, &args);
        assert_eq!(code, 0, "{err}");
        (std::fs::read(tmp.path().join(out)).unwrap(), err)
    };
    let (on_cpu, _) = distance("cpu", "none:1");
    let (fallen_back, err) = distance("gpu", "allocate:1");
    assert!(err.contains("out of device memory") && err.contains("the CPU computes it"), "{err}");
    assert!(fallen_back == on_cpu);
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
