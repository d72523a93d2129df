//! Two pieces of a chain side by side.

/// Does `a` on a thread of its own while this one does `b`. With one thread allowed `b` is done
/// first, then `a`: `a` may wait for what `b` says, `b` must not wait for `a`.
///
/// Not `rayon::join`: a worker that waits for its part of one piece would take up the whole of the
/// other, and the stage it waits in would be given that time.
///
/// # Panics
/// If one of them does, or the system has no thread to give.
pub fn beside<A: Send, B>(a: impl FnOnce() -> A + Send, b: impl FnOnce() -> B) -> (A, B) {
    if rayon::current_num_threads() == 1 {
        let b = b();
        return (a(), b);
    }
    std::thread::scope(|scope| {
        let a = scope.spawn(a);
        let b = b();
        match a.join() {
            Ok(a) => (a, b),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}
