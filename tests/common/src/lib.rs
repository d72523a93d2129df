//! What the test programs share. A crate and not a module, so that it is compiled once for all of
//! them: with no `#[path]`, and with no list of what each program leaves unused.

pub mod cast;
pub mod child;
pub mod colour;
pub mod curves;
pub mod fixtures;
pub mod fly;
pub mod html;
pub mod patience;
pub mod readers;
pub mod screen;
pub mod torso;
pub mod tube;
pub mod volumes;

use std::path::{Path, PathBuf};

use intima::vk::{Choice, Gpu, OpenOptions, Validate};

/// The root of the repository.
pub fn root() -> PathBuf {
    // Where tests were taken to another machine, their files lie in a folder that a variable names.
    let built =
        || Path::new(env!("CARGO_MANIFEST_DIR")).ancestors().nth(2).expect("two folders deep");
    std::env::var_os("INTIMA_TEST_ROOT").map_or_else(|| built().to_owned(), PathBuf::from)
}

/// A folder for thousands of small files that are each read once: in memory where the system has a
/// place for that, because a disk takes milliseconds for each of them.
pub fn scratch() -> tempfile::TempDir {
    let memory = tempfile::tempdir_in("/dev/shm");
    memory.or_else(|_| tempfile::tempdir()).expect("a folder for temporary files")
}

/// A validated device with no pipeline cache on disk, or `None` with the reason printed. With
/// `INTIMA_REQUIRE_GPU=1` a missing device or layer fails instead.
///
/// `INTIMA_TEST_DEVICE=N` takes device N instead of the first real GPU or software.
pub fn gpu(validate: Validate) -> Option<Gpu> {
    open(OpenOptions { validate, cache_dir: None, ..OpenOptions::default() })
}

/// The same, copying through staging memory as on a graphics card.
pub fn staging_gpu(validate: Validate) -> Option<Gpu> {
    open(OpenOptions { validate, cache_dir: None, always_stage: true, ..OpenOptions::default() })
}

/// The same, with kernels that hold every index within its array, as on drivers that do not.
pub fn restricted_gpu(validate: Validate) -> Option<Gpu> {
    open(OpenOptions { validate, cache_dir: None, restricted: true, ..OpenOptions::default() })
}

/// The same, with no more than `n` workgroups in a dimension.
pub fn few_groups_gpu(n: u32, validate: Validate) -> Option<Gpu> {
    open(OpenOptions { validate, cache_dir: None, groups_at_once: n, ..OpenOptions::default() })
}

/// The same, with no more than `n` draws in one indirect command.
pub fn few_draws_gpu(n: u32, validate: Validate) -> Option<Gpu> {
    let options = OpenOptions { validate, cache_dir: None, ..OpenOptions::default() };
    open(OpenOptions { draws_at_once: n, ..options })
}

fn open(options: OpenOptions) -> Option<Gpu> {
    let choice = match std::env::var("INTIMA_TEST_DEVICE").map(|n| n.parse()) {
        Ok(Ok(n)) => Choice::Index(n),
        _ => Choice::Any,
    };
    match Gpu::open_with(choice, options) {
        Ok(gpu) => {
            eprintln!("device: {}", gpu.info().name);
            Some(gpu)
        }
        Err(e) if e.is_no_device() && !required() => {
            eprintln!("skipped: no Vulkan device ({e})");
            None
        }
        Err(e) => panic!("{e}"),
    }
}

/// Whether a skip counts as a failure.
pub fn required() -> bool {
    std::env::var("INTIMA_REQUIRE_GPU").is_ok_and(|v| v == "1")
}

/// Fails with every message the validation layer had.
pub fn assert_silent(gpu: &Gpu) {
    let said = gpu.validation_messages();
    assert!(said.is_empty(), "{} validation messages:\n{}", said.len(), said.join("\n\n"));
}
