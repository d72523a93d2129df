//! Initialized bytes of a buffer: memory that was never written may hold any index.

use std::ops::Range;

/// Initialized ranges of a buffer: parts of equal size, each initialized from its first byte on.
pub(super) struct InitializedRanges {
    part: u64,
    /// Initialized bytes of each part, counted from its start.
    bytes: Vec<u64>,
}

impl InitializedRanges {
    /// Describes a buffer of `bytes` of which none are initialized, in parts of `part` bytes.
    pub fn new(bytes: u64, part: u64) -> Self {
        let part = part.max(1);
        Self { part, bytes: vec![0; bytes.div_ceil(part) as usize] }
    }

    /// Notes that a range is written. A range that leaves a gap before it does not count.
    pub fn add(&mut self, range: Range<u64>) {
        for (part, within) in self.parts(range) {
            if let Some(bytes) = self.bytes.get_mut(part)
                && within.start <= *bytes
            {
                *bytes = (*bytes).max(within.end);
            }
        }
    }

    /// Counts the parts that a range touches as uninitialized again.
    pub fn forget(&mut self, range: Range<u64>) {
        for (part, _) in self.parts(range) {
            self.bytes.get_mut(part).into_iter().for_each(|bytes| *bytes = 0);
        }
    }

    /// Whether all of a range is initialized.
    pub fn contains(&self, range: Range<u64>) -> bool {
        self.parts(range)
            .all(|(part, within)| self.bytes.get(part).is_some_and(|b| within.end <= *b))
    }

    /// Returns the parts that a range touches, each with the bytes of it within the part, counted
    /// from the part's start.
    fn parts(&self, range: Range<u64>) -> impl Iterator<Item = (usize, Range<u64>)> + use<> {
        let size = self.part;
        let parts = match range.is_empty() {
            true => 0..0,
            false => range.start / size..range.end.div_ceil(size),
        };
        parts.map(move |part| {
            let first = part * size;
            let start = range.start.max(first) - first;
            (part as usize, start..range.end.min(first + size) - first)
        })
    }
}

#[cfg(test)]
mod tests {
    use super::InitializedRanges;

    #[test]
    fn a_part_is_initialized_as_far_as_it_was_written_without_a_gap() {
        let mut w = InitializedRanges::new(95, 10);
        assert!(!w.contains(0..1) && w.contains(7..7));
        w.add(20..26);
        assert!(
            w.contains(20..26) && w.contains(23..24) && !w.contains(20..27) && !w.contains(19..21)
        );
        w.add(28..30); // leaves two bytes out
        assert!(!w.contains(26..30) && !w.contains(28..30));
        w.add(26..28);
        assert!(w.contains(20..28) && !w.contains(20..29));
        w.add(20..22);
        assert!(w.contains(20..28), "writing less again takes nothing away");
    }

    #[test]
    fn a_range_over_several_parts_is_initialized_if_each_is_up_to_its_end() {
        let mut w = InitializedRanges::new(95, 10);
        w.add(10..40);
        w.add(90..95);
        assert!(
            w.contains(10..40) && w.contains(19..31) && w.contains(90..95) && !w.contains(10..41)
        );
        w.forget(25..26);
        assert!(!w.contains(20..21) && w.contains(10..20) && w.contains(30..40));
        assert!(!w.contains(90..96) && !w.contains(200..201), "past the end");
    }
}
