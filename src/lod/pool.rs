//! Pages on the device: who lies where, and when a page may be written again.

use std::collections::{BTreeSet, HashMap, VecDeque};
use std::hash::{BuildHasherDefault, Hasher};

/// Why no page could be had.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Full {
    /// This step has uploaded its share; the next one goes on.
    Upload,
    /// Every free page may still be read by a frame in flight; a later step finds it.
    Cooling,
    /// Every page holds a patch that is drawn.
    Pages,
}

#[derive(Clone, Copy, Debug)]
struct Resident {
    page: u32,
    /// Step in which it was last part of the cut.
    used: u64,
    /// Step under which it stands in the order of age.
    filed: u64,
}

/// Spreads keys over a table. They are ours, so that nobody chooses them to collide, and each drawn
/// patch is looked up in every step.
#[derive(Default)]
struct Spread(u64);

impl Hasher for Spread {
    fn write(&mut self, bytes: &[u8]) {
        bytes.iter().for_each(|b| self.write_u64(u64::from(*b)));
    }

    fn write_u64(&mut self, key: u64) {
        // 2^64 by the golden ratio (Knuth, The Art of Computer Programming 3, 6.4).
        self.0 = (self.0 ^ key).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(26);
    }

    fn finish(&self) -> u64 {
        self.0
    }
}

/// Pages by the key of what they hold. A patch that leaves the cut keeps its page until the room is
/// needed, least recently used first: turning back costs nothing. Room is needed when all pages are
/// taken, and also from twice the cut on: memory that was never touched comes from the system a
/// page at a time, which can take longer than writing the patch. A page is written again only
/// after `in_flight` further steps, when no frame that drew it can still be running.
#[derive(Debug)]
pub struct Pool {
    free: Vec<u32>,
    /// Freed pages with the step in which they were last drawn.
    cooling: VecDeque<(u64, u32)>,
    of: HashMap<u64, Resident, BuildHasherDefault<Spread>>,
    /// (step, key) of every resident patch: last used in that step or later. Brought up to date
    /// when something has to go, which it hardly ever has, and not at each use.
    by_age: BTreeSet<(u64, u64)>,
    pages: u32,
    in_flight: u64,
    now: u64,
    budget: u32,
    left: u32,
    /// Patches kept or claimed in this step.
    drawn: usize,
    /// Residents from which on the oldest makes room, though there are pages that held nothing yet.
    enough: usize,
}

/// Residents that always stay.
const FEW: usize = 2048; // 5 MB

impl Pool {
    /// `pages` pages; at most `uploads` of them are written in one step; frames of the last
    /// `in_flight` steps may still be running.
    pub fn new(pages: u32, uploads: u32, in_flight: u32) -> Self {
        Self {
            free: (0..pages).rev().collect(),
            cooling: VecDeque::new(),
            of: HashMap::default(),
            by_age: BTreeSet::new(),
            pages,
            in_flight: u64::from(in_flight),
            now: 0,
            budget: uploads,
            left: uploads,
            drawn: 0,
            enough: FEW,
        }
    }

    /// Pages there are.
    pub fn pages(&self) -> u32 {
        self.pages
    }

    /// Pages that hold a patch.
    pub fn resident(&self) -> u32 {
        self.of.len() as u32
    }

    /// Pages that may still be written in this step.
    pub fn left(&self) -> u32 {
        self.left
    }

    /// Begins the next step.
    pub fn begin(&mut self) {
        self.now += 1;
        self.left = self.budget;
        self.enough = FEW.max(2 * self.drawn);
        self.drawn = 0;
        while let Some(&(used, page)) = self.cooling.front() {
            if used + self.in_flight >= self.now {
                break;
            }
            self.cooling.pop_front();
            self.free.push(page);
        }
    }

    /// The page that holds `key`, which thereby counts as drawn in this step.
    pub fn keep(&mut self, key: u64) -> Option<u32> {
        let r = self.of.get_mut(&key)?;
        r.used = self.now;
        self.drawn += 1;
        Some(r.page)
    }

    /// Whether `key` has a page.
    pub fn holds(&self, key: u64) -> bool {
        self.of.contains_key(&key)
    }

    /// A page for a `key` that has none, to be written and drawn in this step. Patches that stay in
    /// the cut must have been kept before, or they may be driven out.
    ///
    /// # Errors
    /// Why there is none.
    ///
    /// # Panics
    /// If `key` has a page.
    pub fn claim(&mut self, key: u64) -> Result<u32, Full> {
        assert!(!self.of.contains_key(&key), "a patch has one page");
        if self.left == 0 {
            return Err(Full::Upload);
        }
        if self.free.is_empty() {
            self.evict(self.now);
        } else if self.of.len() >= self.enough {
            self.evict(self.now.saturating_sub(self.in_flight));
        }
        let Some(page) = self.free.pop() else {
            return Err(if self.cooling.is_empty() { Full::Pages } else { Full::Cooling });
        };
        self.left -= 1;
        self.drawn += 1;
        self.of.insert(key, Resident { page, used: self.now, filed: self.now });
        self.by_age.insert((self.now, key));
        Ok(page)
    }

