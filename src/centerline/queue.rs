//! The circular bucket queue of the searches (Dial 1969, doi:10.1145/363269.363610).

/// End of a list.
const LAST: u32 = u32::MAX;

/// A circular queue of buckets; words of bits tell which of them hold something. Buckets are lists
/// through one pool of waiting items: there may be far more buckets than items, and a bucket's
/// memory is then a number, near the others in the cache.
pub(super) struct Queue {
    /// Last item of each bucket.
    heads: Vec<u32>,
    busy: Vec<u64>,
    /// Items with the one pushed before into the same bucket.
    pool: Vec<(u32, u32)>,
    /// Places of the pool to use again.
    free: Vec<u32>,
    at: u32,
}

impl Queue {
    /// An empty queue.
    ///
    /// * `most`: the largest difference between keys that wait at the same time.
    /// * `first`: no more than any key.
    pub fn new(most: u32, first: u32) -> Self {
        let n = (most as usize + 1).next_power_of_two().max(64);
        let (pool, free) = (Vec::new(), Vec::new());
        Self { heads: vec![LAST; n], busy: vec![0; n / 64], pool, free, at: first }
    }

    /// Adds an item under a key, at least the last batch's.
    #[inline]
    pub fn push(&mut self, key: u32, item: u32) {
        let i = key as usize & (self.heads.len() - 1);
        self.busy[i / 64] |= 1 << (i % 64);
        let entry = (item, self.heads[i]);
        self.heads[i] = match self.free.pop() {
            Some(place) => {
                self.pool[place as usize] = entry;
                place
            }
            None => {
                self.pool.push(entry);
                self.pool.len() as u32 - 1
            }
        };
    }

    /// The next batch's key, and its items in the order they were pushed.
    pub fn next(&mut self, batch: &mut Vec<u32>) -> Option<u32> {
        batch.clear();
        let n = self.heads.len();
        let start = self.at as usize & (n - 1);
        let mut w = start / 64;
        let mut word = self.busy[w] & !0 << (start % 64);
        for _ in 0..=n / 64 {
            if word != 0 {
                let i = w * 64 + word.trailing_zeros() as usize;
                self.busy[w] &= !(1 << (i % 64));
                self.at = self.at.wrapping_add((i.wrapping_sub(start) & (n - 1)) as u32);
                let mut place = std::mem::replace(&mut self.heads[i], LAST);
                while place != LAST {
                    let (item, before) = self.pool[place as usize];
                    batch.push(item);
                    self.free.push(place);
                    place = before;
                }
                batch.reverse();
                return Some(self.at);
            }
            w = (w + 1) % (n / 64);
            word = self.busy[w];
        }
        None
    }
}

#[cfg(test)]
mod tests {
    use super::Queue;

    #[test]
    fn batches_come_by_key_and_within_one_as_they_were_pushed() {
        let mut q = Queue::new(100, 7);
        for (key, item) in [(90, 1), (7, 2), (90, 3), (107, 4), (90, 5)] {
            q.push(key, item);
        }
        let mut batch = Vec::new();
        assert_eq!((q.next(&mut batch), &batch[..]), (Some(7), &[2][..]));
        q.push(7, 6); // under the key just taken
        q.push(20, 7);
        assert_eq!((q.next(&mut batch), &batch[..]), (Some(7), &[6][..]));
        assert_eq!((q.next(&mut batch), &batch[..]), (Some(20), &[7][..]));
        assert_eq!((q.next(&mut batch), &batch[..]), (Some(90), &[1, 3, 5][..]));
        q.push(190, 8); // once around
        assert_eq!((q.next(&mut batch), &batch[..]), (Some(107), &[4][..]));
        assert_eq!((q.next(&mut batch), &batch[..]), (Some(190), &[8][..]));
        assert_eq!(q.next(&mut batch), None);
    }
}
