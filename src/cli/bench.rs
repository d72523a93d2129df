//! `intima bench`: every kernel on every device, on a phantom.

use std::collections::BTreeMap;
use std::sync::Arc;

use serde::Serialize;

use super::CliError;
use super::global::Global;
use crate::device::DeviceChoice;
use crate::field::Response;
use crate::lumen::IntensitySelection;
use crate::session::copy_rate::{CopyRate, copy_rate};
use crate::session::{
    HessianSettings, LumenSettings, Mode, Product, Session, Settings, Source, StageTime,
    VolumeSource, kernels,
};
use crate::vk::PlanCounts;
use crate::volume::Volume;
use crate::volume::phantom::{Kind, Phantom};

/// `intima bench [STAGE…]`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Kernels or stages to show (default: all)
    stages: Vec<String>,
    /// Voxels along a side of the colon phantom
    #[arg(long, value_name = "N", default_value_t = 128)]
    size: u32,
    /// Timed runs after a warm-up; medians are shown
    #[arg(long, value_name = "N", default_value_t = 5, value_parser = clap::value_parser!(u32).range(1..=1000))]
    runs: u32,
    /// Also count what one chain of plans asks of each device, beside the least that it had to
    #[arg(long)]
    counts: bool,
}

/// One kernel or stage on one device.
#[derive(Debug, Serialize)]
struct BenchRow {
    /// Name of the kernel or stage.
    name: &'static str,
    /// Either `kernel` or `stage`.
    kind: &'static str,
    /// Name of the device.
    device: String,
    /// Median over the runs, all launches of a run together.
    median_ms: f64,
    /// Shortest run.
    min_ms: f64,
    /// Launches of a run.
    launches: usize,
    /// Elements processed in a run.
    items: u64,
    /// Noun of an element, such as `voxels`.
    unit: &'static str,
    /// Items a second, millions.
    rate_m_per_s: f64,
    /// Bytes of all bound buffers.
    bytes: u64,
    /// Bytes of bound buffers a second, 10⁹.
    gb_per_s: f64,
    /// Share of the rate at which the device copies memory.
    of_copy: f64,
}

/// Figures of a device as a whole.
#[derive(Debug, Serialize)]
struct DeviceSummary {
    /// Name of the device.
    device: String,
    /// Worker threads of the CPU stages.
    threads: usize,
    /// Rate at which the device copies memory.
    copy: CopyRate,
    /// Time from the making of the Vulkan instance to the first launches handed over.
    first_dispatch_ms: Option<f64>,
    /// Plans of one chain, and how often it handed work to the device.
    plans: usize,
    /// Submissions of the chain.
    submissions: u64,
    /// Allocations, submissions, waits and bytes of the chain on a Vulkan device that keeps the memory
    /// of an earlier chain.
    asked: PlanCounts,
    /// Least that it had to ask.
    least: PlanCounts,
}

/// Everything that was measured.
#[derive(Serialize)]
struct BenchReport {
    /// Phantom that was measured.
    phantom: &'static str,
    /// Voxels along a side.
    size: u32,
    /// Voxels of the lumen.
    lumen_voxels: u64,
    /// Bricks of 8³ voxels.
    bricks: usize,
    /// Devices that were measured.
    devices: Vec<DeviceSummary>,
    /// Kernels and stages on each device.
    rows: Vec<BenchRow>,
}

