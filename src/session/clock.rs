//! The stage clock: what ran where, for how long, on how much.

use std::time::{Duration, Instant};

use crate::compute::{Outputs, StepTime};

/// One stage of a run.
#[derive(Clone, Debug, PartialEq, serde::Serialize)]
pub struct StageTime {
    /// Stage name.
    pub name: &'static str,
    /// Name of the device that it ran on, or `cpu`.
    pub device: String,
    /// Start, milliseconds since its clock began. Stages may run side by side.
    pub start_ms: f64,
    /// Milliseconds: wall time of CPU stages, and of a plan from hand-over to results.
    pub ms: f64,
    /// Items worked on.
    pub items: u64,
    /// Unit of the items, such as `voxels`.
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
#[derive(Clone, Debug)]
pub struct Clock {
    /// Stages in the order they ended; those of another clock after those before it.
    pub stages: Vec<StageTime>,
    began: Instant,
}

impl Default for Clock {
    fn default() -> Self {
        Self { stages: Vec::new(), began: Instant::now() }
    }
}

impl Clock {
    /// An empty clock that began when this one did, for another thread.
    pub fn fork(&self) -> Self {
        Self { stages: Vec::new(), began: self.began }
    }

    /// Appends the stages of another clock, which did not begin before this one.
    pub fn merge(&mut self, other: Self) {
        let later = milliseconds(other.began.saturating_duration_since(self.began));
        let moved = |s: StageTime| StageTime { start_ms: s.start_ms + later, ..s };
        self.stages.extend(other.stages.into_iter().map(moved));
    }

    /// Milliseconds since this clock began.
    pub fn elapsed_ms(&self) -> f64 {
        milliseconds(self.began.elapsed())
    }

    /// Records a stage that ends now.
    pub fn record(
        &mut self,
        name: &'static str,
        device: &str,
        since: Instant,
        (items, unit): (u64, &'static str),
        kernels: Vec<KernelTime>,
    ) {
        let ms = milliseconds(since.elapsed());
        let start_ms = milliseconds(since.saturating_duration_since(self.began));
        let device = device.to_owned();
        self.stages.push(StageTime { name, device, start_ms, ms, items, unit, kernels });
    }

    /// Times a CPU stage; `items` counts what its result holds.
    pub fn time<T>(
        &mut self,
        name: &'static str,
        unit: &'static str,
        work: impl FnOnce() -> T,
        items: impl FnOnce(&T) -> u64,
    ) -> T {
        crate::task::checkpoint();
        let start = Instant::now();
        let out = work();
        self.record(name, "cpu", start, (0, unit), Vec::new());
        if let Some(stage) = self.stages.last_mut() {
            stage.items = items(&out);
        }
        out
    }

    /// Records a plan that ran.
    pub fn record_plan(
        &mut self,
        name: &'static str,
        device: &str,
        since: Instant,
        items: (u64, &'static str),
        out: &Outputs,
    ) {
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
        self.record(name, device, since, items, kernels);
    }

    /// Milliseconds since this clock began that lie in no stage.
    pub fn unnamed_ms(&self) -> f64 {
        in_no_stage(&self.stages, self.elapsed_ms())
    }
}

/// Milliseconds of a time that lie in none of its stages.
fn in_no_stage(stages: &[StageTime], whole_ms: f64) -> f64 {
    let mut spans: Vec<[f64; 2]> = stages.iter().map(|s| [s.start_ms, s.start_ms + s.ms]).collect();
    spans.sort_by(|a, b| a[0].total_cmp(&b[0]));
    let (mut named, mut end) = (0.0, 0.0f64);
    for [from, to] in spans {
        named += (to - from.max(end)).max(0.0);
        end = end.max(to);
    }
    (whole_ms - named).max(0.0)
}

fn milliseconds(time: Duration) -> f64 {
    time.as_secs_f64() * 1000.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn time_in_no_stage_is_counted_once_however_stages_overlap() {
        let (device, kernels) = ("cpu".to_owned(), Vec::new());
        let any =
            StageTime { name: "s", device, start_ms: 0.0, ms: 0.0, items: 0, unit: "", kernels };
        let stage = |start_ms, ms| StageTime { start_ms, ms, ..any.clone() };
        let stages = [stage(50.0, 40.0), stage(0.0, 60.0), stage(10.0, 10.0)];
        assert_eq!(in_no_stage(&stages, 100.0), 10.0);
        assert_eq!(in_no_stage(&[stage(10.0, 10.0), stage(30.0, 10.0)], 40.0), 20.0);
        assert_eq!(in_no_stage(&[], 7.0), 7.0);
    }

    #[test]
    fn stages_keep_their_place_in_time_when_another_clock_takes_them() {
        let pause = || std::thread::sleep(Duration::from_millis(2));
        let mut clock = Clock::default();
        let mut aside = clock.fork();
        pause();
        let mut later = Clock::default();
        later.time("later", "pauses", pause, |()| 1);
        aside.time("aside", "pauses", pause, |()| 1);
        let (own, same) = (later.stages[0].start_ms, aside.stages[0].start_ms);
        clock.merge(later);
        clock.merge(aside);
        assert!(clock.stages[0].start_ms >= own + 2.0);
        assert_eq!(clock.stages[1].start_ms, same);
        let end = clock.stages[0].start_ms + clock.stages[0].ms;
        assert!(clock.stages[0].ms >= 2.0 && end <= same && same < clock.elapsed_ms());
    }
}
