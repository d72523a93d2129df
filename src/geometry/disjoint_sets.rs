//! Disjoint sets of numbers, with path halving (Tarjan and van Leeuwen 1984,
//! doi:10.1145/62.2160).

/// Numbers from 0 on, each in one set. The root of a set is its smallest number.
#[derive(Clone, Debug, Default)]
pub struct DisjointSets(Vec<u32>);

impl DisjointSets {
    /// Creates sets of one number each.
    pub fn new(count: usize) -> Self {
        Self((0..count as u32).collect())
    }

    /// Adds a number, alone in its set.
    pub fn push(&mut self) -> u32 {
        let new = self.0.len() as u32;
        self.0.push(new);
        new
    }

    /// Returns the root of a number's set.
    pub fn root(&mut self, mut of: u32) -> u32 {
        let Self(up) = self;
        while up[of as usize] != of {
            up[of as usize] = up[up[of as usize] as usize];
            of = up[of as usize];
        }
        of
    }

    /// Joins the sets of two numbers; returns whether they were apart.
    pub fn join(&mut self, a: u32, b: u32) -> bool {
        let (a, b) = (self.root(a), self.root(b));
        self.0[a.max(b) as usize] = a.min(b);
        a != b
    }
}

#[cfg(test)]
mod tests {
    use super::DisjointSets;

    #[test]
    fn joined_numbers_share_the_smallest_as_root() {
        let mut sets = DisjointSets::new(6);
        assert!(sets.join(4, 2) && sets.join(5, 4) && !sets.join(2, 5));
        assert!(sets.join(1, 5) && sets.join(0, 3));
        let new = sets.push();
        let roots: Vec<u32> = (0..=new).map(|i| sets.root(i)).collect();
        assert_eq!(roots, [0, 1, 1, 0, 1, 1, 6]);
    }
}