/// Name and device, then (ms, launches, items, unit, bytes) of each run.
type RunTimes =
    BTreeMap<(usize, &'static str, &'static str), Vec<(f64, usize, u64, &'static str, u64)>>;

impl Args {
    /// Times and prints.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        for s in &self.stages {
            let known = kernels().any(|k| k.name() == s) || STAGES.contains(&s.as_str());
            if !known {
                let names: Vec<_> = kernels().map(|k| k.name()).collect();
                return Err(CliError::Usage(format!(
                    "`{s}` is no kernel or stage; there are {} and the stages {}",
                    names.join(", "),
                    STAGES.join(", ")
                )));
            }
        }
        let phantom = Phantom::new(Kind::Colon, self.size, [1.0; 3])?;
        let volume = phantom.mask();
        let volume = Arc::new(volume);
        let (mut devices, mut rows) = (Vec::new(), Vec::new());
        let mut lumen_counts = (0, 0);
        for choice in choices(global) {
            // Opened in its turn: the time to its first dispatch is its own.
            let (summary, its, counts) = self.on(choice, &volume, global)?;
            lumen_counts = counts;
            devices.push(summary);
            rows.extend(its);
        }
        global.say(format_args!(
            "colon phantom, {0} x {0} x {0}, {1} lumen voxels in {2} bricks, median of {3}",
            self.size, lumen_counts.0, lumen_counts.1, self.runs
        ))?;
        global.say(format_args!(
            "{:<18} {:<34} {:>10} {:>10} {:>14} {:>10} {:>8} {:>7}",
            "kernel or stage",
            "device",
            "median ms",
            "min ms",
            "M items/s",
            "MB bound",
            "GB/s",
            "of copy"
        ))?;
        for r in &rows {
            global.say(format_args!(
                "{:<18} {:<34} {:>10.3} {:>10.3} {:>14.2} {:>10} {:>8} {:>7}  {}",
                r.name,
                r.device.chars().take(34).collect::<String>(),
                r.median_ms,
                r.min_ms,
                r.rate_m_per_s,
                // A stage is more than its kernels: it has no byte count of its own.
                if r.bytes > 0 { format!("{:.1}", r.bytes as f64 / 1e6) } else { "-".into() },
                if r.bytes > 0 { format!("{:.2}", r.gb_per_s) } else { "-".into() },
                if r.of_copy > 0.0 { format!("{:.0} %", 100.0 * r.of_copy) } else { "-".into() },
                r.unit
            ))?;
        }
        for d in &devices {
            global.say(d.line())?;
            if self.counts {
                d.counts().try_for_each(|line| global.say(line))?;
            }
        }
        global.answer(&BenchReport {
            phantom: "colon",
            size: self.size,
            lumen_voxels: lumen_counts.0,
            bricks: lumen_counts.1,
            devices,
            rows,
        })
    }

    /// DeviceSummary and rows of one device, and the lumen's voxels and bricks.
    fn on(
        &self,
        choice: DeviceChoice,
        volume: &Arc<Volume>,
        global: &Global,
    ) -> Result<OnDevice, CliError> {
        let source = Source::Image(VolumeSource::Memory(Arc::clone(volume)));
        let select = Some(IntensitySelection::Labels(Vec::new()));
        let lumen = LumenSettings { select, ..LumenSettings::default() };
        let settings = Settings { device: choice, lumen, ..global.settings() };
        let mut session = Session::new(source, settings)?;
        session.keep_volume();
        let segmented = session.lumen()?;
        let counts = (segmented.lumen.inside_voxels(), segmented.lumen.bricks.len());
        let device = session.device()?;
        let device = || device.lock();
        let before = device().submissions();
        let planned = |s: &&StageTime| STAGES.contains(&s.name) && !CPU_STAGES.contains(&s.name);
        let plans = stages(&mut session)?.iter().filter(planned).count();
        let submissions = device().submissions() - before;
        let mut runs: RunTimes = BTreeMap::new();
        for _ in 0..self.runs {
            for stage in stages(&mut session)? {
                let at = STAGES.iter().position(|s| *s == stage.name);
                if let Some(at) = at {
                    let key = (1000 + at, stage.name, "stage");
                    let row = (stage.ms, 1, stage.items, stage.unit, 0);
                    runs.entry(key).or_default().push(row);
                }
                for k in &stage.kernels {
                    let at = kernels().position(|a| a.name() == k.kernel);
                    let key = (at.unwrap_or(999), k.kernel, "kernel");
                    // The Hessian chain repeats the smoothing: keep the first of a run.
                    let done = runs.entry(key).or_default();
                    let unit = at.and_then(|i| kernels().nth(i)).map_or("items", |k| k.unit);
                    done.push((k.ms, k.launches, stage.items * k.launches as u64, unit, k.bytes));
                }
            }
        }
        let before = device().plan_counts();
        stages(&mut session)?;
        let after = device().plan_counts();
        let [asked, least] = [0, 1].map(|i| after[i].since(&before[i]));
        let copy = copy_rate(&mut device(), COPIED, self.runs as usize)?;
        let rate = copy.gb_per_s.max(1e-9);
        let at = kernels().position(|k| k.name() == "copy").unwrap_or(999);
        let each =
            copy.seconds.iter().map(|s| (s * 1e3, 1, copy.bytes / 16, "quads", 2 * copy.bytes));
        runs.insert((at, "copy", "kernel"), each.collect());
        let name = device().name().to_owned();
        let rows = runs
            .into_iter()
            .filter(|((_, n, _), _)| self.stages.is_empty() || self.stages.iter().any(|s| s == n))
            .map(|((_, kernel, kind), mut all)| {
                all.sort_by(|a, b| a.0.total_cmp(&b.0));
                let (ms, launches, items, unit, bytes) = all[all.len() / 2];
                BenchRow {
                    name: kernel,
                    kind,
                    device: if kind == "stage" && CPU_STAGES.contains(&kernel) {
                        "cpu".to_owned()
                    } else {
                        name.clone()
                    },
                    median_ms: ms,
                    min_ms: all[0].0,
                    launches,
                    items,
                    unit,
                    rate_m_per_s: items as f64 / ms.max(1e-9) / 1e3,
                    bytes,
                    gb_per_s: bytes as f64 / ms.max(1e-9) / 1e6,
                    of_copy: bytes as f64 / ms.max(1e-9) / 1e6 / rate,
                }
            })
            .collect();
        let summary = DeviceSummary {
            device: name,
            threads: rayon::current_num_threads(),
            copy,
            first_dispatch_ms: device().first_dispatch().map(|d| d.as_secs_f64() * 1e3),
            plans,
            submissions,
            asked,
            least,
        };
        Ok((summary, rows, counts))
    }
}

