//! `intima devices`.

use super::CliError;
use super::global::Global;

/// Lists Vulkan devices; none is no error.
pub fn run(global: &Global) -> Result<(), CliError> {
    let devices = match crate::vk::list() {
        Ok(d) => d,
        Err(e) if e.is_no_device() => {
            global.warn(&e);
            Vec::new()
        }
        Err(e) => return Err(crate::device::DeviceError::from(e).into()),
    };
    if devices.is_empty() {
        global.say("no Vulkan device; everything that needs no drawing runs on the CPU")?;
    }
    for d in &devices {
        let memory: u64 = d.memory.iter().filter(|h| h.device_local).map(|h| h.bytes).sum();
        global.say(format_args!(
            "gpu:{}  {}\n       {:?}, Vulkan {}, {}\n       {:.1} GB of memory, storage buffers to {} MiB, subgroups of {}, up to {} samples{}",
            d.index,
            d.name,
            d.kind,
            d.api_version,
            d.driver,
            memory as f64 / 1e9,
            d.max_storage_buffer_range >> 20,
            d.subgroup_size,
            d.max_samples,
            match (d.missing.is_empty(), d.draws) {
                (false, _) => format!("\n       cannot be used: lacks {}", d.missing.join(", ")),
                (true, false) => "\n       computes, but cannot draw".to_owned(),
                (true, true) => String::new(),
            }
        ))?;
    }
    global.answer_only(&devices)
}
