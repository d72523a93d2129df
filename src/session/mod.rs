//! A [`Session`] takes a volume to everything that can be made of it: lumen, distance, centerline,
//! wall, flight, frames, coverage, report.
//!
//! Each result is a *product*. Asking for one is a function call that returns it or a typed error;
//! what it needs is computed first, side by side where possible, and kept. The table in
//! [`stages`] has them all, with what needs what. Everything runs on one pool of threads. [`Session::progress`]
//! can be read, and a [`CancelToken`] cancelled, from any thread at any time. [`Session::apply`]
//! takes other settings and forgets what depends on them; a program that must not wait reads
//! [`Session::products`] when [`Session::wake_by`] has it woken.

mod behind;
mod centering;
mod clock;
pub mod copy_rate;
mod coverage;
mod date;
mod error;
mod fields;
mod flight;
mod folder;
mod folder_lock;
mod frames;
pub mod levels;
mod load;
mod memory;
mod mode;
mod paper;
mod pictures;
mod progress;
mod report;
mod scheduler;
mod search;
mod segmentation;
mod settings;
mod settings_check;
pub mod stages;
mod surface;
mod writer;

pub use crate::task::CancelToken;
pub use centering::{Centered, Visibility};
pub use clock::{Clock, KernelTime, StageTime};
pub use error::SessionError;
pub use fields::{Fields, GreyHessian, HessianSettings, grey_hessian};
pub use folder::{PAGE_FILE, REPORT_FILE, RUN_FILES, Recording, RunOutcome};
pub use frames::{DrawnFrame, FrameStream};
pub use levels::{Levels, LodReport, WallForm};
pub use load::{IN_PARTS_ABOVE, read_any_volume, read_orthogonal_volume};
pub use memory::{
    MeshWork, converting_bytes, gradient_bytes, mesh_bytes, peak_memory_mb, reading_bytes,
    refuse_above, resident_memory_mb,
};
pub use mode::Mode;
pub use pictures::{InsidePicture, OverviewPicture, PngPicture, ReportPictures};
pub use progress::Progress;
pub use report::{
    CenterlineReport, ComponentReport, CoverageReport, CoveredFlight, FramesReport, InputReport,
    LumenReport, OrganReport, PatchReport, Report, SegmentReport, SelectionReport, SurfaceReport,
    WallFieldReport, WallReport,
};
pub use search::Exterior;
pub use segmentation::{Core, Segmented};
pub use settings::{
    Antialiasing, CenterlineSettings, EndPoint, FlightRoute, FlightSettings, LevelSettings, Lod,
    LumenSettings, Reading, Seed, Settings, Source, VolumeSource, WallMethod, WallSettings,
};
pub use settings_check::{SettingError, check_frame_rate, check_frame_size};
pub use stages::{Product, Products, kernels};
pub use surface::{ShownWall, Wall, gradient_normals, smoothed_normals, written_mesh};
pub use writer::{FrameWriter, Stamp, is_frame_file};

use std::sync::atomic::AtomicU64;
use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::device::Device;
use crate::vk::return_freed_memory;

use folder_lock::FolderLocks;
use progress::ProgressState;
use scheduler::Board;
use stages::Slots;

/// The device that plans run on, with what can be known of it without waiting for its work.
pub struct OpenDevice {
    device: Mutex<Device>,
    /// `cpu`, or what the driver calls it.
    pub name: String,
    /// Whether it can draw too.
    pub draws: bool,
    /// Whether it is a GPU, and not the CPU or software Vulkan.
    pub is_real_gpu: bool,
}

impl OpenDevice {
    /// The device itself. Waits while a stage runs on it, so only stages that run on the device
    /// may ask from inside the pool: a worker that waits here may hold parts of that stage.
    pub fn lock(&self) -> MutexGuard<'_, Device> {
        locked(&self.device)
    }
}

/// A place for one product.
type Slot<T> = Mutex<Option<Arc<T>>>;

/// Says on any thread that there is something new.
type Waker = Box<dyn Fn() + Send + Sync>;

