//! Choice between CPU and GPU, in one place.

use std::str::FromStr;
use std::time::Duration;

use crate::compute::{Outputs, Plan, run_cpu};
use crate::vk::{Choice, DeviceInfo, Gpu, PlanCounts, VkError};

/// Choice of the device that computes, as written on the command line.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// First real GPU, else the CPU.
    #[default]
    Auto,
    /// CPU, always.
    Cpu,
    /// First real GPU, else software Vulkan.
    Gpu,
    /// GPU of that index in `intima devices`; by a part of its name too (`gpu:NAME`).
    GpuAt(usize),
}

impl FromStr for DeviceChoice {
    type Err = String;

    fn from_str(s: &str) -> Result<Self, String> {
        match s {
            "auto" => Ok(Self::Auto),
            "cpu" => Ok(Self::Cpu),
            "gpu" => Ok(Self::Gpu),
            _ => match s.strip_prefix("gpu:").filter(|which| !which.is_empty()) {
                None => Err(format!("`{s}` is not a device: auto, cpu, gpu, gpu:N or gpu:NAME")),
                Some(which) => {
                    which.parse().map_or_else(|_| Self::named(which), |n| Ok(Self::GpuAt(n)))
                }
            },
        }
    }
}

impl DeviceChoice {
    /// The one device of this machine whose name holds a text: places in the list change with drivers
    /// and layers.
    fn named(part: &str) -> Result<Self, String> {
        let devices = crate::vk::list().map_err(|e| e.to_string())?;
        let names: Vec<&str> = devices.iter().map(|d| d.name.as_str()).collect();
        only_with(part, &names).map(Self::GpuAt)
    }
}

/// Returns the place of the one name that holds a text, whatever the case of its letters.
fn only_with(part: &str, names: &[&str]) -> Result<usize, String> {
    let holds = |name: &str| name.to_lowercase().contains(&part.to_lowercase());
    let mut found = (0..names.len()).filter(|i| holds(names[*i]));
    match (found.next(), found.next()) {
        (Some(only), None) => Ok(only),
        (Some(_), Some(_)) => {
            Err(format!("several devices are named `{part}`: {}", names.join("; ")))
        }
        (None, _) => Err(format!("no device is named `{part}`: {}", names.join("; "))),
    }
}

impl std::fmt::Display for DeviceChoice {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::Auto => f.write_str("auto"),
            Self::Cpu => f.write_str("cpu"),
            Self::Gpu => f.write_str("gpu"),
            Self::GpuAt(n) => write!(f, "gpu:{n}"),
        }
    }
}

/// A device that runs plans.
pub enum Device {
    /// CPU twins, on the current rayon pool.
    Cpu,
    /// Shaders, on a Vulkan device.
    Gpu(Box<Gpu>),
}

/// Errors of opening a device or running a plan on it.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum DeviceError {
    /// A Vulkan call failed.
    #[error(transparent)]
    Vulkan(VkError),
    /// The plan was cancelled between two of its submissions.
    #[error("cancelled")]
    Cancelled,
}

impl From<VkError> for DeviceError {
    fn from(e: VkError) -> Self {
        match e {
            VkError::Cancelled => Self::Cancelled,
            other => Self::Vulkan(other),
        }
    }
}

impl DeviceError {
    /// Whether the machine has no such device (exit code 4), as opposed to one that failed.
    pub fn is_no_device(&self) -> bool {
        match self {
            Self::Vulkan(e) => e.is_no_device(),
            Self::Cancelled => false,
        }
    }
}

impl Device {
    /// Opens the device chosen.
    ///
    /// # Errors
    /// With [`DeviceChoice::Auto`] only when a GPU is there and its driver fails; a machine
    /// without one computes on the CPU.
    pub fn open(choice: DeviceChoice) -> Result<Self, DeviceError> {
        let gpu = |choice| Gpu::open_to_compute(choice).map(|g| Self::Gpu(Box::new(g)));
        match choice {
            DeviceChoice::Cpu => Ok(Self::Cpu),
            DeviceChoice::Gpu => {
                let opened = gpu(Choice::Any)?;
                if opened.is_software() {
                    let name = opened.name();
                    tracing::warn!("no real GPU was found: {name} is software Vulkan");
                }
                Ok(opened)
            }
            DeviceChoice::GpuAt(n) => Ok(gpu(Choice::Index(n))?),
            DeviceChoice::Auto => match gpu(Choice::Real) {
                Err(e) if e.is_no_device() => {
                    match e {
                        VkError::NoDevice { lacking: true, .. } => {
                            tracing::warn!("the CPU computes: {e}");
                        }
                        _ => tracing::info!("the CPU computes: {e}"),
                    }
                    Ok(Self::Cpu)
                }
                other => Ok(other?),
            },
        }
    }

