//! The thread that owns a surface's levels of detail.
//!
//! A live camera is looked at ([`Worker::look`]) and steps are taken as they come
//! ([`Worker::take`]); neither waits, and only the newest camera counts. A film asks
//! ([`Worker::ask`]) and waits for the settled cut ([`Worker::answer`]). Steps are handed over in
//! the order they were made and none is dropped: each says what to write to pages that the next
//! takes for written.

use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use super::{Camera, PAGE_BYTES, Pool, Refine, Step, Tolerance};

/// Live steps that wait to be taken; the thread makes no more until one is.
const UNTAKEN: usize = 2;
/// Steps in a row that neither upload nor change what is drawn, while nothing is settled, after
/// which a question is given up: pages cool down in far fewer.
const IDLE_STEPS: u32 = 1000;

/// Why there are no more steps.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WorkerError {
    /// The system gave no thread.
    #[error("no thread for level of detail ({0})")]
    NoThread(String),
    /// Refinement panicked; nothing more comes from this worker.
    #[error("level of detail failed: {0}")]
    Panicked(String),
    /// A cut did not settle.
    #[error("level of detail did not settle: {0} steps in a row changed nothing")]
    Unsettled(u32),
}

/// A thread that owns a [`Refine`] and its [`Pool`].
pub struct Worker {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    outstanding: usize,
    finest_faces: u64,
}

#[derive(Default)]
struct Shared {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    look: Option<Camera>,
    untaken: VecDeque<Step>,
    asked: VecDeque<Camera>,
    answers: VecDeque<Step>,
    stop: bool,
    failed: Option<WorkerError>,
}

impl Shared {
    // A panic is caught before it can pass a lock; a poisoned one still holds a whole state.
    fn lock(&self) -> MutexGuard<'_, State> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Worker {
    /// Starts the thread.
    ///
    /// * `pages`: pages on the device.
    /// * `upload_bytes`: most bytes of pages written in one step, at least one page.
    /// * `in_flight`: steps whose frames may still be running; at least 1, so that no step writes
    ///   to what the step before draws.
    ///
    /// # Errors
    /// [`WorkerError::NoThread`].
    pub fn spawn(
        refine: Box<dyn Refine>,
        tolerance: Tolerance,
        pages: u32,
        upload_bytes: u64,
        in_flight: u32,
    ) -> Result<Self, WorkerError> {
        let uploads = (upload_bytes / PAGE_BYTES).clamp(1, u64::from(u32::MAX)) as u32;
        let finest_faces = refine.finest_faces();
        let shared = Arc::new(Shared::default());
        let mut owner = Owner {
            refine,
            tolerance,
            pool: Pool::new(pages, uploads, in_flight.max(1)),
            shared: Arc::clone(&shared),
            camera: None,
            settled: true,
        };
        let thread = std::thread::Builder::new()
            .name("detail".into())
            .spawn(move || owner.run())
            .map_err(|e| WorkerError::NoThread(e.to_string()))?;
        Ok(Self { shared, thread: Some(thread), outstanding: 0, finest_faces })
    }

    /// Faces of the whole surface at its finest.
    pub fn finest_faces(&self) -> u64 {
        self.finest_faces
    }

    /// Turns to a camera. Never waits for a step; a camera not turned to yet is forgotten.
    pub fn look(&mut self, camera: &Camera) {
        self.shared.lock().look = Some(*camera);
        self.shared.changed.notify_all();
    }

    /// The oldest live step that was not taken yet, if there is one. Never waits for a step. While
    /// a question is open there are none: its answer holds them.
    ///
    /// # Errors
    /// [`WorkerError::Panicked`], once all steps made before it have been taken.
    pub fn take(&mut self) -> Result<Option<Step>, WorkerError> {
        if self.outstanding > 0 {
            return Ok(None);
        }
        let mut state = self.shared.lock();
        let step = state.untaken.pop_front();
        match (step, &state.failed) {
            (None, Some(e)) => Err(e.clone()),
            (step, _) => {
                self.shared.changed.notify_all();
                Ok(step)
            }
        }
    }

    /// Asks for the settled cut of a camera, and does not wait for it. Questions are answered in
    /// order, each after as many steps as it needs.
    pub fn ask(&mut self, camera: Camera) {
        self.outstanding += 1;
        self.shared.lock().asked.push_back(camera);
        self.shared.changed.notify_all();
    }

    /// Questions that have no answer yet.
    pub fn outstanding(&self) -> usize {
        self.outstanding
    }

