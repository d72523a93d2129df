//! A real window on an X server without a screen, driven by the keys and pointer events of another
//! program.
#![cfg(target_os = "linux")]

use std::io::{BufRead, BufReader};
use std::path::Path;
use std::process::{Child, Command, Stdio};
use std::sync::mpsc::{Receiver, channel};
use std::time::{Duration, Instant};

use common::cast::Cast;
use common::patience::{PATIENCE, end_of, until};
use glam::DVec3;
use intima::formats::{read_png, write_volume};
use intima::session::{Session, Settings, Source, VolumeSource};
use intima::volume::phantom::{Kind, Phantom};

/// Ends its process when dropped.
struct Ended(Child);

impl Drop for Ended {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// An X server of our own; `None` where the programs are not installed and need not be.
fn x_server() -> Option<(Ended, String)> {
    let has = |name| Command::new(name).arg("-version").output().is_ok();
    if !has("Xvfb") || !has("xdotool") {
        let required = std::env::var_os("INTIMA_REQUIRE_GPU").is_some();
        assert!(!required, "Xvfb and xdotool are needed: cargo xtask test installs them");
        eprintln!("skipped: no Xvfb or no xdotool");
        return None;
    }
    let mut server = Command::new("Xvfb")
        .args(["-displayfd", "1", "-screen", "0", "1400x900x24", "-nolisten", "tcp"])
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .expect("Xvfb starts");
    let mut number = String::new();
    let out = server.stdout.take().expect("its output");
    BufReader::new(out).read_line(&mut number).expect("the number of its display");
    Some((Ended(server), format!(":{}", number.trim())))
}

/// The window of a running program.
struct Desktop {
    display: String,
    window: String,
    program: Ended,
    said: Receiver<String>,
    log: Vec<String>,
    _server: Ended,
}

impl Desktop {
    fn open(dir: &Path, args: &[&str], env: &[(&str, &str)]) -> Option<Self> {
        let (server, display) = x_server()?;
        let mut program = Command::new(env!("CARGO_BIN_EXE_intima"))
            .args(["-v", "fly"])
            .args(args)
            .current_dir(dir)
            .env("DISPLAY", &display)
            .env("INTIMA_VALIDATE", "sync")
            .env("XDG_STATE_HOME", dir.join("state"))
            .env_remove("WAYLAND_DISPLAY")
            .env_remove("INTIMA_FAULT")
            .envs(env.iter().copied())
            .stderr(Stdio::piped())
            .spawn()
            .expect("the program starts");
        let errors = program.stderr.take().expect("its messages");
        let (sender, said) = channel();
        std::thread::spawn(move || {
            for line in BufReader::new(errors).lines().map_while(Result::ok) {
                let _ = sender.send(line);
            }
        });
        let program = Ended(program);
        let mut desktop = Self {
            display,
            window: String::new(),
            program,
            said,
            log: Vec::new(),
            _server: server,
        };
        // The title names the file and the program: nothing of a patient.
        let title = "^mask.nrrd - intima$";
        let id = desktop.xdotool(&["search", "--sync", "--onlyvisible", "--name", title]);
        desktop.window = id.lines().next().expect("a window").to_owned();
        let window = desktop.window.clone();
        desktop.xdotool(&["windowfocus", "--sync", &window]);
        Some(desktop)
    }

    fn xdotool(&self, args: &[&str]) -> String {
        let done = Command::new("xdotool")
            .args(args)
            .env("DISPLAY", &self.display)
            .output()
            .expect("xdotool starts");
        assert!(done.status.success(), "xdotool {args:?}: {done:?}\n{:#?}", self.log);
        String::from_utf8(done.stdout).expect("text")
    }

    fn key(&self, key: &str) {
        self.xdotool(&["key", key]);
    }

    fn click(&self, [x, y]: [u32; 2]) {
        let (x, y) = (x.to_string(), y.to_string());
        self.xdotool(&["mousemove", "--window", &self.window, &x, &y, "click", "1"]);
    }

