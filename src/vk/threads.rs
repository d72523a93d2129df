//! How many threads the software driver may take.

/// Limits lavapipe to `n` worker threads (0: the queue's own thread does all the work).
///
/// Call it at the very start of the program, before any thread exists and before any instance:
/// the driver reads the variable once, and changing the environment beside a thread that reads it
/// is undefined. Rendered and computed bytes do not depend on `n`.
pub fn set_lavapipe_threads(n: usize) {
    // SAFETY: the caller is the only thread, as the documentation demands; `main` keeps it by
    // calling this right after parsing its arguments.
    unsafe { std::env::set_var("LP_NUM_THREADS", n.to_string()) };
}
