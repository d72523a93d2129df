//! Notes of the window and their files: nothing noted is lost, and a session is a case.
#![cfg(feature = "window")]

use std::path::Path;

use super::played::{fly, folder, notes, play, play_alone};
use intima::volume::phantom::{Kind, Phantom};

#[test]
fn a_session_opened_again_leads_to_the_same_pictures() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let write = |name: &str, steps: &str| {
        let text =
            format!(r#"{{"schema": "intima.script/1", "size": [640, 400], "steps": [{steps}]}}"#);
        std::fs::write(tmp.path().join(name), text).unwrap();
    };
    write(
        "make.json",
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "on the path"}},
        {"do": {"field_of_view": 120}}, {"do": {"turn": [0.5, 0.2, 0.3]}},
        {"do": {"fly": [1.0, 0.5, 3.0]}}, {"do": {"bookmark": "off it"}}"#,
    );
    write(
        "back.json",
        r#"{"wait": "complete"}, {"do": {"go_to_bookmark": 1}}, {"do": {"bookmark": "again"}},
        {"do": {"go_to_bookmark": 0}}, {"do": {"bookmark": "again"}}"#,
    );
    for script in ["make", "back"] {
        let file = format!("{script}.json");
        let args = ["--script", &file, "--frames-out", script, "--session", "notes.json"];
        let done = fly(tmp.path(), &[&args[..], &[]].concat());
        assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    }
    let read = |name: &str| std::fs::read(tmp.path().join(name)).unwrap();
    assert!(read("notes-bookmark-2.png") == read("notes-bookmark-3.png"), "off the path");
    assert!(read("notes-bookmark-1.png") == read("notes-bookmark-4.png"), "on the path");
    assert_ne!(read("notes-bookmark-1.png"), read("notes-bookmark-2.png"));
}

/// All findings were "off the path" for ever once another lumen had been tried.
#[test]
fn bookmarks_stay_when_another_lumen_of_the_volume_is_chosen_and_the_first_again() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let scan = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().grey(None, 0);
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &scan).unwrap();
    play(
        tmp.path(),
        &["--threshold", ":-500"],
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "first"}},
        {"do": {"lumen": {"range": [-2000, -700]}}}, {"wait": "complete"},
        {"do": {"bookmark": "second"}},
        {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"},
        {"do": {"go_to_bookmark": 0}}"#,
    );
    let saved = notes(tmp.path());
    let arcs = |text: &str| {
        let all = saved["bookmarks"].as_array().unwrap();
        all.iter().find(|b| b["text"] == text).unwrap()["arc_mm"].as_f64()
    };
    assert_eq!(arcs("first"), Some(20.0));
    assert!(arcs("second").is_some());
    assert_eq!(saved["arc_mm"], 20.0, "the path passes there again");
}

/// The picture had neither marks nor the notice.
#[test]
fn a_saved_view_has_marks_and_notice_and_a_finding_its_plain_picture() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"do": {"seek": 20}}, {"frames": 2},
        {"do": {"bookmark": "plain"}}, {"do": {"export": "view"}}"#,
    );
    // A length in the middle of that view.
    let middle = notes(tmp.path())["bookmarks"][0]["wall_mm"].clone();
    let mark = format!(r#"{{"do": {{"mark": {middle}}}}}"#);
    let steps = r#"{"wait": "complete"}, {"wait": "levels"}, {"do": {"seek": 20}}, {"frames": 2},
        {"do": {"measure": "length"}}, MARK, MARK, {"frames": 1}, {"do": {"export": "view"}}"#;
    play(tmp.path(), &[], &steps.replace("MARK", &mark));
    let read = |name: &str| intima::formats::read_png(&tmp.path().join(name)).unwrap();
    let (width, height, plain) = read("notes-bookmark-1.png");
    let views = ["out/mask-view-1.png", "out/mask-view-2.png"].map(|name| {
        let view = read(name);
        assert_eq!((view.0, view.1), (width, height));
        view.2
    });
    // Rows that differ, from the top.
    let rows = |a: &[u8], b: &[u8]| -> Vec<usize> {
        let row = 3 * width as usize;
        (0..height as usize)
            .filter(|y| a[y * row..(y + 1) * row] != b[y * row..(y + 1) * row])
            .collect()
    };
    let marked = rows(&plain, &views[0]);
    let lowest = height as usize - 1;
    assert!(marked.contains(&(lowest - 5)), "the notice: {marked:?}");
    let measured = rows(&views[0], &views[1]);
    assert!(measured.contains(&(height as usize / 2)), "{measured:?}");
    assert!(measured.len() < height as usize / 2, "{measured:?}");
}

