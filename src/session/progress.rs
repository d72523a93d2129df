//! Progress of a session's present work: a value that any thread can read at any time.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// State of a session's present work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Name of the stage that began last; empty while nothing runs.
    pub stage: &'static str,
    /// Share of the present work that is done, 0 to 1: stages by their usual share of the time,
    /// frames by their number.
    pub share: f32,
    /// Time since the present work began.
    pub elapsed: Duration,
}

impl Progress {
    /// Time left if the rest goes as fast as what is done; `None` before a fiftieth is done.
    pub fn time_left(&self) -> Option<Duration> {
        (self.share >= 0.02).then(|| self.elapsed.mul_f32((1.0 - self.share).max(0.0) / self.share))
    }
}

/// State that the session writes and [`Progress`] is computed from.
pub(super) struct ProgressState(Mutex<Inner>);

struct Inner {
    began: Instant,
    running: Vec<&'static str>,
    /// Weights of all stages of the present work, and of those that have ended.
    total: f32,
    ended: f32,
    /// Frames drawn and wanted, with the weight of all of them.
    frames: (usize, usize, f32),
}

/// Weight of drawing all frames, beside the weights of the stages.
const FRAMES_WEIGHT: f32 = 40.0;

impl Default for ProgressState {
    fn default() -> Self {
        Self(Mutex::new(Inner {
            began: Instant::now(),
            running: Vec::new(),
            total: 0.0,
            ended: 0.0,
            frames: (0, 0, 0.0),
        }))
    }
}

impl ProgressState {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Stages are added to the present work; it begins anew where nothing was running.
    pub fn add(&self, weight: f32) {
        let mut inner = self.lock();
        if inner.running.is_empty() && inner.frames.0 == inner.frames.1 {
            inner.began = Instant::now();
            (inner.total, inner.ended, inner.frames) = (0.0, 0.0, (0, 0, 0.0));
        }
        inner.total += weight;
    }

    /// A stage begins.
    pub fn begin(&self, name: &'static str) {
        self.lock().running.push(name);
    }

    /// A stage ends, done or not.
    pub fn end(&self, name: &'static str, weight: f32) {
        let mut inner = self.lock();
        if let Some(at) = inner.running.iter().position(|l| *l == name) {
            inner.running.remove(at);
        }
        inner.ended += weight;
    }

    /// Frames that are going to be drawn.
    pub fn begin_frames(&self, count: usize) {
        let mut inner = self.lock();
        if inner.frames.2 == 0.0 {
            inner.total += FRAMES_WEIGHT;
        }
        inner.frames = (0, count, FRAMES_WEIGHT);
    }

    /// Frames drawn so far.
    pub fn frames(&self, done: usize) {
        self.lock().frames.0 = done;
    }

    /// No more frames will be drawn.
    pub fn end_frames(&self) {
        let mut inner = self.lock();
        inner.frames.0 = inner.frames.1;
    }

    pub fn read(&self) -> Progress {
        let inner = self.lock();
        let (done, count, weight) = inner.frames;
        let drawing = done < count;
        let stage = if drawing && inner.running.is_empty() {
            "frames"
        } else {
            inner.running.last().copied().unwrap_or_default()
        };
        let drawn = weight * done as f32 / count.max(1) as f32;
        let share = if inner.total > 0.0 { (inner.ended + drawn) / inner.total } else { 0.0 };
        Progress { stage, share: share.clamp(0.0, 1.0), elapsed: inner.began.elapsed() }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn share_counts_ended_stages_and_drawn_frames() {
        let state = ProgressState::default();
        assert_eq!(state.read().share, 0.0);
        state.add(60.0);
        state.begin("a");
        assert_eq!(state.read().stage, "a");
        state.end("a", 60.0);
        assert_eq!(state.read().share, 1.0);
        state.begin_frames(10);
        state.frames(5);
        let read = state.read();
        assert_eq!((read.stage, read.share), ("frames", 0.8));
        state.end_frames();
        assert_eq!(state.read().share, 1.0);
        state.add(1.0);
        assert_eq!(state.read().share, 0.0, "new work begins at nothing");
    }

    #[test]
    fn time_left_follows_the_share_done() {
        let at = |share| Progress { stage: "a", share, elapsed: Duration::from_secs(10) };
        assert_eq!(at(0.0).time_left(), None);
        assert_eq!(at(0.5).time_left(), Some(Duration::from_secs(10)));
        assert_eq!(at(1.0).time_left(), Some(Duration::ZERO));
    }
}
