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

#[cfg(test)]
mod tests {
    use super::beside;
    use std::sync::mpsc::channel;

    #[test]
    fn the_first_may_wait_for_the_second_at_any_number_of_threads() {
        for threads in [1, 2] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let (say, hear) = channel();
            let both = || beside(move || hear.recv(), move || say.send(7).is_ok());
            assert_eq!(pool.install(both), (Ok(7), true));
        }
    }
}
