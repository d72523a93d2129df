//! Speed of each kernel on a device, measured with every piece of a plan and kept on disk between
//! runs: the first plan of a program then has as few pieces as any.
//!
//! Kept rates are hints. A file that is not whole, or of another version of the program, device or
//! driver, is as none, and a failure to read or write costs pieces and nothing else.

use std::collections::BTreeMap;
use std::fmt::Write as _;
use std::io::Write as _;
use std::path::{Path, PathBuf};

use super::info::Limits;
use super::pieces::LaunchSegment;
use crate::compute::Plan;
use crate::formats::read_plain;

/// Seconds of a workgroup that was never measured: more than any takes on a driver in software.
pub(super) const UNKNOWN_S: f64 = 1e-4;
/// Least part of a kernel's seconds a workgroup that is kept when a segment was faster.
const SLOWEST: f64 = 0.8;
/// Most workgroups of a kernel in a piece, as a multiple of those that were measured in one. Those of
/// one launch differ: bricks in the middle of a lumen take many times as long as those at its wall.
pub(super) const GROWTH: f64 = 4.0;
/// First line of a file.
const HEADING: &str = concat!("intima rates 1 ", env!("CARGO_PKG_VERSION"));
/// Largest file that is read.
const MAX_BYTES: u64 = 1 << 20;

/// Speed of a kernel, as last measured.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Rate {
    /// Seconds a workgroup.
    seconds: f64,
    /// Largest number of workgroups measured in a piece.
    groups: f64,
}

/// Speed of each kernel.
#[derive(Default)]
pub(super) struct Rates {
    by_kernel: BTreeMap<String, Rate>,
    /// File that they are kept in.
    path: Option<PathBuf>,
    has_changed: bool,
}

impl Rates {
    /// Opens the rates of this device and driver.
    ///
    /// * `folder`: of the file; nothing is kept without one.
    pub fn open(limits: &Limits, folder: Option<&Path>) -> Self {
        let uuid: String = limits.uuid.iter().map(|b| format!("{b:02x}")).collect();
        let name = format!("rates-{uuid}-{:08x}.txt", limits.driver_version);
        let path = folder.map(|folder| folder.join(name));
        let text = path.as_deref().and_then(|path| read_plain(path, MAX_BYTES).ok());
        let by_kernel = text.and_then(|text| parse(&String::from_utf8(text).ok()?));
        Self { by_kernel: by_kernel.unwrap_or_default(), path, has_changed: false }
    }

    pub fn of(&self, kernel: &str) -> f64 {
        self.by_kernel.get(kernel).map_or(UNKNOWN_S, |r| r.seconds)
    }

    /// Most workgroups of a kernel in the next piece; as many as of one never measured are always
    /// allowed.
    pub fn most(&self, kernel: &str, aim_s: f64) -> f64 {
        let most = |r: &Rate| (GROWTH * r.groups).max(aim_s / UNKNOWN_S);
        self.by_kernel.get(kernel).map_or(f64::INFINITY, most)
    }

    /// Updates the rates of a piece's kernels from the seconds that each segment took. Launches of one
    /// kernel differ by their parameters, workgroups by their place: a fast piece lowers a rate by a
    /// fifth at most.
    pub fn measured(&mut self, plan: &Plan<'_>, piece: &[LaunchSegment], seconds: &[f64]) {
        let mut sums = BTreeMap::<&'static str, [f64; 2]>::new();
        for (segment, took) in piece.iter().zip(seconds) {
            let [groups, all] = sums.entry(plan.steps()[segment.step].kernel.name()).or_default();
            (*groups, *all) = (*groups + segment.count(), *all + took);
        }
        for (kernel, [groups, all]) in sums {
            self.set(kernel, groups, (all / groups).max(1e-12));
        }
    }

    /// Takes in what a workgroup of a kernel took in a piece.
    pub fn set(&mut self, kernel: &str, groups: f64, seconds: f64) {
        self.has_changed = true;
        match self.by_kernel.get_mut(kernel) {
            Some(known) => {
                // The last piece of a launch has few.
                let groups = groups.max(known.groups);
                *known = Rate { seconds: seconds.max(SLOWEST * known.seconds), groups };
            }
            None => drop(self.by_kernel.insert(kernel.to_owned(), Rate { seconds, groups })),
        }
    }