    /// Waits for the answer to the oldest question: all its steps, and live ones before them, as
    /// one, with each page written at most once.
    ///
    /// # Errors
    /// [`WorkerError::Panicked`], [`WorkerError::Unsettled`].
    ///
    /// # Panics
    /// If nothing was asked.
    pub fn answer(&mut self) -> Result<Step, WorkerError> {
        assert!(self.outstanding > 0, "an answer needs a question");
        self.outstanding -= 1;
        let mut state = self.shared.lock();
        loop {
            if let Some(step) = state.answers.pop_front() {
                return Ok(step);
            }
            if let Some(e) = &state.failed {
                self.outstanding = 0;
                return Err(e.clone());
            }
            state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Waits for the settled cut of a camera. The answers to earlier questions are part of it.
    ///
    /// # Errors
    /// As [`Worker::answer`].
    pub fn converge(&mut self, camera: Camera) -> Result<Step, WorkerError> {
        self.ask(camera);
        let mut merged = Merged::default();
        while self.outstanding > 0 {
            merged.add(self.answer()?);
        }
        Ok(merged.step)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // The thread catches its panics; there is nothing to learn from how it ended.
            let _ = thread.join();
        }
    }
}

/// What runs on the thread.
struct Owner {
    refine: Box<dyn Refine>,
    tolerance: Tolerance,
    pool: Pool,
    shared: Arc<Shared>,
    camera: Option<Camera>,
    settled: bool,
}

enum Job {
    Step(Camera),
    Settle(Camera, Vec<Step>),
}

impl Owner {
    fn run(&mut self) {
        while let Some(job) = self.next_job() {
            let done = match job {
                Job::Step(camera) => self.step(&camera).map(|step| {
                    self.shared.lock().untaken.push_back(step);
                }),
                Job::Settle(camera, before) => self.settle(&camera, before).map(|step| {
                    self.shared.lock().answers.extend(step);
                }),
            };
            if let Err(e) = done {
                self.shared.lock().failed = Some(e);
                self.shared.changed.notify_all();
                return;
            }
            self.shared.changed.notify_all();
        }
    }

    /// Waits for something to do; `None` when it is time to end.
    fn next_job(&mut self) -> Option<Job> {
        let shared = Arc::clone(&self.shared);
        let mut state = shared.lock();
        loop {
            if state.stop {
                return None;
            }
            if let Some(camera) = state.asked.pop_front() {
                return Some(Job::Settle(camera, state.untaken.drain(..).collect()));
            }
            if state.untaken.len() < UNTAKEN {
                if let Some(camera) = state.look.take()
                    && self.camera != Some(camera)
                {
                    self.camera = Some(camera);
                    self.settled = false;
                }
                if let (false, Some(camera)) = (self.settled, self.camera) {
                    return Some(Job::Step(camera));
                }
            }
            state = shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn step(&mut self, camera: &Camera) -> Result<Step, WorkerError> {
        let step = catch_unwind(AssertUnwindSafe(|| {
            self.pool.begin();
            self.refine.step(camera, &self.tolerance, &mut self.pool)
        }))
        .map_err(|panic| WorkerError::Panicked(message(&*panic)))?;
        self.settled = step.settled;
        Ok(step)
    }

    /// Steps until settled; `None` when it is time to end.
    fn settle(&mut self, camera: &Camera, before: Vec<Step>) -> Result<Option<Step>, WorkerError> {
        self.camera = Some(*camera);
        let mut merged = Merged::default();
        before.into_iter().for_each(|s| merged.add(s));
        let mut idle = 0;
        loop {
            let step = self.step(camera)?;
            let same = step.uploads.is_empty() && step.drawn == merged.step.drawn;
            idle = if same { idle + 1 } else { 0 };
            merged.add(step);
            if self.settled {
                return Ok(Some(merged.step));
            }
            if idle == IDLE_STEPS {
                return Err(WorkerError::Unsettled(idle));
            }
            if self.shared.lock().stop {
                return Ok(None);
            }
        }
    }
}

/// Steps as one.
#[derive(Default)]
struct Merged {
    step: Step,
    /// Where in the uploads each page is.
    place: HashMap<u32, usize>,
}

impl Merged {
    fn add(&mut self, next: Step) {
        let changed = self.step.leaves_changed.saturating_add(next.leaves_changed);
        for upload in next.uploads {
            match self.place.get(&upload.page) {
                Some(&at) => self.step.uploads[at] = upload,
                None => {
                    self.place.insert(upload.page, self.step.uploads.len());
                    self.step.uploads.push(upload);
                }
            }
        }
        let uploads = std::mem::take(&mut self.step.uploads);
        self.step = Step { uploads, leaves_changed: changed, ..next };
    }
}

fn message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "unknown".into())
}

#[cfg(test)]
mod tests;