    /// Waits until the program says something.
    fn wait_for(&mut self, text: &str) {
        let begun = Instant::now();
        while !self.log.iter().any(|l| l.contains(text)) {
            let left = PATIENCE.saturating_sub(begun.elapsed());
            match self.said.recv_timeout(left) {
                Ok(line) => self.log.push(line),
                Err(_) => panic!("it does not say {text:?}: {:#?}", self.log),
            }
        }
    }

    /// Waits until something is so.
    fn until<T>(&self, what: &str, ready: impl Fn() -> Option<T>) -> T {
        until(what, ready)
    }

    /// Makes a bookmark and waits for it; where it is, and how the eye is turned.
    fn bookmark(&self, session: &Path, number: usize) -> (DVec3, [f64; 4]) {
        self.key("b");
        let json = self.until("the bookmark is saved", || {
            let text = std::fs::read_to_string(session).ok()?;
            let json: serde_json::Value = serde_json::from_str(&text).ok()?;
            (json["bookmarks"].as_array()?.len() == number).then_some(json)
        });
        let b = &json["bookmarks"][number - 1];
        let numbers = |v: &serde_json::Value| -> Vec<f64> {
            v.as_array().unwrap().iter().map(|n| n.as_f64().unwrap()).collect()
        };
        let at = DVec3::from_slice(&numbers(&b["position_mm"]));
        (at, numbers(&b["rotation"]).try_into().unwrap())
    }

    /// Quits by key; the exit code, and everything that was said.
    fn quit(self) -> (Option<i32>, Vec<String>) {
        // Pressed and let go by themselves: the window is gone before the key is up.
        self.xdotool(&["keydown", "ctrl", "key", "q"]);
        let _ =
            Command::new("xdotool").args(["keyup", "ctrl"]).env("DISPLAY", &self.display).output();
        self.end()
    }

    /// Sends the program a signal.
    fn terminate(&self, signal: &str) {
        let process = self.program.0.id().to_string();
        let sent = Command::new("kill").args(["-s", signal, &process]).status();
        assert!(sent.expect("kill starts").success());
    }

