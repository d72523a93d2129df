//! The device and every Vulkan resource, under one owner.

use std::cell::Cell;
use std::mem::ManuallyDrop;
use std::ops::Deref;
use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use ash::vk;
use slotmap::SlotMap;

use super::cache::Cache;
use super::commands::Commands;
use super::counts::PlanCounts;
use super::draw_pipeline::DrawPipeline;
use super::ids::ResourceId;
use super::info::{self, Choice, DeviceInfo};
use super::instance::{Instance, Validate};
use super::memory::{Buffer, Memory};
use super::pipeline::ComputePipelines;
use super::plan_memory::Arena;
use super::plan_pools::PlanPools;
use super::presentation::{PresentationSurface, Presenter, WindowHandles, display_of};
use super::rates::Rates;
use super::resources::{GpuBuffer, GpuImage};
use super::retire::{Releaser, RetireQueue, Retired};
use super::staging::Staging;
use super::timeline::Timeline;
use super::{BufferId, DrawPipelineId, ImageId, VkError, device};
use crate::formats::atomic_file;

/// Options for opening a device.
#[derive(Clone, Debug)]
pub struct OpenOptions {
    /// Checks of the validation layer.
    pub validate: Validate,
    /// Folder that compiled pipelines are kept in between runs; `None` keeps none.
    pub cache_dir: Option<PathBuf>,
    /// Whether to copy through staging memory even where host and device share theirs, so that
    /// software drivers can test the path of graphics cards.
    #[doc(hidden)]
    pub always_stage: bool,
    /// Whether kernels hold every index within its array themselves, as on drivers that do not.
    #[doc(hidden)]
    pub restricted: bool,
    /// Most workgroups in a dimension of a launch, to test grids that are folded.
    #[doc(hidden)]
    pub groups_at_once: u32,
    /// Largest number of draws from one indirect command, to test devices with lower limits; 1 is a
    /// device without multiDrawIndirect.
    #[doc(hidden)]
    pub draws_at_once: u32,
}

impl Default for OpenOptions {
    /// Returns options with validation as `INTIMA_VALIDATE` says and pipelines in the user's cache
    /// folder.
    fn default() -> Self {
        Self {
            validate: Validate::from_env(),
            cache_dir: atomic_file::user_cache(),
            always_stage: false,
            restricted: false,
            groups_at_once: u32::MAX,
            draws_at_once: u32::MAX,
        }
    }
}

/// Use that a device is opened for.
enum Purpose {
    Compute,
    Draw,
    Present(Arc<dyn WindowHandles>),
}

/// A device and everything made on it.
pub struct Gpu {
    pub(super) info: DeviceInfo,
    pub(super) pipelines: ComputePipelines,
    // Not dropped where the device was given up: it may still use them.
    pub(super) cache: ManuallyDrop<Cache>,
    pub(super) commands: ManuallyDrop<Commands>,
    pub(super) timeline: ManuallyDrop<Timeline>,
    pub(super) queue: vk::Queue,
    pub(super) draw_pipelines: SlotMap<DrawPipelineId, DrawPipeline>,
    pub(super) buffers: SlotMap<BufferId, GpuBuffer>,
    pub(super) images: SlotMap<ImageId, GpuImage>,
    pub(super) staging: Staging,
    pub(super) retired: RetireQueue<Retired>,
    pub(super) releaser: Releaser,
    /// Resources made since [`Gpu::all_or_none`] began.
    pub(super) made: Option<Vec<ResourceId>>,
    /// Images whose layout the recording in progress has changed, each with its layout before.
    pub(super) transitions: Vec<(ImageId, vk::ImageLayout)>,
    /// Measured speed of each kernel on this device.
    pub(super) rates: Rates,
    /// Memory of the last plan, for the next one.
    pub(super) arena: Arena,
    /// Descriptors and time stamps of the last plan, for the next one.
    pub(super) pools: PlanPools,
    /// Memory that results of plans are read back through.
    pub(super) readback: Option<Buffer>,
    /// Counts of what plans asked of the device, and of the least that they had to.
    pub(super) counts: [PlanCounts; 2],
    /// Number of times that the host waited for the device.
    pub(super) waits: Cell<(u64, Duration)>,
    /// The longest submission of a plan so far.
    pub(super) longest_piece: Duration,
    /// Choice and options that it was opened with.
    opened_with: (Choice, OpenOptions),
    started: Instant,
    first_dispatch: Option<Duration>,
    pub(super) presenter: Option<Presenter>,
    pub(super) memory: ManuallyDrop<Memory>,
    pub(super) device: ManuallyDrop<OwnedDevice>,
    pub(super) instance: ManuallyDrop<Instance>,
}

