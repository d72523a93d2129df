//! `cargo xtask demo`: makes a phantom and flies through it.

use crate::TaskError;
use crate::process::{cargo, on_path, root, run};
use crate::setup::{Purpose, setup};
use std::fs;
use std::path::Path;

const OUT: &str = "out/demo";
const VOLUME: &str = "out/demo/colon.nrrd";
const VIDEO: &str = "out/demo/flight.mp4";
/// Half-way between the phantom's air (-950 HU) and its wall (40 HU).
const AIR: &str = ":-455";

/// What is built: the command line alone, 152 crates instead of 245.
const FEATURES: [&str; 3] = ["--no-default-features", "--features", "cli"];

/// `cargo xtask demo`
pub fn demo() -> Result<(), TaskError> {
    setup(Purpose::Running)?;
    eprintln!("The demo's intima has no window; `cargo build --release` has it.");
    run(&mut cargo(&[&["build", "--release", "--locked"], &FEATURES[..]].concat()))?;
    let folder = root().join(OUT);
    fs::create_dir_all(&folder).map_err(|e| TaskError::Failed(format!("{OUT}: {e}")))?;
    let intima = |args: &[&str]| {
        // Through cargo, which knows where the program was built.
        let start = ["run", "--release", "--locked", "--quiet", "--package", "intima"];
        run(&mut cargo(&[&start, &FEATURES[..], &["--"], args].concat()))
    };
    intima(&["phantom", "colon", "-o", VOLUME, "--size", "128"])?;
    intima(&flight(on_path("ffmpeg")))?;
    println!("\nEverything is in {}:", folder.display());
    for (name, what) in PRODUCTS {
        if let Some(line) = listed(&folder, name, what) {
            println!("{line}");
        }
    }
    Ok(())
}

/// Arguments of `intima run`; a video only where `ffmpeg` is installed.
fn flight(ffmpeg: bool) -> Vec<&'static str> {
    let mut args = vec!["run", VOLUME, "--threshold", AIR, "--out", OUT];
    args.extend(["--frames", "120", "--size", "640x480"]);
    if ffmpeg {
        args.extend(["--video", VIDEO]);
    }
    args
}

const PRODUCTS: &[(&str, &str)] = &[
    ("frames", "the flight, one picture a step"),
    ("flight.mp4", "the same as a video"),
    ("surface.ply", "the wall, with smoothed normals"),
    ("centerline.csv", "the path flown; .vtp and .mrk.json beside it"),
    ("unseen.csv", "boundary voxels that the flight does not see"),
    ("report.html", "the run on one page, for a browser"),
    ("report.json", "every figure of the run"),
    ("colon.nrrd", "the phantom itself"),
];

/// A line about a product, if the run made it.
fn listed(folder: &Path, name: &str, what: &str) -> Option<String> {
    let path = folder.join(name);
    let count = path.is_dir().then(|| fs::read_dir(&path).map_or(0, Iterator::count));
    let note = count.map(|n| format!(" ({n} files)")).unwrap_or_default();
    path.exists().then(|| format!("  {name:<16} {what}{note}"))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_video_is_requested_only_with_ffmpeg() {
        assert!(flight(true).contains(&VIDEO));
        assert!(!flight(false).contains(&"--video"));
    }

    #[test]
    fn only_existing_products_are_listed() {
        assert_eq!(listed(&root(), "no-such-thing", "x"), None);
        assert!(listed(&root(), "Cargo.toml", "x").unwrap().contains("Cargo.toml"));
    }
}
