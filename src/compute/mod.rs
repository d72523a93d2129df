//! Work as data: a [`Plan`] of typed buffers and kernel launches that any device can execute, and
//! the CPU runner. No Vulkan here.

mod array;
mod compare;
mod cpu;
mod kernel;
mod plan;

pub use array::Array;
pub use compare::{Mismatch, Tolerance, worst};
pub use cpu::{CpuArgs, CpuSlices, run_cpu};
pub use kernel::{Binding, Kernel, Launch, Shader, ShaderNeeds};
pub use plan::{Buf, BufId, Contents, Outputs, Plan, PlanBuffer, Step, StepTime};
