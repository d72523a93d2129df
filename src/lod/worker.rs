//! The worker thread that owns the level-of-detail hierarchy of a surface and its page cache.
//!
//! Live mode: [`Worker::set_camera`] replaces the camera and [`Worker::try_recv`] returns finished
//! steps; neither waits, and only the newest camera counts. Capture mode: [`Worker::request`]
//! queues a camera and [`Worker::recv`] waits for its settled cut. Steps are delivered in the order
//! in which they were made and none is dropped, since each relies on the page contents that the
//! ones before it wrote.

use std::collections::{HashMap, VecDeque};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::{Arc, Condvar, Mutex, MutexGuard, PoisonError};
use std::thread::JoinHandle;

use super::{LodHierarchy, LodStep, PAGE_BYTES, PageCache, Tolerance};
use crate::geometry::Camera;

/// Finished live steps that may be queued; the thread pauses until one is received.
const MAX_PENDING: usize = 2;
/// Consecutive steps that change nothing while the cut is not settled, after which a request fails.
/// Frames in flight release their pages in far fewer.
const MAX_IDLE_STEPS: u32 = 1000;

/// Why there are no more steps.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum WorkerError {
    /// The system could not start the thread.
    #[error("no thread for level of detail ({0})")]
    NoThread(String),
    /// The hierarchy panicked; the worker has ended.
    #[error("level of detail failed: {0}")]
    Panicked(String),
    /// A requested cut did not settle.
    #[error("level of detail did not settle: {0} steps in a row changed nothing")]
    Unsettled(u32),
}

/// A thread that owns an [`LodHierarchy`] and its [`PageCache`].
pub struct Worker {
    shared: Arc<Shared>,
    thread: Option<JoinHandle<()>>,
    outstanding: usize,
    finest_faces: u64,
}

#[derive(Default)]
struct Shared {
    state: Mutex<WorkerState>,
    changed: Condvar,
}

#[derive(Default)]
struct WorkerState {
    camera: Option<Camera>,
    pending: VecDeque<LodStep>,
    requests: VecDeque<Camera>,
    replies: VecDeque<LodStep>,
    stop: bool,
    failed: Option<WorkerError>,
}

