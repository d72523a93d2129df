//! Slot cache: which patch occupies which slot of a buffer on the device. The least recently used patch
//! goes first.

use std::collections::{BTreeSet, HashMap};
use std::hash::{BuildHasherDefault, Hasher};

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
/// writing the patch. A slot may be overwritten as soon as it is not drawn: copies wait for the
/// frames before.
#[derive(Debug)]
pub struct SlotCache {
    free: Vec<u32>,
    residents: HashMap<u32, Resident, BuildHasherDefault<KeyHasher>>,
    /// (step, key) of every resident patch: last used in that step or later. Updated lazily, when
    /// something is evicted, which is rare, and not at each use.
    by_age: BTreeSet<(u64, u32)>,
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
    /// Creates a cache of so many slots.
    pub fn new(slots: u32) -> Self {
        Self {
            free: (0..slots).rev().collect(),
            residents: HashMap::default(),
            by_age: BTreeSet::new(),
            step: 0,
            uploads_left: 0,
            touched: 0,
            soft_capacity: MIN_RESIDENT,
        }
    }

    /// Begins the next step, in which at most `uploads` slots are written.
    pub fn begin_step(&mut self, uploads: u32) {
        self.step += 1;
        self.uploads_left = uploads;
        self.soft_capacity = MIN_RESIDENT.max(2 * self.touched);
        self.touched = 0;
    }

    /// The slot that holds `key`; marks it as used in this step.
    pub fn touch(&mut self, key: u32) -> Option<u32> {
        let r = self.residents.get_mut(&key)?;
        r.last_used = self.step;
        self.touched += 1;
        Some(r.slot)
    }

    /// Allocates a slot for a `key` that is not resident, to be written and drawn in this step; `None`
    /// if the step has used up its uploads, or if all slots hold patches of the present cut. Patches
    /// that stay in the cut must have been touched before, or they may be evicted.
    ///
    /// # Panics
    /// If `key` is resident.
    pub fn allocate(&mut self, key: u32) -> Option<u32> {
        assert!(!self.residents.contains_key(&key), "a patch has one slot");
        if self.uploads_left == 0 {
            return None;
        }
        if self.free.is_empty() || self.residents.len() >= self.soft_capacity {
            self.evict();
        }
        let slot = self.free.pop()?;
        self.uploads_left -= 1;
        self.touched += 1;
        self.residents.insert(key, Resident { slot, last_used: self.step, queued: self.step });
        self.by_age.insert((self.step, key));
        Some(slot)
    }

    /// Evicts the least recently used patch that is not of the present cut, if there is one.
    fn evict(&mut self) {
        while let Some(&(queued, key)) = self.by_age.first() {
            let Some(r) = self.residents.get_mut(&key) else { return };
            if r.last_used == queued {
                if queued < self.step {
                    self.free.push(r.slot);
                    self.residents.remove(&key);
                    self.by_age.remove(&(queued, key));
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
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn eviction_is_least_recently_used_and_never_takes_the_current_cut() {
        let mut cache = SlotCache::new(3);
        for key in 1..=3 {
            cache.begin_step(u32::MAX);
            cache.allocate(key).unwrap();
        }
        cache.begin_step(u32::MAX);
        cache.touch(1);
        cache.allocate(4).unwrap();
        let is_there = |cache: &SlotCache, key: u32| cache.residents.contains_key(&key);
        assert!(!is_there(&cache, 2) && is_there(&cache, 1) && is_there(&cache, 3));
        cache.allocate(5).unwrap();
        assert!(!is_there(&cache, 3));
        assert_eq!(cache.allocate(6), None);
        assert_eq!(cache.residents.len(), 3);
    }

    #[test]
    fn stale_slots_are_reused_before_untouched_memory() {
        let mut cache = SlotCache::new(10 * MIN_RESIDENT as u32);
        let mut slots = BTreeSet::new();
        // A flight that never turns back: a cut of 100 patches, ten of them new in each step.
        for step in 0..3 * MIN_RESIDENT as u32 / 10 {
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
            for key in 1_000_000..1_000_000 + 3 * MIN_RESIDENT as u32 {
                assert!(cache.touch(key).is_some() || cache.allocate(key).is_some());
            }
        }
        assert!(cache.residents.len() >= 3 * MIN_RESIDENT);
        cache.begin_step(u32::MAX);
        assert_eq!(cache.soft_capacity, 6 * MIN_RESIDENT);
    }

    #[test]
    fn allocations_stop_at_the_uploads_of_a_step() {
        let mut cache = SlotCache::new(10);
        cache.begin_step(2);
        assert!(cache.allocate(1).is_some() && cache.allocate(2).is_some());
        assert_eq!(cache.allocate(3), None);
        cache.begin_step(2);
        assert!(cache.allocate(3).is_some());
    }

    #[test]
    fn no_slot_belongs_to_two_patches() {
        let mut cache = SlotCache::new(8);
        let mut seed = 1u64;
        let mut drawn: Vec<u32> = Vec::new();
        for _ in 0..500 {
            cache.begin_step(u32::MAX);
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1);
            drawn.retain(|k| (u64::from(*k) ^ seed >> 33) & 3 != 0);
            drawn.retain(|&k| cache.touch(k).is_some());
            for k in 0..3 {
                let key = ((seed >> (20 + 5 * k)) % 40) as u32;
                if !cache.residents.contains_key(&key) && cache.allocate(key).is_some() {
                    drawn.push(key);
                }
            }
            let mut slots: Vec<u32> = cache.residents.values().map(|r| r.slot).collect();
            slots.extend(&cache.free);
            slots.sort_unstable();
            assert_eq!(slots, (0..8).collect::<Vec<_>>());
        }
    }
}
