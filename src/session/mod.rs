//! A [`Session`] takes a volume to everything that can be made of it: lumen, distance, centerline,
//! wall, flight, frames, coverage, report.
//!
//! Each result is a *product*. Asking for one is a function call that returns it or a typed error;
//! what it needs is computed first, side by side where possible, and kept. [`stages::STAGES`] is
//! the table of what needs what. Everything runs on one pool of threads. [`Session::progress`]
//! can be read, and a [`CancelToken`] cancelled, from any thread at any time.

mod centering;
mod clock;
pub mod copy_rate;
mod coverage;
mod error;
mod fields;
mod flight;
mod folder;
mod frames;
mod level_cache;
pub mod levels;
mod load;
mod memory;
mod progress;
mod report;
mod scheduler;
mod search;
mod segmentation;
mod settings;
pub mod stages;
mod surface;
mod writer;

pub use crate::task::CancelToken;
pub use centering::{Centered, Visibility};
pub use clock::{Clock, KernelTime, StageTime};
pub use error::SessionError;
pub use fields::{Fields, GreyHessian, HessianSettings, grey_hessian};
pub use folder::{REPORT_FILE, Recording};
pub use frames::{DrawnFrame, FrameStream};
pub use levels::{Levels, LodReport};
pub use load::{read_any_volume, read_orthogonal_volume};
pub use memory::{estimate_bytes, peak_memory_mb, refuse_above};
pub use progress::Progress;
pub use report::{
    CenterlineReport, ComponentReport, CoverageReport, FramesReport, InputReport, LumenReport,
    Modes, OrganReport, PatchReport, Report, SegmentReport, SurfaceReport, WallFieldReport,
    WallReport,
};
pub use search::Exterior;
pub use segmentation::{Core, Segmented};
pub use settings::{
    CenterlineSettings, FlightRoute, FlightSettings, LevelSettings, Lod, LumenSettings, Seed,
    Settings, Source, VolumeSource, WallMethod, WallSettings,
};
pub use stages::Product;
pub use surface::{DrawnWall, Wall, gradient_normals, smoothed_normals, without_caps};
pub use writer::FrameWriter;

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};

use crate::compute::Array;
use crate::device::Device;
use crate::flight::{Coverage, Flight, SectionFigures, WallIndex};
use crate::geometry::{Mesh, TriangleBvh};
use crate::surface::Shading;

use frames::Display;
use levels::BuiltClusters;
use load::{Inputs, Loaded};
use progress::ProgressState;
use scheduler::Board;

/// What the chain follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// What is right.
    #[default]
    Default,
    /// What the paper (Li et al. 2004) says, errors and all.
    Paper,
}

/// The device that plans run on, with what can be known of it without waiting for its work.
pub struct OpenDevice {
    device: Mutex<Device>,
    /// `cpu`, or what the driver calls it.
    pub name: String,
    /// Whether it is a Vulkan device.
    pub is_gpu: bool,
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

/// The products that are there.
#[derive(Default)]
struct Slots {
    volume: Slot<Loaded>,
    device: Slot<OpenDevice>,
    identity: Slot<String>,
    inputs: Slot<Inputs>,
    core: Slot<Core>,
    lumen: Slot<Segmented>,
    distance: Slot<Array<f32>>,
    fields: Slot<Fields>,
    route: Slot<crate::centerline::Routed>,
    visibility: Slot<Visibility>,
    centerline: Slot<Centered>,
    wall: Slot<Wall>,
    drawn_wall: Slot<DrawnWall>,
    shading: Slot<Shading>,
    triangle_tree: Slot<TriangleBvh>,
    drawn_tree: Slot<TriangleBvh>,
    wall_index: Slot<WallIndex>,
    exterior: Slot<Exterior>,
    clusters: Slot<BuiltClusters>,
    levels: Slot<Levels>,
    flight: Slot<Flight>,
    display: Slot<Display>,
    coverage: Slot<Coverage>,
    sections: Slot<Vec<Option<SectionFigures>>>,
    base: Slot<Mesh>,
}

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
}

/// The mutexes here guard whole values: one that panicked while it held a lock left it whole.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

