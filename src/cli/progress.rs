//! The progress bar: what a session says of its work, drawn on a terminal.

use std::io::IsTerminal as _;
use std::sync::mpsc::{RecvTimeoutError, channel};
use std::time::Duration;

use indicatif::{ProgressBar, ProgressDrawTarget, ProgressStyle};

use super::global::Global;
use crate::session::Session;

/// Work shorter than this shows nothing.
const PATIENCE: Duration = Duration::from_secs(1);
const REDRAW: Duration = Duration::from_millis(100);
/// Steps of the bar.
const STEPS: u64 = 1000;

impl Global {
    /// Does `work` on a session; where standard error is a terminal and the work takes over a
    /// second, a bar shows stage, share done and time left.
    pub fn watched<T>(&self, session: &Session, work: impl FnOnce() -> T) -> T {
        if self.quiet || !std::io::stderr().is_terminal() {
            return work();
        }
        let (done, ended) = channel::<()>();
        std::thread::scope(|scope| {
            scope.spawn(move || {
                let mut bar = None;
                let mut waited = Duration::ZERO;
                while ended.recv_timeout(REDRAW) == Err(RecvTimeoutError::Timeout) {
                    waited += REDRAW;
                    if waited >= PATIENCE {
                        draw(bar.get_or_insert_with(new_bar), session);
                    }
                }
                if let Some(bar) = bar {
                    bar.finish_and_clear();
                }
            });
            let out = work();
            drop(done);
            out
        })
    }
}

fn new_bar() -> ProgressBar {
    let bar = ProgressBar::with_draw_target(Some(STEPS), ProgressDrawTarget::stderr());
    let style = ProgressStyle::with_template("{bar:30} {percent:>3} % {msg}");
    bar.set_style(style.unwrap_or_else(|_| ProgressStyle::default_bar()));
    bar
}

fn draw(bar: &ProgressBar, session: &Session) {
    let progress = session.progress();
    bar.set_position((progress.share * STEPS as f32) as u64);
    bar.set_message(match progress.time_left() {
        Some(left) => format!("{}, {} s left", progress.stage, left.as_secs_f32().ceil()),
        None => progress.stage.to_owned(),
    });
}
