//! Cohorts: many scans through the program, stopped anywhere and gone on with.

use std::collections::BTreeMap;
use std::path::{Path, PathBuf};
use std::process::{Command, Output, Stdio};
use std::time::Instant;

use common::patience::until;
use intima::formats::write_volume;
use intima::volume::phantom::{Kind, Phantom};
use serde_json::Value;

/// Settings under which a case takes well under a second.
const SMALL: [&str; 4] = ["--frames", "2", "--size", "64x48"];

/// A folder `in` of scans, and `out` beside it.
struct Cohort(tempfile::TempDir);

impl Cohort {
    fn new() -> Self {
        let tmp = tempfile::tempdir().unwrap();
        std::fs::create_dir(tmp.path().join("in")).unwrap();
        Self(tmp)
    }

    /// A plain folder of three label maps.
    fn plain() -> Self {
        let cohort = Self::new();
        for (name, kind) in [("a", Kind::Tube), ("b_1", Kind::Bend), ("c", Kind::Ellipse)] {
            cohort.scan(&format!("{name}.nrrd"), kind);
        }
        cohort
    }

    fn dir(&self) -> &Path {
        self.0.path()
    }

    fn out(&self, path: &str) -> PathBuf {
        self.dir().join("out").join(path)
    }

    fn scan(&self, name: &str, kind: Kind) {
        let path = self.dir().join("in").join(name);
        std::fs::create_dir_all(path.parent().unwrap()).unwrap();
        write_volume(&path, &Phantom::new(kind, 32, [1.0; 3]).unwrap().mask()).unwrap();
    }

    fn command(&self, level: &str, more: &[&str]) -> Command {
        let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
        command.args(["bids", "in", "out", level]).args(SMALL).args(more);
        command.current_dir(self.dir()).env_remove("INTIMA_FAULT").stdin(Stdio::null());
        command
    }

    fn run(&self, level: &str, more: &[&str]) -> Output {
        self.command(level, more).output().expect("the program starts")
    }

    /// Runs with `--json`; the exit code and the answer.
    fn answer(&self, level: &str, more: &[&str]) -> (Option<i32>, Value) {
        let out = self.run(level, &[more, &["--json"]].concat());
        let text = String::from_utf8_lossy(&out.stdout);
        let answer = text.lines().last().and_then(|l| serde_json::from_str(l).ok());
        let said = String::from_utf8_lossy(&out.stderr);
        (out.status.code(), answer.unwrap_or_else(|| panic!("no answer: {said}")))
    }

    /// Each case with how it ended.
    fn states(&self, more: &[&str]) -> (Option<i32>, Vec<String>) {
        let (code, answer) = self.answer("participant", more);
        let state =
            |c: &Value| format!("{} {}", c["case"].as_str().unwrap(), c["state"].as_str().unwrap());
        (code, answer["cases"].as_array().unwrap().iter().map(state).collect())
    }

    fn status(&self, case: &str) -> Value {
        let path = self.out(&format!("logs/{case}/status.json"));
        serde_json::from_slice(&std::fs::read(path).unwrap()).unwrap()
    }

    /// The quality table without what differs from run to run, by column.
    fn table(&self) -> Vec<BTreeMap<String, String>> {
        assert_eq!(self.answer("group", &[]).0, Some(0));
        let tsv = std::fs::read_to_string(self.out("quality.tsv")).unwrap();
        let cells = |line: &str| line.split('\t').map(str::to_owned).collect::<Vec<_>>();
        let mut lines = tsv.lines().map(cells);
        let head = lines.next().unwrap();
        assert_eq!(head[0], "participant_id");
        let is_kept = |(name, _): &(String, String)| {
            !["seconds", "memory_mb", "outliers"].contains(&name.as_str())
        };
        lines.map(|row| head.iter().cloned().zip(row).filter(is_kept).collect()).collect()
    }

    /// All files below the folder of outputs, but reports and records, which hold times.
    fn products(&self) -> BTreeMap<String, Vec<u8>> {
        let mut found = BTreeMap::new();
        let mut open = vec![self.out("")];
        while let Some(folder) = open.pop() {
            for path in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
                let name = path.strip_prefix(self.out("")).unwrap().to_string_lossy().into_owned();
                if path.is_dir() && name != "logs" {
                    open.push(path);
                } else if path.is_file() && !name.contains("_report.") {
                    found.insert(name, std::fs::read(&path).unwrap());
                }
            }
        }
        found
    }
}

