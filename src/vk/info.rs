//! Vulkan devices of this machine, their properties, and the choice of one.

use std::ffi::CStr;

use ash::vk;
use serde::Serialize;

use super::VkError;
use super::device::is_portable;
use super::instance::{Instance, Validate, dotted};
use crate::compute::ShaderNeeds;
use crate::kernels::host::NEEDS;

/// Choice of the device to open.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Choice {
    /// First real GPU: discrete before integrated before virtual.
    Real,
    /// First real GPU, else software.
    Any,
    /// Device with that index in [`list`].
    Index(usize),
}

impl std::fmt::Display for Choice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Real => f.write_str("a real GPU"),
            Self::Any => f.write_str("gpu"),
            Self::Index(n) => write!(f, "gpu:{n}"),
        }
    }
}

/// Kind of hardware behind a device.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DeviceKind {
    /// Discrete graphics card.
    Discrete,
    /// GPU that shares the processor's memory.
    Integrated,
    /// Slice of a GPU in a virtual machine.
    Virtual,
    /// Any other kind.
    Other,
    /// Software driver such as lavapipe.
    Software,
}

/// One heap of device memory.
#[derive(Clone, Copy, Debug, Serialize)]
pub struct MemoryHeap {
    /// Size, bytes.
    pub bytes: u64,
    /// Whether the device reaches it at full speed.
    pub device_local: bool,
}

/// Properties of a device, as the driver reports them.
#[derive(Clone, Debug, Serialize)]
pub struct DeviceInfo {
    /// Position in the list; `gpu:N` on the command line.
    pub index: usize,
    /// Name the driver gives it.
    pub name: String,
    /// Kind of hardware, or software.
    pub kind: DeviceKind,
    /// Highest Vulkan version.
    pub api_version: String,
    /// Driver and its version.
    pub driver: String,
    /// Memory heaps.
    pub memory: Vec<MemoryHeap>,
    /// Whether host and device share all memory, so that no copy has to be staged.
    pub unified_memory: bool,
    /// Largest storage buffer of one binding, bytes.
    pub max_storage_buffer_range: u64,
    /// Largest buffer, bytes.
    pub max_buffer_bytes: u64,
    /// Bytes of memory shared by a workgroup.
    pub max_shared_bytes: u32,
    /// Number of invocations that run in step.
    pub subgroup_size: u32,
    /// Nanoseconds a timestamp tick; 0 without timestamps.
    pub timestamp_period_ns: f32,
    /// Most columns and rows of an image.
    #[serde(skip)]
    pub max_image_side: u32,
    /// Most samples a pixel for colour and depth together.
    pub max_samples: u32,
    /// Requirements of intima that this device lacks; empty when it can be used.
    pub missing: Vec<String>,
    /// Whether it can draw; some devices only compute.
    pub draws: bool,
    /// Figures that the runner needs.
    #[serde(skip)]
    pub(super) limits: Limits,
}

/// Properties that only this room needs.
#[derive(Clone, Debug, Default)]
pub(super) struct Limits {
    pub queue_family: u32,
    pub timestamp_bits: u32,
    pub groups: [u32; 2],
    /// Whether kernels hold every index within its array themselves, since the driver may not.
    pub restricted: bool,
    /// Most indirect draws of one command; 1 without multiDrawIndirect or
    /// drawIndirectFirstInstance: each is then a command of its own.
    pub draws_at_once: u32,
    pub vendor: u32,
    pub device: u32,
    pub driver_version: u32,
    pub uuid: [u8; vk::UUID_SIZE],
}

impl DeviceInfo {
    /// Whether it is hardware.
    pub fn is_real(&self) -> bool {
        self.kind != DeviceKind::Software
    }

    /// Whether intima can run on it.
    pub fn usable(&self) -> bool {
        self.missing.is_empty()
    }
}

/// Lists all Vulkan devices of this machine, usable or not.
///
/// # Errors
/// [`VkError::NoLibrary`], [`VkError::NoDriver`], or a failing driver.
pub fn list() -> Result<Vec<DeviceInfo>, VkError> {
    let instance = Instance::new(Validate::Off, None)?;
    Ok(devices(&instance)?.into_iter().map(|(_, info)| info).collect())
}

pub(super) fn devices(
    instance: &Instance,
) -> Result<Vec<(vk::PhysicalDevice, DeviceInfo)>, VkError> {
    let all = instance.physical_devices()?;
    if all.is_empty() {
        return Err(VkError::NoDriver);
    }
    Ok(all.into_iter().enumerate().map(|(i, p)| (p, describe(instance, p, i))).collect())
}

