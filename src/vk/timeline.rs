//! The timeline semaphore that counts submissions.

use ash::vk;

use super::VkError;

/// A timeline semaphore; each submission signals the next value. Dropped before the device, once
/// that is idle.
pub(super) struct Timeline {
    device: ash::Device,
    pub semaphore: vk::Semaphore,
    /// Value of the latest submission.
    pub submitted: u64,
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
        Ok(Self { device: device.clone(), semaphore, submitted: 0 })
    }

    /// Returns the value the device has reached.
    pub fn reached(&self) -> Result<u64, VkError> {
        // SAFETY: the semaphore is ours, of this device, and a timeline.
        unsafe { self.device.get_semaphore_counter_value(self.semaphore) }
            .map_err(VkError::of("vkGetSemaphoreCounterValue"))
    }

    /// Blocks until the device has reached `value`.
    pub fn wait(&self, value: u64) -> Result<(), VkError> {
        let (semaphores, values) = ([self.semaphore], [value]);
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is ours, of this device; arrays outlive the call.
        unsafe { self.device.wait_semaphores(&info, u64::MAX) }
            .map_err(VkError::of("vkWaitSemaphores"))
    }
}

impl Drop for Timeline {
    fn drop(&mut self) {
        // SAFETY: the semaphore is ours and goes once; the device is idle (`Gpu::drop` waits) or
        // nothing was submitted to it.
        unsafe { self.device.destroy_semaphore(self.semaphore, None) };
    }
}
