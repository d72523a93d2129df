//! Adaptive 4-8 subdivision by bisection: each triangle is split from its newest corner to the
//! midpoint of the opposite side.

use super::AdaptiveScheme;
use super::net::RefinedNet;

/// Triangles (a, b, c) whose next split side is (a, b), opposite the newest corner c.
pub struct FourEight {
    faces: Vec<[u32; 3]>,
}

impl FourEight {
    /// Every base face gets a vertex at its centre, so that each edge of the base is the diagonal
    /// of a quad and all sides that are split first match (Velho & Zorin, section 3). Departure:
    /// pairs of faces are not joined, which would spare some triangles and depend on the pairing.
    pub fn new(net: &mut RefinedNet) -> Self {
        let mut faces = Vec::with_capacity(3 * net.base.faces.len());
        for t @ [a, b, c] in net.base.faces.clone() {
            match net.centre(t) {
                Some(m) => faces.extend([[a, b, m], [b, c, m], [c, a, m]]),
                None => faces.push(t),
            }
        }
        Self { faces }
    }

    fn bisect(net: &mut RefinedNet, [a, b, c]: [u32; 3]) -> Option<[[u32; 3]; 2]> {
        let m = net.split_edge(a, b)?;
        Some([[c, a, m], [b, c, m]])
    }
}

impl AdaptiveScheme for FourEight {
    fn refine_once(
        &mut self,
        net: &mut RefinedNet,
        exceeds_tolerance: &dyn Fn(&RefinedNet, [u32; 3]) -> bool,
    ) -> usize {
        let marked: Vec<bool> = self.faces.iter().map(|t| exceeds_tolerance(net, *t)).collect();
        let count = marked.iter().filter(|n| **n).count();
        let mut next = Vec::with_capacity(self.faces.len() + count);
        for (t, marked) in self.faces.iter().zip(marked) {
            match marked.then(|| Self::bisect(net, *t)).flatten() {
                Some(two) => next.extend(two),
                None => next.push(*t),
            }
        }
        // Triangles with a hanging vertex are bisected until it is a corner.
        loop {
            let before = next.len();
            let mut mended = Vec::with_capacity(before);
            for t in next {
                let hangs = (0..3).any(|e| net.midpoint(t[e], t[(e + 1) % 3]).is_some());
                match hangs.then(|| Self::bisect(net, t)).flatten() {
                    Some(two) => mended.extend(two),
                    None => mended.push(t),
                }
            }
            next = mended;
            if next.len() == before {
                break;
            }
        }
        self.faces = next;
        count
    }

    fn faces(&self, _: &RefinedNet) -> Vec<[u32; 3]> {
        self.faces.clone()
    }
}
