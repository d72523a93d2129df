//! Runs ended at random moments and disks that fill at every write: nothing partial stays.

use std::collections::BTreeMap;
use std::path::PathBuf;
use std::time::{Duration, Instant};

use common::html;

use super::files::{signal, start, temporary};
use super::*;

/// A command, and what it makes when nothing disturbs it.
struct Case {
    tmp: tempfile::TempDir,
    args: Vec<&'static str>,
    products: BTreeMap<PathBuf, Vec<u8>>,
    took: Duration,
}

const CONVERT: &[&str] = &["convert", "ct.nrrd", "-o", "out/v.mhd"];
const RECORD: &[&str] = &[
    "record",
    "--mask",
    "mask.nrrd",
    "--out",
    "out/f",
    "--frames",
    "12",
    "--size",
    "64x48",
    "--video",
    "out/v.mp4",
];
const RUN: &[&str] =
    &["run", "--mask", "mask.nrrd", "--out", "out", "--frames", "4", "--size", "64x48"];

/// Files below a folder, with their bytes. Times of reports differ from run to run: `report.json`
/// is left out, and so is the part of the page that has them.
fn products(dir: &Path) -> BTreeMap<PathBuf, Vec<u8>> {
    let mut found = BTreeMap::new();
    let mut open = vec![dir.to_owned()];
    while let Some(folder) = open.pop() {
        for path in std::fs::read_dir(folder).unwrap().map(|e| e.unwrap().path()) {
            if path.is_dir() {
                open.push(path);
            } else if !path.ends_with("report.json") {
                let mut bytes = std::fs::read(&path).unwrap();
                if path.ends_with("report.html") {
                    bytes = html::lasting(&String::from_utf8_lossy(&bytes)).into_bytes();
                }
                found.insert(path.strip_prefix(dir).unwrap().to_owned(), bytes);
            }
        }
    }
    found
}