/// Drives every stage from a volume to frames; see the [module](self).
pub struct Session {
    source: Source,
    settings: Settings,
    pool: Arc<rayon::ThreadPool>,
    cancel: CancelToken,
    progress: ProgressState,
    clock: Mutex<Clock>,
    board: Board,
    slots: Slots,
    keep_volume: bool,
    /// Products that were asked for so far, or will be: a bit each, for the estimate of memory.
    expected: AtomicU64,
    /// Called when a product is there.
    wake: Option<Waker>,
    /// Folders that this session is writing a run into.
    folders: Mutex<FolderLocks>,
}

/// The mutexes here guard whole values: one that panicked while it held a lock left it whole.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn put<T>(slot: &Slot<T>, value: impl Into<Arc<T>>) {
    *locked(slot) = Some(value.into());
}

/// The threads of a session.
///
/// # Errors
/// [`SessionError::System`] if the system gives none.
fn pool(
    threads: Option<usize>,
    cancel: &CancelToken,
) -> Result<Arc<rayon::ThreadPool>, SessionError> {
    let entered = cancel.clone();
    rayon::ThreadPoolBuilder::new()
        .num_threads(threads.unwrap_or(0))
        .thread_name(|i| format!("worker {i}"))
        .start_handler(move |_| entered.enter())
        .build()
        .map(Arc::new)
        .map_err(|e| SessionError::System(e.to_string()))
}

impl Products {
    /// The volume the lumen is chosen from; `None` also where it is read in parts.
    pub fn volume(&self) -> Option<&Arc<crate::volume::Volume>> {
        self.loaded.as_ref().and_then(|loaded| loaded.volume.whole())
    }
}

/// A product that the table says is there.
fn present<T>(slot: &Slot<T>) -> Arc<T> {
    locked(slot).clone().expect("the table of stages names every need")
}

impl Session {
    /// A session. Nothing is read or computed until a product is asked for.
    ///
    /// # Errors
    /// [`SessionError::Setting`] for a setting out of its range, [`SessionError::System`] if the
    /// system gives no threads.
    pub fn new(source: Source, settings: Settings) -> Result<Self, SessionError> {
        settings.check()?;
        let cancel = CancelToken::default();
        let pool = pool(settings.threads, &cancel)?;
        Ok(Self::on_pool(source, settings, pool, cancel))
    }

    /// Runs work on the threads of the session: parallel work elsewhere would start one thread for each
    /// core beside them.
    pub fn install<T: Send>(&self, work: impl FnOnce() -> T + Send) -> T {
        self.pool.install(work)
    }

    fn on_pool(
        source: Source,
        settings: Settings,
        pool: Arc<rayon::ThreadPool>,
        cancel: CancelToken,
    ) -> Self {
        Self {
            source,
            settings,
            pool,
            cancel,
            progress: ProgressState::default(),
            clock: Mutex::default(),
            board: Board::default(),
            slots: Slots::default(),
            keep_volume: false,
            expected: AtomicU64::new(0),
            wake: None,
            folders: Mutex::default(),
        }
    }

    /// A session of the same inputs that follows another mode: shares threads, device and all
    /// products that do not depend on the mode with this one. It draws with a renderer of its own.
    pub fn in_mode(&self, mode: Mode) -> Self {
        let settings = Settings { mode, ..self.settings.clone() };
        let stale = stages::stale(&self.settings, &settings);
        let (pool, cancel) = (Arc::clone(&self.pool), self.cancel.clone());
        let mut other = Self::on_pool(self.source.clone(), settings, pool, cancel);
        other.keep_volume = self.keep_volume;
        let is_shared = |p: &&Product| **p != Product::Display && !stale.contains(p);
        for product in Product::ALL.iter().filter(is_shared) {
            if other.slots.share(&self.slots, *product) {
                other.board.mark_ready(*product);
            }
        }
        other
    }

    /// Changes the settings, and forgets exactly the products that other settings make otherwise
    /// or not at all. The volume is not read again.
    ///
    /// # Errors
    /// Those of [`Self::new`]; then nothing is changed.
    pub fn apply(&mut self, settings: Settings) -> Result<(), SessionError> {
        settings.check()?;
        if settings.threads != self.settings.threads {
            self.pool = pool(settings.threads, &self.cancel)?;
        }
        let stale = stages::stale(&self.settings, &settings);
        self.settings = settings;
        stale.iter().for_each(|p| self.forget_one(*p));
        Ok(())
    }