    /// Frees the page of a patch whose content will not be asked for again.
    pub fn forget(&mut self, key: u64) {
        if let Some(r) = self.of.remove(&key) {
            self.by_age.remove(&(r.filed, key));
            self.release(r);
        }
    }

    /// Frees the page that was not drawn for longest, if that was before the step `before`.
    fn evict(&mut self, before: u64) {
        while let Some(&(filed, key)) = self.by_age.first() {
            let Some(r) = self.of.get_mut(&key) else { return };
            if r.used == filed {
                if filed < before {
                    self.forget(key);
                }
                return;
            }
            // Used since; all others were last used no earlier than they are filed.
            self.by_age.remove(&(filed, key));
            r.filed = r.used;
            self.by_age.insert((r.filed, key));
        }
    }

    fn release(&mut self, r: Resident) {
        if r.used + self.in_flight < self.now {
            self.free.push(r.page);
        } else {
            // Kept in order of time, so that `begin` looks at the front alone.
            let at = self.cooling.partition_point(|c| c.0 <= r.used);
            self.cooling.insert(at, (r.used, r.page));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_page_is_not_written_while_a_frame_that_drew_it_may_run() {
        let mut pool = Pool::new(2, 10, 3);
        pool.begin();
        let a = pool.claim(1).unwrap();
        pool.claim(2).unwrap();
        assert_eq!(pool.claim(3), Err(Full::Pages));
        for wait in 0..3 {
            pool.begin();
            pool.keep(2);
            assert_eq!(pool.claim(3), Err(Full::Cooling), "after {wait} steps");
        }
        pool.begin();
        pool.keep(2);
        assert_eq!(pool.claim(3), Ok(a));
        assert!(!pool.holds(1) && pool.holds(2) && pool.holds(3));
    }

    #[test]
    fn what_was_drawn_longest_ago_goes_first_and_what_is_drawn_stays() {
        let mut pool = Pool::new(3, 10, 0);
        for key in 1..=3 {
            pool.begin();
            pool.claim(key).unwrap();
        }
        pool.begin();
        pool.keep(1);
        pool.claim(4).unwrap();
        assert!(!pool.holds(2) && pool.holds(1) && pool.holds(3));
        pool.claim(5).unwrap();
        assert!(!pool.holds(3));
        assert_eq!(pool.claim(6), Err(Full::Pages));
        assert_eq!(pool.resident(), 3);
    }

    #[test]
    fn what_was_left_behind_makes_room_before_memory_that_was_never_touched() {
        let mut pool = Pool::new(10 * FEW as u32, u32::MAX, 3);
        let mut pages = BTreeSet::new();
        // A flight that never turns back: a cut of 100, of which ten are new in each step.
        for step in 0..3 * FEW as u64 / 10 {
            pool.begin();
            for key in 10 * step..10 * step + 100 {
                if pool.keep(key).is_none() {
                    pages.insert(pool.claim(key).unwrap());
                }
            }
        }
        assert_eq!(pages.len(), FEW);
        // A cut larger than that still finds pages, and twice as many stay.
        for _ in 0..2 {
            pool.begin();
            for key in 1_000_000..1_000_000 + 3 * FEW as u64 {
                assert!(pool.keep(key).is_some() || pool.claim(key).is_ok());
            }
        }
        assert!(pool.resident() as usize >= 3 * FEW);
        pool.begin();
        assert_eq!(pool.enough, 6 * FEW);
    }

    #[test]
    fn a_step_writes_no_more_pages_than_its_budget() {
        let mut pool = Pool::new(10, 2, 1);
        pool.begin();
        assert!(pool.claim(1).is_ok() && pool.claim(2).is_ok());
        assert_eq!(pool.claim(3), Err(Full::Upload));
        pool.begin();
        assert!(pool.claim(3).is_ok());
    }

    #[test]
    fn pages_are_handed_out_once() {
        let mut pool = Pool::new(8, 100, 1);
        let mut seed = 1u64;
        let mut drawn: Vec<u64> = Vec::new();
        for _ in 0..500 {
            pool.begin();
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1);
            drawn.retain(|k| (k ^ seed >> 33) & 3 != 0);
            drawn.retain(|&k| pool.keep(k).is_some());
            for k in 0..3 {
                let key = (seed >> (20 + 5 * k)) % 40;
                if !pool.holds(key) && pool.claim(key).is_ok() {
                    drawn.push(key);
                }
            }
            let mut pages: Vec<u32> = pool.of.values().map(|r| r.page).collect();
            pages.extend(pool.free.iter().chain(pool.cooling.iter().map(|c| &c.1)));
            pages.sort_unstable();
            assert_eq!(pages, (0..8).collect::<Vec<_>>());
        }
    }
}