/// One report took the place of the other: of the same case, or of another patient.
#[test]
fn a_report_saved_twice_is_two_and_that_of_another_case_has_its_name() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let other = Phantom::new(Kind::Tube, 40, [1.0; 3]).unwrap().mask();
    intima::formats::write_volume(&tmp.path().join("other.nrrd"), &other).unwrap();
    play_alone(
        tmp.path(),
        &["mask.nrrd"],
        r#"{"wait": "complete"}, {"do": {"bookmark": "stalk"}}, {"do": {"export": "report"}},
        {"do": {"bookmark": "sessile"}}, {"do": {"export": "report"}},
        {"do": {"open": "other.nrrd"}}, {"do": "discard"}, {"wait": "complete"},
        {"do": {"export": "report"}}"#,
    );
    let has = |name: &str, finding: &str| {
        let page = std::fs::read_to_string(tmp.path().join("out").join(name)).unwrap();
        page.contains(finding)
    };
    assert!(has("mask-report-1.html", "stalk") && !has("mask-report-1.html", "sessile"));
    assert!(has("mask-report-2.html", "sessile"));
    assert!(!has("other-report-1.html", "stalk"));
}

/// The lumen had to be chosen again, and the eye, the colour and the branch were those of a new
/// window.
#[test]
fn a_session_closed_and_opened_without_options_is_the_same_to_the_pixel() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let scan = Phantom::new(Kind::Y, 48, [1.0; 3]).unwrap().grey(None, 0);
    intima::formats::write_volume(&tmp.path().join("mask.nrrd"), &scan).unwrap();
    let picture = |n: &str| std::fs::read(tmp.path().join(format!("out/{n}.png"))).unwrap();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "failure"}, {"picture": "asked"},
        {"do": {"lumen": {"range": [-2000, -500]}}}, {"wait": "complete"}, {"wait": "levels"},
        {"do": {"branch": 1}}, {"do": {"seek": 25}}, {"do": {"colour": "radius"}},
        {"do": {"opacity": 1.6}}, {"do": {"orbit": [0.6, -0.3]}}, {"do": {"extent": {"mm": 60}}},
        {"do": {"turn": [0.5, 0.2, 0.1]}}, {"do": {"fly": [0.5, 0.5, 0.5]}},
        {"do": {"bookmark": "here"}}, {"picture": "closed"}, {"do": {"export": "view"}}"#,
    );
    let json = notes(tmp.path());
    assert!(json["view"]["eye"].is_object() && json["lumen"]["range"].is_object(), "{json}");
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"frames": 2}, {"picture": "opened"},
        {"do": {"export": "view"}}"#,
    );
    assert!(picture("mask-view-1") == picture("mask-view-2"), "the inside view");
    assert_ne!(picture("asked"), picture("closed"));
    let again = notes(tmp.path());
    assert_eq!((&json["view"], &json["lumen"]), (&again["view"], &again["lumen"]));
}

#[test]
fn a_session_is_opened_in_a_window_of_its_volume_and_another_file_changes_nothing() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"wait": "levels"}, {"do": {"seek": 20}},
        {"do": {"colour": "radius"}}, {"do": {"turn": [0.5, 0.2, 0.1]}}, {"frames": 2},
        {"do": {"export": "view"}}"#,
    );
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"wait": "complete"}, {"wait": "levels"}, {"do": {"open_session": "notes.json"}},
        {"frames": 3}, {"do": {"export": "view"}}, {"do": {"open_session": "o.json"}},
        {"frames": 2}, {"do": {"export": "view"}}]}"#;
    std::fs::write(tmp.path().join("o.json"), script).unwrap();
    let args = ["--script", "o.json", "--frames-out", "out"];
    let done = fly(tmp.path(), &args);
    let said = String::from_utf8_lossy(&done.stderr);
    assert!(done.status.success() && said.contains("o.json: no session file"), "{said}");
    let view = |i: u32| std::fs::read(tmp.path().join(format!("out/mask-view-{i}.png"))).unwrap();
    assert!(view(1) == view(2) && view(2) == view(3));
}

