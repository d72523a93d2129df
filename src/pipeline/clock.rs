//! The stage clock: what ran where, for how long, on how much.

use std::time::Instant;

use crate::compute::{Outputs, StepTime};

/// One stage of a run.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct Stage {
    /// Stage name.
    pub name: &'static str,
    /// Where it ran: `cpu`, or the device's name.
    pub device: String,
    /// Milliseconds: wall time of CPU stages, and of a plan from hand-over to results.
    pub ms: f64,
    /// Items worked on.
    pub items: u64,
    /// What an item is.
    pub unit: &'static str,
    /// Kernels of a plan, each with its own time.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub kernels: Vec<KernelTime>,
}

/// All launches of one kernel in a stage.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct KernelTime {
    /// Kernel.
    pub kernel: &'static str,
    /// Launches.
    pub launches: usize,
    /// Milliseconds on the device.
    pub ms: f64,
    /// Bytes of all buffers bound.
    pub bytes: u64,
}

/// Collects stages.
#[derive(Clone, Debug, Default)]
pub struct Clock {
    /// Stages in the order they ended.
    pub stages: Vec<Stage>,
}

impl Clock {
    /// Times a CPU stage; `items` counts what its result holds.
    pub fn time<T>(
        &mut self,
        name: &'static str,
        unit: &'static str,
        work: impl FnOnce() -> T,
        items: impl FnOnce(&T) -> u64,
    ) -> T {
        let start = Instant::now();
        let out = work();
        let ms = start.elapsed().as_secs_f64() * 1000.0;
        let items = items(&out);
        let device = "cpu".to_owned();
        self.stages.push(Stage { name, device, ms, items, unit, kernels: Vec::new() });
        out
    }

    /// Records a plan that ran.
    pub fn plan(
        &mut self,
        name: &'static str,
        device: &str,
        since: Instant,
        (items, unit): (u64, &'static str),
        out: &Outputs,
    ) {
        let ms = since.elapsed().as_secs_f64() * 1000.0;
        let mut kernels: Vec<KernelTime> = Vec::new();
        for StepTime { kernel, seconds, bytes, .. } in &out.times {
            match kernels.iter_mut().find(|k| k.kernel == *kernel) {
                Some(k) => {
                    k.launches += 1;
                    k.ms += seconds * 1000.0;
                    k.bytes += bytes;
                }
                None => kernels.push(KernelTime {
                    kernel,
                    launches: 1,
                    ms: seconds * 1000.0,
                    bytes: *bytes,
                }),
            }
        }
        let device = device.to_owned();
        self.stages.push(Stage { name, device, ms, items, unit, kernels });
    }

    /// Milliseconds of all stages together.
    pub fn total_ms(&self) -> f64 {
        self.stages.iter().map(|s| s.ms).sum()
    }
}
