//! `--repeat`: the computation run again and again in memory.

use std::collections::BTreeMap;
use std::time::Instant;

use super::CliError;
use super::global::Global;
use crate::device::Device;
use crate::pipeline::{Clock, Stage};

/// What `--json` answers for a computing command.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Timing {
    /// Median seconds of the repeats (or of the one run).
    pub median_s: f64,
    /// Fastest, seconds.
    pub min_s: f64,
    /// Runs counted.
    pub runs: u32,
    /// Stages of the median run.
    pub stages: Vec<Stage>,
    /// The clock of the median run.
    #[serde(skip)]
    pub clock: Clock,
    /// Where plans ran.
    pub device: String,
    /// Result figures of the command.
    #[serde(flatten)]
    pub result: BTreeMap<&'static str, serde_json::Value>,
}

/// Runs `work` once, or a warm-up and `--repeat` times; returns the last result.
pub fn timed<T>(
    global: &Global,
    device: &mut Device,
    mut work: impl FnMut(&mut Device, &mut Clock) -> Result<T, CliError>,
) -> Result<(T, Timing), CliError> {
    let runs = global.repeat.unwrap_or(1);
    if global.repeat.is_some() {
        work(device, &mut Clock::default())?;
    }
    let mut measured: Vec<(f64, Clock)> = Vec::new();
    let mut last = None;
    for _ in 0..runs {
        drop(last.take());
        let mut clock = Clock::default();
        let start = Instant::now();
        last = Some(work(device, &mut clock)?);
        measured.push((start.elapsed().as_secs_f64(), clock));
    }
    measured.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (median, clock) = &measured[measured.len() / 2];
    let timing = Timing {
        median_s: *median,
        min_s: measured[0].0,
        runs,
        stages: clock.stages.clone(),
        clock: clock.clone(),
        device: device.name().to_owned(),
        result: BTreeMap::new(),
    };
    let result = last.expect("at least one run");
    Ok((result, timing))
}

impl Timing {
    /// The figures other programs look for, for a report to carry.
    pub fn keys(&self) -> BTreeMap<&'static str, f64> {
        BTreeMap::from([("median_s", self.median_s), ("min_s", self.min_s)])
    }

    /// Adds a figure of the result.
    pub fn with(mut self, name: &'static str, value: impl Into<serde_json::Value>) -> Self {
        self.result.insert(name, value.into());
        self
    }
}