    /// Runs a plan to its end. Where a buffer or a launch is larger than the GPU takes at once, or
    /// its memory runs out, the CPU twins run the plan instead, with a warning. A device that was lost
    /// is opened anew and runs the plan again; if it is lost again, or cannot be opened, the CPU
    /// computes from then on.
    ///
    /// # Errors
    /// See [`Gpu::run`]; the CPU has none.
    pub fn run(&mut self, plan: &Plan<'_>) -> Result<Outputs, DeviceError> {
        let Self::Gpu(gpu) = self else { return Ok(run_cpu(plan)) };
        let mut outcome = gpu.run(plan);
        if let Err(e) = &outcome
            && e.is_lost()
        {
            tracing::warn!("{e}; the device is opened again");
            match gpu.opened_anew() {
                // Not another one, which may be software.
                Ok(new) if new.info().name == gpu.info().name => {
                    **gpu = new;
                    outcome = gpu.run(plan);
                }
                Ok(_) => {}
                Err(e) => tracing::warn!("it cannot be opened: {e}"),
            }
        }
        match outcome {
            Ok(out) => Ok(out),
            Err(
                e @ (VkError::TooLarge { .. }
                | VkError::TooManyThreads { .. }
                | VkError::OutOfMemory { .. }),
            ) => {
                tracing::warn!("{e}; the CPU computes it instead");
                Ok(run_cpu(plan))
            }
            Err(e) if e.is_lost() => {
                tracing::warn!("{e}; the CPU computes from now on");
                *self = Self::Cpu;
                Ok(run_cpu(plan))
            }
            Err(e) => Err(e.into()),
        }
    }

    /// Whether the device is a software Vulkan driver, which runs on the CPU and no faster than its
    /// twins.
    pub fn is_software(&self) -> bool {
        self.info().is_some_and(|i| !i.is_real())
    }

    /// Returns the name for the report: `cpu`, or the driver's name of the device.
    pub fn name(&self) -> &str {
        self.info().map_or("cpu", |i| i.name.as_str())
    }

    /// Returns the properties of the Vulkan device; `None` for the CPU.
    pub fn info(&self) -> Option<&DeviceInfo> {
        match self {
            Self::Cpu => None,
            Self::Gpu(gpu) => Some(gpu.info()),
        }
    }

    /// Returns the number of submissions to the device so far; the CPU has none.
    pub fn submissions(&self) -> u64 {
        match self {
            Self::Cpu => 0,
            Self::Gpu(gpu) => gpu.submissions(),
        }
    }

    /// Returns what plans asked of the device so far, and the least that they had to; the CPU is
    /// asked nothing.
    pub fn plan_counts(&self) -> [PlanCounts; 2] {
        match self {
            Self::Cpu => Default::default(),
            Self::Gpu(gpu) => gpu.plan_counts(),
        }
    }

    /// Returns the time from before the Vulkan instance was made to the first launches handed to
    /// the device.
    pub fn first_dispatch(&self) -> Option<Duration> {
        match self {
            Self::Cpu => None,
            Self::Gpu(gpu) => gpu.first_dispatch(),
        }
    }

    /// Returns the size of the largest buffer a plan may hold on this device, bytes.
    pub fn max_buffer_bytes(&self) -> u64 {
        self.info().map_or(u64::MAX, |i| i.max_storage_buffer_range.min(i.max_buffer_bytes))
    }
}

#[cfg(test)]
mod tests {
    use super::{DeviceChoice, only_with};

    #[test]
    fn a_device_choice_reads_as_it_writes() {
        for s in ["auto", "cpu", "gpu", "gpu:0", "gpu:12"] {
            assert_eq!(s.parse::<DeviceChoice>().unwrap().to_string(), s);
        }
        for s in ["", "GPU", "gpu:", "gpu:no such device", "cuda"] {
            assert!(s.parse::<DeviceChoice>().is_err(), "`{s}`");
        }
    }

    #[test]
    fn a_device_is_chosen_by_a_part_of_its_name_that_no_other_has() {
        let names = ["NVIDIA H100", "AMD Radeon (RADV)", "AMD Radeon (AMDVLK)"];
        assert_eq!(only_with("h100", &names), Ok(0));
        assert_eq!(only_with("RADV", &names), Ok(1));
        assert!(only_with("radeon", &names).unwrap_err().starts_with("several devices"));
        assert!(only_with("Intel", &names).unwrap_err().contains("NVIDIA H100; AMD"));
        assert!(only_with("Intel", &[]).is_err());
    }
}
