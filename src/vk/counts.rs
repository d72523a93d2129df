//! Counts of what running plans asked of a device, beside the least that had to be.

use serde::Serialize;

use super::plan_memory::PlanMemory;
use crate::compute::{Contents, Plan};

/// Counts of what plans asked of a device. Sizes in bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct PlanCounts {
    /// Plans.
    pub plans: u64,
    /// Launches.
    pub launches: u64,
    /// Pieces of memory taken from the system.
    pub allocations: u64,
    /// Submissions to the queue.
    pub submissions: u64,
    /// Times the host waited for the device.
    pub waits: u64,
    /// Barriers between commands.
    pub barriers: u64,
    /// Size of what was filled with zeros.
    pub cleared_bytes: u64,
    /// Size of what the host wrote for the device.
    pub uploaded_bytes: u64,
    /// Size of what the device copied, to and from memory that the host reaches.
    pub copied_bytes: u64,
    /// Size of what the host took back.
    pub read_back_bytes: u64,
    /// Largest memory of one plan's buffers.
    pub arena_bytes: u64,
    /// Duration of the plans on the host, µs, from their first buffer made to the last freed.
    pub host_us: u64,
    /// Time of it spent writing inputs, µs.
    pub write_us: u64,
    /// Time of it spent waiting for the device, µs.
    pub wait_us: u64,
    /// Time of it spent taking results, µs.
    pub take_us: u64,
}

impl PlanCounts {
    /// Least that a plan has to ask: one submission and one wait, memory that is there already,
    /// nothing cleared but what launches read before they write it, each input written and each
    /// result taken once.
    ///
    /// * `bound`: whether a launch binds each buffer.
    /// * `memory`: knows the largest size of buffers in use at once, and which were on the device
    ///   already.
    /// * `staged`: whether the host cannot reach the device's memory, so that inputs and results
    ///   have to be copied.
    pub(super) fn least(
        plan: &Plan<'_>,
        bound: &[bool],
        memory: &PlanMemory,
        staged: bool,
    ) -> Self {
        let sum = |keep: &dyn Fn(&Contents<'_>) -> bool| {
            let of =
                plan.buffers().iter().zip(bound).filter(|(b, bound)| **bound && keep(&b.contents));
            of.map(|(b, _)| b.bytes as u64).sum::<u64>()
        };
        let inputs = sum(&|c| matches!(c, Contents::Borrowed(_) | Contents::Owned(_)));
        let uploaded_bytes = inputs - memory.resident_bytes(plan);
        let results = plan.downloads().iter().map(|id| id.0 as usize).filter(|at| bound[*at]);
        let read_back_bytes = results.map(|at| plan.buffers()[at].bytes as u64).sum();
        Self {
            plans: 1,
            launches: plan.steps().len() as u64,
            allocations: 0,
            submissions: 1,
            waits: 1,
            barriers: 0,
            cleared_bytes: sum(&|c| matches!(c, Contents::Zeroed)),
            uploaded_bytes,
            copied_bytes: if staged { uploaded_bytes + read_back_bytes } else { 0 },
            read_back_bytes,
            arena_bytes: memory.least_bytes(),
            ..Self::default()
        }
    }

    /// Returns the counts of the plans that came after `earlier`. The memory is that of the largest
    /// plan of all.
    #[must_use]
    pub fn since(&self, earlier: &Self) -> Self {
        Self {
            plans: self.plans - earlier.plans,
            launches: self.launches - earlier.launches,
            allocations: self.allocations - earlier.allocations,
            submissions: self.submissions - earlier.submissions,
            waits: self.waits - earlier.waits,
            barriers: self.barriers - earlier.barriers,
            cleared_bytes: self.cleared_bytes - earlier.cleared_bytes,
            uploaded_bytes: self.uploaded_bytes - earlier.uploaded_bytes,
            copied_bytes: self.copied_bytes - earlier.copied_bytes,
            read_back_bytes: self.read_back_bytes - earlier.read_back_bytes,
            arena_bytes: self.arena_bytes,
            host_us: self.host_us - earlier.host_us,
            write_us: self.write_us - earlier.write_us,
            wait_us: self.wait_us - earlier.wait_us,
            take_us: self.take_us - earlier.take_us,
        }
    }

    /// Adds the counts of later plans.
    pub fn add(&mut self, later: &Self) {
        self.plans += later.plans;
        self.launches += later.launches;
        self.allocations += later.allocations;
        self.submissions += later.submissions;
        self.waits += later.waits;
        self.barriers += later.barriers;
        self.cleared_bytes += later.cleared_bytes;
        self.uploaded_bytes += later.uploaded_bytes;
        self.copied_bytes += later.copied_bytes;
        self.read_back_bytes += later.read_back_bytes;
        self.arena_bytes = self.arena_bytes.max(later.arena_bytes);
        self.host_us += later.host_us;
        self.write_us += later.write_us;
        self.wait_us += later.wait_us;
        self.take_us += later.take_us;
    }
}