impl Gpu {
    /// Opens a device that computes and draws, with the default options.
    ///
    /// # Errors
    /// [`VkError::NoLibrary`], [`VkError::NoDriver`], [`VkError::NoDevice`] where the machine has
    /// none that fits; others when a driver fails.
    pub fn open(choice: Choice) -> Result<Self, VkError> {
        Self::open_with(choice, OpenOptions::default())
    }

    /// Opens a device that computes, with the default options. Some cannot draw
    /// ([`DeviceInfo::draws`]).
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn open_to_compute(choice: Choice) -> Result<Self, VkError> {
        Self::open_parts(choice, OpenOptions::default(), Purpose::Compute)
    }

    /// Opens a device.
    ///
    /// # Errors
    /// As [`Gpu::open`]; [`VkError::NoValidation`] when the layer is asked for and not there.
    pub fn open_with(choice: Choice, options: OpenOptions) -> Result<Self, VkError> {
        Self::open_parts(choice, options, Purpose::Draw)
    }

    /// Opens a device that can draw to a window ([`Gpu::acquire`], [`Gpu::present`]). The window
    /// is held until the device is gone.
    ///
    /// # Errors
    /// As [`Gpu::open_with`]; [`VkError::NoSurface`] where the display takes no Vulkan pictures,
    /// [`VkError::NoDevice`] where no device can draw to the window.
    pub fn open_for_window(
        choice: Choice,
        options: OpenOptions,
        window: Arc<dyn WindowHandles>,
    ) -> Result<Self, VkError> {
        Self::open_parts(choice, options, Purpose::Present(window))
    }

    /// Opens a device as this one was opened. Nothing that was made on this one is on the other.
    ///
    /// # Errors
    /// As [`Gpu::open`].
    pub fn opened_anew(&self) -> Result<Self, VkError> {
        let (choice, options) = self.opened_with.clone();
        let purpose = if self.info.draws { Purpose::Draw } else { Purpose::Compute };
        Self::open_parts(choice, options, purpose)
    }

    fn open_parts(choice: Choice, options: OpenOptions, purpose: Purpose) -> Result<Self, VkError> {
        let started = Instant::now();
        let opened_with = (choice, options.clone());
        let to_draw = !matches!(purpose, Purpose::Compute);
        let window = match purpose {
            Purpose::Present(window) => Some(window),
            Purpose::Compute | Purpose::Draw => None,
        };
        let display = window.as_ref().map(display_of).transpose()?;
        let mut instance = Instance::new(options.validate, display)?;
        let surface =
            window.map(|window| PresentationSurface::new(&instance, window)).transpose()?;
        let presents = |physical, family| {
            surface.as_ref().is_none_or(|s: &PresentationSurface| {
                device::has_swapchains(&instance, physical) && s.is_supported(physical, family)
            })
        };
        let (physical, mut info) = info::choose(&instance, choice, to_draw, presents)?;
        if info.is_real() {
            instance.keep_driver();
        }
        info.limits.restricted |= options.restricted;
        info.limits.groups = info.limits.groups.map(|most| most.min(options.groups_at_once));
        info.limits.draws_at_once = info.limits.draws_at_once.min(options.draws_at_once);
        let (device, queue) = device::open(&instance, physical, &info, surface.is_some())?;
        let device = OwnedDevice(device);
        let presenter = surface
            .map(|surface| Presenter::new(&instance, &device, physical, surface))
            .transpose()?;
        let unified = info.unified_memory && !options.always_stage;
        let memory = Memory::new(&instance, &device, physical, unified)?;
        // Each destroys itself when a later one fails.
        let rates = Rates::open(&info.limits, options.cache_dir.as_deref());
        let cache = Cache::open(&device, &info.limits, options.cache_dir)?;
        let commands = Commands::new(&device, info.limits.queue_family)?;
        let timeline = Timeline::new(&device)?;
        Ok(Self {
            pipelines: ComputePipelines::default(),
            cache: ManuallyDrop::new(cache),
            commands: ManuallyDrop::new(commands),
            timeline: ManuallyDrop::new(timeline),
            queue,
            draw_pipelines: SlotMap::with_key(),
            buffers: SlotMap::with_key(),
            images: SlotMap::with_key(),
            staging: Staging::default(),
            retired: RetireQueue::default(),
            releaser: Releaser::default(),
            made: None,
            transitions: Vec::new(),
            rates,
            arena: Arena::default(),
            pools: PlanPools::default(),
            readback: None,
            counts: Default::default(),
            waits: Cell::new((0, Duration::ZERO)),
            longest_piece: Duration::ZERO,
            opened_with,
            started,
            first_dispatch: None,
            memory: ManuallyDrop::new(memory),
            device: ManuallyDrop::new(device),
            info,
            instance: ManuallyDrop::new(instance),
            presenter,
        })
    }

    /// Returns the properties the device reports.
    pub fn info(&self) -> &DeviceInfo {
        &self.info
    }