#[test]
fn a_session_begins_at_the_place_on_the_path_where_it_ended() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let view = |i: u32| std::fs::read(tmp.path().join(format!("out/mask-view-{i}.png"))).unwrap();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"do": {"export": "view"}}, {"do": {"seek": 20}},
        {"do": {"export": "view"}}"#,
    );
    assert_eq!(notes(tmp.path())["arc_mm"], 20.0);
    // Also where it ends before the path is known.
    play(tmp.path(), &[], r#"{"wait": "distance"}"#);
    play(tmp.path(), &[], r#"{"wait": "complete"}, {"do": {"export": "view"}}"#);
    assert!(view(3) == view(2) && view(3) != view(1));
}

/// The window asked for a lumen, showed no finding, and the file held no way to its volume.
#[test]
fn a_session_file_alone_opens_its_volume_and_a_lumen_that_no_window_can_choose() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    let scan = Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().grey(None, 0);
    std::fs::create_dir(tmp.path().join("case")).unwrap();
    intima::formats::write_volume(&tmp.path().join("case/ct.nrrd"), &scan).unwrap();
    play_alone(
        tmp.path(),
        &["case/ct.nrrd", "--threshold", ":-500", "--no-fill", "--session", "case/s.json"],
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "here"}},
        {"do": {"export": "view"}}"#,
    );
    std::fs::rename(tmp.path().join("case"), tmp.path().join("moved")).unwrap();
    let steps = r#"{"do": {"open_session": "moved/s.json"}}, {"wait": "complete"},
        {"do": {"export": "view"}}, {"do": {"bookmark": "again"}}"#;
    play_alone(tmp.path(), &[], steps);
    let view = |i: u32| std::fs::read(tmp.path().join(format!("out/ct-view-{i}.png"))).unwrap();
    assert!(view(1) == view(2), "the place of the session");
    let json = std::fs::read(tmp.path().join("moved/s.json")).unwrap();
    let json: serde_json::Value = serde_json::from_slice(&json).unwrap();
    let texts: Vec<_> = json["bookmarks"].as_array().unwrap().iter().map(|b| &b["text"]).collect();
    assert_eq!(texts, ["here", "again"], "saved where it was opened");
    assert_eq!(json["lumen"]["settings"]["range"], serde_json::json!([null, -500.0]));
    assert_eq!(json["case"]["image"]["path"], "ct.nrrd");
    // Without its volume, the reason is said and nothing is lost.
    std::fs::remove_file(tmp.path().join("moved/ct.nrrd")).unwrap();
    let said = play_alone(tmp.path(), &[], r#"{"do": {"open_session": "moved/s.json"}}"#);
    assert!(said.contains("s.json: its volume is not there: ct.nrrd"), "{said}");
}

