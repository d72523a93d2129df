//! Slot cache: which patch occupies which slot of a buffer on the device, and when a slot may be
//! overwritten. The least recently used patch goes first.

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::hash::{BuildHasherDefault, Hasher};

/// Why no slot could be allocated.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoSlot {
    /// This step has used up its upload budget; the next one continues.
    UploadBudget,
    /// Every free slot may still be read by a frame in flight; a later step succeeds.
    InFlight,
    /// Every slot holds a patch of the current cut.
    AllDrawn,
}

#[derive(Clone, Copy, Debug)]
struct Resident {
    slot: u32,
    /// Step in which it was last part of the cut.
    last_used: u64,
    /// Step under which it stands in `by_age`.
    queued: u64,
}

/// Multiplicative hash. Keys are our own, so nobody can choose colliding ones, and every patch of
/// the cut is looked up in every step.
#[derive(Default)]
pub(super) struct KeyHasher(u64);

impl Hasher for KeyHasher {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u64(u64::from(*b)));
    }

    fn write_u32(&mut self, key: u32) {
        self.write_u64(u64::from(key));
    }

    fn write_u64(&mut self, key: u64) {
        // 2^64 by the golden ratio (Knuth, The Art of Computer Programming 3, 6.4).
        self.0 = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(26);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Map from the key of a patch to the slot that holds it.
///
/// A patch that leaves the cut keeps its slot until space is needed, so that turning back costs
/// nothing. Space is needed when all slots are taken, and also from twice the size of the cut:
/// memory that was never touched comes from the system slot by slot, which can take longer than
/// writing the patch. A slot is overwritten only after `in_flight` further steps, when no frame
/// that drew it can still be running.
#[derive(Debug)]
pub struct SlotCache {
    free: Vec<u32>,
    /// Freed slots with the step in which they were last drawn, oldest first.
    cooling: VecDeque<(u64, u32)>,
    residents: HashMap<u64, Resident, BuildHasherDefault<KeyHasher>>,
    /// (step, key) of every resident patch: last used in that step or later. Updated lazily, when
    /// something is evicted, which is rare, and not at each use.
    by_age: BTreeSet<(u64, u64)>,
    slots: u32,
    in_flight: u64,
    step: u64,
    uploads_left: u32,
    /// Patches touched or allocated in this step.
    touched: usize,
    /// Number of residents from which the oldest is evicted although slots are still free.
    soft_capacity: usize,
}

/// Residents that are never evicted early.
const MIN_RESIDENT: usize = 2048; // 5 MB

impl SlotCache {
    /// `slots` slots; frames of the last `in_flight` steps may still be running.
    pub fn new(slots: u32, in_flight: u32) -> Self {
        Self {
            free: (0..slots).rev().collect(),
            cooling: VecDeque::new(),
            residents: HashMap::default(),
            by_age: BTreeSet::new(),
            slots,
            in_flight: u64::from(in_flight),
            step: 0,
            uploads_left: 0,
            touched: 0,
            soft_capacity: MIN_RESIDENT,
        }
    }

    /// Capacity in slots.
    pub fn slots(&self) -> u32 {
        self.slots
    }

    /// Number of slots that hold a patch.
    pub fn resident_slots(&self) -> u32 {
        self.residents.len() as u32
    }

    /// Number of slots that may still be written in this step.
    pub fn uploads_left(&self) -> u32 {
        self.uploads_left
    }

    /// Begins the next step, in which at most `uploads` slots are written.
    pub fn begin_step(&mut self, uploads: u32) {
        self.step += 1;
        self.uploads_left = uploads;
        self.soft_capacity = MIN_RESIDENT.max(2 * self.touched);
        self.touched = 0;
        while let Some(&(last_used, slot)) = self.cooling.front() {
            if last_used + self.in_flight >= self.step {
                break;
            }
            self.cooling.pop_front();
            self.free.push(slot);
        }
    }

    /// The slot that holds `key`; marks it as used in this step.
    pub fn touch(&mut self, key: u64) -> Option<u32> {
        let r = self.residents.get_mut(&key)?;
        r.last_used = self.step;
        self.touched += 1;
        Some(r.slot)
    }

    /// Whether `key` is resident.
    pub fn contains(&self, key: u64) -> bool {
        self.residents.contains_key(&key)
    }

    /// Allocates a slot for a `key` that is not resident, to be written and drawn in this step.
    /// Patches that stay in the cut must have been touched before, or they may be evicted.
    ///
    /// # Errors
    /// [`NoSlot`] with the reason.
    ///
    /// # Panics
    /// If `key` is resident.
    pub fn allocate(&mut self, key: u64) -> Result<u32, NoSlot> {
        assert!(!self.residents.contains_key(&key), "a patch has one slot");
        if self.uploads_left == 0 {
            return Err(NoSlot::UploadBudget);
        }
        if self.free.is_empty() {
            self.evict(self.step);
        } else if self.residents.len() >= self.soft_capacity {
            self.evict(self.step.saturating_sub(self.in_flight));
        }
        let Some(slot) = self.free.pop() else {
            return Err(if self.cooling.is_empty() { NoSlot::AllDrawn } else { NoSlot::InFlight });
        };
        self.uploads_left -= 1;
        self.touched += 1;
        self.residents.insert(key, Resident { slot, last_used: self.step, queued: self.step });
        self.by_age.insert((self.step, key));
        Ok(slot)
    }

    /// Removes a patch and frees its slot.
    pub fn remove(&mut self, key: u64) {
        if let Some(r) = self.residents.remove(&key) {
            self.by_age.remove(&(r.queued, key));
            self.release(r);
        }
    }

    /// Evicts the least recently used patch, if it was last used before the step `before`.
    fn evict(&mut self, before: u64) {
        while let Some(&(queued, key)) = self.by_age.first() {
            let Some(r) = self.residents.get_mut(&key) else { return };
            if r.last_used == queued {
                if queued < before {
                    self.remove(key);
                }
                return;
            }
            // Used since then: update its place; all others were last used no earlier than their
            // place says.
            self.by_age.remove(&(queued, key));
            r.queued = r.last_used;
            self.by_age.insert((r.queued, key));
        }
    }

    fn release(&mut self, r: Resident) {
        if r.last_used + self.in_flight < self.step {
            self.free.push(r.slot);
        } else {
            // Sorted by step, so that `begin_step` looks at the front alone.
            let at = self.cooling.partition_point(|c| c.0 <= r.last_used);
            self.cooling.insert(at, (r.last_used, r.slot));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_slot_is_not_overwritten_while_frames_that_drew_it_are_in_flight() {
        let mut cache = SlotCache::new(2, 3);
        cache.begin_step(u32::MAX);
        let a = cache.allocate(1).unwrap();
        cache.allocate(2).unwrap();
        assert_eq!(cache.allocate(3), Err(NoSlot::AllDrawn));
        for wait in 0..3 {
            cache.begin_step(u32::MAX);
            cache.touch(2);
            assert_eq!(cache.allocate(3), Err(NoSlot::InFlight), "after {wait} steps");
        }
        cache.begin_step(u32::MAX);
        cache.touch(2);
        assert_eq!(cache.allocate(3), Ok(a));
        assert!(!cache.contains(1) && cache.contains(2) && cache.contains(3));
    }

    #[test]
    fn eviction_is_least_recently_used_and_never_takes_the_current_cut() {
        let mut cache = SlotCache::new(3, 0);
        for key in 1..=3 {
            cache.begin_step(u32::MAX);
            cache.allocate(key).unwrap();
        }
        cache.begin_step(u32::MAX);
        cache.touch(1);
        cache.allocate(4).unwrap();
        assert!(!cache.contains(2) && cache.contains(1) && cache.contains(3));
        cache.allocate(5).unwrap();
        assert!(!cache.contains(3));
        assert_eq!(cache.allocate(6), Err(NoSlot::AllDrawn));
        assert_eq!(cache.resident_slots(), 3);
    }

    #[test]
    fn stale_slots_are_reused_before_untouched_memory() {
        let mut cache = SlotCache::new(10 * MIN_RESIDENT as u32, 3);
        let mut slots = BTreeSet::new();
        // A flight that never turns back: a cut of 100 patches, ten of them new in each step.
        for step in 0..3 * MIN_RESIDENT as u64 / 10 {
            cache.begin_step(u32::MAX);
            for key in 10 * step..10 * step + 100 {
                if cache.touch(key).is_none() {
                    slots.insert(cache.allocate(key).unwrap());
                }
            }
        }
        assert_eq!(slots.len(), MIN_RESIDENT);
        // A larger cut still finds slots, and twice its size stays resident.
        for _ in 0..2 {
            cache.begin_step(u32::MAX);
            for key in 1_000_000..1_000_000 + 3 * MIN_RESIDENT as u64 {
                assert!(cache.touch(key).is_some() || cache.allocate(key).is_ok());
            }
        }
        assert!(cache.resident_slots() as usize >= 3 * MIN_RESIDENT);
        cache.begin_step(u32::MAX);
        assert_eq!(cache.soft_capacity, 6 * MIN_RESIDENT);
    }

    #[test]
    fn allocations_stop_at_the_upload_budget() {
        let mut cache = SlotCache::new(10, 1);
        cache.begin_step(2);
        assert!(cache.allocate(1).is_ok() && cache.allocate(2).is_ok());
        assert_eq!(cache.allocate(3), Err(NoSlot::UploadBudget));
        cache.begin_step(2);
        assert!(cache.allocate(3).is_ok());
    }

    #[test]
    fn no_slot_belongs_to_two_patches() {
        let mut cache = SlotCache::new(8, 1);
        let mut seed = 1u64;
        let mut drawn: Vec<u64> = Vec::new();
        for _ in 0..500 {
            cache.begin_step(u32::MAX);
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1);
            drawn.retain(|k| (k ^ seed >> 33) & 3 != 0);
            drawn.retain(|&k| cache.touch(k).is_some());
            for k in 0..3 {
                let key = (seed >> (20 + 5 * k)) % 40;
                if !cache.contains(key) && cache.allocate(key).is_ok() {
                    drawn.push(key);
                }
            }
            let mut slots: Vec<u32> = cache.residents.values().map(|r| r.slot).collect();
            slots.extend(cache.free.iter().chain(cache.cooling.iter().map(|c| &c.1)));
            slots.sort_unstable();
            assert_eq!(slots, (0..8).collect::<Vec<_>>());
        }
    }
}
