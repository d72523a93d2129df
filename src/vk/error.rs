//! Errors of Vulkan calls and of the devices behind them.

use ash::vk;

use crate::fault;

/// An error of the Vulkan room.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum VkError {
    /// The machine has no Vulkan loader.
    #[error("no Vulkan library on this machine ({0})")]
    NoLibrary(String),
    /// The loader finds no driver.
    #[error("the Vulkan library found no driver")]
    NoDriver,
    /// None of the drivers' devices fits the choice.
    #[error("no Vulkan device fits `{wanted}` (found: {found})")]
    NoDevice {
        /// The choice, as the user would write it.
        wanted: String,
        /// Names of the devices there are and what they lack.
        found: String,
        /// Whether a real GPU is among them that lacks something.
        lacking: bool,
    },
    /// Validation was requested and its layer is not installed.
    #[error("validation was asked for, but {0} is not installed")]
    NoValidation(&'static str),
    /// Nothing can be drawn to a window.
    #[error("cannot draw to a window: {0}")]
    NoSurface(&'static str),
    /// A buffer of a plan is larger than one binding of this device may be.
    #[error("buffer `{buffer}` takes {bytes} bytes, {device} binds at most {limit} at once")]
    TooLarge {
        /// Name in the plan.
        buffer: &'static str,
        /// Size of the buffer, bytes.
        bytes: u64,
        /// `maxStorageBufferRange` or `maxBufferSize`.
        limit: u64,
        /// Device name.
        device: String,
    },
    /// A launch has more threads than the device can count.
    #[error("`{kernel}` asks for {threads} threads, this device launches at most {limit}")]
    TooManyThreads {
        /// Kernel name.
        kernel: &'static str,
        /// Number of threads of the launch.
        threads: u64,
        /// Most threads of one launch.
        limit: u64,
    },
    /// A frame has more to write and draw than the staging ring can take at the moment.
    #[error("no room to stage {bytes} bytes in a ring of at most {budget}")]
    StagingFull {
        /// Number of bytes requested.
        bytes: u64,
        /// Largest size of the ring.
        budget: u64,
    },
    /// Device memory ran out.
    #[error("out of device memory: {bytes} bytes for `{what}` ({detail})")]
    OutOfMemory {
        /// Name of the resource the memory was for.
        what: String,
        /// Number of bytes requested.
        bytes: u64,
        /// Message of the allocator.
        detail: String,
    },
    /// The token of this thread was cancelled between two submissions of a plan.
    #[error("cancelled")]
    Cancelled,
    /// The device stopped answering; the `Gpu` is of no further use.
    #[error("the device was lost during {during}")]
    DeviceLost {
        /// Name of the call that reported it.
        during: &'static str,
    },
    /// The device did not answer and was given up; the `Gpu` is of no further use, and what was
    /// made on it stays until the program ends.
    #[error("the device did not answer for {seconds} s, while {waited_for} was waited for")]
    Unresponsive {
        /// Work that was waited for.
        waited_for: &'static str,
        /// Seconds it was waited for.
        seconds: u32,
    },
    /// Any other failure of a Vulkan call.
    #[error("{call} failed: {result}")]
    Call {
        /// Name of the call.
        call: &'static str,
        /// Result code of the call.
        result: vk::Result,
    },
}

impl VkError {
    /// Whether the machine simply has no such device, as opposed to one that failed.
    pub fn is_no_device(&self) -> bool {
        matches!(
            self,
            Self::NoLibrary(_)
                | Self::NoDriver
                | Self::NoDevice { .. }
                | Self::NoSurface(_)
                | Self::NoValidation(_)
        )
    }

    /// Whether the device is of no further use, while another that is opened may work.
    pub fn is_lost(&self) -> bool {
        matches!(self, Self::DeviceLost { .. } | Self::Unresponsive { .. })
    }

    /// Fails where a fault is planted at the creation of things.
    pub(super) fn planted(call: &'static str) -> Result<(), Self> {
        match fault::hit(fault::Point::Create) {
            true => Err(Self::of(call)(vk::Result::ERROR_OUT_OF_HOST_MEMORY)),
            false => Ok(()),
        }
    }

    /// Turns the answer of a call into an error that names the call.
    pub(super) fn of(call: &'static str) -> impl Fn(vk::Result) -> Self {
        move |result| match result {
            vk::Result::ERROR_DEVICE_LOST => Self::DeviceLost { during: call },
            vk::Result::ERROR_OUT_OF_DEVICE_MEMORY | vk::Result::ERROR_OUT_OF_HOST_MEMORY => {
                Self::OutOfMemory { what: call.into(), bytes: 0, detail: result.to_string() }
            }
            result => Self::Call { call, result },
        }
    }
}