#[test]
fn notes_of_no_file_are_kept_offered_and_taken_with_their_pictures() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let args = ["mask.nrrd", "--state", "state"];
    let kept = || {
        let cases = std::fs::read_dir(tmp.path().join("state/cases")).unwrap();
        let paths = cases.map(|e| e.unwrap().path());
        let mut files: Vec<_> =
            paths.filter(|p| p.extension().is_some_and(|e| e == "json")).collect();
        assert_eq!(files.len(), 1, "one volume: {files:?}");
        files.remove(0)
    };
    let texts = |file: &Path| -> Vec<String> {
        let json: serde_json::Value =
            serde_json::from_slice(&std::fs::read(file).unwrap()).unwrap();
        let bookmarks = json["bookmarks"].as_array().unwrap().clone();
        bookmarks.iter().map(|b| b["text"].as_str().unwrap().to_owned()).collect()
    };
    play_alone(tmp.path(), &args, r#"{"wait": "complete"}, {"do": {"bookmark": "first"}}"#);
    // Nobody answers: both are kept.
    play_alone(
        tmp.path(),
        &args,
        r#"{"wait": "complete"}, {"do": {"bookmark": "second"}}, {"picture": "offer"}"#,
    );
    assert_eq!(texts(&kept()), ["second", "first"]);
    play_alone(
        tmp.path(),
        &args,
        r#"{"wait": "complete"}, {"frames": 1}, {"do": "take_kept"},
        {"do": {"save_as": "mine.json"}}"#,
    );
    assert_eq!(texts(&tmp.path().join("mine.json")), ["second", "first"]);
    for i in [1, 2] {
        assert!(tmp.path().join(format!("mine-bookmark-{i}.png")).exists());
    }
    // The case is opened by its kept file alone, from anywhere.
    let file = kept();
    let steps = format!(
        r#"{{"do": {{"open_kept": {file:?}}}}}, {{"wait": "complete"}},
        {{"do": {{"bookmark": "third"}}}}"#
    );
    play_alone(tmp.path(), &["--state", "state"], &steps);
    assert_eq!(texts(&file), ["second", "first", "third"]);
    // Left, they are set aside.
    let steps = r#"{"wait": "complete"}, {"frames": 1}, {"do": "leave_kept"}, {"frames": 1}"#;
    play_alone(tmp.path(), &args, steps);
    assert!(texts(&kept()).is_empty());
    let aside = kept().with_extension("1.aside");
    assert_eq!(texts(&aside), ["second", "first", "third"]);
}

#[test]
fn notes_made_without_a_session_file_are_saved_as_one_with_their_pictures() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let script = r#"{"schema": "intima.script/1", "size": [640, 400], "steps": [
        {"wait": "complete"}, {"do": {"bookmark": "first"}}, {"do": {"save_as": "notes.json"}},
        {"do": {"bookmark": "second"}}, {"do": "quit"}]}"#;
    std::fs::write(tmp.path().join("s.json"), script).unwrap();
    let args = ["--script", "s.json", "--frames-out", "out"];
    let done = fly(tmp.path(), &args);
    assert!(done.status.success(), "{}", String::from_utf8_lossy(&done.stderr));
    let names = ["notes-bookmark-1.png", "notes-bookmark-2.png"];
    for (i, name) in names.into_iter().enumerate() {
        assert_eq!(notes(tmp.path())["bookmarks"][i]["picture"], name);
        assert!(tmp.path().join(name).exists());
    }
}

/// A path that somebody had begun elsewhere was the first one again.
#[test]
fn ends_that_were_set_by_hand_are_those_of_the_session() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = folder();
    let length = || notes(tmp.path())["arc_mm"].as_f64().unwrap();
    play(
        tmp.path(),
        &[],
        r#"{"wait": "complete"}, {"do": {"seek": 20}}, {"do": {"bookmark": "a"}},
        {"do": {"seek": 1e9}}"#,
    );
    let whole = length();
    let at = notes(tmp.path())["bookmarks"][0]["position_mm"].clone();
    let begin = format!(
        r#"{{"do": {{"start_at": {at}}}}}, {{"wait": "complete"}}, {{"do": {{"seek": 1e9}}}}"#
    );
    play(tmp.path(), &[], &format!(r#"{{"wait": "complete"}}, {begin}"#));
    let shorter = length();
    assert!((whole - 20.0 - shorter).abs() < 6.0, "{shorter} of {whole} mm");
    play(tmp.path(), &[], r#"{"wait": "complete"}, {"do": {"seek": 1e9}}"#);
    assert!((length() - shorter).abs() < 1e-6, "{} mm", length());
    assert_eq!(notes(tmp.path())["ends"]["start_mm"], at);
    // An end that is no place is refused, and the file stays.
    let path = tmp.path().join("notes.json");
    let text = std::fs::read_to_string(&path).unwrap();
    let bad = text.replace("\"start_mm\"", "\"begin_mm\"");
    std::fs::write(&path, &bad).unwrap();
    let said =
        fly(tmp.path(), &["--session", "notes.json", "--script", "s.json", "--frames-out", "o"]);
    assert!(!said.status.success() && std::fs::read_to_string(&path).unwrap() == bad);
}
