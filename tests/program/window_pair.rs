//! Two cases beside each other in one window.
#![cfg(feature = "window")]

use std::path::Path;

use super::played::play_alone;
use intima::volume::phantom::{Kind, Phantom};

/// A folder with a bend and a tube.
fn two_cases() -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    for (name, kind) in [("prone.nrrd", Kind::Bend), ("supine.nrrd", Kind::Tube)] {
        let scan = Phantom::new(kind, 48, [1.0; 3]).unwrap().grey(None, 0);
        intima::formats::write_volume(&tmp.path().join(name), &scan).unwrap();
    }
    tmp
}

/// Plays a script with a state folder; then the place on the path and the notes of each case.
fn kept(dir: &Path, args: &[&str], steps: &str) -> [(f64, Vec<String>); 2] {
    play_alone(dir, &[args, &["--state", "state"]].concat(), steps);
    let of = |name: &str| {
        let files = std::fs::read_dir(dir.join("state/cases")).unwrap().flatten();
        let json = files.filter_map(|f| std::fs::read(f.path()).ok()).find_map(|bytes| {
            let json: serde_json::Value = serde_json::from_slice(&bytes).ok()?;
            json["case"]["image"]["path"].as_str()?.ends_with(name).then_some(json)
        });
        let json = json.unwrap_or_else(|| panic!("{name} is not kept"));
        let texts = json["bookmarks"].as_array().unwrap().iter();
        let texts = texts.map(|b| b["text"].as_str().unwrap().to_owned()).collect();
        (json["arc_mm"].as_f64().unwrap(), texts)
    };
    [of("prone.nrrd"), of("supine.nrrd")]
}

/// Both cases, each with its lumen.
const BOTH: &str = r#"{"wait": "complete"}, {"do": {"beside": {"open": "supine.nrrd"}}},
    {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"}"#;

#[test]
fn a_place_is_found_in_the_other_case_and_each_keeps_its_own_notes() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = two_cases();
    let steps = format!(
        r#"{BOTH}, {{"do": {{"seek": 0}}}}, {{"do": {{"bookmark": "in supine"}}}},
        {{"do": {{"activate": 0}}}}, {{"do": {{"seek": 1e9}}}}, {{"do": {{"bookmark": "in prone"}}}},
        {{"do": "find_in_other"}}, {{"frames": 120}}, {{"picture": "pair"}}"#
    );
    let args = ["prone.nrrd", "--threshold", ":-500"];
    let [prone, supine] = kept(tmp.path(), &args, &steps);
    assert_eq!(
        (&prone.1[..], &supine.1[..]),
        (&["in prone".into()][..], &["in supine".into()][..])
    );
    assert!(prone.0 > 20.0, "at its end: {} mm", prone.0);
    // The tube's own end, not as many millimetres.
    let alone = tmp.path().join("alone");
    std::fs::create_dir(&alone).unwrap();
    std::fs::rename(tmp.path().join("state"), tmp.path().join("before")).unwrap();
    let end = r#"{"wait": "complete"}, {"do": {"beside": {"open": "supine.nrrd"}}},
        {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"}, {"do": {"seek": 1e9}}"#;
    let [_, to_the_end] = kept(tmp.path(), &args, end);
    assert!((supine.0 - to_the_end.0).abs() < 1e-6, "{} {}", supine.0, to_the_end.0);
}

#[test]
fn linked_eyes_move_together_and_a_closed_case_leaves_the_other() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = two_cases();
    let args = ["prone.nrrd", "--threshold", ":-500"];
    // They begin at their starts: at the end of one the other is at its own.
    let linked = format!(r#"{BOTH}, {{"do": {{"link": true}}}}, {{"do": {{"seek": 1e9}}}}"#);
    let [prone, supine] = kept(tmp.path(), &args, &linked);
    assert!(prone.0 > 20.0 && supine.0 > 20.0, "{} {}", prone.0, supine.0);
    std::fs::remove_dir_all(tmp.path().join("state")).unwrap();
    let free = format!(
        r#"{BOTH}, {{"do": {{"link": true}}}}, {{"do": {{"link": false}}}}, {{"do": {{"seek": 1e9}}}},
        {{"do": "close_case"}}, {{"do": {{"bookmark": "left"}}}}, {{"picture": "one"}}"#
    );
    let [prone, supine] = kept(tmp.path(), &args, &free);
    assert!(prone.0 < 1.0 && supine.0 > 20.0, "{} {}", prone.0, supine.0);
    assert_eq!((prone.1, supine.1), (vec!["left".to_owned()], Vec::new()));
}
