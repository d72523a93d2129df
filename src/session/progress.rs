//! Progress of a session's present work: a value that any thread can read at any time.

use std::sync::{Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

/// State of a session's present work.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Progress {
    /// Name of the stage that began last; empty while nothing runs.
    pub stage: &'static str,
    /// Share of the present work that is done, 0 to 1: stages by their usual share of the time, a
    /// running one by the time it has taken, frames by their number.
    pub share: f32,
    /// Time since that stage began.
    pub stage_elapsed: Duration,
    /// Frames drawn and wanted, while some are drawn.
    pub frames: Option<(usize, usize)>,
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
    running: Vec<RunningStage>,
    /// Weights of all stages of the present work, and of those that have ended.
    total: f32,
    ended: f32,
    /// Time that those which have ended took.
    ended_time: Duration,
    /// Frames drawn and wanted, with the weight of all of them.
    frames: (usize, usize, f32),
    /// When the frames began.
    frames_began: Instant,
    /// Largest share that was read since work was added last: a share does not go back.
    shown: f32,
}

struct RunningStage {
    name: &'static str,
    weight: f32,
    began: Instant,
}

impl RunningStage {
    /// Share of the stage that is done by its usual time, never all of it: where it takes longer
    /// than usual, the share still grows.
    ///
    /// * `second`: weight of a second on this machine.
    fn share(&self, second: f32) -> f32 {
        let usual = (self.weight / second).max(1e-3);
        let taken = self.began.elapsed().as_secs_f32();
        taken / (taken + usual)
    }
}

/// Weight of a second, before a stage has ended.
const FIRST_SECOND: f32 = 10.0;

/// Weight of drawing all frames, beside the weights of the stages.
const FRAMES_WEIGHT: f32 = 40.0;

impl Default for ProgressState {
    fn default() -> Self {
        Self(Mutex::new(Inner {
            began: Instant::now(),
            running: Vec::new(),
            total: 0.0,
            ended: 0.0,
            ended_time: Duration::ZERO,
            frames: (0, 0, 0.0),
            frames_began: Instant::now(),
            shown: 0.0,
        }))
    }
}

impl Inner {
    fn begin_work(&mut self) {
        if self.running.is_empty() && self.frames.0 == self.frames.1 {
            self.began = Instant::now();
            (self.total, self.ended, self.frames) = (0.0, 0.0, (0, 0, 0.0));
            (self.ended_time, self.shown) = (Duration::ZERO, 0.0);
        }
    }
}

impl ProgressState {
    fn lock(&self) -> MutexGuard<'_, Inner> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// The work begins anew where nothing is running: what was done before is not part of it.
    pub fn begin_work(&self) {
        self.lock().begin_work();
    }

    /// Stages are added to the present work; it begins anew where nothing was running.
    pub fn add(&self, weight: f32) {
        let mut inner = self.lock();
        inner.begin_work();
        inner.total += weight;
        inner.shown = 0.0;
    }

    /// A stage begins.
    pub fn begin(&self, name: &'static str, weight: f32) {
        self.lock().running.push(RunningStage { name, weight, began: Instant::now() });
    }

    /// A stage ends, done or not.
    pub fn end(&self, name: &'static str, weight: f32) {
        let mut inner = self.lock();
        if let Some(at) = inner.running.iter().position(|l| l.name == name) {
            let taken = inner.running.remove(at).began.elapsed();
            inner.ended_time += taken;
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
        (inner.frames_began, inner.shown) = (Instant::now(), 0.0);
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
        let mut inner = self.lock();
        let (done, count, weight) = inner.frames;
        let drawing = done < count;
        let (stage, began) = match inner.running.last() {
            Some(stage) => (stage.name, stage.began),
            None if drawing => ("frames", inner.frames_began),
            None => ("", Instant::now()),
        };
        let drawn = weight * done as f32 / count.max(1) as f32;
        let ended_s = inner.ended_time.as_secs_f32();
        let second = if ended_s > 0.0 { (inner.ended / ended_s).max(1e-3) } else { FIRST_SECOND };
        let running: f32 = inner.running.iter().map(|s| s.weight * s.share(second)).sum();
        let done_weight = inner.ended + running + drawn;
        let share = if inner.total > 0.0 { done_weight / inner.total } else { 0.0 };
        inner.shown = share.clamp(inner.shown, 1.0);
        Progress {
            stage,
            share: inner.shown,
            stage_elapsed: began.elapsed(),
            frames: drawing.then_some((done, count)),
            elapsed: inner.began.elapsed(),
        }
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
        state.begin("a", 60.0);
        assert_eq!(state.read().stage, "a");
        state.end("a", 60.0);
        assert_eq!(state.read().share, 1.0);
        state.begin_frames(10);
        state.frames(5);
        let read = state.read();
        assert_eq!((read.stage, read.share, read.frames), ("frames", 0.8, Some((5, 10))));
        state.end_frames();
        assert_eq!(state.read().share, 1.0);
        state.add(1.0);
        assert_eq!(state.read().share, 0.0, "new work begins at nothing");
    }

    #[test]
    fn time_left_follows_the_share_done() {
        let elapsed = Duration::from_secs(10);
        let at = |share| Progress { stage: "a", share, elapsed, ..Progress::default() };
        assert_eq!(at(0.0).time_left(), None);
        assert_eq!(at(0.5).time_left(), Some(Duration::from_secs(10)));
        assert_eq!(at(1.0).time_left(), Some(Duration::ZERO));
    }

    #[test]
    fn the_bar_moves_while_a_long_stage_runs_and_its_time_counts_from_its_own_beginning() {
        let state = ProgressState::default();
        let pause = || std::thread::sleep(Duration::from_millis(20));
        state.add(100.0);
        state.begin("short", 1.0);
        pause();
        state.end("short", 1.0);
        state.begin("long", 99.0);
        let mut last = state.read();
        assert!(last.elapsed - last.stage_elapsed >= Duration::from_millis(20), "{last:?}");
        for _ in 0..5 {
            pause();
            let read = state.read();
            assert!(read.share > last.share && read.share < 1.0, "{read:?} after {last:?}");
            last = read;
        }
        state.end("long", 99.0);
        assert_eq!(state.read().share, 1.0);
    }
}