/// Chooses a device.
///
/// * `to_draw`: whether it has to draw; else computing is enough.
/// * `presents`: whether a queue family of a device can present to the window, if one is wanted.
pub(super) fn choose(
    instance: &Instance,
    choice: Choice,
    to_draw: bool,
    presents: impl Fn(vk::PhysicalDevice, u32) -> bool,
) -> Result<(vk::PhysicalDevice, DeviceInfo), VkError> {
    let mut all = devices(instance)?;
    for (device, info) in all.iter_mut().filter(|(_, d)| d.usable()) {
        if to_draw && !info.draws {
            info.missing.push("a queue for graphics".into());
        } else if !presents(*device, info.limits.queue_family) {
            info.missing.push("presentation to this window".into());
        }
    }
    let fits = |(i, d): &(usize, &DeviceInfo)| match choice {
        Choice::Real => d.is_real(),
        Choice::Any => true,
        Choice::Index(n) => *i == n,
    };
    let usable = all.iter().map(|(_, d)| d).enumerate().filter(|(_, d)| d.usable());
    let best = usable.filter(fits).min_by_key(|(_, d)| d.kind).map(|(i, _)| i);
    let found = || {
        let names = all.iter().map(|(_, d)| match d.usable() {
            true => d.name.clone(),
            false => format!("{} without {}", d.name, d.missing.join(", ")),
        });
        names.collect::<Vec<_>>().join("; ")
    };
    let lacking = || all.iter().any(|(_, d)| d.is_real() && !d.usable());
    let at = best.ok_or_else(|| VkError::NoDevice {
        wanted: choice.to_string(),
        found: found(),
        lacking: lacking(),
    })?;
    Ok(all.into_iter().nth(at).expect("an index of the list"))
}

fn describe(instance: &Instance, device: vk::PhysicalDevice, index: usize) -> DeviceInfo {
    let mut driver = vk::PhysicalDeviceDriverProperties::default();
    let mut subgroup = vk::PhysicalDeviceSubgroupProperties::default();
    let mut largest = vk::PhysicalDeviceMaintenance4Properties::default();
    let mut features12 = vk::PhysicalDeviceVulkan12Features::default();
    let mut features13 = vk::PhysicalDeviceVulkan13Features::default();
    // SAFETY: `device` comes from this live instance. The version decides which structs may be
    // chained: a device below 1.3 does not know the last ones.
    let plain = unsafe { instance.raw.get_physical_device_properties(device) };
    let modern = plain.api_version >= vk::API_VERSION_1_3;
    let mut properties = vk::PhysicalDeviceProperties2::default();
    let mut features = vk::PhysicalDeviceFeatures2::default();
    if modern {
        properties = properties.push_next(&mut driver).push_next(&mut subgroup);
        properties = properties.push_next(&mut largest);
        features = features.push_next(&mut features12).push_next(&mut features13);
        // SAFETY: as above, for a device of version 1.3; the chained structs outlive the calls.
        unsafe {
            instance.raw.get_physical_device_properties2(device, &mut properties);
            instance.raw.get_physical_device_features2(device, &mut features);
        }
    }
    // SAFETY: `device` comes from this live instance.
    let (memory, families) = unsafe {
        let memory = instance.raw.get_physical_device_memory_properties(device);
        (memory, instance.raw.get_physical_device_queue_family_properties(device))
    };
    let many_draws = features.features.multi_draw_indirect == vk::TRUE
        && features.features.draw_indirect_first_instance == vk::TRUE;
    let flags: Vec<_> = families.iter().map(|f| f.queue_flags).collect();
    let family = queue_family(&flags);

    let mut missing = Vec::new();
    let mut need = |there: bool, what: &str| {
        if !there {
            missing.push(what.to_owned());
        }
    };
    need(modern, "Vulkan 1.3");
    need(family.is_some(), "a queue for compute");
    if modern {
        need(features13.dynamic_rendering == vk::TRUE, "dynamic rendering");
        need(features13.synchronization2 == vk::TRUE, "synchronization2");
        need(features12.timeline_semaphore == vk::TRUE, "timeline semaphores");
    }

    missing.extend(short_limits(&plain.limits, &NEEDS));
    let family = family.unwrap_or(0);
    let draws = flags.get(family).is_some_and(|f| f.contains(vk::QueueFlags::GRAPHICS));

    let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
    let local = |h: &vk::MemoryHeap| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL);
    let limits = &plain.limits;
    let samples = limits.framebuffer_color_sample_counts & limits.framebuffer_depth_sample_counts;
    let timestamp_bits = families.get(family).map_or(0, |f| f.timestamp_valid_bits);
    let kind = match plain.device_type {
        vk::PhysicalDeviceType::DISCRETE_GPU => DeviceKind::Discrete,
        vk::PhysicalDeviceType::INTEGRATED_GPU => DeviceKind::Integrated,
        vk::PhysicalDeviceType::VIRTUAL_GPU => DeviceKind::Virtual,
        vk::PhysicalDeviceType::CPU => DeviceKind::Software,
        _ => DeviceKind::Other,
    };
    let shared = matches!(kind, DeviceKind::Integrated | DeviceKind::Software);
    DeviceInfo {
        index,
        name: text(plain.device_name_as_c_str()),
        kind,
        api_version: dotted(plain.api_version),
        driver: format!(
            "{} {}",
            text(driver.driver_name_as_c_str()),
            text(driver.driver_info_as_c_str())
        )
        .trim()
        .to_owned(),
        memory: heaps
            .iter()
            .map(|h| MemoryHeap { bytes: h.size, device_local: local(h) })
            .collect(),
        unified_memory: shared && heaps.iter().all(local),
        max_storage_buffer_range: u64::from(limits.max_storage_buffer_range),
        max_buffer_bytes: largest.max_buffer_size,
        max_shared_bytes: limits.max_compute_shared_memory_size,
        subgroup_size: subgroup.subgroup_size,
        timestamp_period_ns: if timestamp_bits > 0 { limits.timestamp_period } else { 0.0 },
        max_image_side: limits.max_image_dimension2_d,
        max_samples: 1 << (31 - samples.as_raw().max(1).leading_zeros()),
        missing,
        draws,
        limits: Limits {
            queue_family: family as u32,
            restricted: is_portable(instance, device),
            timestamp_bits,
            groups: [
                limits.max_compute_work_group_count[0],
                limits.max_compute_work_group_count[1],
            ],
            draws_at_once: if many_draws { limits.max_draw_indirect_count } else { 1 },
            vendor: plain.vendor_id,
            device: plain.device_id,
            driver_version: plain.driver_version,
            uuid: plain.pipeline_cache_uuid,
        },
    }
}

