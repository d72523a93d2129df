//! Computes the products asked for: each once, in the order of their needs, side by side where
//! they do not need each other.

use std::sync::atomic::Ordering;
use std::sync::{Condvar, Mutex, MutexGuard, PoisonError};

use super::stages::{PRODUCTS, Product, RunsOn, STAGES, Stage, row};
use super::{Session, SessionError};
use crate::task::{catch_cancelled, checkpoint};

/// Stages that run at once, at most. Each keeps one worker busy while it is serial, so there are
/// never more than there are workers. After the wall there is work for four: its normals, its trees,
/// the space outside it, and the route.
const SIDE_BY_SIDE: usize = 4;

#[derive(Clone, Copy, Debug, Default, PartialEq)]
enum Status {
    #[default]
    Missing,
    Running,
    Ready,
}

/// State of the products: missing, being made or ready.
#[derive(Default)]
pub(super) struct Board {
    state: Mutex<State>,
    changed: Condvar,
}

#[derive(Default)]
struct State {
    status: [Status; PRODUCTS],
    device_busy: bool,
}

impl Board {
    fn lock(&self) -> MutexGuard<'_, State> {
        // Nothing panics while it holds this lock.
        self.state.lock().unwrap_or_else(PoisonError::into_inner)
    }

    pub fn is_ready(&self, product: Product) -> bool {
        self.lock().status[product as usize] == Status::Ready
    }

    /// A product was put in place by hand.
    pub fn mark_ready(&self, product: Product) {
        self.lock().status[product as usize] = Status::Ready;
    }

    /// A product is gone.
    pub fn forget(&self, product: Product) {
        self.lock().status[product as usize] = Status::Missing;
        self.changed.notify_all();
    }

    /// Takes the first row that can start, or waits for one; `None` when all that are needed have
    /// ended or `stop` has an error. A product that nobody asked for is needed until all rows that
    /// need it have ended: a volume that was dropped then is not read again.
    fn take(
        &self,
        plan: &[&'static Stage],
        asked: &[Product],
        stop: &Mutex<Option<SessionError>>,
    ) -> Option<&'static Stage> {
        let mut state = self.lock();
        loop {
            let stopped = stop.lock().unwrap_or_else(PoisonError::into_inner).is_some();
            let status = state.status;
            let ready = |p: &Product| status[*p as usize] == Status::Ready;
            let is_needed = |p: Product| {
                let open = |s: &&Stage| s.needs.contains(&p) && !ready(&s.product);
                asked.contains(&p) || plan.iter().any(open)
            };
            if stopped || plan.iter().all(|s| ready(&s.product) || !is_needed(s.product)) {
                return None;
            }
            let can_start = |s: &&&Stage| {
                status[s.product as usize] == Status::Missing
                    && is_needed(s.product)
                    && s.needs.iter().all(ready)
                    && !(s.runs_on == RunsOn::Device && state.device_busy)
            };
            if let Some(stage) = plan.iter().find(can_start) {
                state.status[stage.product as usize] = Status::Running;
                state.device_busy |= stage.runs_on == RunsOn::Device;
                return Some(stage);
            }
            state = self.changed.wait(state).unwrap_or_else(PoisonError::into_inner);
        }
    }

    fn finish(&self, stage: &Stage, done: bool) {
        let mut state = self.lock();
        state.status[stage.product as usize] = if done { Status::Ready } else { Status::Missing };
        if stage.runs_on == RunsOn::Device {
            state.device_busy = false;
        }
        drop(state);
        self.changed.notify_all();
    }
}

const _: () = assert!(PRODUCTS <= 64, "a bit each in `Session::expected`");

/// Whether the volume is kept for a stage. Only a window asks for the range of values, and it
/// keeps the volume.
fn reads_volume(stage: &Stage) -> bool {
    stage.needs.contains(&Product::Volume) && stage.product != Product::ValueRange
}

impl Session {
    /// Computes these products and what they need, side by side where possible. Asking for one
    /// that is there costs nothing; one that another thread computes is waited for.
    ///
    /// # Errors
    /// The first of the stages' errors; [`SessionError::Cancelled`];
    /// [`SessionError::Unavailable`] before anything is computed, where the settings leave a
    /// product out.
    pub fn prepare(&self, products: &[Product]) -> Result<(), SessionError> {
        let plan = self.plan(products)?;
        self.note_expected(&plan);
        if plan.is_empty() {
            return Ok(());
        }
        self.progress.add(plan.iter().map(|s| s.weight).sum());
        self.run_plan(&plan, products)
    }

