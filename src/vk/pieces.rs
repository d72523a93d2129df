//! A plan's launches in pieces: each a submission of its own, short enough that a window stays
//! alive beside it and no watchdog takes the device for hung.
//!
//! A launch is cut between workgroups (`vkCmdDispatchBase`), so that threads have the same numbers
//! in any number of pieces; workgroups of one launch depend on no order. How long a workgroup of a
//! kernel takes is measured with every piece ([`Rates`]).

use std::collections::BTreeMap;
use std::time::Duration;

use super::rates::Rates;
use crate::compute::Plan;

/// Target duration of a piece: workgroups differ, and none should take more than 100 ms.
pub(super) const AIM: Duration = Duration::from_millis(50);
/// Share of a piece that the first part of a launch may take: its parameters may make it slower
/// than the launch of the same kernel that was measured.
const FIRST: f64 = 0.25;
/// Most workgroups along x of a launch that needs two dimensions, which is cut between rows.
const ROW: u64 = 1024;

/// A part of a launch.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct LaunchSegment {
    /// Index of the launch in the plan.
    pub step: usize,
    /// First workgroup along x and y.
    pub base: [u32; 2],
    /// Workgroups along x and y.
    pub groups: [u32; 2],
}

impl LaunchSegment {
    /// Number of workgroups.
    pub fn count(&self) -> f64 {
        f64::from(self.groups[0]) * f64::from(self.groups[1])
    }

    /// Whether the segment holds its launch's first workgroup.
    pub fn is_first(&self) -> bool {
        self.base == [0, 0]
    }
}

/// Launches of a plan that have not been submitted.
pub(super) struct Pieces {
    /// Workgroups of each launch.
    grids: Vec<[u32; 2]>,
    step: usize,
    /// Number of workgroups of the current launch that are done; of a launch in two dimensions, of
    /// rows of them.
    done: u32,
}

impl Pieces {
    /// Starts at the beginning of a plan.
    ///
    /// * `limit`: most workgroups in a dimension.
    pub fn new(plan: &Plan<'_>, limit: u32) -> Self {
        let grid = |s: &crate::compute::Step| match s.threads {
            0 => [0, 0],
            threads => fold(threads, s.kernel.shader.workgroup, limit),
        };
        Self { grids: plan.steps().iter().map(grid).collect(), step: 0, done: 0 }
    }

    /// Whether all launches have been handed out.
    pub fn is_done(&self) -> bool {
        self.grids[self.step..].iter().all(|g| g[0] == 0)
    }

    /// Returns the next piece: as much as should take at most `aim` and is not much more than was
    /// measured ([`super::rates::GROWTH`]), and at least a workgroup, or a row of them where a launch has two
    /// dimensions.
    pub fn next(&mut self, plan: &Plan<'_>, rates: &Rates, aim: Duration) -> Vec<LaunchSegment> {
        let aim_s = aim.as_secs_f64();
        let mut left = aim_s;
        let mut piece = Vec::new();
        let mut taken = BTreeMap::<&'static str, f64>::new();
        while let Some(&[x, y]) = self.grids.get(self.step) {
            let (units, per_unit) = if y > 1 { (y, x) } else { (x, 1) };
            let kernel = plan.steps()[self.step].kernel.name();
            let seconds = f64::from(per_unit) * rates.of(kernel);
            let taken = taken.entry(kernel).or_default();
            let budget = if self.done == 0 { left.min(FIRST * aim_s) } else { left };
            let most = (rates.most(kernel, aim_s) - *taken) / f64::from(per_unit);
            // Saturates: no end of time is all there is.
            let fit = (budget / seconds).min(most).floor() as u32;
            let least = u32::from(piece.is_empty());
            let take = fit.max(least).min(units - self.done);
            if take == 0 && units > 0 {
                break;
            }
            left -= f64::from(take) * seconds;
            *taken += f64::from(take) * f64::from(per_unit);
            if take > 0 {
                let (base, groups) =
                    if y > 1 { ([0, self.done], [x, take]) } else { ([self.done, 0], [take, 1]) };
                piece.push(LaunchSegment { step: self.step, base, groups });
                self.done += take;
            }
            if self.done < units {
                break;
            }
            (self.step, self.done) = (self.step + 1, 0);
        }
        piece
    }
}

/// Returns the largest number of threads of one launch. Kernels count them in 32 bits.
pub(super) fn most_threads(groups: [u32; 2], workgroup: u32) -> u64 {
    let [x, y] = groups.map(u64::from);
    x.saturating_mul(y).saturating_mul(workgroup.into()).min(u32::MAX.into())
}

/// Workgroups for `threads`, folded into two dimensions where one would pass the device's limit;
/// `shaders/lib/thread.wgsl` unfolds them. Rows are short, so that pieces can be.
fn fold(threads: usize, workgroup: u32, limit: u32) -> [u32; 2] {
    let groups = threads.div_ceil(workgroup as usize) as u64;
    let limit = u64::from(limit);
    let y = if groups <= limit {
        1
    } else {
        let short = groups.div_ceil(ROW.min(limit));
        if short <= limit { short } else { groups.div_ceil(limit) }
    };
    [groups.div_ceil(y) as u32, y as u32]
}

