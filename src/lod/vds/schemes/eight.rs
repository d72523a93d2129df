//! 4-8 by halving: each triangle is cut from its newest corner to the middle of the side opposite.

use super::Work;
use super::net::Net;

/// Triangles, the side that is cut next first: (a, b) with the newest corner c.
pub struct Eight {
    faces: Vec<[u32; 3]>,
}

impl Eight {
    /// Every base face gets a vertex in its middle, so that each edge of the base is the diagonal
    /// of a quad and all sides that are cut first match (Velho & Zorin, section 3). Ours: pairs of
    /// faces are not joined, which would spare some triangles and depend on the pairing.
    pub fn new(net: &mut Net) -> Self {
        let mut faces = Vec::with_capacity(3 * net.base.faces.len());
        for t @ [a, b, c] in net.base.faces.clone() {
            match net.centre(t) {
                Some(m) => faces.extend([[a, b, m], [b, c, m], [c, a, m]]),
                None => faces.push(t),
            }
        }
        Self { faces }
    }

    fn cut(net: &mut Net, [a, b, c]: [u32; 3]) -> Option<[[u32; 3]; 2]> {
        let m = net.halve(a, b)?;
        Some([[c, a, m], [b, c, m]])
    }
}

impl Work for Eight {
    fn round(&mut self, net: &mut Net, too_far: &dyn Fn(&Net, [u32; 3]) -> bool) -> usize {
        let named: Vec<bool> = self.faces.iter().map(|t| too_far(net, *t)).collect();
        let count = named.iter().filter(|n| **n).count();
        let mut next = Vec::with_capacity(self.faces.len() + count);
        for (t, named) in self.faces.iter().zip(named) {
            match named.then(|| Self::cut(net, *t)).flatten() {
                Some(two) => next.extend(two),
                None => next.push(*t),
            }
        }
        // Whoever has a vertex on a side is cut until it is a corner.
        loop {
            let before = next.len();
            let mut mended = Vec::with_capacity(before);
            for t in next {
                let hangs = (0..3).any(|e| net.middle(t[e], t[(e + 1) % 3]).is_some());
                match hangs.then(|| Self::cut(net, t)).flatten() {
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

    fn faces(&self, _: &Net) -> Vec<[u32; 3]> {
        self.faces.clone()
    }
}
