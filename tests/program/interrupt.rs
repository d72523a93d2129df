//! Ctrl-C while Vulkan works: the exit code is 130 whatever the driver's threads are doing.
#![cfg(unix)]

use std::path::Path;
use std::process::{Command, Stdio};
use std::time::Duration;

use intima::formats::write_volume;
use intima::vk::Validate;
use intima::volume::phantom::{Kind, Phantom};

/// Starts a long flight on Vulkan, interrupts it after `delay`, and says how it ended.
fn interrupted(folder: &Path, delay: Duration) -> std::process::ExitStatus {
    let args = ["record", "--mask", "mask.nrrd", "--out", "frames", "--frames", "99999"];
    let mut child = Command::new(env!("CARGO_BIN_EXE_intima"))
        .current_dir(folder)
        .args(args)
        .args(["--device", "gpu", "--size", "160x120"])
        .stdout(Stdio::null())
        .stderr(Stdio::null())
        .spawn()
        .unwrap();
    std::thread::sleep(delay);
    let sent = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    assert!(sent.success(), "the flight ended before it was interrupted");
    child.wait().unwrap()
}

fn interrupt(times: u64) {
    let Some(_) = common::gpu(Validate::Off) else { return };
    let tmp = tempfile::tempdir().unwrap();
    let mask = Phantom::new(Kind::Bend, 64, [1.0; 3]).unwrap().mask();
    write_volume(&tmp.path().join("mask.nrrd"), &mask).unwrap();
    // From where the handler is there to where frames are drawn: 200 ms to 2 s.
    let mut seed = 7u64;
    for i in 0..times {
        seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        let delay = Duration::from_millis(200 + (seed >> 33) % 1800);
        let ended = interrupted(tmp.path(), delay);
        assert_eq!(ended.code(), Some(130), "try {i}, after {delay:?}: {ended}");
    }
}

#[test]
fn an_interrupted_flight_exits_with_130() {
    interrupt(6);
}

#[test]
#[ignore = "minutes: cargo test --release --test program two_hundred -- --ignored"]
fn two_hundred_interrupted_flights_exit_with_130() {
    interrupt(200);
}