    /// Changes the volumes, and forgets everything that was made from those before.
    pub fn set_source(&mut self, source: Source) {
        self.source = source;
        self.forget(&[Product::Volume]);
    }

    /// The volumes.
    pub fn source(&self) -> &Source {
        &self.source
    }

    /// Has a function called whenever a product is there, on the thread that made it. It says no
    /// more than that: [`Session::products`] reads what there is.
    pub fn wake_by(&mut self, wake: impl Fn() + Send + Sync + 'static) {
        self.wake = Some(Box::new(wake));
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// Returns the progress of the present work.
    pub fn progress(&self) -> Progress {
        self.progress.read()
    }

    /// Cancels work of this session from any thread; calls then end with
    /// [`SessionError::Cancelled`]. [`CancelToken::reset`] lets it go on.
    pub fn cancel_token(&self) -> CancelToken {
        self.cancel.clone()
    }

    /// Stages that ran, with their times.
    pub fn clock(&self) -> MutexGuard<'_, Clock> {
        locked(&self.clock)
    }

    /// Name of the device that plans run on.
    ///
    /// # Errors
    /// As [`Device::open`].
    pub fn device_name(&self) -> Result<String, SessionError> {
        Ok(self.device()?.name.clone())
    }

    /// The volume the lumen is chosen from: the image, or the label map on the image's grid. Where it
    /// is read in parts, this reads all of it.
    ///
    /// # Errors
    /// As [`crate::formats::read_volume`]; [`SessionError::ShearedGrid`].
    pub fn volume(&self) -> Result<Arc<crate::volume::Volume>, SessionError> {
        self.whole(&*self.loaded()?)
    }

    /// Keeps the volume even when every product that reads it is there, so that products can be
    /// computed again without reading it. It is read as a whole then.
    pub fn keep_volume(&mut self) {
        self.keep_volume = true;
    }

    /// Drops these products and everything made from them; the next call computes them anew.
    pub fn forget(&mut self, products: &[Product]) {
        let mut gone = stages::with_dependents(products.to_vec(), &self.settings);
        if gone.contains(&Product::Fields) {
            gone.push(Product::Distance);
        }
        gone.iter().for_each(|p| self.forget_one(*p));
    }

    /// Drops these products; products made from them stay.
    fn release(&self, products: &[Product]) {
        products.iter().for_each(|p| self.forget_one(*p));
        return_freed_memory();
    }

    /// Begins a new clock.
    pub fn restart_clock(&mut self) -> Clock {
        std::mem::take(&mut *self.clock())
    }

    /// Returns the notes on the products that a user should know.
    pub fn warnings(&self) -> Vec<String> {
        let mut out = Vec::new();
        if let Some(lumen) = locked(&self.slots.lumen).as_deref() {
            out.extend(lumen.notes.iter().cloned());
        }
        if let Some(wall) = locked(&self.slots.wall).as_deref() {
            out.extend(wall.notes());
        }
        if let Some(centered) = locked(&self.slots.centerline).as_deref() {
            out.extend(centered.notes());
        }
        out
    }

    fn product<T>(&self, product: Product, slot: &Slot<T>) -> Result<Arc<T>, SessionError> {
        loop {
            if let Some(value) = locked(slot).clone() {
                return Ok(value);
            }
            // Another thread may forget it in between.
            self.prepare(&[product])?;
        }
    }

    fn forget_one(&self, product: Product) {
        self.slots.forget(product);
        self.board.forget(product);
    }

    fn run_device(&self, _: &mut Clock) -> Result<OpenDevice, SessionError> {
        let device = Device::open(self.settings.device)?;
        tracing::info!("computing on {}", device.name());
        let (name, info) = (device.name().to_owned(), device.info());
        let draws = info.is_some_and(|i| i.draws);
        let is_real_gpu = info.is_some_and(|i| i.is_real());
        Ok(OpenDevice { device: Mutex::new(device), name, draws, is_real_gpu })
    }
}
