//! The logical device and its one queue.

use std::ffi::CStr;

use ash::{khr, vk};

use super::VkError;
use super::info::DeviceInfo;
use super::instance::Instance;

/// Creates the device with the features intima stands on, and fetches its queue.
pub(super) fn open(
    instance: &Instance,
    physical: vk::PhysicalDevice,
    info: &DeviceInfo,
    for_window: bool,
) -> Result<(ash::Device, vk::Queue), VkError> {
    // SAFETY: `physical` comes from this live instance.
    let has = unsafe { instance.raw.get_physical_device_features(physical) };
    // Optional: used where present, never required.
    let features = vk::PhysicalDeviceFeatures::default()
        // Every device has it. Immediate blocks of a plan are not related to the lengths of its
        // buffers; with this, a kernel that is told a wrong size stays within its buffers. Where it
        // is not real (`is_portable`), kernels see to that themselves.
        .robust_buffer_access(true)
        .multi_draw_indirect(has.multi_draw_indirect == vk::TRUE)
        .draw_indirect_first_instance(has.draw_indirect_first_instance == vk::TRUE)
        // Without it an index counts 24 bits at most.
        .full_draw_index_uint32(has.full_draw_index_uint32 == vk::TRUE)
        // Asked for by the layer when it instruments shaders.
        .fragment_stores_and_atomics(has.fragment_stores_and_atomics == vk::TRUE)
        .vertex_pipeline_stores_and_atomics(has.vertex_pipeline_stores_and_atomics == vk::TRUE);
    let mut features12 = vk::PhysicalDeviceVulkan12Features::default().timeline_semaphore(true);
    let mut features13 = vk::PhysicalDeviceVulkan13Features::default()
        .dynamic_rendering(true)
        .synchronization2(true);
    let queues = [vk::DeviceQueueCreateInfo::default()
        .queue_family_index(info.limits.queue_family)
        .queue_priorities(&[1.0])];
    let mut extensions = Vec::new();
    if is_portable(instance, physical) {
        // Whoever translates Vulkan to another interface (MoltenVK) demands that it be enabled.
        extensions.push(khr::portability_subset::NAME.as_ptr());
    }
    if for_window {
        extensions.push(khr::swapchain::NAME.as_ptr());
    }
    let create = vk::DeviceCreateInfo::default()
        .queue_create_infos(&queues)
        .enabled_features(&features)
        .enabled_extension_names(&extensions)
        .push_next(&mut features12)
        .push_next(&mut features13);
    VkError::planted("vkCreateDevice")?;
    // SAFETY: `physical` comes from this instance and was found to have version 1.3, the queue
    // family and the features; everything `create` points to lives until the call returns.
    let device = unsafe { instance.raw.create_device(physical, &create, None) }
        .map_err(VkError::of("vkCreateDevice"))?;
    // SAFETY: the family was requested above with one queue.
    let queue = unsafe { device.get_device_queue(info.limits.queue_family, 0) };
    Ok((device, queue))
}

/// Whether a driver translates Vulkan to another interface, as MoltenVK does to Metal. Such a driver
/// may report `robustBufferAccess` where what is below checks no bounds.
pub(super) fn is_portable(instance: &Instance, physical: vk::PhysicalDevice) -> bool {
    has_extension(instance, physical, khr::portability_subset::NAME)
}

/// Whether a device can show pictures in windows at all; some only compute and draw.
pub(super) fn has_swapchains(instance: &Instance, physical: vk::PhysicalDevice) -> bool {
    has_extension(instance, physical, khr::swapchain::NAME)
}

fn has_extension(instance: &Instance, physical: vk::PhysicalDevice, name: &CStr) -> bool {
    // SAFETY: `physical` comes from this live instance.
    let there = unsafe { instance.raw.enumerate_device_extension_properties(physical) };
    there.is_ok_and(|all| all.iter().any(|e| e.extension_name_as_c_str() == Ok(name)))
}
