//! One to four, adaptively: red triangles, and green templates where the neighbour is finer.

use super::Work;
use super::net::Net;

/// Triangles that were split the regular way only.
pub struct Quad {
    red: Vec<[u32; 3]>,
}

impl Quad {
    pub fn new(net: &Net) -> Self {
        Self { red: net.base.faces.clone() }
    }

    fn split(net: &mut Net, t: [u32; 3]) -> Option<[[u32; 3]; 4]> {
        let [a, b, c] = t;
        let (ab, bc, ca) = (net.halve(a, b)?, net.halve(b, c)?, net.halve(c, a)?);
        Some([[a, ab, ca], [ab, b, bc], [ca, bc, c], [ab, bc, ca]])
    }

    /// Whether a side of the triangle has been split twice: one template would not do.
    fn gapes(net: &Net, t: [u32; 3]) -> bool {
        (0..3).any(|e| {
            let (a, b) = (t[e], t[(e + 1) % 3]);
            let half = |m| net.middle(a, m).is_some() || net.middle(m, b).is_some();
            net.middle(a, b).is_some_and(half)
        })
    }
}

impl Work for Quad {
    fn round(&mut self, net: &mut Net, too_far: &dyn Fn(&Net, [u32; 3]) -> bool) -> usize {
        let named: Vec<bool> = self.red.iter().map(|t| too_far(net, *t)).collect();
        let count = named.iter().filter(|n| **n).count();
        let mut next = Vec::with_capacity(self.red.len() + 3 * count);
        for (t, named) in self.red.iter().zip(named) {
            match named.then(|| Self::split(net, *t)).flatten() {
                Some(four) => next.extend(four),
                None => next.push(*t),
            }
        }
        loop {
            let before = next.len();
            let mut mended = Vec::with_capacity(before);
            for t in next {
                match Self::gapes(net, t).then(|| Self::split(net, t)).flatten() {
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

    fn faces(&self, net: &Net) -> Vec<[u32; 3]> {
        let mut all = Vec::with_capacity(self.red.len());
        for t in &self.red {
            let middle = [0, 1, 2].map(|e| net.middle(t[e], t[(e + 1) % 3]));
            crate::lod::vds::tessellate::template(*t, middle, &mut all);
        }
        all
    }
}