    /// Shares the seconds of a piece among its segments, in proportion to their expected durations.
    pub fn shares(&self, plan: &Plan<'_>, piece: &[LaunchSegment], seconds: f64) -> Vec<f64> {
        let cost = |s: &LaunchSegment| s.count() * self.of(plan.steps()[s.step].kernel.name());
        let all: f64 = piece.iter().map(cost).sum();
        piece.iter().map(|s| seconds * cost(s) / all).collect()
    }
}

impl Drop for Rates {
    /// Writes the rates to disk, if they have changed.
    fn drop(&mut self) {
        if let Some(path) = self.path.as_ref().filter(|_| self.has_changed) {
            let _ = write(path, &self.by_kernel);
        }
    }
}

/// After the hash of the rest a heading, then a line a kernel: name, seconds a workgroup, workgroups.
fn parse(text: &str) -> Option<BTreeMap<String, Rate>> {
    let (hash, text) = text.split_once('\n')?;
    if blake3::hash(text.as_bytes()).to_hex().as_str() != hash {
        return None;
    }
    let mut lines = text.lines();
    if lines.next() != Some(HEADING) {
        return None;
    }
    let rate = |line: &str| {
        let [kernel, seconds, groups] = line.split(' ').collect::<Vec<_>>().try_into().ok()?;
        let number = |text: &str| text.parse().ok().filter(|v: &f64| v.is_finite() && *v > 0.0);
        let (seconds, groups) = (number(seconds)?, number(groups)?);
        Some((kernel.to_owned(), Rate { seconds, groups }))
    };
    lines.map(rate).collect()
}

fn write(path: &Path, rates: &BTreeMap<String, Rate>) -> std::io::Result<()> {
    let mut text = format!("{HEADING}\n");
    for (kernel, Rate { seconds, groups }) in rates {
        let _ = writeln!(text, "{kernel} {seconds:e} {groups}");
    }
    let folder = path.parent().ok_or(std::io::ErrorKind::InvalidInput)?;
    std::fs::create_dir_all(folder)?;
    let mut file = tempfile::NamedTempFile::new_in(folder)?;
    writeln!(file, "{}", blake3::hash(text.as_bytes()).to_hex())?;
    file.write_all(text.as_bytes())?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_rate_follows_slower_launches_at_once_and_faster_ones_by_fifths() {
        let mut rates = Rates::default();
        for (seconds, want) in [(0.1, 0.1), (0.4, 0.4), (0.01, 0.32), (0.01, 0.256), (0.3, 0.3)] {
            rates.set("kernel", 10.0, seconds);
            assert!((rates.of("kernel") - want).abs() < 1e-12, "{}", rates.of("kernel"));
        }
        // As many more as were measured in all launches of a piece, also after a small one.
        rates.set("kernel", 1e6, 1e-9);
        rates.set("kernel", 1.0, 1e-9);
        assert_eq!(rates.most("kernel", 0.05), 4e6);
    }

    #[test]
    fn rates_come_back_whole_for_their_device_and_version_and_else_not_at_all() {
        let folder = tempfile::tempdir().unwrap();
        let limits = Limits { uuid: [9; 16], driver_version: 3, ..Limits::default() };
        let open = |limits: &Limits| Rates::open(limits, Some(folder.path()));
        let mut rates = open(&limits);
        rates.set("copy", 10.0, 1.25e-8);
        rates.set("hessian", 7.0, 3.0);
        let measured = rates.by_kernel.clone();
        let path = rates.path.clone().unwrap();
        drop(rates);
        assert_eq!(open(&limits).by_kernel, measured);
        assert_eq!(open(&Limits { driver_version: 4, ..limits.clone() }).by_kernel.len(), 0);
        let whole = std::fs::read_to_string(&path).unwrap();
        let newer = whole.replace("rates 1", "rates 2");
        let cut = whole[..whole.len() - 2].to_owned();
        for bad in [newer, cut, whole.replace('7', "8"), format!("{whole}x 1 3"), String::new()] {
            std::fs::write(&path, &bad).unwrap();
            assert!(open(&limits).by_kernel.is_empty(), "{bad:?}");
        }
    }
}
