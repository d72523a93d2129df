//! Priority queue of vertices by the cost of their cheapest collapse.

use super::halfedge::NONE;

/// A vertex's cheapest collapse. Ordered by cost, then by vertex.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct HeapEntry {
    /// Bits of a cost that is not negative: they order as the costs do.
    pub cost: u64,
    /// The vertex.
    pub vertex: u32,
}

/// An indexed 4-ary heap with at most one entry a vertex, whose cost may change.
pub struct Heap {
    entries: Vec<HeapEntry>,
    /// Index of each vertex's entry, `NONE` where it has none.
    place: Vec<u32>,
}

impl Heap {
    /// Heap of the vertices that have a cost. O(V).
    pub fn new(costs: &[Option<f64>]) -> Self {
        let some = |(v, c): (usize, &Option<f64>)| {
            c.map(|c| HeapEntry { cost: c.to_bits(), vertex: v as u32 })
        };
        let entries: Vec<HeapEntry> = costs.iter().enumerate().filter_map(some).collect();
        let mut place = vec![NONE; costs.len()];
        for (i, e) in entries.iter().enumerate() {
            place[e.vertex as usize] = i as u32;
        }
        let mut heap = Self { entries, place };
        for i in (0..heap.entries.len().div_ceil(4)).rev() {
            heap.sink(i);
        }
        heap
    }

    /// All entries, in no order.
    pub fn entries(&self) -> &[HeapEntry] {
        &self.entries
    }

    /// The cheapest entry.
    pub fn first(&self) -> Option<HeapEntry> {
        self.entries.first().copied()
    }

    /// Removes the cheapest entry.
    pub fn pop(&mut self) {
        let Some(first) = self.first() else { return };
        self.place[first.vertex as usize] = NONE;
        let last = self.entries.pop();
        if let (Some(last), false) = (last, self.entries.is_empty()) {
            self.entries[0] = last;
            self.sink(0);
        }
    }

    /// Cost of a vertex's entry, as bits.
    #[inline]
    pub fn cost(&self, vertex: u32) -> Option<u64> {
        let at = self.place[vertex as usize];
        (at != NONE).then(|| self.entries[at as usize].cost)
    }

    /// Sets the cost of a vertex, whether it has an entry or not.
    pub fn set(&mut self, vertex: u32, cost: f64) {
        let entry = HeapEntry { cost: cost.to_bits(), vertex };
        let at = self.place[vertex as usize];
        if at == NONE {
            self.entries.push(entry);
            self.rise(self.entries.len() - 1);
            return;
        }
        let old = std::mem::replace(&mut self.entries[at as usize], entry);
        if entry < old {
            self.rise(at as usize);
        } else {
            self.sink(at as usize);
        }
    }

    fn rise(&mut self, mut i: usize) {
        let entry = self.entries[i];
        while i > 0 {
            let parent = (i - 1) / 4;
            let above = self.entries[parent];
            if above <= entry {
                break;
            }
            self.entries[i] = above;
            self.place[above.vertex as usize] = i as u32;
            i = parent;
        }
        self.entries[i] = entry;
        self.place[entry.vertex as usize] = i as u32;
    }

    fn sink(&mut self, mut i: usize) {
        let entry = self.entries[i];
        loop {
            let first = 4 * i + 1;
            let end = (first + 4).min(self.entries.len());
            let Some(children) = self.entries.get(first..end).filter(|c| !c.is_empty()) else {
                break;
            };
            let mut least = (first, children[0]);
            for (k, c) in children.iter().enumerate().skip(1) {
                if *c < least.1 {
                    least = (first + k, *c);
                }
            }
            if least.1 >= entry {
                break;
            }
            self.entries[i] = least.1;
            self.place[least.1.vertex as usize] = i as u32;
            i = least.0;
        }
        self.entries[i] = entry;
        self.place[entry.vertex as usize] = i as u32;
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn entries_pop_by_cost_then_vertex_after_any_changes() {
        let mut seed = 5u64;
        let mut noise = |n: u64| {
            seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
            (seed >> 33) % n
        };
        for n in [0usize, 1, 2, 5, 6, 100, 1000] {
            let mut want: Vec<Option<f64>> =
                (0..n).map(|_| (noise(5) > 0).then(|| noise(50) as f64)).collect();
            let mut heap = Heap::new(&want);
            for _ in 0..2 * n {
                let v = noise(n as u64) as usize;
                want[v] = Some(noise(50) as f64);
                heap.set(v as u32, want[v].unwrap());
                assert_eq!(heap.cost(v as u32), Some(want[v].unwrap().to_bits()));
            }
            let some = |(v, c): (usize, &Option<f64>)| c.map(|c| (c, v as u32));
            let mut want: Vec<(f64, u32)> = want.iter().enumerate().filter_map(some).collect();
            want.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            for (cost, vertex) in want {
                assert_eq!(heap.first(), Some(HeapEntry { cost: cost.to_bits(), vertex }));
                heap.pop();
            }
            assert_eq!(heap.first(), None);
        }
    }
}
