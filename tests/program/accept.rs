//! The acceptance of a GPU, small, on what Vulkan there is: a mistake in the script must not cost time on
//! a card.
#![cfg(unix)]

use std::os::unix::fs::symlink;
use std::process::Command;

#[test]
fn the_acceptance_of_a_gpu_runs_through_on_software_vulkan() {
    if common::gpu(intima::vk::Validate::Off).is_none() {
        return;
    }
    let tmp = tempfile::tempdir().unwrap();
    symlink(env!("CARGO_BIN_EXE_intima"), tmp.path().join("intima")).unwrap();
    let has_faults = cfg!(feature = "faults");
    if has_faults {
        std::fs::write(tmp.path().join("has-faults"), "").unwrap();
    }
    let mut command = Command::new("sh");
    command.arg(common::root().join("tools/gpu/accept.sh")).args(["--small", "--out", "my result"]);
    command.arg("--pack").arg(tmp.path()).current_dir(&tmp);
    command.env_remove("INTIMA_FAULT").env_remove("INTIMA_VALIDATE");
    let done = command.output().unwrap();
    let table = std::fs::read_to_string(tmp.path().join("my result/table.txt")).unwrap();
    assert!(done.status.success(), "{table}{}", String::from_utf8_lossy(&done.stderr));
    // Each part has its rows, none of them without a value.
    let lost = if has_faults { "record, lost at" } else { "a frame of the window" };
    for part in [
        "segment as on the CPU",
        "distance as",
        "surface as",
        "submissions of",
        "run with",
        "--lod culled",
        "--lod vds",
        "a frame of the window",
        lost,
    ] {
        let row = table.lines().find(|row| row.contains(part));
        let row = row.unwrap_or_else(|| panic!("{part}: {table}"));
        assert!(row[50..].split_whitespace().next().is_some_and(|value| value != "-"), "{row}");
    }
    assert!(table.ends_with("accepted\n") && !table.contains("FAIL"), "{table}");
    let devices = std::fs::read(tmp.path().join("my result/devices.json")).unwrap();
    assert!(serde_json::from_slice::<serde_json::Value>(&devices).is_ok());
}

#[test]
fn without_a_program_or_with_an_unknown_flag_the_acceptance_says_so() {
    let tmp = tempfile::tempdir().unwrap();
    let script = common::root().join("tools/gpu/accept.sh");
    let mine = tmp.path().join("mine");
    std::fs::create_dir(&mine).unwrap();
    symlink(env!("CARGO_BIN_EXE_intima"), mine.join("intima")).unwrap();
    for (args, said) in [
        (&["--pack", "."][..], "no program at"),
        (&["--speed", "."], "no option --speed"),
        (&["--pack", "mine", "--out", "mine"], "mine is there, and not of an acceptance"),
    ] {
        let done = Command::new("sh").arg(&script).args(args).current_dir(&tmp).output().unwrap();
        let err = String::from_utf8_lossy(&done.stderr);
        assert!(done.status.code() == Some(2) && err.contains(said), "{err}");
    }
    assert!(mine.join("intima").exists(), "nothing of the user's goes");
}
