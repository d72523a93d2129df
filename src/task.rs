//! Cancellation of the work at hand, for loops that do not know their caller.
//!
//! A [`Session`](crate::session::Session) enters a [`CancelToken`] on every thread of its pool and
//! looks at it before every stage and frame. Loops that may take longer call [`checkpoint`], at
//! most about 50 ms of work apart. Where the token is cancelled, that call unwinds to the nearest
//! [`catch_cancelled`], which turns it into an error; no panic message is printed. Threads without a
//! token are never cancelled.

use std::cell::RefCell;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::Arc;
use std::sync::atomic::{AtomicBool, Ordering};

/// The work was cancelled before it was done.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
#[error("cancelled")]
pub struct Cancelled;

/// Asks work to stop, from any thread. Clones share one flag.
#[derive(Clone, Debug, Default)]
pub struct CancelToken(Arc<AtomicBool>);

thread_local! {
    static CURRENT: RefCell<Option<CancelToken>> = const { RefCell::new(None) };
}

impl CancelToken {
    /// Requests cancellation. Work that has finished already is not affected.
    pub fn cancel(&self) {
        self.0.store(true, Ordering::Relaxed);
    }

    /// Whether cancellation was requested.
    pub fn is_cancelled(&self) -> bool {
        self.0.load(Ordering::Relaxed)
    }

    /// Withdraws the request, so that the same token serves the next piece of work.
    pub fn reset(&self) {
        self.0.store(false, Ordering::Relaxed);
    }

    /// Makes this the token of the calling thread until the thread ends or enters another.
    pub fn enter(&self) {
        CURRENT.with(|current| *current.borrow_mut() = Some(self.clone()));
    }
}

/// Unwinds to [`catch_cancelled`] if the token of this thread is cancelled. Costs a thread-local
/// read and an atomic load: nothing beside a millisecond of work.
pub fn checkpoint() {
    if is_cancelled() {
        // `resume_unwind` does not call the panic hook: nothing is printed.
        resume_unwind(Box::new(Cancelled));
    }
}

/// Whether the token of this thread is cancelled: for places that return an error instead of
/// unwinding, because they hold resources that must be released.
pub fn is_cancelled() -> bool {
    CURRENT.with(|c| c.borrow().as_ref().is_some_and(CancelToken::is_cancelled))
}

/// Runs `work` and turns an unwinding from [`checkpoint`] into an error. Other panics go on.
///
/// # Errors
/// [`Cancelled`].
pub fn catch_cancelled<T>(work: impl FnOnce() -> T) -> Result<T, Cancelled> {
    catch_unwind(AssertUnwindSafe(work)).map_err(|payload| match payload.downcast::<Cancelled>() {
        Ok(cancelled) => *cancelled,
        Err(panic) => resume_unwind(panic),
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use rayon::prelude::*;

    #[test]
    fn a_cancelled_token_ends_a_parallel_loop_on_every_thread_of_the_pool() {
        let token = CancelToken::default();
        let entered = token.clone();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(3)
            .start_handler(move |_| entered.enter())
            .build()
            .unwrap();
        let run = || {
            pool.install(|| {
                catch_cancelled(|| {
                    (0..64u32).into_par_iter().for_each(|i| {
                        if i == 7 {
                            token.cancel();
                        }
                        checkpoint();
                    });
                })
            })
        };
        assert_eq!(run(), Err(Cancelled));
        token.reset();
        let all = pool.install(|| {
            catch_cancelled(|| {
                (0..64u32)
                    .into_par_iter()
                    .map(|i| {
                        checkpoint();
                        i
                    })
                    .sum::<u32>()
            })
        });
        assert_eq!(all, Ok(2016));
    }

    #[test]
    fn a_thread_without_a_token_is_never_cancelled() {
        let token = CancelToken::default();
        token.cancel();
        assert_eq!(catch_cancelled(checkpoint), Ok(()));
        token.enter();
        assert_eq!(catch_cancelled(checkpoint), Err(Cancelled));
    }

    #[test]
    fn other_panics_pass_through() {
        let outcome = catch_unwind(|| catch_cancelled(|| panic!("a fault")));
        assert!(outcome.is_err());
    }
}