/// DeviceSummary and rows of one device, and the lumen's voxels and bricks.
type OnDevice = (DeviceSummary, Vec<BenchRow>, (u64, usize));

impl DeviceSummary {
    /// For people.
    fn line(&self) -> String {
        let Self { device, copy, plans, submissions, .. } = self;
        let mb = copy.bytes as f64 / 1e6;
        let mut line = format!("{device}: copies {mb:.0} MB at {:.2} GB/s", copy.gb_per_s);
        if let Some(ms) = self.first_dispatch_ms {
            line += &format!("; {ms:.0} ms from instance to first dispatch; ");
            line += &format!("{submissions} submissions for {plans} plans");
        }
        line
    }
}

impl DeviceSummary {
    /// Counts of a Vulkan device for people, a line each.
    fn counts(&self) -> impl Iterator<Item = String> {
        let Self { device, asked, least, .. } = self;
        let mb = |bytes: u64| format!("{:.3}", bytes as f64 / 1e6);
        let ms = |us: u64| format!("{:.3}", us as f64 / 1e3);
        let rows = [
            ("pieces of memory", asked.allocations.to_string(), least.allocations.to_string()),
            ("submissions", asked.submissions.to_string(), least.submissions.to_string()),
            ("waits of the host", asked.waits.to_string(), least.waits.to_string()),
            ("barriers", asked.barriers.to_string(), "-".to_owned()),
            ("cleared, MB", mb(asked.cleared_bytes), mb(least.cleared_bytes)),
            ("written by the host, MB", mb(asked.uploaded_bytes), mb(least.uploaded_bytes)),
            ("copied by the device, MB", mb(asked.copied_bytes), mb(least.copied_bytes)),
            ("read back, MB", mb(asked.read_back_bytes), mb(least.read_back_bytes)),
            ("memory of the largest plan, MB", mb(asked.arena_bytes), mb(least.arena_bytes)),
            ("host, ms", ms(asked.host_us), "-".to_owned()),
            ("  writing inputs, ms", ms(asked.write_us), "-".to_owned()),
            ("  waiting for the device, ms", ms(asked.wait_us), "-".to_owned()),
            ("  taking results, ms", ms(asked.take_us), "-".to_owned()),
        ];
        let head = format!(
            "{device}: {} plans with {} launches{:>14}{:>12}",
            asked.plans, asked.launches, "asked", "least"
        );
        let table = rows.map(|(name, asked, least)| format!("  {name:<32}{asked:>12}{least:>12}"));
        let any = asked.plans > 0;
        std::iter::once(head).chain(table).filter(move |_| any)
    }
}

/// Beyond the caches of most devices, and within a binding of those with small ones.
const COPIED: u64 = 128 << 20;

const STAGES: [&str; 8] = [
    "distance",
    "distance, smooth",
    "distance, ridge",
    "hessian",
    "visibility",
    "fair",
    "route",
    "surface",
];
const CPU_STAGES: [&str; 2] = ["route", "surface"];

/// Every stage once, each alone.
fn stages(session: &mut Session) -> Result<Vec<StageTime>, CliError> {
    session.forget(&[Product::Distance, Product::Fields, Product::Wall]);
    session.restart_clock();
    session.prepare(&[Product::Distance])?;
    // Its kernels are part of the next plan too: they are counted there.
    session.clock().stages.iter_mut().for_each(|s| s.kernels.clear());
    for product in [Product::Fields, Product::Route, Product::Visibility] {
        session.prepare(&[product])?;
    }
    // The paper's chain goes on to ridge candidates; what both have was counted above.
    let paper = session.in_mode(Mode::Paper);
    paper.prepare(&[Product::Fields])?;
    let mut ridge = paper.clock().stages.clone();
    ridge.iter_mut().for_each(|s| s.kernels.retain(|k| k.kernel.starts_with("ridge")));
    session.clock().stages.extend(ridge);
    let lumen = session.lumen()?;
    let before = session.clock().stages.len();
    session.distance_hessian(HessianSettings {
        sigma_mm: lumen.lumen.grid.spacing_mm.min_element(),
        response: Response::Ridge,
        dark: false,
    })?;
    // Its distance and smoothing were timed above already.
    for stage in &mut session.clock().stages[before..] {
        stage.kernels.retain(|k| k.kernel == "hessian");
    }
    session.prepare(&[Product::Wall])?;
    let stages = session.clock().stages.clone();
    Ok(stages)
}

/// The CPU and every Vulkan device, or the one asked for.
fn choices(global: &Global) -> Vec<DeviceChoice> {
    if global.device != DeviceChoice::Auto {
        return vec![global.device];
    }
    let gpus = crate::vk::list().unwrap_or_default().len();
    std::iter::once(DeviceChoice::Cpu).chain((0..gpus).map(DeviceChoice::GpuAt)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::session::stages;

    #[test]
    fn stages_have_the_names_of_the_table_of_stages() {
        // Steps of the stages of the surface and of no stage.
        for name in STAGES.iter().filter(|name| !["fair", "hessian"].contains(name)) {
            assert!(stages::STAGES.iter().any(|s| s.name == *name), "{name}");
        }
    }
}
