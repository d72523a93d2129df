//! The circular bucket queue of the searches (Dial 1969, doi:10.1145/363269.363610).

/// A circular queue of buckets; words of bits tell which of them hold something.
pub(super) struct Queue<T> {
    buckets: Vec<Vec<T>>,
    busy: Vec<u64>,
    spare: Vec<T>,
    at: u32,
}

impl<T> Queue<T> {
    /// An empty queue.
    ///
    /// * `most`: the largest difference between keys that wait at the same time.
    /// * `first`: no more than any key.
    pub fn new(most: u32, first: u32) -> Self {
        let n = (most as usize + 1).next_power_of_two().max(64);
        let buckets = std::iter::repeat_with(Vec::new).take(n).collect();
        Self { buckets, busy: vec![0; n / 64], spare: Vec::new(), at: first }
    }

    /// Adds an item under a key, at least the last batch's.
    #[inline]
    pub fn push(&mut self, key: u32, item: T) {
        let i = key as usize & (self.buckets.len() - 1);
        self.busy[i / 64] |= 1 << (i % 64);
        self.buckets[i].push(item);
    }

    /// The next batch with its key.
    pub fn next(&mut self) -> Option<(u32, Vec<T>)> {
        let n = self.buckets.len();
        let start = self.at as usize & (n - 1);
        let mut w = start / 64;
        let mut word = self.busy[w] & !0 << (start % 64);
        for _ in 0..=n / 64 {
            if word != 0 {
                let i = w * 64 + word.trailing_zeros() as usize;
                self.busy[w] &= !(1 << (i % 64));
                self.at = self.at.wrapping_add((i.wrapping_sub(start) & (n - 1)) as u32);
                return Some((
                    self.at,
                    std::mem::replace(&mut self.buckets[i], std::mem::take(&mut self.spare)),
                ));
            }
            w = (w + 1) % (n / 64);
            word = self.busy[w];
        }
        None
    }

    /// Gives a batch's memory back.
    pub fn done(&mut self, mut batch: Vec<T>) {
        batch.clear();
        self.spare = batch;
    }
}
