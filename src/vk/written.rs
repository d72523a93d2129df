//! What of a buffer holds something: memory that was never written may hold any index.

use std::ops::Range;

/// Parts of equal size, each written from its first byte on.
pub(super) struct Written {
    part: u64,
    /// Bytes written of each part.
    bytes: Vec<u64>,
}

impl Written {
    /// Nothing of a buffer of `bytes`, in parts of `part` bytes.
    pub fn new(bytes: u64, part: u64) -> Self {
        let part = part.max(1);
        Self { part, bytes: vec![0; bytes.div_ceil(part) as usize] }
    }

    /// Notes that a range is written. What leaves a gap before it does not count.
    pub fn add(&mut self, range: Range<u64>) {
        for (part, within) in self.parts(range) {
            if let Some(bytes) = self.bytes.get_mut(part)
                && within.start <= *bytes
            {
                *bytes = (*bytes).max(within.end);
            }
        }
    }

    /// Nothing counts as written any more in parts that a range touches.
    pub fn forget(&mut self, range: Range<u64>) {
        for (part, _) in self.parts(range) {
            self.bytes.get_mut(part).into_iter().for_each(|bytes| *bytes = 0);
        }
    }

    /// Whether all of a range is written.
    pub fn holds(&self, range: Range<u64>) -> bool {
        self.parts(range)
            .all(|(part, within)| self.bytes.get(part).is_some_and(|b| within.end <= *b))
    }

    /// The parts of a range, each with what of it lies within.
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
    use super::Written;

    #[test]
    fn a_part_holds_what_was_written_from_its_start_without_a_gap() {
        let mut w = Written::new(95, 10);
        assert!(!w.holds(0..1) && w.holds(7..7));
        w.add(20..26);
        assert!(w.holds(20..26) && w.holds(23..24) && !w.holds(20..27) && !w.holds(19..21));
        w.add(28..30); // leaves two bytes out
        assert!(!w.holds(26..30) && !w.holds(28..30));
        w.add(26..28);
        assert!(w.holds(20..28) && !w.holds(20..29));
        w.add(20..22);
        assert!(w.holds(20..28), "writing less again takes nothing away");
    }

    #[test]
    fn a_range_over_several_parts_wants_each_of_them_whole_up_to_its_end() {
        let mut w = Written::new(95, 10);
        w.add(10..40);
        w.add(90..95);
        assert!(w.holds(10..40) && w.holds(19..31) && w.holds(90..95) && !w.holds(10..41));
        w.forget(25..26);
        assert!(!w.holds(20..21) && w.holds(10..20) && w.holds(30..40));
        assert!(!w.holds(90..96) && !w.holds(200..201), "past the end");
    }
}
