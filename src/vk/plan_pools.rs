//! Descriptor sets and time stamps of a plan's launches, from pools that are kept for the next plan.

use ash::vk;

use super::VkError;

/// Pools of one plan at a time.
#[derive(Default)]
pub(super) struct PlanPools {
    sets: vk::DescriptorPool,
    /// Sets and descriptors that the pool has room for.
    room: [u32; 2],
    /// Time stamps; null where the queue has none.
    pub queries: vk::QueryPool,
    count: u32,
}

impl PlanPools {
    /// Returns an empty pool for so many sets and descriptors. Sets that came from it before are gone.
    pub fn sets(
        &mut self,
        device: &ash::Device,
        room: [u32; 2],
    ) -> Result<vk::DescriptorPool, VkError> {
        if self.room[0] < room[0] || self.room[1] < room[1] {
            let [sets, descriptors] = [0, 1].map(|i| room[i].max(self.room[i]).next_power_of_two());
            let sizes = [vk::DescriptorPoolSize {
                ty: vk::DescriptorType::STORAGE_BUFFER,
                descriptor_count: descriptors,
            }];
            let info = vk::DescriptorPoolCreateInfo::default().max_sets(sets).pool_sizes(&sizes);
            // SAFETY: the device is live; the pool is kept here until `destroy`.
            let new = unsafe { device.create_descriptor_pool(&info, None) }
                .map_err(VkError::of("vkCreateDescriptorPool"))?;
            // SAFETY: the plan before, which alone used the old pool, has been waited for; null is
            // ignored.
            unsafe { device.destroy_descriptor_pool(self.sets, None) };
            (self.sets, self.room) = (new, [sets, descriptors]);
        } else {
            let flags = vk::DescriptorPoolResetFlags::empty();
            // SAFETY: no set of the pool is in use: the plan before has been waited for.
            unsafe { device.reset_descriptor_pool(self.sets, flags) }
                .map_err(VkError::of("vkResetDescriptorPool"))?;
        }
        Ok(self.sets)
    }

    /// Makes room for so many time stamps.
    pub fn make_queries(&mut self, device: &ash::Device, count: u32) -> Result<(), VkError> {
        if self.count >= count {
            return Ok(());
        }
        let count = count.next_power_of_two();
        let info = vk::QueryPoolCreateInfo::default()
            .query_type(vk::QueryType::TIMESTAMP)
            .query_count(count);
        // SAFETY: the device is live; the pool is kept here until `destroy`.
        let new = unsafe { device.create_query_pool(&info, None) }
            .map_err(VkError::of("vkCreateQueryPool"))?;
        // SAFETY: as of the descriptor pool.
        unsafe { device.destroy_query_pool(self.queries, None) };
        (self.queries, self.count) = (new, count);
        Ok(())
    }

    /// Destroys the pools. The device is idle.
    pub fn destroy(&mut self, device: &ash::Device) {
        // SAFETY: nothing is in use on an idle device; each pool goes once, null is ignored.
        unsafe {
            device.destroy_descriptor_pool(self.sets, None);
            device.destroy_query_pool(self.queries, None);
        }
        *self = Self::default();
    }
}
