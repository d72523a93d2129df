//! The tissue behind the wall from outside: command line, window, and volumes without values.

use std::path::Path;
use std::process::{Command, Output};
use std::sync::Arc;

use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::phantom::{Kind, Phantom};
use intima::volume::{Acquisition, Volume};

fn intima(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_intima")).current_dir(folder).args(args).output().unwrap()
}

/// A folder with the scan of a branched tube, and its mask.
fn folder() -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    let phantom = Phantom::new(Kind::Y, 48, [1.0; 3]).unwrap();
    let scan = phantom.grey(None, 0);
    intima::formats::write_volume(&tmp.path().join("scan.nrrd"), &scan).unwrap();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &phantom.mask()).unwrap();
    tmp
}

fn record(folder: &Path, input: &[&str], more: &[&str]) -> Vec<u8> {
    let frames = ["--frames", "3", "--size", "96x64", "--out", "out"];
    let done = intima(folder, &[&["record"], input, &frames, more].concat());
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    std::fs::read(folder.join("out/frame_00002.png")).unwrap()
}

#[test]
fn a_translucent_frame_depends_on_its_depth_and_on_no_number_of_threads() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let scan = ["scan.nrrd", "--threshold", ":-500"];
    let draw = |more: &[&str]| record(tmp.path(), &scan, more);
    let translucent = draw(&["--view", "translucent"]);
    assert!(translucent != draw(&[]), "the tissue shows");
    assert!(translucent == draw(&["--behind", "5"]), "5 mm unless someone asks for more");
    assert!(translucent != draw(&["--behind", "2"]));
    for threads in ["1", "3"] {
        assert!(translucent == draw(&["--view", "translucent", "--threads", threads]));
    }
    // A mask of the same lumen takes its values from the image.
    let masked = ["scan.nrrd", "--mask", "mask.nrrd"];
    let plain = record(tmp.path(), &masked, &[]);
    assert!(plain != record(tmp.path(), &masked, &["--view", "translucent"]));
    // Everything about the eye shows tissue too.
    assert!(draw(&["--view", "cube"]) != draw(&["--view", "cube", "--behind", "5"]));
}

#[test]
fn volumes_without_ct_numbers_show_nothing_behind_the_wall_and_say_why() {
    let tmp = folder();
    let frames = ["record", "mask.nrrd", "--out", "out", "--view", "translucent"];
    let done = intima(tmp.path(), &frames);
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(3), "{said}");
    assert!(said.contains("a label map has no values behind the wall"), "{said}");
    assert!(!tmp.path().join("out/frame_00001.png").exists());

    let deep = ["record", "scan.nrrd", "--threshold", ":-500", "--out", "out", "--behind", "26"];
    let done = intima(tmp.path(), &deep);
    let said = String::from_utf8_lossy(&done.stderr);
    assert_eq!(done.status.code(), Some(2), "{said}");
    assert!(said.contains("0.5 to 25 mm"), "{said}");

    let far = ["record", "scan.nrrd", "--threshold", ":-500", "--out", "out", "--view", "overview"];
    let done = intima(tmp.path(), &[&far[..], &["--behind", "5"]].concat());
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.code() == Some(2) && said.contains("not for the overview"), "{said}");

    let acquisition = Some(Acquisition { modality: "MR", series_hash: None });
    let scan = Phantom::new(Kind::Tube, 32, [1.0; 3]).unwrap().grey(None, 0);
    let scan = Arc::new(Volume { acquisition, ..scan });
    let mut settings = Settings::default();
    settings.lumen.select =
        Some(intima::lumen::IntensitySelection::Range { lo: f64::NEG_INFINITY, hi: -500.0 });
    let session = Session::new(Source::Image(VolumeSource::Memory(scan)), settings).unwrap();
    let error = session.behind().unwrap_err().to_string();
    assert!(error.contains("MR volume"), "{error}");
}

#[test]
#[cfg(feature = "window")]
fn the_window_looks_behind_the_wall_of_a_scan_and_not_of_a_label_map() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let steps = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"wait": "complete"}, {"wait": "levels"}, {"do": {"seek": 15}}, {"frames": 2},
        {"do": {"export": "view"}}, {"do": {"colour": "behind"}}, {"frames": 3},
        {"do": {"export": "view"}}, {"do": {"colour": "tissue"}}, {"frames": 2},
        {"do": {"export": "view"}}]}"#;
    std::fs::write(tmp.path().join("steps.json"), steps).unwrap();
    let script = ["--script", "steps.json", "--frames-out", "out"];
    for (input, shows) in
        [(&["scan.nrrd", "--threshold", ":-500"][..], true), (&["mask.nrrd"], false)]
    {
        let case = input[0].trim_end_matches(".nrrd");
        let view =
            |i: u32| std::fs::read(tmp.path().join(format!("out/{case}-view-{i}.png"))).unwrap();
        let done = intima(tmp.path(), &[&["fly"], input, &script].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        assert_eq!(view(1) != view(2), shows, "{input:?}");
        assert!(view(1) == view(3), "{input:?}");
        std::fs::remove_dir_all(tmp.path().join("out")).unwrap();
    }
}