    /// Computes products as [`Session::prepare`] does, each group before the next one; progress is
    /// of all of them.
    ///
    /// # Errors
    /// As [`Session::prepare`].
    pub fn prepare_in_order(&self, groups: &[&[Product]]) -> Result<(), SessionError> {
        let plan = self.plan(&groups.concat())?;
        self.note_expected(&plan);
        if !plan.is_empty() {
            self.progress.add(plan.iter().map(|s| s.weight).sum());
        }
        groups.iter().try_for_each(|group| self.run_plan(&self.plan(group)?, group))
    }

    /// Runs stages side by side.
    ///
    /// * `asked`: products that the plan is for.
    fn run_plan(&self, plan: &[&'static Stage], asked: &[Product]) -> Result<(), SessionError> {
        let error = Mutex::new(None);
        let lanes = self.pool.current_num_threads().min(SIDE_BY_SIDE).min(plan.len());
        std::thread::scope(|scope| {
            for _ in 1..lanes {
                scope.spawn(|| self.work(plan, asked, &error));
            }
            self.work(plan, asked, &error);
        });
        error.into_inner().unwrap_or_else(PoisonError::into_inner).map_or(Ok(()), Err)
    }

    /// Announces products that will be asked for: memory is estimated once the lumen is there, with all
    /// of them. Those that the settings leave out are passed over.
    pub fn expect(&self, products: &[Product]) {
        for product in products {
            if let Ok(plan) = self.plan(&[*product]) {
                self.note_expected(&plan);
            }
        }
    }

    fn note_expected(&self, plan: &[&'static Stage]) {
        let bits = plan.iter().fold(0, |bits, s| bits | 1u64 << s.product as u32);
        self.expected.fetch_or(bits, Ordering::Relaxed);
    }

    /// Whether a product was asked for, or will be.
    pub(super) fn expects(&self, product: Product) -> bool {
        self.expected.load(Ordering::Relaxed) >> product as u32 & 1 == 1
    }

    /// Rows to be run, in the order of the table.
    fn plan(&self, products: &[Product]) -> Result<Vec<&'static Stage>, SessionError> {
        let mut wanted = [false; PRODUCTS];
        let mut open: Vec<Product> = products.to_vec();
        let mut plan: Vec<&'static Stage> = Vec::new();
        while let Some(product) = open.pop() {
            if wanted[product as usize] || self.board.is_ready(product) {
                continue;
            }
            wanted[product as usize] = true;
            let stage = row(product, &self.settings)?;
            open.extend(stage.needs);
            plan.push(stage);
        }
        let place = |s: &&'static Stage| STAGES.iter().position(|t| std::ptr::eq(t, *s));
        plan.sort_by_key(place);
        Ok(plan)
    }

    /// Runs stages of a plan until there are none left or one has failed.
    fn work(
        &self,
        plan: &[&'static Stage],
        asked: &[Product],
        error: &Mutex<Option<SessionError>>,
    ) {
        while let Some(stage) = self.board.take(plan, asked, error) {
            let outcome = self.run_stage(stage);
            if let Err(e) = &outcome {
                tracing::debug!("{}: {e}", stage.name);
            }
            let done = outcome.is_ok();
            if let Err(e) = outcome {
                error.lock().unwrap_or_else(PoisonError::into_inner).get_or_insert(e);
            }
            self.board.finish(stage, done);
            if done && reads_volume(stage) {
                self.release_volume();
            }
            if let Some(wake) = self.wake.as_ref().filter(|_| done) {
                wake();
            }
        }
    }

    /// One stage on a worker of the pool, serial parts included.
    fn run_stage(&self, stage: &Stage) -> Result<(), SessionError> {
        if self.cancel.is_cancelled() {
            return Err(SessionError::Cancelled);
        }
        self.progress.begin(stage.name, stage.weight);
        let mut clock = self.clock().fork();
        let outcome = self.pool.install(|| {
            catch_cancelled(|| {
                checkpoint();
                (stage.run)(self, &mut clock)
            })
        });
        self.clock().merge(clock);
        self.progress.end(stage.name, stage.weight);
        outcome.unwrap_or(Err(SessionError::Cancelled))
    }

    /// Drops the volume once every product that reads it is there, and its samples once no more of
    /// them are read. One that is asked for later is read again and kept until another reader ends.
    pub(super) fn release_volume(&self) {
        if self.keep_volume {
            return;
        }
        let used = STAGES.iter().filter(|s| (s.when)(&self.settings));
        // Few sessions look behind the wall.
        let is_wanted = |s: &&Stage| s.product != Product::Behind || self.settings.shows_tissue();
        let mut readers = used.filter(is_wanted).filter(|s| reads_volume(s));
        if readers.all(|s| self.board.is_ready(s.product)) {
            self.forget_one(Product::Volume);
        } else if self.board.is_ready(Product::Identity) || !self.expects(Product::Identity) {
            self.release_samples();
        }
    }
}