impl Case {
    fn new(args: &[&'static str]) -> Self {
        let tmp = tempfile::tempdir().unwrap();
        phantom(tmp.path(), Kind::Bend, 32);
        let mut case =
            Self { tmp, args: args.to_vec(), products: BTreeMap::new(), took: Duration::ZERO };
        // Once more, so that the time is that of warm caches.
        for _ in 0..2 {
            case.clear();
            let since = Instant::now();
            let status = start(case.dir(), &case.args).wait().unwrap();
            assert!(status.success(), "{args:?}");
            case.took = since.elapsed();
        }
        case.products = products(&case.out());
        case
    }

    fn dir(&self) -> &Path {
        self.tmp.path()
    }

    fn out(&self) -> PathBuf {
        self.dir().join("out")
    }

    fn clear(&self) {
        let _ = std::fs::remove_dir_all(self.out());
        std::fs::create_dir(self.out()).unwrap();
    }

    /// Every file that is there is complete, temporary ones aside.
    fn assert_complete_files(&self, what: &str) {
        let passing = |name: &Path| {
            name.file_name().is_some_and(|n| n.to_string_lossy().starts_with(".intima-"))
        };
        for (name, bytes) in products(&self.out()).iter().filter(|(name, _)| !passing(name)) {
            let whole = self.products.get(name) == Some(bytes);
            assert!(whole, "{what}: {} is partial", name.display());
        }
    }

    /// The same, and no temporary file.
    fn assert_complete(&self, what: &str) {
        assert_eq!(temporary(self.dir()), Vec::<PathBuf>::new(), "{what}");
        self.assert_complete_files(what);
    }

    /// Ends `runs` runs at work by signals at moments spread over the time they take, every other
    /// one by KILL; how they ended, with the number of each. Runs that had finished do not count.
    fn end_at_random(&self, runs: usize) -> BTreeMap<String, usize> {
        use std::os::unix::process::ExitStatusExt;
        let mut state = 88_172_645_463_325_252u64;
        let mut counts = BTreeMap::new();
        let mut count = |what: String, n: usize| *counts.entry(what).or_insert(0) += n;
        let signals = ["-KILL", "-INT", "-KILL", "-TERM"];
        let (mut took, mut ended_runs, mut tries) = (self.took, 0, 0);
        while ended_runs < runs {
            let name = signals[ended_runs % 4];
            tries += 1;
            assert!(tries <= 5 * runs, "runs end too soon: {counts:?}");
            state ^= state << 13;
            state ^= state >> 7;
            state ^= state << 17;
            let moment = took.mul_f64((state % 1000) as f64 / 1000.0);
            self.clear();
            let mut child = start(self.dir(), &self.args);
            std::thread::sleep(moment);
            let finished = child.try_wait().unwrap().is_some();
            if !finished {
                signal(&child, name);
            }
            let status = child.wait().unwrap();
            let what = format!("{:?} {name} after {moment:?}: {status}", self.args);
            // Runs take less time on a machine that has become idle, a third of it where builds ended.
            took = took.mul_f64(if finished { 0.8 } else { 1.02 });
            ended_runs += usize::from(!finished && status.code() != Some(0));
            if name == "-KILL" {
                self.assert_complete_files(&what);
                let ended = if status.signal() == Some(9) { "killed" } else { "finished before" };
                count(format!("KILL: {ended}"), 1);
                count("KILL: temporary files left".into(), temporary(self.dir()).len());
                let again = start(self.dir(), &self.args).wait().unwrap();
                assert!(again.success(), "{what}: {again}");
                self.assert_complete(&what);
                assert_eq!(products(&self.out()).len(), self.products.len(), "{what}");
            } else {
                // A signal to a run that has not set up its handler ends it as any program; a shell
                // says 130 then too. One that is past its last check finishes.
                let ended = match (status.code(), status.signal()) {
                    (Some(130), _) => "exit code 130".to_owned(),
                    (Some(0), _) if finished => "finished before".to_owned(),
                    (Some(0), _) => "exit code 0, past the last check".to_owned(),
                    (None, Some(2 | 15)) => {
                        assert_eq!(products(&self.out()), BTreeMap::new(), "{what}");
                        "ended before the handler was there".to_owned()
                    }
                    _ => panic!("{what}"),
                };
                count(format!("{}: {ended}", &name[1..]), 1);
                // An encoder that is ended needs a moment to go.
                std::thread::sleep(Duration::from_millis(20));
                self.assert_complete(&what);
            }
        }
        println!("{:?}, {:?}: {counts:#?}", self.args[0], self.took);
        counts
    }

    /// Fills the disk at the n-th write, for each `n` until a run has fewer writes.
    #[cfg(feature = "faults")]
    fn fill_disk(&self, moments: impl Iterator<Item = u32>) {
        for n in moments {
            self.clear();
            let output = Command::new(env!("CARGO_BIN_EXE_intima"))
                .args(&self.args)
                .current_dir(self.dir())
                .env("PATH", super::files::ffmpeg(self.dir()))
                .env("INTIMA_FAULT", format!("write:{n}"))
                .output()
                .unwrap();
            let err = String::from_utf8_lossy(&output.stderr);
            let what = format!("{:?}, write {n}: {err}", self.args);
            self.assert_complete(&what);
            if output.status.success() {
                return;
            }
            assert_eq!(output.status.code(), Some(1), "{what}");
            assert!(!self.out().join("report.json").exists(), "{what}");
        }
    }
}

fn cases() -> Vec<Case> {
    let all: &[&[&str]] = if can_draw() { &[CONVERT, RECORD, RUN] } else { &[CONVERT] };
    all.iter().map(|args| Case::new(args)).collect()
}

#[test]
fn runs_ended_at_random_moments_leave_complete_files_alone() {
    cases().iter().for_each(|case| drop(case.end_at_random(12)));
}

/// Over all commands 204 runs at work are killed and 204 interrupted or terminated.
#[test]
#[ignore = "minutes: cargo test --release --test program runs_ended_at_400 -- --ignored"]
fn runs_ended_at_400_random_moments_leave_complete_files_alone() {
    let mut all = BTreeMap::new();
    for (what, n) in cases().iter().flat_map(|case| case.end_at_random(136)) {
        *all.entry(what).or_insert(0) += n;
    }
    println!("all: {all:#?}");
    assert!(all["KILL: killed"] >= 200, "{all:?}");
    assert!(all["INT: exit code 130"] + all["TERM: exit code 130"] >= 150, "{all:?}");
}

#[cfg(feature = "faults")]
#[test]
fn a_disk_that_fills_at_some_write_leaves_complete_files_alone() {
    cases().iter().for_each(|case| case.fill_disk([1, 2, 3, 5, 8, 13, 21].into_iter()));
}

#[cfg(feature = "faults")]
#[test]
#[ignore = "minutes: cargo test --features faults --test program fills_at_any -- --ignored"]
fn a_disk_that_fills_at_any_write_leaves_complete_files_alone() {
    cases().iter().for_each(|case| case.fill_disk(1..));
}
