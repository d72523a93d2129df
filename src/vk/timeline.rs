//! The timeline semaphore that counts submissions.

use ash::vk;

use super::VkError;

/// A timeline semaphore; each submission signals the next value.
pub(super) struct Timeline {
    pub semaphore: vk::Semaphore,
    /// Value of the latest submission.
    pub submitted: u64,
}

impl Timeline {
    pub fn new(device: &ash::Device) -> Result<Self, VkError> {
        let mut kind =
            vk::SemaphoreTypeCreateInfo::default().semaphore_type(vk::SemaphoreType::TIMELINE);
        let info = vk::SemaphoreCreateInfo::default().push_next(&mut kind);
        // SAFETY: `device` is live and `info` outlives the call.
        let semaphore = unsafe { device.create_semaphore(&info, None) }
            .map_err(VkError::of("vkCreateSemaphore"))?;
        Ok(Self { semaphore, submitted: 0 })
    }

    /// Value the device has reached.
    pub fn reached(&self, device: &ash::Device) -> Result<u64, VkError> {
        // SAFETY: the semaphore is ours, of this device, and a timeline.
        unsafe { device.get_semaphore_counter_value(self.semaphore) }
            .map_err(VkError::of("vkGetSemaphoreCounterValue"))
    }

    /// Blocks until the device has reached `value`.
    pub fn wait(&self, device: &ash::Device, value: u64) -> Result<(), VkError> {
        let (semaphores, values) = ([self.semaphore], [value]);
        let info = vk::SemaphoreWaitInfo::default().semaphores(&semaphores).values(&values);
        // SAFETY: the semaphore is ours, of this device; arrays outlive the call.
        unsafe { device.wait_semaphores(&info, u64::MAX) }.map_err(VkError::of("vkWaitSemaphores"))
    }
}
