//! Vulkan devices of this machine, their properties, and the choice of one.

use std::ffi::CStr;

use ash::vk;
use serde::Serialize;

use super::VkError;
use super::device::is_portable;
use super::instance::{Instance, Validate, dotted};

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
    pub missing: Vec<&'static str>,
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
    /// Most indirect draws of one command; 1 without multiDrawIndirect.
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
/// * `presents`: whether a queue family of a device can present to the window, if one is wanted.
pub(super) fn choose(
    instance: &Instance,
    choice: Choice,
    presents: impl Fn(vk::PhysicalDevice, u32) -> bool,
) -> Result<(vk::PhysicalDevice, DeviceInfo), VkError> {
    let mut all = devices(instance)?;
    for (device, info) in all.iter_mut().filter(|(_, d)| d.usable()) {
        if !presents(*device, info.limits.queue_family) {
            info.missing.push("presentation to this window");
        }
    }
    let mut best: Option<usize> = None;
    for (i, (_, d)) in all.iter().enumerate().filter(|(_, (_, d))| d.usable()) {
        let fits = match choice {
            Choice::Real => d.is_real(),
            Choice::Any => true,
            Choice::Index(n) => i == n,
        };
        if fits && best.is_none_or(|b| d.kind < all[b].1.kind) {
            best = Some(i);
        }
    }
    let found = || {
        let names = all.iter().map(|(_, d)| match d.usable() {
            true => d.name.clone(),
            false => format!("{} without {}", d.name, d.missing.join(", ")),
        });
        names.collect::<Vec<_>>().join("; ")
    };
    let at =
        best.ok_or_else(|| VkError::NoDevice { wanted: choice.to_string(), found: found() })?;
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
    let many_draws = features.features.multi_draw_indirect == vk::TRUE;
    let both = vk::QueueFlags::GRAPHICS | vk::QueueFlags::COMPUTE;
    let family = families.iter().position(|f| f.queue_flags.contains(both));

    let mut missing = Vec::new();
    let mut need = |there: bool, what| {
        if !there {
            missing.push(what);
        }
    };
    need(modern, "Vulkan 1.3");
    need(family.is_some(), "a queue for graphics and compute");
    if modern {
        need(features13.dynamic_rendering == vk::TRUE, "dynamic rendering");
        need(features13.synchronization2 == vk::TRUE, "synchronization2");
        need(features12.timeline_semaphore == vk::TRUE, "timeline semaphores");
    }

    let heaps = &memory.memory_heaps[..memory.memory_heap_count as usize];
    let local = |h: &vk::MemoryHeap| h.flags.contains(vk::MemoryHeapFlags::DEVICE_LOCAL);
    let limits = &plain.limits;
    let samples = limits.framebuffer_color_sample_counts & limits.framebuffer_depth_sample_counts;
    let timestamp_bits = family.map_or(0, |f| families[f].timestamp_valid_bits);
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
        limits: Limits {
            queue_family: family.unwrap_or(0) as u32,
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

fn text<E>(s: Result<&CStr, E>) -> String {
    s.map(|s| s.to_string_lossy().into_owned()).unwrap_or_default()
}
