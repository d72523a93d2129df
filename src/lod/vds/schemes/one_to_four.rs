//! Adaptive 1-to-4 subdivision: red triangles, and green templates where the neighbour is finer.

use super::AdaptiveScheme;
use super::net::RefinedNet;

/// The red triangles, without templates.
pub struct OneToFour {
    red: Vec<[u32; 3]>,
}

impl OneToFour {
    pub fn new(net: &RefinedNet) -> Self {
        Self { red: net.base.faces.clone() }
    }

    fn split(net: &mut RefinedNet, t: [u32; 3]) -> Option<[[u32; 3]; 4]> {
        let [a, b, c] = t;
        let (ab, bc, ca) = (net.split_edge(a, b)?, net.split_edge(b, c)?, net.split_edge(c, a)?);
        Some([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    }

    /// Whether a side of the triangle has been split twice: a template cannot close that.
    fn has_split_twice(net: &RefinedNet, t: [u32; 3]) -> bool {
        (0..3).any(|e| {
            let (a, b) = (t[e], t[(e + 1) % 3]);
            let half = |m| net.midpoint(a, m).is_some() || net.midpoint(m, b).is_some();
            net.midpoint(a, b).is_some_and(half)
        })
    }
}

impl AdaptiveScheme for OneToFour {
    fn refine_once(
        &mut self,
        net: &mut RefinedNet,
        exceeds_tolerance: &dyn Fn(&RefinedNet, [u32; 3]) -> bool,
    ) -> usize {
        let marked: Vec<bool> = self.red.iter().map(|t| exceeds_tolerance(net, *t)).collect();
        let count = marked.iter().filter(|n| **n).count();
        let mut next = Vec::with_capacity(self.red.len() + 3 * count);
        for (t, marked) in self.red.iter().zip(marked) {
            match marked.then(|| Self::split(net, *t)).flatten() {
                Some(four) => next.extend(four),
                None => next.push(*t),
            }
        }
        loop {
            let before = next.len();
            let mut mended = Vec::with_capacity(before);
            for t in next {
                match Self::has_split_twice(net, t).then(|| Self::split(net, t)).flatten() {
                    Some(four) => mended.extend(four),
                    None => mended.push(t),
                }
            }
            next = mended;
            if next.len() == before {
                break;
            }
        }
        self.red = next;
        count
    }

    fn faces(&self, net: &RefinedNet) -> Vec<[u32; 3]> {
        let mut all = Vec::with_capacity(self.red.len());
        for t in &self.red {
            let middle = [0, 1, 2].map(|e| net.midpoint(t[e], t[(e + 1) % 3]));
            crate::lod::vds::template::template(*t, middle, &mut all);
        }
        all
    }
}
