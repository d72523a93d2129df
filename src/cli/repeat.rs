//! `--repeat`: a computation run again and again in memory.

use std::collections::BTreeMap;
use std::time::Instant;

use super::CliError;
use super::global::Global;
use crate::session::{Clock, Product, Session, StageTime};

/// Result of a computing command, as `--json` prints it.
#[derive(Clone, Debug, serde::Serialize)]
pub struct Timing {
    /// Median seconds of the repeats (or of the one run).
    pub median_s: f64,
    /// Fastest, seconds.
    pub min_s: f64,
    /// Runs counted.
    pub runs: u32,
    /// Stages of the median run.
    pub stages: Vec<StageTime>,
    /// Name of the device on which plans ran.
    pub device: String,
    /// Result figures of the command.
    #[serde(flatten)]
    pub result: BTreeMap<&'static str, serde_json::Value>,
}

/// Runs `work` once, or a warm-up and `--repeat` times; returns the last result. `prepare` is
/// called before each run, outside the clock.
pub fn timed<S, T>(
    global: &Global,
    state: &mut S,
    device: impl Fn(&S) -> Result<String, CliError>,
    mut prepare: impl FnMut(&mut S),
    mut work: impl FnMut(&mut S) -> Result<(T, Clock), CliError>,
) -> Result<(T, Timing), CliError> {
    let runs = global.repeat.unwrap_or(1);
    if global.repeat.is_some() {
        prepare(state);
        work(state)?;
    }
    let mut measured: Vec<(f64, Clock)> = Vec::new();
    let mut last = None;
    for _ in 0..runs {
        drop(last.take());
        prepare(state);
        let start = Instant::now();
        let (result, clock) = work(state)?;
        measured.push((start.elapsed().as_secs_f64(), clock));
        last = Some(result);
    }
    measured.sort_by(|a, b| a.0.total_cmp(&b.0));
    let (median, clock) = &measured[measured.len() / 2];
    let timing = Timing {
        median_s: *median,
        min_s: measured[0].0,
        runs,
        stages: clock.stages.clone(),
        device: device(state)?,
        result: BTreeMap::new(),
    };
    let result = last.expect("at least one run");
    Ok((result, timing))
}

/// Times what a session makes: before each run `anew` and all that follows from them are
/// forgotten. What they need is computed before the first run.
pub fn timed_products<T>(
    global: &Global,
    session: &mut Session,
    needs: &[Product],
    anew: &[Product],
    mut work: impl FnMut(&Session) -> Result<T, CliError>,
) -> Result<(T, Timing), CliError> {
    if global.repeat.is_some() {
        session.keep_volume();
    }
    global.watched(session, || session.prepare(needs))?;
    let single = global.repeat.is_none();
    timed(
        global,
        session,
        |s| Ok(s.device_name()?),
        |s| {
            s.forget(anew);
            s.restart_clock();
        },
        |s| {
            let session = &*s;
            let result =
                if single { global.watched(session, || work(session))? } else { work(session)? };
            let clock = session.clock().clone();
            Ok((result, clock))
        },
    )
}

impl Timing {
    /// The figures other programs look for, for a report to carry.
    pub fn keys(&self) -> BTreeMap<&'static str, f64> {
        BTreeMap::from([("median_s", self.median_s), ("min_s", self.min_s)])
    }

    /// Adds a figure of the result.
    pub fn with(mut self, name: &'static str, value: impl serde::Serialize) -> Self {
        self.result.insert(name, serde_json::to_value(value).unwrap_or_default());
        self
    }
}
