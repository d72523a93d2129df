//! The window without a display: scripts give the same bytes each time.
#![cfg(feature = "window")]

use std::process::{Command, Output};

use super::played::{fly, folder, play_alone};
use common::html::Element;
use common::{torso, volumes};
use intima::volume::phantom::{Kind, Phantom};

const SCRIPT: &str = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
    {"wait": "complete"}, {"picture": "begin"},
    {"key": "Space"}, {"frames": 20}, {"key": "Space"}, {"picture": "played"},
    {"hold": ["W", 40]}, {"key": "B"}, {"picture": "flown"},
    {"pointer": [100, 200]}, {"drag": [160, 180]}, {"wheel": 2}, {"picture": "looked"},
    {"do": {"maximise": "axial"}}, {"picture": "axial"}, {"key": "Escape"},
    {"pointer": [200, 365]}, {"click": null}, {"frames": 30}, {"picture": "sought"},
    {"key": "V"}, {"picture": "cube"}, {"key": "V"}, {"picture": "panorama"}, {"key": "V"},
    {"key": "C"}, {"picture": "missed"}, {"key": "C"}, {"picture": "radius"},
    {"key": "M"}, {"pointer": [100, 150]}, {"click": null}, {"pointer": [150, 200]},
    {"click": null}, {"picture": "measured"},
    {"do": {"export": "view"}}, {"do": {"export": "report"}}]}"#;

#[test]
fn a_script_played_twice_gives_the_same_pictures_and_saves_its_bookmarks() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let script = SCRIPT.replace(r#"{"click": null}"#, r#""click""#);
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let mut all = Vec::new();
    for (out, threads) in [("a", "1"), ("b", "2")] {
        let session = format!("{out}.json");
        let args = ["--script", "s.json", "--frames-out", out, "--session", &session];
        let done = fly(tmp.path(), &[&args[..], &["--threads", threads]].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        let names = [
            "begin", "played", "flown", "looked", "axial", "sought", "cube", "panorama", "missed",
            "radius", "measured",
        ];
        let read = |n: &str| std::fs::read(tmp.path().join(out).join(format!("{n}.png"))).unwrap();
        let pictures: Vec<Vec<u8>> = names.iter().map(|n| read(n)).collect();
        for (i, w) in pictures.windows(2).enumerate() {
            assert_ne!(w[0], w[1], "{} and {} differ", names[i], names[i + 1]);
        }
        let notes = std::fs::read_to_string(tmp.path().join(&session)).unwrap();
        let json: serde_json::Value = serde_json::from_str(&notes).unwrap();
        assert_eq!(json["schema"], "intima.session/1");
        assert_eq!(json["bookmarks"].as_array().unwrap().len(), 1);
        assert_eq!(json["measurements"].as_array().unwrap().len(), 1);
        let name = json["bookmarks"][0]["picture"].as_str().unwrap();
        let bookmark = intima::formats::read_png(&tmp.path().join(name)).unwrap();
        let view =
            intima::formats::read_png(&tmp.path().join(out).join("mask-view-1.png")).unwrap();
        assert_eq!((bookmark.0, bookmark.1), (view.0, view.1), "both are the inside pane");
        let html =
            std::fs::read_to_string(tmp.path().join(out).join("mask-report-1.html")).unwrap();
        let page = common::html::read(&html);
        let findings = page.by_id("findings").unwrap();
        assert!(findings.text.contains("1. Place 1") && findings.text.contains("Wall at"));
        assert!(page.by_id("measurements").is_some() && page.by_id("profile").is_some());
        let count = |e: &Element| e.all().iter().filter(|e| e.name == "img").count();
        assert_eq!((count(findings), count(&page)), (4, 9), "the view and three slices");
        assert!(!html.contains("mask.nrrd"), "no name of a file");
        let html = common::html::lasting(&html);
        all.push((pictures, notes.replace(&format!("{out}-bookmark"), "bookmark"), html));
    }
    assert!(all[0] == all[1], "the same bytes at any number of threads");
}

#[test]
fn a_volume_is_opened_in_the_window_and_its_lumen_chosen_there() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let phantom = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &phantom.mask()).unwrap();
    intima::formats::write_volume(&tmp.path().join("ct.nrrd"), &phantom.grey(None, 0)).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"frames": 2}, {"picture": "empty"},
        {"do": {"open": "ct.nrrd"}}, {"wait": "volume"}, {"picture": "grey"},
        {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"}, {"picture": "chosen"},
        {"do": {"open": "mask.nrrd"}}, {"wait": "complete"}, {"picture": "label"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["fly", "--script", "s.json", "--frames-out", "out"]);
    let done = command.current_dir(tmp.path()).env_remove("INTIMA_FAULT").output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let read = |n: &str| std::fs::read(tmp.path().join("out").join(format!("{n}.png"))).unwrap();
    let pictures = ["empty", "grey", "chosen", "label"].map(read);
    for w in pictures.windows(2) {
        assert_ne!(w[0], w[1]);
    }
}

