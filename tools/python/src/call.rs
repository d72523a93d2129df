//! Work of the engine called from Python: without the interpreter's lock, ended by Ctrl-C.

use std::sync::{Condvar, Mutex, PoisonError};
use std::thread;
use std::time::Duration;

use intima::session::SessionError;
use intima::task::CancelToken;
use pyo3::prelude::*;

use crate::error;

/// Longest time between two looks for signals.
const LOOK: Duration = Duration::from_millis(50);

/// Runs `work` on a thread of its own while this one waits without the interpreter's lock and looks
/// for signals. Python calls its handlers only on its main thread and only when asked, so Ctrl-C
/// would otherwise wait for the end of the work. A handler that raises cancels the work; its
/// exception is the outcome.
pub fn call<T: Send>(
    py: Python<'_>,
    cancel: &CancelToken,
    work: impl FnOnce() -> Result<T, SessionError> + Send,
) -> PyResult<T> {
    let done = Done::default();
    thread::scope(|scope| {
        let name = thread::Builder::new().name("intima".into());
        let run = || {
            let _signal = SignalOnDrop(&done);
            work()
        };
        let worker = name.spawn_scoped(scope, run).map_err(|e| error::no_thread(&e))?;
        let mut raised = None;
        while !py.detach(|| done.wait()) {
            if raised.is_none()
                && let Err(e) = py.check_signals()
            {
                cancel.cancel();
                raised = Some(e);
            }
        }
        let outcome = py.detach(|| worker.join());
        if let Some(raised) = raised {
            cancel.reset();
            return Err(raised);
        }
        match outcome {
            Ok(result) => result.map_err(error::session),
            Err(panic) => std::panic::resume_unwind(panic),
        }
    })
}

/// Whether the work has ended.
#[derive(Default)]
struct Done {
    ended: Mutex<bool>,
    changed: Condvar,
}

impl Done {
    /// Waits a while for the end; whether it came.
    fn wait(&self) -> bool {
        let ended = self.ended.lock().unwrap_or_else(PoisonError::into_inner);
        let waited = self.changed.wait_timeout_while(ended, LOOK, |ended| !*ended);
        *waited.unwrap_or_else(PoisonError::into_inner).0
    }
}

/// Says that the work has ended, also where it panics.
struct SignalOnDrop<'a>(&'a Done);

impl Drop for SignalOnDrop<'_> {
    fn drop(&mut self) {
        *self.0.ended.lock().unwrap_or_else(PoisonError::into_inner) = true;
        self.0.changed.notify_all();
    }
}
