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
        global.say(d)?;
    }
    global.answer(&devices)
}
