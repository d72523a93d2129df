//! Work as data: a [`Plan`] of typed buffers and kernel launches that any device can execute, and
//! the CPU runner. No Vulkan here.

mod array;
mod cpu;
mod cpu_args;
mod device_copy;
mod kernel;
mod plan;

pub use array::Array;
pub use cpu::run_cpu;
pub use cpu_args::{CpuArgs, CpuSlices};
pub use device_copy::DeviceCopy;
pub use kernel::{Binding, BufId, Kernel, Launch, Shader, ShaderNeeds, Tolerance};
pub use plan::{Buf, Contents, Outputs, Plan, PlanBuffer, Step, StepTime};
