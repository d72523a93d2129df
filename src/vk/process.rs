//! Settings of the whole process that only unsafe calls can change.

use std::sync::atomic::{AtomicBool, Ordering};

/// Whether a Vulkan instance was ever made, and with it perhaps software Vulkan's threads.
static INSTANCE_MADE: AtomicBool = AtomicBool::new(false);

/// Notes that an instance is about to be made.
pub(super) fn note_instance() {
    INSTANCE_MADE.store(true, Ordering::SeqCst);
}

/// Reason why the number of software Vulkan's threads cannot be set.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ThreadsError {
    /// Other threads may read the environment at this moment.
    #[error("software Vulkan's threads can be set only before other threads start ({0} run)")]
    OtherThreads(usize),
    /// The driver has read the number already.
    #[error("software Vulkan's threads can be set only before Vulkan starts")]
    InstanceMade,
    /// This system does not say how many threads run.
    #[error("software Vulkan's threads cannot be set safely on this system")]
    Unknown,
}

/// Limits lavapipe to `n` worker threads (0: the queue's own thread does all the work), by setting
/// `LP_NUM_THREADS`, which the driver reads once. Rendered and computed bytes do not depend on `n`.
///
/// # Errors
/// [`ThreadsError`], and nothing was changed: the environment may be written only while no other
/// thread can read it, and the driver reads it when the first instance is made.
pub fn set_lavapipe_threads(n: usize) -> Result<(), ThreadsError> {
    if INSTANCE_MADE.load(Ordering::SeqCst) {
        return Err(ThreadsError::InstanceMade);
    }
    match threads_running() {
        None => return Err(ThreadsError::Unknown),
        Some(1) => {}
        Some(threads) => return Err(ThreadsError::OtherThreads(threads)),
    }
    // SAFETY: this is the only thread of the process, as the system has just said, and no other can
    // start before this one goes on; so nobody reads or writes the environment meanwhile.
    unsafe { std::env::set_var("LP_NUM_THREADS", n.to_string()) };
    Ok(())
}

/// Threads of this process, this one included; `None` where the system does not say.
fn threads_running() -> Option<usize> {
    if cfg!(windows) {
        return Some(1); // its environment has a lock of its own
    }
    std::fs::read_dir("/proc/self/task").ok().map(Iterator::count)
}

/// Ends the process at once with an exit code. Unlike [`std::process::exit`] it runs no destructors
/// of C libraries, and so may be called while other threads are within a Vulkan driver: destructors
/// of software Vulkan and its compiler free what those threads use. Output that is still buffered
/// is lost.
pub fn exit_now(code: i32) -> ! {
    #[cfg(unix)]
    {
        unsafe extern "C" {
            fn _exit(status: std::ffi::c_int) -> !;
        }
        // SAFETY: may be called by any thread at any time (async-signal-safe in POSIX), and does
        // not return.
        unsafe { _exit(code) }
    }
    #[cfg(not(unix))]
    std::process::exit(code)
}

/// Makes a write beyond the user's largest file size (`ulimit -f`) fail as a full disk does. By
/// default the system ends the process there, with no word and its temporary files left behind.
pub fn survive_file_size_limit() {
    #[cfg(any(target_os = "linux", target_os = "macos"))]
    {
        unsafe extern "C" {
            fn signal(number: std::ffi::c_int, handler: usize) -> usize;
        }
        const SIGXFSZ: std::ffi::c_int = 25;
        const SIG_IGN: usize = 1;
        // SAFETY: number and handler are the C library's own constants on these systems, and a
        // signal that is ignored runs no code of ours.
        unsafe { signal(SIGXFSZ, SIG_IGN) };
    }
}

/// Gives freed memory back to the system. The C library keeps what was freed in small pieces for
/// later requests, for each thread its own: after levels of detail were built for 0.8 million faces
/// that was some 250 MB which nothing else would use. Where there is no such call, nothing
/// happens.
pub fn return_freed_memory() {
    #[cfg(all(target_os = "linux", target_env = "gnu"))]
    {
        unsafe extern "C" {
            fn malloc_trim(pad: usize) -> std::ffi::c_int;
        }
        // SAFETY: may be called by any thread at any time (malloc_trim(3) is MT-safe) and touches
        // nothing that is in use.
        unsafe { malloc_trim(0) };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    #[cfg(target_os = "linux")]
    fn lavapipe_threads_are_not_set_while_other_threads_run() {
        let before = std::env::var_os("LP_NUM_THREADS");
        let refused = std::thread::scope(|s| s.spawn(|| set_lavapipe_threads(3)).join().unwrap());
        // The thread that waits, and this one, are two at least.
        match refused {
            Err(ThreadsError::OtherThreads(n)) => assert!(n >= 2, "{n}"),
            other => assert_eq!(other, Err(ThreadsError::InstanceMade)),
        }
        assert_eq!(std::env::var_os("LP_NUM_THREADS"), before);
    }
}