#[cfg(test)]
mod tests {
    use super::super::rates::UNKNOWN_S;
    use super::*;
    use crate::kernels::copy;

    #[test]
    fn thread_limits_of_devices_with_huge_group_counts_do_not_overflow() {
        assert_eq!(most_threads([u32::MAX; 2], 1024), u64::from(u32::MAX));
        assert_eq!(most_threads([65_535, 65_535], 64), u64::from(u32::MAX));
        assert_eq!(most_threads([100, 3], 64), 19_200);
    }

    #[test]
    fn folded_workgroups_cover_every_thread_within_the_limit() {
        for threads in [1, 63, 64, 65, 65535 * 64, 65535 * 64 + 1, 512 * 512 * 512, 1 << 32] {
            let [x, y] = fold(threads, 64, 65535);
            assert!(x <= 65535 && y <= 65535, "{threads}: {x} x {y}");
            let covered = u64::from(x) * u64::from(y) * 64;
            assert!(covered >= threads as u64, "{threads}: {x} x {y}");
            assert!(covered - (threads as u64) < 64 * (u64::from(y) + 1), "{threads}: {x} x {y}");
        }
    }

    /// Launches of a kernel over so many threads.
    fn plan(threads: &[usize]) -> Plan<'static> {
        let mut plan = Plan::new();
        for &n in threads {
            let source = plan.zeroed("source", 4);
            let copied = plan.zeroed("copied", 4);
            let bindings = copy::Bindings { source, copied };
            plan.launch(&copy::KERNEL, bindings, copy::Params { quads: 4 }, n, n);
        }
        plan
    }

    #[test]
    fn pieces_cover_every_workgroup_once_in_order_and_hold_to_their_time() {
        let launches = [64 * 70, 0, 1, 64 * 3000, 64 * 65_535 + 1, 0];
        let plan = plan(&launches);
        for (rate, aim_ms) in [(UNKNOWN_S, 50), (1e-6, 50), (1e-3, 5), (1.0, 50), (1e-9, 50)] {
            let mut rates = Rates::default();
            rates.set(copy::KERNEL.name(), 1.0, rate);
            let aim = Duration::from_millis(aim_ms);
            let mut pieces = Pieces::new(&plan, 65_535);
            let mut all = Vec::new();
            while !pieces.is_done() {
                let piece = pieces.next(&plan, &rates, aim);
                let seconds: f64 = piece.iter().map(|s| s.count() * rate).sum();
                let least =
                    piece.len() == 1 && (piece[0].groups[0] == 1 || piece[0].groups[1] == 1);
                assert!(!piece.is_empty() && (seconds <= 0.001 * aim_ms as f64 + 1e-9 || least));
                all.extend(piece);
            }
            for (step, threads) in launches.into_iter().enumerate() {
                let [x, y] = if threads == 0 { [0, 0] } else { fold(threads, 64, 65_535) };
                let of: Vec<_> = all.iter().filter(|s| s.step == step).collect();
                let mut next = 0;
                for s in &of {
                    let at = if y > 1 { s.base[1] } else { s.base[0] };
                    assert_eq!(at, next, "{of:?}");
                    assert!(y <= 1 || s.groups[0] == x);
                    next += if y > 1 { s.groups[1] } else { s.groups[0] };
                }
                assert_eq!(next, if y > 1 { y } else { x }, "{of:?}");
            }
            assert!(all.is_sorted_by_key(|s| s.step));
        }
        // Without a limit on time all of it is one piece.
        let mut pieces = Pieces::new(&plan, 65_535);
        assert_eq!(pieces.next(&plan, &Rates::default(), Duration::MAX).len(), 4);
        assert!(pieces.is_done());
    }

    #[test]
    fn a_piece_is_no_more_than_four_times_the_one_measured_before() {
        let plan = plan(&[64 * 50_625, 64 * 50_625]);
        let mut pieces = Pieces::new(&plan, 65_535);
        let mut rates = Rates::default();
        let mut counts = vec![[0.0; 2]];
        while !pieces.is_done() {
            let piece = pieces.next(&plan, &rates, AIM);
            let mut count = [0.0; 2];
            for s in &piece {
                count[s.step] += s.count();
            }
            // Twenty times as fast as a kernel that was never measured.
            let took: Vec<f64> = piece.iter().map(|s| s.count() * UNKNOWN_S / 20.0).collect();
            rates.measured(&plan, &piece, &took);
            counts.push(count);
        }
        let first: Vec<f64> = counts.iter().map(|c| c[0]).filter(|c| *c > 0.0).collect();
        assert_eq!(first[..3], [125.0, 500.0, 2000.0]);
        assert!(counts.windows(2).all(|c| {
            let [before, now] = [c[0].iter().sum::<f64>(), c[1].iter().sum::<f64>()];
            now <= (4.0 * before).max(500.0)
        }));
        // The second launch may be slower: it begins with a quarter of a piece.
        let begins = counts.iter().map(|c| c[1]).find(|c| *c > 0.0);
        assert!(begins.is_some_and(|c| (2400.0..=2500.0).contains(&c)), "{begins:?}");
    }
}
