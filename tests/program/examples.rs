//! The examples run on a phantom and say what they should.

use std::path::{Path, PathBuf};
use std::process::Command;

use intima::formats::{read_png, write_volume};
use intima::volume::phantom::{Kind, Phantom};

/// An example as `cargo test` has built it, beside this test's own program.
fn example(name: &str) -> PathBuf {
    let own = std::env::current_exe().unwrap();
    own.ancestors().nth(2).unwrap().join("examples").join(name)
}

fn output(name: &str, args: &[&Path]) -> String {
    let out = Command::new(example(name)).args(args).output().unwrap();
    let said = String::from_utf8_lossy(&out.stderr);
    assert!(out.status.success(), "{name}: {said}");
    String::from_utf8(out.stdout).unwrap()
}

fn phantom(folder: &Path) -> PathBuf {
    let path = folder.join("bend.nrrd");
    write_volume(&path, &Phantom::new(Kind::Bend, 48, [1.0; 3]).unwrap().mask()).unwrap();
    path
}

#[test]
fn stages_prints_every_product_it_asks_for() {
    let folder = tempfile::tempdir().unwrap();
    let said = output("stages", &[&phantom(folder.path())]);
    for part in ["Centerline", "lumen:", "deepest:", "centerline:", "wall:", "distance"] {
        assert!(said.contains(part), "no `{part}` in:\n{said}");
    }
}

#[test]
fn fly_goes_from_a_file_to_frames_that_show_something() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let folder = tempfile::tempdir().unwrap();
    let frames = folder.path().join("frames");
    let said = output("fly", &[&phantom(folder.path()), &frames]);
    assert!(said.starts_with("12 frames"), "{said}");
    let (width, height, rgb) = read_png(&frames.join("frame_00006.png")).unwrap();
    assert_eq!((width, height), (320, 180));
    let bright = rgb.iter().filter(|v| **v > 60).count();
    assert!(bright > rgb.len() / 10, "only {bright} of {} bytes are bright", rgb.len());
}
