//! Staging: a ring of mapped memory that every frame writes its changes and draw commands to.
//!
//! Bytes stay until the timeline has passed the submission that reads them. The ring grows, by
//! doubling, up to [`STAGING_BYTES`]; beyond that the caller waits or sends less.

use std::collections::VecDeque;

use ash::vk;

use super::memory::{Buffer, MemoryUse};
use super::retire::Retired;
use super::{Gpu, VkError};

/// Largest size of the ring, bytes: three frames in flight and the one being made, 8 MiB each.
pub const STAGING_BYTES: u64 = 32 << 20;
/// Initial size of the ring, bytes.
const MIN_BYTES: u64 = 1 << 20;

/// Allocation state of a ring. `head` and `tail` are counted over all rounds, so that full and
/// empty differ.
#[derive(Debug, Default)]
struct Ring {
    bytes: u64,
    head: u64,
    tail: u64,
    /// Timeline values of submissions, each with the ring's head after it; values never decrease.
    marks: VecDeque<(u64, u64)>,
}

impl Ring {
    /// Reserves `n` contiguous bytes and returns their place.
    fn take(&mut self, n: u64) -> Option<u64> {
        if self.head == self.tail {
            (self.head, self.tail) = (0, 0);
        }
        let place = self.head.checked_rem(self.bytes)?;
        // A piece does not go round the end: the rest of this round is left empty.
        let skip = if place + n > self.bytes { self.bytes - place } else { 0 };
        if self.head + skip + n - self.tail > self.bytes {
            return None;
        }
        self.head += skip + n;
        Some((place + skip) % self.bytes)
    }

    /// Marks the bytes taken since the last mark as in use until `value` is reached.
    fn mark(&mut self, value: u64) {
        if self.marks.back().map_or(self.tail, |m| m.1) < self.head {
            self.marks.push_back((value, self.head));
        }
    }

    /// Gives back the bytes taken since the last mark.
    fn cancel(&mut self) {
        self.head = self.marks.back().map_or(self.tail, |m| m.1);
    }

    fn reap(&mut self, reached: u64) {
        while let Some(&(value, head)) = self.marks.front()
            && value <= reached
        {
            self.tail = head;
            self.marks.pop_front();
        }
    }
}

/// The ring and its memory.
#[derive(Default)]
pub(super) struct Staging {
    ring: Ring,
    pub buffer: Option<Buffer>,
}

impl Staging {
    /// Ends a submission: the bytes it took stay taken until `value`, or not at all if it failed.
    pub fn close(&mut self, sent: Option<u64>) {
        match sent {
            Some(value) => self.ring.mark(value),
            None => self.ring.cancel(),
        }
    }

    /// Returns the bytes at `place`, as the host sees them.
    pub fn bytes_mut(&mut self, place: u64, bytes: u64) -> &mut [u8] {
        let mapped = self.buffer.as_mut().and_then(Buffer::mapped_mut);
        &mut mapped.expect("staging memory is mapped")[place as usize..(place + bytes) as usize]
    }
}

impl Gpu {
    /// Takes `bytes` of the ring for the submission being made; `reached` is the timeline's value.
    pub(super) fn stage(&mut self, bytes: u64, reached: u64) -> Result<u64, VkError> {
        self.staging.ring.reap(reached);
        if let Some(place) = self.staging.ring.take(bytes) {
            return Ok(place);
        }
        let has = self.staging.ring.bytes;
        let more = (2 * has).max(MIN_BYTES).max(bytes.next_power_of_two()).min(STAGING_BYTES);
        if bytes > more || more == has {
            return Err(VkError::StagingFull { bytes, budget: STAGING_BYTES });
        }
        use vk::BufferUsageFlags as Use;
        let usage = Use::TRANSFER_SRC | Use::INDIRECT_BUFFER;
        let buffer = self.new_buffer("staging", more, usage, MemoryUse::Upload)?;
        if let Some(old) = self.staging.buffer.replace(buffer) {
            self.retired.push(self.timeline.submitted, Retired::Buffer(old));
        }
        self.staging.ring = Ring { bytes: more, ..Ring::default() };
        self.staging.ring.take(bytes).ok_or(VkError::StagingFull { bytes, budget: STAGING_BYTES })
    }

    /// Waits until the next submission can stage `bytes`. Does not wait while the ring has room or
    /// may grow, which is always so where no submission stages more than a quarter of
    /// [`STAGING_BYTES`] and no more than three are running.
    ///
    /// # Errors
    /// [`VkError::StagingFull`] if the whole ring would not hold them; [`VkError::DeviceLost`].
    pub fn make_room(&mut self, bytes: u64) -> Result<(), VkError> {
        if bytes > STAGING_BYTES {
            return Err(VkError::StagingFull { bytes, budget: STAGING_BYTES });
        }
        let mut reached = self.reached()?;
        loop {
            self.staging.ring.reap(reached);
            let may_grow = self.staging.ring.bytes < STAGING_BYTES;
            if may_grow || self.staging.ring.take(bytes).is_some() {
                self.staging.ring.cancel();
                return Ok(());
            }
            // Nothing in use and still no room cannot be: the ring begins anew when empty.
            let Some(&(value, _)) = self.staging.ring.marks.front() else {
                return Err(VkError::StagingFull { bytes, budget: STAGING_BYTES });
            };
            self.wait(value, "a frame that was staged before")?;
            reached = value;
        }
    }

    /// Returns the present size of the staging ring, bytes.
    pub fn staging_held(&self) -> u64 {
        self.staging.ring.bytes
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ring(bytes: u64) -> Ring {
        Ring { bytes, ..Ring::default() }
    }

    #[test]
    fn a_ring_goes_round_and_never_hands_out_what_is_in_use() {
        let mut r = ring(1000);
        let mut seed = 5u64;
        let mut live: VecDeque<(u64, Vec<(u64, u64)>)> = VecDeque::new();
        let (mut rounds, mut last, mut refused) = (0, 0, 0);
        for value in 1..5000 {
            let mut mine = Vec::new();
            for _ in 0..2 {
                seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
                let n = (seed >> 40) % 300 + 1;
                let Some(at) = r.take(n) else {
                    refused += 1;
                    continue;
                };
                assert!(at + n <= 1000, "{at} + {n}");
                let used = live.iter().flat_map(|l| &l.1).chain(&mine);
                for (a, m) in used {
                    assert!(at + n <= *a || a + m <= at, "{at}+{n} over {a}+{m}");
                }
                rounds += u32::from(at < last);
                last = at;
                mine.push((at, n));
            }
            r.mark(value);
            live.push_back((value, mine));
            if live.len() > (seed >> 20) as usize % 5 {
                let (done, _) = live.pop_front().unwrap();
                r.reap(done);
            }
        }
        assert!(rounds > 500 && refused > 100, "{rounds} rounds, {refused} refused");
    }

    #[test]
    fn an_empty_ring_holds_one_piece_as_large_as_itself() {
        let mut r = ring(100);
        assert_eq!(r.take(60), Some(0));
        r.mark(1);
        assert_eq!((r.take(60), r.take(41)), (None, None));
        r.reap(1);
        assert_eq!(r.take(100), Some(0));
        assert_eq!(r.take(1), None);
        r.cancel();
        assert_eq!(r.take(100), Some(0));
        assert_eq!(ring(0).take(0), None);
    }
}