impl Shared {
    // Panics are caught before they unwind through a lock; a poisoned state is still consistent.
    fn lock(&self) -> MutexGuard<'_, WorkerState> {
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Worker {
    /// Starts the thread.
    ///
    /// * `pages`: capacity of the page cache.
    /// * `upload_bytes`: most bytes of pages written in one step; at least one page is.
    /// * `in_flight`: steps whose frames may still be running; at least 1, so that no step
    ///   overwrites what the step before it draws.
    ///
    /// # Errors
    /// [`WorkerError::NoThread`].
    pub fn spawn(
        hierarchy: Box<dyn LodHierarchy>,
        tolerance: Tolerance,
        pages: u32,
        upload_bytes: u64,
        in_flight: u32,
    ) -> Result<Self, WorkerError> {
        let uploads = (upload_bytes / PAGE_BYTES).clamp(1, u64::from(u32::MAX)) as u32;
        let finest_faces = hierarchy.finest_faces();
        let shared = Arc::new(Shared::default());
        let mut worker = WorkerThread {
            hierarchy,
            tolerance,
            cache: PageCache::new(pages, uploads, in_flight.max(1)),
            shared: Arc::clone(&shared),
            camera: None,
            settled: true,
        };
        let thread = std::thread::Builder::new()
            .name("detail".into())
            .spawn(move || worker.run())
            .map_err(|e| WorkerError::NoThread(e.to_string()))?;
        Ok(Self { shared, thread: Some(thread), outstanding: 0, finest_faces })
    }

    /// Faces of the whole surface at its finest.
    pub fn finest_faces(&self) -> u64 {
        self.finest_faces
    }

    /// Sets the camera of the live mode. Never waits; a camera that was not processed yet is
    /// replaced.
    pub fn set_camera(&mut self, camera: &Camera) {
        self.shared.lock().camera = Some(*camera);
        self.shared.changed.notify_all();
    }

    /// Receives the oldest finished live step, if there is one. Never waits. While requests are
    /// outstanding there are none: their replies include them.
    ///
    /// # Errors
    /// [`WorkerError::Panicked`], once all steps made before it have been received.
    pub fn try_recv(&mut self) -> Result<Option<LodStep>, WorkerError> {
        if self.outstanding > 0 {
            return Ok(None);
        }
        let mut state = self.shared.lock();
        let step = state.pending.pop_front();
        match (step, &state.failed) {
            (None, Some(e)) => Err(e.clone()),
            (step, _) => {
                self.shared.changed.notify_all();
                Ok(step)
            }
        }
    }

    /// Requests the settled cut of a camera without waiting. Requests are served in order, each by
    /// as many steps as it needs.
    pub fn request(&mut self, camera: Camera) {
        self.outstanding += 1;
        self.shared.lock().requests.push_back(camera);
        self.shared.changed.notify_all();
    }

    /// Requests that were not received yet.
    pub fn outstanding(&self) -> usize {
        self.outstanding
    }

    /// Waits for the reply to the oldest request: all its steps, and live ones before them, merged
    /// into one that writes each page at most once.
    ///
    /// # Errors
    /// [`WorkerError::Panicked`], [`WorkerError::Unsettled`].
    ///
    /// # Panics
    /// If no request is outstanding.
    pub fn recv(&mut self) -> Result<LodStep, WorkerError> {
        assert!(self.outstanding > 0, "recv needs an outstanding request");
        self.outstanding -= 1;
        let mut state = self.shared.lock();
        loop {
            if let Some(step) = state.replies.pop_front() {
                return Ok(step);
            }
            if let Some(e) = &state.failed {
                self.outstanding = 0;
                return Err(e.clone());
            }
            state = self.shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    /// Requests the settled cut of a camera and waits for it. Replies to earlier requests are
    /// merged into the result.
    ///
    /// # Errors
    /// As [`Worker::recv`].
    pub fn converge(&mut self, camera: Camera) -> Result<LodStep, WorkerError> {
        self.request(camera);
        let mut merged = MergedSteps::default();
        while self.outstanding > 0 {
            merged.add(self.recv()?);
        }
        Ok(merged.step)
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.shared.lock().stop = true;
        self.shared.changed.notify_all();
        if let Some(thread) = self.thread.take() {
            // The thread catches its panics and reports them; the join result holds nothing more.
            let _ = thread.join();
        }
    }
}

/// State of the thread.
struct WorkerThread {
    hierarchy: Box<dyn LodHierarchy>,
    tolerance: Tolerance,
    cache: PageCache,
    shared: Arc<Shared>,
    camera: Option<Camera>,
    settled: bool,
}

enum Job {
    LodStep(Camera),
    Settle(Camera, Vec<LodStep>),
}

impl WorkerThread {
    fn run(&mut self) {
        while let Some(job) = self.next_job() {
            let done = match job {
                Job::LodStep(camera) => self.step(&camera).map(|step| {
                    self.shared.lock().pending.push_back(step);
                }),
                Job::Settle(camera, before) => self.settle(&camera, before).map(|step| {
                    self.shared.lock().replies.extend(step);
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

    /// Waits for the next job; `None` when the worker is dropped.
    fn next_job(&mut self) -> Option<Job> {
        let shared = Arc::clone(&self.shared);
        let mut state = shared.lock();
        loop {
            if state.stop {
                return None;
            }
            if let Some(camera) = state.requests.pop_front() {
                return Some(Job::Settle(camera, state.pending.drain(..).collect()));
            }
            if state.pending.len() < MAX_PENDING {
                if let Some(camera) = state.camera.take()
                    && self.camera != Some(camera)
                {
                    self.camera = Some(camera);
                    self.settled = false;
                }
                if let (false, Some(camera)) = (self.settled, self.camera) {
                    return Some(Job::LodStep(camera));
                }
            }
            state = shared.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn step(&mut self, camera: &Camera) -> Result<LodStep, WorkerError> {
        let step = catch_unwind(AssertUnwindSafe(|| {
            self.cache.begin_step();
            self.hierarchy.step(camera, &self.tolerance, &mut self.cache)
        }))
        .map_err(|panic| WorkerError::Panicked(panic_message(&*panic)))?;
        self.settled = step.settled;
        Ok(step)
    }

    /// Steps until the cut is settled; `None` when the worker is dropped.
    fn settle(
        &mut self,
        camera: &Camera,
        before: Vec<LodStep>,
    ) -> Result<Option<LodStep>, WorkerError> {
        self.camera = Some(*camera);
        let mut merged = MergedSteps::default();
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
            if idle == MAX_IDLE_STEPS {
                return Err(WorkerError::Unsettled(idle));
            }
            if self.shared.lock().stop {
                return Ok(None);
            }
        }
    }
}

/// Several steps merged into one.
#[derive(Default)]
struct MergedSteps {
    step: LodStep,
    /// Index of each page in the uploads.
    upload_at: HashMap<u32, usize>,
}

impl MergedSteps {
    fn add(&mut self, next: LodStep) {
        let changed = self.step.leaves_changed.saturating_add(next.leaves_changed);
        for upload in next.uploads {
            match self.upload_at.get(&upload.page) {
                Some(&at) => self.step.uploads[at] = upload,
                None => {
                    self.upload_at.insert(upload.page, self.step.uploads.len());
                    self.step.uploads.push(upload);
                }
            }
        }
        let uploads = std::mem::take(&mut self.step.uploads);
        self.step = LodStep { uploads, leaves_changed: changed, ..next };
    }
}

fn panic_message(panic: &(dyn std::any::Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(|s| (*s).to_owned());
    text.or_else(|| panic.downcast_ref::<String>().cloned()).unwrap_or_else(|| "unknown".into())
}

#[cfg(test)]
mod tests;
