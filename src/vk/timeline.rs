//! Counting submissions, and holding freed things until the device is past their last use.

use std::collections::VecDeque;

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

/// Things waiting for the device to pass a timeline value. Values pushed never decrease.
pub(super) struct Retire<T> {
    queue: VecDeque<(u64, T)>,
}

impl<T> Default for Retire<T> {
    fn default() -> Self {
        Self { queue: VecDeque::new() }
    }
}

impl<T> Retire<T> {
    /// Holds `thing` until `value` is reached.
    pub fn push(&mut self, value: u64, thing: T) {
        debug_assert!(self.queue.back().is_none_or(|(v, _)| *v <= value), "values decrease");
        self.queue.push_back((value, thing));
    }

    /// Takes out everything whose value has been reached.
    pub fn reap(&mut self, reached: u64) -> impl Iterator<Item = T> + '_ {
        let n = self.queue.iter().take_while(|(v, _)| *v <= reached).count();
        self.queue.drain(..n).map(|(_, t)| t)
    }
}

#[cfg(test)]
mod tests {
    use super::Retire;

    #[test]
    fn things_leave_only_once_their_value_is_reached() {
        let mut r = Retire::default();
        for (value, thing) in [(1, 'a'), (1, 'b'), (3, 'c')] {
            r.push(value, thing);
        }
        assert_eq!(r.reap(0).count(), 0);
        assert_eq!(r.reap(2).collect::<String>(), "ab");
        assert_eq!(r.reap(2).count(), 0);
        assert_eq!(r.reap(3).collect::<String>(), "c");
    }
}
