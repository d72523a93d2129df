//! Waiting for another process. A busy machine only makes it longer; the limit ends a test that hangs.

use std::process::{Child, ExitStatus};
use std::time::{Duration, Instant};

/// Time after which a test counts as hanging.
pub const PATIENCE: Duration = Duration::from_secs(300);

/// Waits until something is so.
///
/// # Panics
/// After [`PATIENCE`].
pub fn until<T>(what: &str, mut ready: impl FnMut() -> Option<T>) -> T {
    let begun = Instant::now();
    loop {
        if let Some(found) = ready() {
            return found;
        }
        assert!(begun.elapsed() < PATIENCE, "not so: {what}");
        std::thread::sleep(Duration::from_millis(5));
    }
}

/// Waits until something is so while a process runs.
///
/// # Panics
/// If the process ends before, or after [`PATIENCE`].
pub fn until_while_running(child: &mut Child, what: &str, mut ready: impl FnMut() -> bool) {
    until(what, || {
        let is_ready = ready();
        let has_ended = child.try_wait().expect("state of a process").is_some();
        assert!(is_ready || !has_ended, "the process ended before: {what}");
        is_ready.then_some(())
    });
}

/// Waits for the end of a process.
///
/// # Panics
/// After [`PATIENCE`]; the process is ended then.
pub fn end_of(child: &mut Child, what: &str) -> ExitStatus {
    let begun = Instant::now();
    loop {
        if let Some(status) = child.try_wait().expect("state of a process") {
            return status;
        }
        if begun.elapsed() > PATIENCE {
            child.kill().expect("a running process");
            panic!("it does not end: {what}");
        }
        std::thread::sleep(Duration::from_millis(5));
    }
}