fn can_draw() -> bool {
    common::gpu(intima::vk::Validate::Off).is_some()
}

#[test]
fn a_plain_folder_becomes_derivatives_that_a_second_run_leaves_alone() {
    if !can_draw() {
        return;
    }
    let cohort = Cohort::plain();
    let done = ["sub-a done", "sub-b1 done", "sub-c done"];
    assert_eq!(cohort.states(&["--jobs", "2"]), (Some(0), done.map(String::from).to_vec()));
    for path in [
        "dataset_description.json",
        ".bidsignore",
        "sub-b1/anat/sub-b1_label-lumen_desc-wall_mask.nii.gz",
        "sub-b1/anat/sub-b1_label-lumen_desc-wall_mask.json",
        "sub-b1/anat/sub-b1_desc-lumen_dseg.nii.gz",
        "sub-b1/anat/sub-b1_desc-centerline_curve.vtp",
        "sub-b1/anat/sub-b1_report.json",
        "sub-b1/figures/sub-b1_frames/frame_00002.png",
    ] {
        assert!(cohort.out(path).is_file(), "{path}");
    }
    assert!(!cohort.out("logs/sub-a/work").exists());
    let table = cohort.table();
    assert!(table.iter().all(|row| row["state"] == "done" && row["volume_ml"] != "n/a"));

    let written =
        |c: &Cohort| std::fs::metadata(c.out("logs/sub-a/status.json")).unwrap().modified();
    let before = written(&cohort).unwrap();
    let (code, states) = cohort.states(&[]);
    assert_eq!((code, states[0].as_str()), (Some(0), "sub-a up to date"));
    assert!(states.iter().all(|s| s.ends_with("up to date")), "{states:?}");
    assert_eq!(written(&cohort).unwrap(), before);
    // The same bytes under another time are the same case; other settings are not.
    let bytes = std::fs::read(cohort.dir().join("in/a.nrrd")).unwrap();
    std::fs::write(cohort.dir().join("in/a.nrrd"), bytes).unwrap();
    assert_eq!(cohort.states(&["--case", "sub-a"]).1, ["sub-a up to date"]);
    let list = |more: &[&str]| {
        let (_, answer) = cohort.answer("participant", &[more, &["--list"]].concat());
        let done = |c: &Value| c["done"].as_bool().unwrap();
        answer["cases"].as_array().unwrap().iter().map(done).collect::<Vec<_>>()
    };
    assert_eq!(list(&["--threads", "1", "--max-memory", "9000"]), [true; 3]);
    assert_eq!(list(&["--no-fill"]), [false; 3]);
    assert_eq!(list(&["--device", "cpu"]), [false; 3]);
    // A byte changed within a file of the same size is seen by a check of all bytes alone.
    let mask = cohort.out("sub-a/anat/sub-a_desc-lumen_surface.ply");
    let mut bytes = std::fs::read(&mask).unwrap();
    *bytes.last_mut().unwrap() ^= 1;
    std::fs::write(&mask, bytes).unwrap();
    assert_eq!(list(&[]), [true; 3]);
    assert_eq!(list(&["--resume", "verify"]), [false, true, true]);
}

#[test]
fn a_bids_dataset_keeps_its_names_and_is_only_read() {
    if !can_draw() {
        return;
    }
    let cohort = Cohort::new();
    let description = cohort.dir().join("in/dataset_description.json");
    std::fs::write(&description, "{\"Name\": \"x\", \"BIDSVersion\": \"1.11.0\"}").unwrap();
    cohort.scan("sub-01/ses-a/anat/sub-01_ses-a_CT.nii.gz", Kind::Tube);
    cohort.scan("sub-02/anat/sub-02_CT.nii.gz", Kind::Tube);
    let out = ["--participant_label", "sub-01", "--session_label", "a", "--skip_bids_validation"];
    assert_eq!(cohort.states(&out), (Some(0), vec!["sub-01_ses-a done".into()]));
    let mask = "sub-01/ses-a/anat/sub-01_ses-a_label-lumen_desc-wall_mask";
    assert!(cohort.out(&format!("{mask}.nii.gz")).is_file());
    let sidecar = std::fs::read(cohort.out(&format!("{mask}.json"))).unwrap();
    let sidecar: Value = serde_json::from_slice(&sidecar).unwrap();
    assert_eq!(sidecar["Type"], "ROI");
    assert_eq!(sidecar["Sources"][0], "bids:raw:sub-01/ses-a/anat/sub-01_ses-a_CT.nii.gz");
    let table = cohort.table();
    let states: Vec<_> = table.iter().map(|r| (r["case"].as_str(), r["state"].as_str())).collect();
    assert_eq!(states, [("sub-01_ses-a", "done"), ("sub-02", "missing")]);
    assert_eq!(table[0]["session_id"], "ses-a");
    assert_eq!(cohort.run("participant", &["--participant-label", "03"]).status.code(), Some(2));
    let mut left: Vec<_> = std::fs::read_dir(cohort.dir().join("in"))
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .collect();
    left.sort();
    assert_eq!(left, ["dataset_description.json", "sub-01", "sub-02"]);
}