fn put<T>(slot: &Slot<T>, value: impl Into<Arc<T>>) {
    *locked(slot) = Some(value.into());
}

/// A product that the table says is there.
fn present<T>(slot: &Slot<T>) -> Arc<T> {
    locked(slot).clone().expect("the table of stages names every need")
}

macro_rules! products {
    ($($(#[$doc:meta])* $get:ident: $slot:ident, $product:ident, $kind:ty;)*) => {
        impl Session {
            $($(#[$doc])*
            ///
            /// # Errors
            /// What its stages fail with; [`SessionError::Cancelled`];
            /// [`SessionError::Unavailable`] where the settings leave it out.
            pub fn $get(&self) -> Result<Arc<$kind>, SessionError> {
                self.product(Product::$product, &self.slots.$slot)
            })*
        }
    };
}

products! {
    /// The mask that decides which lumen is meant.
    core: core, Core, Core;
    /// The lumen in bricks, with what choosing it found.
    lumen: lumen, Lumen, Segmented;
    /// Exact distance to the nearest external voxel centre, mm, in slot order of the lumen.
    distance: distance, Distance, Array<f32>;
    /// Distance and smoothed distance, in paper mode ridge candidates too.
    fields: fields, Fields, Fields;
    /// Path or tree, centred and proven inside, with the visibility test.
    centerline: centerline, Centerline, Centered;
    /// BLAKE3 of the samples of the volume the lumen is chosen from, in hexadecimal.
    identity: identity, Identity, String;
    /// The wall with smoothed normals, LPS mm.
    wall: wall, Wall, Wall;
    /// The wall's triangles by place: for rays, nearest points and planes.
    triangle_tree: triangle_tree, TriangleTree, TriangleBvh;
    /// The wall's triangles in buckets: for distances up to a limit.
    wall_index: wall_index, WallIndex, WallIndex;
    /// Space outside the wall, where it is watertight.
    exterior: exterior, Exterior, Exterior;
    /// The wall at many levels of detail.
    levels: levels, Levels, Levels;
    /// Poses of the flight along the first path.
    flight: flight, Flight, Flight;
    /// What the frames of the flight saw of the wall, weighted by area.
    coverage: coverage, Coverage, Coverage;
    /// Cross-sections of the lumen along the flight, one a pose.
    sections: sections, Sections, Vec<Option<SectionFigures>>;
    /// The wall with few faces.
    base: base, Base, Mesh;
}

impl Session {
    /// A session. Nothing is read or computed until a product is asked for.
    ///
    /// # Errors
    /// [`SessionError::System`] if the system gives no threads.
    pub fn new(source: Source, settings: Settings) -> Result<Self, SessionError> {
        let cancel = CancelToken::default();
        let entered = cancel.clone();
        let pool = rayon::ThreadPoolBuilder::new()
            .num_threads(settings.threads.unwrap_or(0))
            .thread_name(|i| format!("worker {i}"))
            .start_handler(move |_| entered.enter())
            .build()
            .map_err(|e| SessionError::System(e.to_string()))?;
        Ok(Self {
            source,
            settings,
            pool: Arc::new(pool),
            cancel,
            progress: ProgressState::default(),
            clock: Mutex::default(),
            board: Board::default(),
            slots: Slots::default(),
            keep_volume: false,
        })
    }

    /// A session of the same inputs that follows another mode: shares threads, device, volume and
    /// core with this one.
    pub fn in_mode(&self, mode: Mode) -> Self {
        let other = Self {
            source: self.source.clone(),
            settings: Settings { mode, ..self.settings.clone() },
            pool: Arc::clone(&self.pool),
            cancel: self.cancel.clone(),
            progress: ProgressState::default(),
            clock: Mutex::default(),
            board: Board::default(),
            slots: Slots::default(),
            keep_volume: self.keep_volume,
        };
        fn share<T>(from: &Session, to: &Session, slot: fn(&Slots) -> &Slot<T>, product: Product) {
            if let Some(value) = locked(slot(&from.slots)).clone() {
                put(slot(&to.slots), value);
                to.board.mark_ready(product);
            }
        }
        share(self, &other, |s| &s.volume, Product::Volume);
        share(self, &other, |s| &s.device, Product::Device);
        share(self, &other, |s| &s.identity, Product::Identity);
        share(self, &other, |s| &s.inputs, Product::Inputs);
        share(self, &other, |s| &s.core, Product::Core);
        other
    }

    /// The settings.
    pub fn settings(&self) -> &Settings {
        &self.settings
    }

    /// How far the present work has come.
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

    /// The device that plans run on.
    ///
    /// # Errors
    /// As [`Device::open`].
    pub fn device(&self) -> Result<Arc<OpenDevice>, SessionError> {
        self.product(Product::Device, &self.slots.device)
    }

    /// The volume the lumen is chosen from: the image, or the label map on the image's grid.
    ///
    /// # Errors
    /// As [`crate::formats::read_volume`]; [`SessionError::ShearedGrid`].
    pub fn volume(&self) -> Result<Arc<crate::volume::Volume>, SessionError> {
        let loaded = self.product(Product::Volume, &self.slots.volume)?;
        Ok(Arc::clone(&loaded.volume))
    }

    /// Keeps the volume even when every product that reads it is there, so that products can be
    /// computed again without reading it.
    pub fn keep_volume(&mut self) {
        self.keep_volume = true;
    }

    /// Drops these products and everything made from them; the next call computes them anew.
    pub fn forget(&mut self, products: &[Product]) {
        let mut gone = products.to_vec();
        // Rows stand below what they need, so one pass finds all that follows.
        for stage in stages::STAGES.iter().filter(|s| (s.when)(&self.settings)) {
            let lost = stage.needs.iter().any(|n| gone.contains(n));
            if lost && !gone.contains(&stage.product) {
                gone.push(stage.product);
            }
        }
        if gone.contains(&Product::Fields) {
            gone.push(Product::Distance);
        }
        gone.iter().for_each(|p| self.forget_one(*p));
    }

    /// Begins a new clock.
    pub fn restart_clock(&mut self) -> Clock {
        std::mem::take(&mut *self.clock())
    }

    /// What a user should know of how the products came out.
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
        let slots = &self.slots;
        match product {
            Product::Volume => drop(locked(&slots.volume).take()),
            Product::Device => drop(locked(&slots.device).take()),
            Product::Identity => drop(locked(&slots.identity).take()),
            Product::Inputs => drop(locked(&slots.inputs).take()),
            Product::Core => drop(locked(&slots.core).take()),
            Product::Lumen => drop(locked(&slots.lumen).take()),
            Product::Distance => drop(locked(&slots.distance).take()),
            Product::Fields => drop(locked(&slots.fields).take()),
            Product::Route => drop(locked(&slots.route).take()),
            Product::Visibility => drop(locked(&slots.visibility).take()),
            Product::Centerline => drop(locked(&slots.centerline).take()),
            Product::Wall => drop(locked(&slots.wall).take()),
            Product::DrawnWall => drop(locked(&slots.drawn_wall).take()),
            Product::Shading => drop(locked(&slots.shading).take()),
            Product::TriangleTree => drop(locked(&slots.triangle_tree).take()),
            Product::DrawnTree => drop(locked(&slots.drawn_tree).take()),
            Product::WallIndex => drop(locked(&slots.wall_index).take()),
            Product::Exterior => drop(locked(&slots.exterior).take()),
            Product::Clusters => drop(locked(&slots.clusters).take()),
            Product::Levels => drop(locked(&slots.levels).take()),
            Product::Flight => drop(locked(&slots.flight).take()),
            Product::Display => drop(locked(&slots.display).take()),
            Product::Coverage => drop(locked(&slots.coverage).take()),
            Product::Sections => drop(locked(&slots.sections).take()),
            Product::Base => drop(locked(&slots.base).take()),
        }
        self.board.forget(product);
    }

    fn run_device(&self, _: &mut Clock) -> Result<(), SessionError> {
        let device = Device::open(self.settings.device)?;
        tracing::info!("computing on {}", device.name());
        let (name, is_gpu) = (device.name().to_owned(), device.info().is_some());
        put(&self.slots.device, OpenDevice { device: Mutex::new(device), name, is_gpu });
        Ok(())
    }
}