    /// Notes that launches were handed to the device.
    pub(super) fn dispatched(&mut self) {
        let started = self.started;
        self.first_dispatch.get_or_insert_with(|| started.elapsed());
    }

    /// Returns the time from before the instance was made to the first launches handed to the
    /// device.
    pub fn first_dispatch(&self) -> Option<Duration> {
        self.first_dispatch
    }

    /// Submissions so far.
    pub fn submissions(&self) -> u64 {
        self.timeline.submitted
    }

    /// Returns the longest duration of a submission of a plan, from handing it over to its end.
    pub fn longest_piece(&self) -> Duration {
        self.longest_piece
    }

    /// Returns what plans asked of the device so far, and the least that they had to.
    pub fn plan_counts(&self) -> [PlanCounts; 2] {
        self.counts
    }

    /// Returns the messages of the validation layer so far, severity warning and above. Always
    /// empty without validation.
    pub fn validation_messages(&self) -> Vec<String> {
        self.instance.messages()
    }

    /// Whether the validation layer watches this device.
    pub fn validated(&self) -> bool {
        self.instance.validate != Validate::Off
    }

    /// Returns the timeline value the device has reached.
    pub(super) fn reached(&self) -> Result<u64, VkError> {
        match self.instance.validate {
            Validate::GpuAssisted => self.wait_idle("all work").map(|()| self.timeline.submitted),
            _ => self.timeline.reached(),
        }
    }

    /// Blocks until the device has reached a timeline value; `what` names its work in the error.
    pub(super) fn wait(&self, value: u64, what: &'static str) -> Result<(), VkError> {
        let start = Instant::now();
        let done = match self.instance.validate {
            Validate::GpuAssisted => self.wait_idle(what),
            _ => self.timeline.wait(value, what),
        };
        let (waits, waited) = self.waits.get();
        self.waits.set((waits + 1, waited + start.elapsed()));
        done
    }

    /// Waits until the device has nothing left to do. Returns false where it was given up: then
    /// nothing that was made on it may be destroyed.
    pub(super) fn comes_to_rest(&mut self) -> bool {
        let _ = self.wait(self.timeline.submitted, "the end of all work");
        if self.timeline.is_given_up() {
            self.memory.give_up();
            return false;
        }
        // SAFETY: `&mut self` makes us the only user of device and queue. A lost device answers with an error and is idle all the same.
        let _ = unsafe { self.device.device_wait_idle() };
        true
    }

    /// Waits until the queue is idle. Takes the place of the timeline when shaders are
    /// instrumented: there the layer's own book-keeping of timelines hangs (it says so itself,
    /// after ten seconds). An idle queue has reached every value.
    ///
    /// * `what`: what is waited for, for the error.
    pub(super) fn wait_idle(&self, what: &'static str) -> Result<(), VkError> {
        // `Gpu` owns the queue and is not shared between threads while this runs: every caller
        // holds it by `&mut`.
        self.timeline.wait_for_queue(self.queue, what)
    }

    /// Returns the number of buffers, images and graphics pipelines that were made and not freed.
    pub fn live_resources(&self) -> usize {
        self.buffers.len() + self.images.len() + self.draw_pipelines.len()
    }

    /// Returns the device memory held at the moment, bytes, blocks kept for reuse included.
    pub fn memory_held(&self) -> u64 {
        self.memory.capacity()
    }
}

impl Drop for Gpu {
    fn drop(&mut self) {
        if !self.comes_to_rest() {
            std::mem::forget(self.presenter.take());
            return;
        }
        self.close_window();
        self.destroy_all();
        self.pipelines.destroy(&self.device);
        self.pools.destroy(&self.device);
        // SAFETY: each goes once, here, and nothing is used after it: the device is idle, what was
        // made on it is gone before it, and it before its instance.
        unsafe {
            ManuallyDrop::drop(&mut self.cache);
            ManuallyDrop::drop(&mut self.commands);
            ManuallyDrop::drop(&mut self.timeline);
            ManuallyDrop::drop(&mut self.memory);
            ManuallyDrop::drop(&mut self.device);
            ManuallyDrop::drop(&mut self.instance);
        }
    }
}

/// The logical device, destroyed when dropped: after the allocator, before the instance.
pub(super) struct OwnedDevice(ash::Device);

impl Deref for OwnedDevice {
    type Target = ash::Device;
    fn deref(&self) -> &ash::Device {
        &self.0
    }
}

impl Drop for OwnedDevice {
    fn drop(&mut self) {
        // SAFETY: dropped once, after everything made on it (`Gpu::drop`); idle, because nothing was submitted yet or `Gpu::drop` has waited.
        unsafe { self.0.destroy_device(None) };
    }
}

#[cfg(test)]
mod tests {
    #[test]
    fn a_gpu_may_move_to_another_thread() {
        fn moves<T: Send>() {}
        moves::<super::Gpu>();
    }
}
