//! The timeline semaphore that counts submissions.

use std::cell::Cell;

use ash::vk;

use super::VkError;
use crate::{fault, task};

/// Longest call into the driver of a wait, ns: between two calls a hung device can be given up.
const SLICE_NS: u64 = 1_000_000_000;
/// Slices after which a device is given up. Drivers reset hardware that hangs within seconds; what
/// is drawn in software on a busy machine may take long. Slices are counted, not the time, so that
/// a machine that slept does not lose its device.
const SLICES: u32 = 120;
/// Slices after which it is given up where the work was cancelled.
const SLICES_CANCELLED: u32 = 5;

/// A timeline semaphore; each submission signals the next value. Dropped before the device, once
/// that is idle.
pub(super) struct Timeline {
    device: ash::Device,
    pub semaphore: vk::Semaphore,
    /// Value of the latest submission.
    pub submitted: u64,
    /// Wait that the device was given up in, and its slices.
    given_up: Cell<Option<(&'static str, u32)>>,
}

impl Timeline {
    pub fn new(device: &ash::Device) -> Result<Self, VkError> {
        let mut kind =
            vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        VkError::planted("vkCreateSemaphore")?;
        // SAFETY: `device` is live and `info` outlives the call.
        let semaphore = unsafe { device.create_semaphore(&info, None) }
            .map_err(VkError::of("vkCreateSemaphore"))?;
        Ok(Self { device: device.clone(), semaphore, submitted: 0, given_up: Cell::new(None) })
    }

    /// Returns the value the device has reached.
    pub fn reached(&self) -> Result<u64, VkError> {
        self.answers()?;
        // SAFETY: the semaphore is ours, of this device, and a timeline.
        unsafe { self.device.get_semaphore_counter_value(self.semaphore) }
            .map_err(VkError::of("vkGetSemaphoreCounterValue"))
    }

    /// Whether the device was given up: what was submitted to it may run for ever.
    pub fn is_given_up(&self) -> bool {
        self.given_up.get().is_some()
    }

    fn answers(&self) -> Result<(), VkError> {
        self.given_up.get().map_or(Ok(()), |(waited_for, seconds)| {
            Err(VkError::Unresponsive { waited_for, seconds })
        })
    }

    /// Blocks until the device has reached `value`.
    ///
    /// * `what`: what is waited for, for the error.
    ///
    /// # Errors
    /// [`VkError::Unresponsive`] where the device is given up; then, and from then on.
    pub fn wait(&self, value: u64, what: &'static str) -> Result<(), VkError> {
        let (semaphores, values) = ([self.semaphore], [value]);
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        self.in_slices(what, "vkWaitSemaphores", || {
            // SAFETY: the semaphore is ours, of this device; arrays outlive the call.
            unsafe { self.device.wait_semaphores(&info, SLICE_NS) }
        })
    }

    /// Blocks until a queue has ended all that was submitted to it, by a fence.
    ///
    /// * `what`: what is waited for, for the error.
    ///
    /// # Errors
    /// As [`Timeline::wait`].
    pub fn wait_for_queue(&self, queue: vk::Queue, what: &'static str) -> Result<(), VkError> {
        self.answers()?;
        // SAFETY: `device` is live, and the structure outlives the call.
        let fence = unsafe { self.device.create_fence(&vk::FenceCreateInfo::default(), None) }
            .map_err(VkError::of("vkCreateFence"))?;
        // SAFETY: the fence is new; the queue is this device's, and the caller has it to itself.
        let submitted = unsafe { self.device.queue_submit2(queue, &[], fence) }
            .map_err(VkError::of("vkQueueSubmit2"));
        let outcome = submitted.and_then(|()| {
            self.in_slices(what, "vkWaitForFences", || {
                // SAFETY: the fence is ours, of this device; the array outlives the call.
                unsafe { self.device.wait_for_fences(&[fence], true, SLICE_NS) }
            })
        });
        if !self.is_given_up() {
            // SAFETY: the fence is ours and goes once. It was signalled, was not submitted, or the
            // device is lost; of a device that was given up it stays.
            unsafe { self.device.destroy_fence(fence, None) };
        }
        outcome
    }

    /// Repeats a wait of [`SLICE_NS`] while it times out, until the device is given up.
    fn in_slices(
        &self,
        what: &'static str,
        call: &'static str,
        wait: impl Fn() -> Result<(), vk::Result>,
    ) -> Result<(), VkError> {
        self.answers()?;
        let mut slices = 0;
        loop {
            let answer = match fault::hit(fault::Point::Wait) {
                true => Err(vk::Result::TIMEOUT),
                false => wait(),
            };
            match answer {
                Err(vk::Result::TIMEOUT) => slices += 1,
                answer => return answer.map_err(VkError::of(call)),
            }
            let most = if task::is_cancelled() { SLICES_CANCELLED } else { SLICES };
            if slices >= most {
                self.given_up.set(Some((what, slices)));
                return self.answers();
            }
        }
    }
}

impl Drop for Timeline {
    fn drop(&mut self) {
        // SAFETY: the semaphore is ours and goes once; the device is idle (`Gpu::drop` waits) or
        // nothing was submitted to it.
        unsafe { self.device.destroy_semaphore(self.semaphore, None) };
    }
}