#[test]
fn a_failed_case_is_a_row_with_its_reason_and_stops_no_other() {
    if !can_draw() {
        return;
    }
    let cohort = Cohort::new();
    cohort.scan("z.nrrd", Kind::Tube);
    let junk = |name: &str| std::fs::write(cohort.dir().join("in").join(name), "junk").unwrap();
    junk("Doe^John.nrrd");
    let (code, states) = cohort.states(&[]);
    assert_eq!((code, states), (Some(3), vec!["sub-DoeJohn failed".into(), "sub-z done".into()]));
    let status = cohort.status("sub-DoeJohn");
    assert_eq!(status["exit_code"], 3);
    assert!(status["error"].as_str().unwrap().starts_with("sub-DoeJohn: "), "{status}");
    let row = &cohort.table()[0];
    assert_eq!([&row["state"], &row["exit_code"], &row["volume_ml"]], ["failed", "3", "n/a"]);
    let page = std::fs::read_to_string(cohort.out("quality.html")).unwrap();
    assert!(page.contains(status["reason"].as_str().unwrap()));
    assert!(page.contains("data:image/png;base64,"), "no picture of the other case");
    // A failure is no end: the next run tries again, and only that.
    cohort.scan("Doe^John.nrrd", Kind::Tube);
    let mended = ["sub-DoeJohn done", "sub-z up to date"].map(String::from).to_vec();
    assert_eq!(cohort.states(&[]), (Some(0), mended));
    // Where files have names of patients, nothing that is written has them.
    junk("Doe^John.nrrd");
    std::fs::remove_dir_all(cohort.out("")).unwrap();
    let hashed = ["--case-names", "hash"];
    assert_eq!(cohort.answer("participant", &hashed).0, Some(3));
    assert_eq!(cohort.answer("group", &hashed).0, Some(0));
    // Both spellings, whole: three letters may stand in the base64 of a picture by chance.
    let names = ["-r", "-l", "-F", "-e", "Doe^John", "-e", "DoeJohn"];
    let found = Command::new("grep").args(names).arg(cohort.out("")).output();
    assert_eq!(String::from_utf8_lossy(&found.unwrap().stdout), "");
}

#[test]
fn a_folder_with_the_name_of_a_patient_is_in_no_output_of_hashed_cases() {
    let cohort = Cohort::new();
    cohort.scan("../Doe^Jane/a.nrrd", Kind::Tube);
    let absolute = cohort.dir().join("Doe^Jane");
    for (input, out) in [("Doe^Jane", "out"), (absolute.to_str().unwrap(), "out_2")] {
        for level in ["participant", "group"] {
            let mut command = Command::new(env!("CARGO_BIN_EXE_intima"));
            command.args(["bids", input, out, level, "--case-names", "hash"]).args(SMALL);
            let run = command.current_dir(cohort.dir()).stdin(Stdio::null()).output().unwrap();
            assert_eq!(run.status.code(), Some(0), "{}", String::from_utf8_lossy(&run.stderr));
            let said = [run.stdout, run.stderr].concat();
            assert!(!String::from_utf8_lossy(&said).contains("Doe"));
        }
        let mut grep = Command::new("grep");
        grep.args(["-r", "-l", "-e", "Doe.*Jane"]).arg(out).current_dir(cohort.dir());
        let found = grep.output().unwrap();
        assert_eq!(String::from_utf8_lossy(&found.stdout), "");
    }
}