/// `fly` took `--lod off` for another form, and left `--core` out without a word.
#[test]
fn without_levels_of_detail_the_window_draws_the_whole_wall() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let phantom = Phantom::new(Kind::Colon, 96, [1.0; 3]).unwrap();
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &phantom.mask()).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [900, 600], "steps": [
        {"wait": "levels"}, {"frames": 2}, {"picture": "p"}, {"wait": "complete"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let shown = |lod: &str, error: &str| {
        let out = format!("{lod}-{error}");
        let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
        command.args(["fly", "--mask", "mask.nrrd", "--script", "s.json", "--frames-out", &out]);
        command.args(["--lod", lod, "--pixel-error", error]);
        let done = command.current_dir(tmp.path()).env_remove("INTIMA_FAULT").output().unwrap();
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        intima::formats::read_png(&tmp.path().join(out).join("p.png")).unwrap().2
    };
    let apart = |a: &[u8], b: &[u8]| {
        assert_eq!(a.len(), b.len());
        let pairs = a.chunks(3).zip(b.chunks(3)).filter(|(a, b)| a != b);
        let most = |(a, b): (&[u8], &[u8])| {
            a.iter().zip(b).map(|(a, b)| a.abs_diff(*b)).max().unwrap_or(0)
        };
        (pairs.clone().count(), pairs.map(most).max().unwrap_or(0))
    };
    let whole = shown("off", "1");
    assert!(whole == shown("off", "100"), "the whole wall does not hang on the error");
    // On the crest of a fold front and back may have the same depth, and the back win.
    let (pixels, most) = apart(&whole, &shown("culled", "1"));
    assert!(pixels <= 20 && most < 64, "{pixels} pixels see what was left out, by {most}");
    assert!(whole != shown("vds", "8"), "a cut is drawn instead of the whole wall");
    let mut core = Command::new(env!("CARGO_BIN_EXE_intima"));
    core.args(["fly", "--mask", "mask.nrrd", "--core", "c.nrrd"]).current_dir(tmp.path());
    let done = core.args(["--script", "s.json", "--frames-out", "out"]).output().unwrap();
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.code() == Some(2) && said.contains("--core is not for"), "{said}");
}

/// Without levels of detail the window drew the caps that `--open-ends` leaves out.
#[test]
fn an_open_end_is_open_in_the_window() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let inside = |i: usize| ((i % 20) as f64 - 9.5).hypot((i / 20 % 20) as f64 - 9.5) < 6.0;
    let voxels: Vec<u8> = (0..20 * 20 * 40).map(|i| u8::from(inside(i))).collect();
    let grid = intima::volume::Grid::axis_aligned([20, 20, 40], [1.0; 3]);
    let volume = intima::volume::Volume::new(grid, voxels.into());
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &volume).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [900, 600], "steps": [
        {"wait": "complete"}, {"do": {"seek": 10}}, {"frames": 2}, {"picture": "p"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let shown = |out: &str, more: &[&str]| {
        let args = ["--script", "s.json", "--frames-out", out];
        let done = fly(tmp.path(), &[&args[..], &[], more].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
        intima::formats::read_png(&tmp.path().join(out).join("p.png")).unwrap().2
    };
    let apart = |a: &[u8], b: &[u8]| a.chunks(3).zip(b.chunks(3)).filter(|(a, b)| a != b).count();
    let (closed, open) = (shown("closed", &[]), shown("open", &["--open-ends"]));
    assert!(apart(&closed, &open) > 1000, "{} pixels", apart(&closed, &open));
}

#[test]
fn the_window_is_exported_as_it_is_seen_with_findings_as_a_table() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    play_alone(
        tmp.path(),
        &["mask.nrrd"],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"do": {"bookmark": "fold, \"high\""}},
        {"do": {"measure": "length"}}, {"do": {"mark": [10, 20, 30]}},
        {"do": {"mark": [10, 20, 37]}}, {"frames": 2}, {"picture": "seen"},
        {"do": {"export": "window"}}, {"do": {"export": "findings"}}"#,
    );
    let read = |name: &str| intima::formats::read_png(&tmp.path().join(name)).unwrap();
    assert!(read("out/seen.png") == read("out/mask-window-1.png"));
    let table = std::fs::read_to_string(tmp.path().join("out/mask-findings-1.csv")).unwrap();
    assert!(table.contains("\r\n1,\"fold, \"\"high\"\"\",,0.00,"), "{table}");
}