/// Returns the index of the queue family to use: one that draws and computes, else one that
/// computes.
fn queue_family(flags: &[vk::QueueFlags]) -> Option<usize> {
    let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let with = |wanted| flags.iter().position(|f| f.contains(wanted));
    with(both).or_else(|| with(vk::QueueFlags::COMPUTE))
}

/// Returns the limits that are below what kernels need, each with both figures.
fn short_limits(limits: &vk::PhysicalDeviceLimits, needs: &ShaderNeeds) -> Vec<String> {
    let buffers =
        limits.max_per_stage_descriptor_storage_buffers.min(limits.max_per_stage_resources);
    let all = [
        (limits.max_compute_work_group_invocations, needs.workgroup, "invocations a workgroup"),
        (limits.max_compute_work_group_size[0], needs.workgroup, "invocations along x"),
        (buffers, needs.storage_buffers, "storage buffers a shader"),
        (limits.max_descriptor_set_storage_buffers, needs.storage_buffers, "storage buffers a set"),
        (limits.max_push_constants_size, needs.params_bytes, "bytes of push constants"),
        (limits.max_compute_shared_memory_size, needs.shared_bytes, "bytes of shared memory"),
    ];
    let short = all.into_iter().filter(|(has, needed, _)| has < needed);
    short.map(|(has, needed, what)| format!("{needed} {what} (it has {has})")).collect()
}

fn text<E>(s: Result<&CStr, E>) -> String {
    s.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::kernels::ALL;

    #[test]
    fn a_device_that_only_computes_has_a_queue() {
        let (draw, compute) = (vk::QueueFlags::GRAPHICS, vk::QueueFlags::COMPUTE);
        let copy = vk::QueueFlags::TRANSFER;
        assert_eq!(queue_family(&[copy, compute, draw | compute]), Some(2));
        assert_eq!(queue_family(&[copy, compute | copy]), Some(1));
        assert_eq!(queue_family(&[copy, draw]), None);
    }

    #[test]
    fn a_device_with_limits_below_the_largest_kernel_is_refused_with_both_figures() {
        // Those of `paper` are wider; this room does not see them.
        assert!(ALL.iter().all(|k| k.shader.workgroup <= NEEDS.workgroup));
        let buffers = ALL.iter().map(|k| k.shader.bindings.len() as u32).max();
        assert_eq!(buffers, Some(NEEDS.storage_buffers));
        assert!(ALL.iter().all(|k| k.shader.params_size <= NEEDS.params_bytes));
        // What Vulkan 1.3 asks of every device.
        let least = vk::PhysicalDeviceLimits {
            max_compute_work_group_invocations: 128,
            max_compute_work_group_size: [128, 128, 64],
            max_per_stage_descriptor_storage_buffers: 4,
            max_per_stage_resources: 128,
            max_descriptor_set_storage_buffers: 24,
            max_push_constants_size: 128,
            max_compute_shared_memory_size: 16_384,
            ..Default::default()
        };
        let short = short_limits(&least, &NEEDS);
        let (workgroup, buffers) = (NEEDS.workgroup, NEEDS.storage_buffers);
        let wanted = [
            format!("{workgroup} invocations a workgroup (it has 128)"),
            format!("{workgroup} invocations along x (it has 128)"),
            format!("{buffers} storage buffers a shader (it has 4)"),
        ];
        assert_eq!(short, wanted);
        let enough = vk::PhysicalDeviceLimits {
            max_compute_work_group_invocations: workgroup,
            max_compute_work_group_size: [workgroup, 1, 1],
            max_per_stage_descriptor_storage_buffers: buffers,
            ..least
        };
        assert!(short_limits(&enough, &NEEDS).is_empty());
    }
}