#[test]
fn flags_that_cannot_suit_every_case_are_refused() {
    let cohort = Cohort::plain();
    for flags in [&["--mask", "m.nrrd"][..], &["--video", "v.mp4"], &["--repeat", "2"]] {
        assert_eq!(cohort.run("participant", flags).status.code(), Some(2), "{flags:?}");
    }
    assert!(!cohort.out("").exists());
    let mut into_itself = Command::new(env!("CARGO_BIN_EXE_intima"));
    into_itself.args(["bids", "in", "in", "participant"]).current_dir(cohort.dir());
    assert_eq!(into_itself.output().unwrap().status.code(), Some(2));
}

/// Processes that work in a folder.
#[cfg(target_os = "linux")]
fn processes_of(dir: &Path) -> Vec<u32> {
    let pid = |e: std::fs::DirEntry| e.file_name().to_str()?.parse::<u32>().ok();
    let all = std::fs::read_dir("/proc").unwrap().filter_map(|e| pid(e.unwrap()));
    let dir = dir.canonicalize().unwrap();
    let is_ours =
        |pid: &u32| std::fs::read_link(format!("/proc/{pid}/cwd")).is_ok_and(|d| d == dir);
    all.filter(is_ours).collect()
}

#[cfg(target_os = "linux")]
fn kill(pid: u32) {
    let _ = Command::new("kill").args(["-KILL", &pid.to_string()]).status();
}

#[test]
#[cfg(target_os = "linux")]
fn a_cohort_killed_at_any_moment_goes_on_to_the_same_files() {
    if !can_draw() {
        return;
    }
    let whole = Cohort::plain();
    let since = Instant::now();
    assert_eq!(whole.answer("participant", &[]).0, Some(0));
    let took = since.elapsed();
    let killed = Cohort::plain();
    // The engine twice, a case once.
    for (share, of_case) in [(0.25, false), (0.5, true), (0.4, false)] {
        let mut engine = killed.command("participant", &[]);
        let mut engine = engine.stdout(Stdio::null()).stderr(Stdio::null()).spawn().unwrap();
        std::thread::sleep(took.mul_f64(share));
        match of_case {
            false => kill(engine.id()),
            true => {
                let others = processes_of(killed.dir());
                others.into_iter().filter(|pid| *pid != engine.id()).for_each(kill);
            }
        }
        engine.wait().unwrap();
        if !of_case {
            // Nobody works on whose engine is gone.
            let all_ended = || processes_of(killed.dir()).is_empty().then_some(());
            until("no case outlives its cohort", all_ended);
        }
    }
    let (code, states) = killed.states(&[]);
    assert_eq!(code, Some(0), "{states:?}");
    assert_eq!(killed.table(), whole.table());
    let mut want = whole.products();
    let mut found = killed.products();
    for name in ["quality.tsv", "quality.html", "dataset_description.json"] {
        want.remove(name);
        found.remove(name);
    }
    assert_eq!(found.keys().collect::<Vec<_>>(), want.keys().collect::<Vec<_>>());
    assert!(found == want, "files differ");
}

#[test]
#[cfg(target_os = "linux")]
fn a_killed_case_is_a_failure_that_the_next_run_mends() {
    if !can_draw() {
        return;
    }
    let cohort = Cohort::new();
    cohort.scan("a.nrrd", Kind::Tube);
    let long = ["--frames", "99999"];
    let mut engine = Command::new(env!("CARGO_BIN_EXE_intima"));
    engine.args(["bids", "in", "out", "participant", "--size", "64x48"]).args(long);
    let mut engine = engine.current_dir(cohort.dir()).stderr(Stdio::null()).spawn().unwrap();
    let frame = cohort.out("logs/sub-a/work/frames/frame_00001.png");
    until("a frame is drawn", || frame.exists().then_some(()));
    let others = processes_of(cohort.dir());
    others.into_iter().filter(|pid| *pid != engine.id()).for_each(kill);
    assert_eq!(engine.wait().unwrap().code(), Some(137));
    let status = cohort.status("sub-a");
    assert_eq!([&status["reason"], &status["exit_code"]], [&Value::from("killed"), &137.into()]);
    assert_eq!(cohort.states(&[]), (Some(0), vec!["sub-a done".into()]));
    assert!(!cohort.out("logs/sub-a/work").exists(), "the remains are gone");
}