    /// Waits for the end of the program; the exit code, and everything that was said.
    fn end(mut self) -> (Option<i32>, Vec<String>) {
        let code = end_of(&mut self.program.0, "the window").code();
        self.log.extend(self.said.iter());
        (code, self.log)
    }
}

fn folder(kind: Kind) -> tempfile::TempDir {
    let tmp = tempfile::tempdir().unwrap();
    let mask = Phantom::new(kind, 48, [1.0; 3]).unwrap().mask();
    write_volume(&tmp.path().join("mask.nrrd"), &mask).unwrap();
    tmp
}

fn assert_silent(log: &[String]) {
    let bad = |l: &&String| l.contains("VUID") || l.contains("ERROR") || l.contains("WARN");
    let said: Vec<_> = log.iter().filter(bad).collect();
    assert!(said.is_empty(), "{said:#?}");
}

#[test]
fn a_window_is_flown_by_keys_and_pointer_and_keeps_what_was_found() {
    let tmp = folder(Kind::Y);
    let session = tmp.path().join("notes.json");
    let args = ["mask.nrrd", "--session", "notes.json", "--export", "out"];
    let args = [&args[..], &["--size", "1000x700"]].concat();
    let Some(mut d) = Desktop::open(tmp.path(), &args, &[]) else { return };
    d.wait_for("everything is computed");

    // Played for a while, the eye has moved along the path.
    let (start, _) = d.bookmark(&session, 1);
    d.key("space");
    std::thread::sleep(Duration::from_millis(700));
    d.key("space");
    let (played, turned) = d.bookmark(&session, 2);
    assert!(played.distance(start) > 2.0, "{start} {played}");

    // Flown by hand against the wall: it stays inside, with room about it.
    d.xdotool(&["keydown", "d"]);
    std::thread::sleep(Duration::from_millis(2500));
    d.xdotool(&["keyup", "d"]);
    // A frame that meets the end of this key and the next one places the bookmark first.
    std::thread::sleep(Duration::from_millis(700));
    let (pressed, _) = d.bookmark(&session, 3);
    let mask = Phantom::new(Kind::Y, 48, [1.0; 3]).unwrap().mask();
    let source = Source::Image(VolumeSource::Memory(std::sync::Arc::new(mask)));
    let wall = Session::new(source, Settings::default()).unwrap().wall().unwrap();
    let cast = Cast::of(&wall.mesh);
    assert!(pressed.distance(played) > 1.0, "it moved");
    let (_, room) = cast.nearest(pressed).unwrap();
    assert!(room > 0.3 && room < 2.0, "beside the wall: {room} mm");
    assert!(cast.ray(played, pressed - played).is_none_or(|h| h.t > 1.0), "not through it");

    // Dragged, the eye looks elsewhere from the same place.
    let at = ["mousemove", "--window", &d.window, "200", "300", "mousedown", "1"];
    d.xdotool(&at);
    for _ in 0..5 {
        d.xdotool(&["mousemove_relative", "--", "18", "7"]);
        std::thread::sleep(Duration::from_millis(40));
    }
    d.xdotool(&["mouseup", "1"]);
    let (looked, looks) = d.bookmark(&session, 4);
    assert!(looked.distance(pressed) < 1e-3, "the place is the same: {looked} {pressed}");
    let cosine: f64 = looks.iter().zip(turned).map(|(a, b)| a * b).sum();
    assert!(cosine.abs() < 0.999, "it looks elsewhere: {cosine}");

    // Near the end of the trunk the other branch is a choice: its tip is another end.
    d.key("5");
    d.key("End");
    let (first_tip, _) = d.bookmark(&session, 5);
    // Ever farther along the path, until a branch is offered and taken.
    let other_tip = (1..30).find_map(|tries| {
        d.key("Home");
        d.xdotool(&["keydown", "Up"]);
        std::thread::sleep(Duration::from_millis(150 * tries));
        d.xdotool(&["keyup", "Up"]);
        d.key("1");
        std::thread::sleep(Duration::from_millis(300));
        d.key("End");
        let (tip, _) = d.bookmark(&session, 5 + tries as usize);
        (tip.distance(first_tip) > 8.0).then_some(tip)
    });
    assert!(other_tip.is_some(), "no other branch was taken");

    // The view and the report leave the window; a resize does it no harm.
    d.key("e");
    let view = tmp.path().join("out/mask-view-1.png");
    let (width, height, _) = d.until("the view is written", || read_png(&view).ok());
    assert!(width > 300 && height > 300);
    let window = d.window.clone();
    d.xdotool(&["windowsize", "--sync", &window, "700", "500"]);
    d.key("v");
    d.key("c");
    d.click([300, 480]);
    std::thread::sleep(Duration::from_millis(500));
    d.key("e");
    let second = tmp.path().join("out/mask-view-2.png");
    let (small, ..) = d.until("the second view is written", || read_png(&second).ok());
    assert!(small < width, "{small} of {width}");
    let (code, log) = d.quit();
    assert_eq!(code, Some(0), "{log:#?}");
    assert_silent(&log);
}

/// The kept file of the one volume that was opened, once it holds so many bookmarks.
fn kept(dir: &Path, bookmarks: usize) -> serde_json::Value {
    until("the notes are kept", || {
        let entries = std::fs::read_dir(dir.join("state/intima/cases")).ok()?;
        let mut files = entries.map(|e| e.unwrap().path()).filter(|p| is_json(p));
        let json: serde_json::Value = serde_json::from_slice(&std::fs::read(files.next()?).ok()?)
            .expect("a kept file is whole at any time");
        (json["bookmarks"].as_array()?.len() == bookmarks).then_some(json)
    })
}

fn is_json(path: &Path) -> bool {
    path.extension().is_some_and(|e| e == "json")
}

/// The second of two presses closed the window, and the notes were gone.
#[test]
fn a_window_whose_notes_are_in_no_file_asks_and_a_second_press_is_no_answer() {
    let tmp = folder(Kind::Bend);
    let args = ["mask.nrrd", "--device", "cpu"];
    let Some(mut d) = Desktop::open(tmp.path(), &args, &[]) else { return };
    d.wait_for("everything is computed");
    d.key("b");
    kept(tmp.path(), 1);
    d.xdotool(&["key", "ctrl+q"]);
    d.wait_for("bookmarks are in no file of the user's yet");
    d.xdotool(&["key", "ctrl+q"]);
    std::thread::sleep(Duration::from_millis(700));
    assert!(d.program.0.try_wait().unwrap().is_none(), "it asks instead of closing");
    d.terminate("TERM");
    let (code, log) = d.end();
    assert_eq!(code, Some(0), "{log:#?}");
    assert_silent(&log);
}

/// Notes made without a session file were gone with the process.
#[test]
fn notes_and_place_outlive_signals_and_are_offered_when_the_scan_is_opened_again() {
    let tmp = folder(Kind::Bend);
    let args = ["mask.nrrd", "--device", "cpu"];
    for (i, signal) in ["TERM", "INT", "HUP", "KILL"].into_iter().enumerate() {
        let Some(mut d) = Desktop::open(tmp.path(), &args, &[]) else { return };
        d.wait_for("everything is computed");
        d.key("b");
        // What was kept before and nobody has taken stays beside what is new.
        let count = kept(tmp.path(), i + 1)["bookmarks"].as_array().unwrap().len();
        assert_eq!(count, i + 1);
        d.key("End");
        // A place is kept once the eye has rested for a moment.
        let at_end = || (kept(tmp.path(), i + 1)["arc_mm"].as_f64()? > 10.0).then_some(());
        d.until("the place is kept", at_end);
        d.terminate(signal);
        let (code, log) = d.end();
        assert_eq!(code, (signal != "KILL").then_some(0), "{log:#?}");
        let json = kept(tmp.path(), i + 1);
        assert!(json["arc_mm"].as_f64().unwrap() > 10.0, "the place is not: {signal}");
    }
}

/// The later window overwrote what the earlier one had noted.
#[test]
fn two_windows_on_one_session_file_keep_the_notes_of_both() {
    let tmp = folder(Kind::Bend);
    let session = tmp.path().join("notes.json");
    let args = ["mask.nrrd", "--device", "cpu", "--session", "notes.json"];
    let Some(mut first) = Desktop::open(tmp.path(), &args, &[]) else { return };
    first.wait_for("everything is computed");
    first.bookmark(&session, 1);
    let mut second = Desktop::open(tmp.path(), &args, &[]).expect("another one");
    second.wait_for("everything is computed");
    second.bookmark(&session, 2);
    first.bookmark(&session, 3);
    second.bookmark(&session, 4);
    for window in [first, second] {
        let (code, log) = window.quit();
        assert_eq!(code, Some(0), "{log:#?}");
        assert_silent(&log);
    }
    let json: serde_json::Value =
        serde_json::from_slice(&std::fs::read(&session).unwrap()).unwrap();
    assert_eq!(json["bookmarks"].as_array().unwrap().len(), 4);
}

/// Resident memory of a process, MB.
fn resident_mb(process: u32) -> u64 {
    let status = std::fs::read_to_string(format!("/proc/{process}/status")).expect("it runs");
    let line = status.lines().find_map(|l| l.strip_prefix("VmRSS:")).expect("its memory");
    line.split_whitespace().next().and_then(|kb| kb.parse::<u64>().ok()).expect("kB") / 1024
}

#[test]
fn a_window_that_is_resized_again_and_again_takes_no_more_memory() {
    let tmp = folder(Kind::Bend);
    let args = ["mask.nrrd", "--device", "cpu", "--size", "900x640"];
    let Some(mut d) = Desktop::open(tmp.path(), &args, &[("INTIMA_VALIDATE", "")]) else { return };
    d.wait_for("everything is computed");
    let window = d.window.clone();
    let resize = |times: u32| {
        for i in 0..times {
            let (width, height) = (900 + i * 37 % 300, 640 + i * 23 % 200);
            d.xdotool(&["windowsize", &window, &width.to_string(), &height.to_string()]);
            std::thread::sleep(Duration::from_millis(60));
        }
        resident_mb(d.program.0.id())
    };
    let (settled, later) = (resize(20), resize(120));
    println!("{settled} MB after 20 sizes, {later} MB after 120 more");
    assert!(later < settled + 60, "{settled} MB after 20 sizes, {later} MB after 120 more");
    let (code, log) = d.quit();
    assert_eq!(code, Some(0), "{log:#?}");
}

/// A red page with the wrong advice hid the wall and every later message, and stayed.
#[test]
fn beside_a_session_file_of_another_volume_the_scan_is_shown_and_the_file_stays() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let (bend, tube) = (folder(Kind::Bend), folder(Kind::Tube));
    super::played::play(bend.path(), &[], r#"{"wait": "complete"}, {"do": {"bookmark": "bend"}}"#);
    let session = tube.path().join("notes.json");
    std::fs::copy(bend.path().join("notes.json"), &session).unwrap();
    let before = std::fs::read(&session).unwrap();
    let args = ["mask.nrrd", "--device", "cpu", "--session", "notes.json"];
    let Some(mut d) = Desktop::open(tube.path(), &args, &[]) else { return };
    d.wait_for("the session file is of another volume");
    d.wait_for("first picture of the wall");
    d.wait_for("everything is computed");
    d.key("b");
    // What is noted here is kept with this scan, and not in that file.
    kept(tube.path(), 1);
    d.terminate("TERM");
    let (_, log) = d.end();
    assert!(std::fs::read(&session).unwrap() == before, "{log:#?}");
}

/// The terminal said ERROR while the window asked politely.
#[test]
fn a_folder_of_two_series_is_a_question_in_the_window_and_no_error_on_the_terminal() {
    let tmp = tempfile::tempdir().unwrap();
    std::fs::create_dir(tmp.path().join("mask.nrrd")).unwrap();
    for (series, z) in [("1.2.3", 0u8), ("1.2.3", 1), ("1.2.4", 0), ("1.2.4", 1)] {
        let slice = common::volumes::Slice {
            series,
            size: [4, 3],
            position: [0.0, 0.0, f64::from(z)],
            pixels: (0..12).map(|p| p * 90).collect(),
            ..common::volumes::Slice::default()
        };
        let file = tmp.path().join(format!("mask.nrrd/{series}-{z}.dcm"));
        std::fs::write(file, common::volumes::dicom_slice(&slice)).unwrap();
    }
    let args = ["mask.nrrd", "--device", "cpu"];
    let Some(mut d) = Desktop::open(tmp.path(), &args, &[]) else { return };
    d.wait_for("choose one with --series");
    let (code, log) = d.quit();
    assert_eq!(code, Some(0), "{log:#?}");
    assert_silent(&log);
}

/// Needs the fault hook.
#[cfg(feature = "faults")]
#[test]
fn a_full_disk_is_said_and_bookmarks_are_saved_once_there_is_room() {
    let tmp = folder(Kind::Bend);
    let session = tmp.path().join("notes.json");
    let args = ["mask.nrrd", "--device", "cpu", "--session", "notes.json"];
    // The picture, the bookmark, and the bookmark once more.
    // Notes are kept nowhere else, as that would count too.
    let env = [("INTIMA_FAULT", "write:1-3"), ("XDG_STATE_HOME", "/dev/null/none")];
    let Some(mut d) = Desktop::open(tmp.path(), &args, &env) else { return };
    d.wait_for("everything is computed");
    d.bookmark(&session, 1);
    d.wait_for("bookmarks are not saved");
    let (code, log) = d.quit();
    assert_eq!(code, Some(0), "{log:#?}");
}

/// Needs the fault hook.
#[cfg(feature = "faults")]
#[test]
fn a_lost_device_is_opened_again_and_nothing_noted_is_lost() {
    let tmp = folder(Kind::Bend);
    let session = tmp.path().join("notes.json");
    let args = ["mask.nrrd", "--device", "cpu", "--session", "notes.json"];
    // The window's own submissions are the only ones of a session that computes on the CPU.
    let env = [("INTIMA_FAULT", "submit:60-60")];
    let Some(mut d) = Desktop::open(tmp.path(), &args, &env) else { return };
    d.wait_for("everything is computed");
    let (before, _) = d.bookmark(&session, 1);
    d.key("space");
    d.wait_for("the device is opened again");
    d.key("space");
    let (after, _) = d.bookmark(&session, 2);
    assert!(before.is_finite() && after.distance(before) < 500.0);
    let (code, log) = d.quit();
    assert_eq!(code, Some(0), "{log:#?}");
    assert_eq!(log.iter().filter(|l| l.contains("opened again")).count(), 1);
}
