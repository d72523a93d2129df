//! `--max-memory` as a bound: a run that grows beyond it is ended.
//!
//! Estimates refuse most of what does not fit before it is begun (`session::memory`). What they
//! miss, this thread sees: it reads the resident size of the process every few milliseconds.

use std::time::Duration;

use super::CliError;
use super::global::Global;
use crate::formats::atomic_file;
use crate::session::resident_memory_mb;

/// Time between two looks. A core writes about 10 MB of fresh pages in it.
const INTERVAL: Duration = Duration::from_millis(5);

/// Starts the thread that ends the process beyond the limit, with the error and exit code of a
/// refusal; unfinished files are removed.
pub fn watch(global: &Global, allowed_mb: u64) {
    let global = global.clone();
    std::thread::spawn(move || {
        loop {
            let resident_mb = resident_memory_mb();
            if resident_mb > allowed_mb as f64 {
                let needed_mb = resident_mb.ceil() as u64;
                let error = CliError::Memory { needed_mb, allowed_mb, what: "stopped on the way" };
                atomic_file::discard_unfinished();
                eprintln!("intima: {error}");
                global.refuse(&error);
                crate::vk::exit_now(i32::from(error.exit_code()));
            }
            std::thread::sleep(INTERVAL);
        }
    });
}