#[test]
fn a_series_a_segment_and_an_organ_are_chosen_in_the_window() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    std::fs::create_dir(tmp.path().join("scan")).unwrap();
    for (series, columns) in [("1.2.3", 4u16), ("1.2.4", 6)] {
        for z in 0..3u8 {
            let slice = volumes::Slice {
                series,
                size: [columns, 3],
                position: [0.0, 0.0, f64::from(z)],
                pixels: (0..columns * 3).map(|p| p * 90).collect(),
                ..volumes::Slice::default()
            };
            let file = tmp.path().join(format!("scan/{series}-{z}.dcm"));
            std::fs::write(file, volumes::dicom_slice(&slice)).unwrap();
        }
    }
    let seg = volumes::fixture("seg/layers.seg.nrrd");
    std::fs::copy(seg, tmp.path().join("a.seg.nrrd")).unwrap();
    let torso = torso::Torso::default().scan();
    intima::formats::write_volume(&tmp.path().join("torso.nrrd"), &torso).unwrap();
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"do": {"open": "scan"}}, {"wait": "failure"}, {"picture": "two_series"},
        {"do": {"series": 1}}, {"wait": "volume"}, {"picture": "series"},
        {"do": {"open": "a.seg.nrrd"}}, {"wait": "failure"}, {"picture": "segments"},
        {"do": {"segment": "Lumen"}}, {"wait": "wall"}, {"picture": "segment"},
        {"do": {"open": "torso.nrrd"}}, {"wait": "failure"}, {"picture": "no_lumen"},
        {"do": {"organ": "vessel"}}, {"wait": "wall"}, {"picture": "aorta"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
    command.args(["fly", "--script", "s.json", "--frames-out", "out"]);
    let done = command.current_dir(tmp.path()).env_remove("INTIMA_FAULT").output().unwrap();
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let names = ["two_series", "series", "segments", "segment", "no_lumen", "aorta"];
    let read = |n: &str| std::fs::read(tmp.path().join("out").join(format!("{n}.png"))).unwrap();
    let pictures = names.map(read);
    for w in pictures.windows(2) {
        assert_ne!(w[0], w[1]);
    }
    if let Some(out) = std::env::var_os("INTIMA_OUT") {
        for (name, picture) in names.iter().zip(&pictures) {
            std::fs::write(std::path::Path::new(&out).join(format!("{name}.png")), picture)
                .unwrap();
        }
    }
}

#[test]
fn without_a_display_or_with_a_wrong_script_a_clear_line_and_a_code_of_its_own() {
    let tmp = folder();
    let line = |o: &Output| String::from_utf8_lossy(&o.stderr).trim().to_owned();
    let none = fly(tmp.path(), &[]);
    assert_eq!((none.status.code(), line(&none).lines().count()), (Some(4), 1), "{}", line(&none));
    assert_eq!(line(&none), "intima: no display: neither X11 nor Wayland answers");
    std::fs::write(
        tmp.path().join("s.json"),
        r#"{"schema": "intima.script/1", "steps": [{"leap": 1}]}"#,
    )
    .unwrap();
    let wrong = fly(tmp.path(), &["--script", "s.json", "--frames-out", "o"]);
    assert_eq!(wrong.status.code(), Some(3));
    assert_eq!(line(&wrong), "intima: step 1 of the script: no step that there is");
    assert!(!tmp.path().join("o").exists());
}
