//! A session and its tasks, each on a thread of its own: products, a branch, a flight that is saved.

use std::sync::{Arc, Mutex, PoisonError};
use std::thread::JoinHandle;

use super::model::Model;
use crate::session::{Session, SessionError};

/// Change of the model by the outcome of a task.
pub(super) type Outcome = Box<dyn FnOnce(&mut Model) + Send>;

/// Kind of a task.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum TaskKind {
    /// Looks at the volume to name the organs that it may show.
    Glance,
    /// Computes all products that are shown.
    Products,
    /// Plans the flight along a branch.
    Branch,
    /// Computes the coverage of a flight along a branch.
    Coverage,
    /// Prepares the tissue behind the wall.
    Behind,
    /// Draws and writes the flight.
    SavedFlight,
    /// Draws pictures and writes the page of the report.
    Report,
}

impl TaskKind {
    fn name(self) -> &'static str {
        match self {
            Self::Glance => "glance",
            Self::Products => "products",
            Self::Branch => "flight",
            Self::Coverage => "coverage",
            Self::Behind => "behind",
            Self::SavedFlight => "export",
            Self::Report => "report",
        }
    }
}

/// State of the work that takes time, for the panels.
#[derive(Clone, Debug, PartialEq)]
pub struct WorkStatus {
    /// Stage and its time, or frames and the time that is left.
    pub text: String,
    /// Share that is done, 0 to 1.
    pub share: f32,
    /// Whether products are computed; else a file is written.
    pub is_computing: bool,
}

/// A session and its tasks.
pub(super) struct Computation {
    pub session: Arc<Session>,
    tasks: Vec<(TaskKind, JoinHandle<()>)>,
    /// Outcomes of tasks that have ended.
    outcomes: Arc<Mutex<Vec<Outcome>>>,
}

impl Computation {
    /// No tasks yet.
    pub fn new(session: Session) -> Self {
        Self { session: Arc::new(session), tasks: Vec::new(), outcomes: Arc::default() }
    }

    /// Starts a task.
    ///
    /// * `wake`: called when its outcome is there.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no thread.
    pub fn spawn(
        &mut self,
        kind: TaskKind,
        wake: Arc<dyn Fn() + Send + Sync>,
        work: impl FnOnce(&Session) -> Outcome + Send + 'static,
    ) -> Result<(), SessionError> {
        self.tidy();
        let (session, outcomes) = (Arc::clone(&self.session), Arc::clone(&self.outcomes));
        let run = move || {
            let outcome = work(&session);
            // Nobody holds the session when the outcome is there.
            drop(session);
            outcomes.lock().unwrap_or_else(PoisonError::into_inner).push(outcome);
            wake();
        };
        let task = std::thread::Builder::new().name(kind.name().into()).spawn(run);
        self.tasks.push((kind, task.map_err(|e| SessionError::System(e.to_string()))?));
        Ok(())
    }

    /// Returns the outcomes that came since the last time.
    pub fn outcomes(&mut self) -> Vec<Outcome> {
        self.tidy();
        std::mem::take(&mut self.outcomes.lock().unwrap_or_else(PoisonError::into_inner))
    }

    /// Forgets tasks that have ended. Once all that were cancelled have, what is asked for next is
    /// not cancelled any more.
    fn tidy(&mut self) {
        self.tasks.retain(|(_, task)| !task.is_finished());
        if self.tasks.is_empty() {
            self.session.cancel_token().reset();
        }
    }

    /// Whether such a task runs.
    pub fn runs(&self, kind: TaskKind) -> bool {
        self.tasks.iter().any(|(k, task)| *k == kind && !task.is_finished())
    }

    /// Asks all tasks to end.
    pub fn cancel(&self) {
        self.session.cancel_token().cancel();
    }

    /// Waits for all tasks.
    pub fn join(&mut self) -> Vec<Outcome> {
        self.tasks.drain(..).for_each(|(_, task)| drop(task.join()));
        self.outcomes()
    }

    /// Cancels all tasks and waits for their ends.
    pub fn stop(&mut self) {
        self.cancel();
        self.join();
    }

    /// Returns the work in progress and its share that is done; `None` where no task takes time.
    pub fn status(&self, is_computing: bool) -> Option<WorkStatus> {
        let saves = self.runs(TaskKind::SavedFlight);
        if !is_computing && !saves {
            return None;
        }
        let progress = self.session.progress();
        let text = match progress.frames {
            _ if self.session.cancel_token().is_cancelled() => "stopping".into(),
            Some((done, count)) => {
                let left = progress.time_left().map(|left| format!(", {} left", duration(left)));
                let left = left.unwrap_or_default();
                format!("saving the flight: {done} of {count} frames{left}")
            }
            None if saves => format!("saving the flight: {}", progress.stage),
            None if progress.stage.is_empty() => String::new(),
            None => format!("{}, {}", progress.stage, duration(progress.stage_elapsed)),
        };
        Some(WorkStatus { text, share: progress.share, is_computing })
    }
}

impl Drop for Computation {
    fn drop(&mut self) {
        self.stop();
    }
}

/// Seconds, or minutes and seconds.
fn duration(time: std::time::Duration) -> String {
    let s = time.as_secs();
    if s < 60 { format!("{s} s") } else { format!("{} min {} s", s / 60, s % 60) }
}

#[cfg(test)]
mod tests {
    use std::time::{Duration, Instant};

    use super::*;
    use crate::session::{Product, Settings, Source, VolumeSource};
    use crate::volume::phantom::{Kind, Phantom};

    #[test]
    fn what_was_cancelled_can_be_taken_up_again() {
        let mask = Phantom::new(Kind::Tube, 32, [1.0; 3]).unwrap().mask();
        let source = Source::Image(VolumeSource::Memory(Arc::new(mask)));
        let settings = Settings { device: crate::device::DeviceChoice::Cpu, ..Settings::default() };
        let session = Session::new(source, settings).unwrap();
        let mut computation = Computation::new(session);
        let mut model = Model::new(20.0);
        let wake: Arc<dyn Fn() + Send + Sync> = Arc::new(|| {});
        let compute = |session: &Session| -> Outcome {
            let outcome = session.prepare(&[Product::Wall]);
            Box::new(move |model| model.finish(outcome, None))
        };
        let begun = Instant::now();
        // Cancelled before the stages begin.
        let (start, wait) = std::sync::mpsc::channel();
        computation
            .spawn(TaskKind::Products, Arc::clone(&wake), move |session| {
                let _ = wait.recv();
                compute(session)
            })
            .unwrap();
        assert!(computation.runs(TaskKind::Products));
        computation.cancel();
        assert_eq!(computation.status(true).unwrap().text, "stopping");
        start.send(()).unwrap();
        while model.message.is_none() || computation.session.cancel_token().is_cancelled() {
            computation.outcomes().into_iter().for_each(|outcome| outcome(&mut model));
            assert!(begun.elapsed() < Duration::from_secs(60), "the task does not end");
        }
        assert!(model.is_stopped && model.failure.is_none());
        model.resume();
        computation.spawn(TaskKind::Products, wake, compute).unwrap();
        computation.join().into_iter().for_each(|outcome| outcome(&mut model));
        assert!(model.is_complete && !model.is_stopped, "{:?}", model.failure);
        assert!(computation.session.products(&[Product::Wall]).wall.is_some());
    }
}
