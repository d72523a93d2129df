//! Adaptive √3 subdivision: a vertex at the centre of a triangle, then the old edge between two
//! such triangles is flipped.
//!
//! After Kobbelt 2000, section 4: a triangle of even age is split at its centre; the three that
//! result have odd age and wait for the triangle across their old edge. When both are present the
//! edge is flipped and both have even age again. To split a waiting triangle, the one across is
//! split first. Ages across an edge thus differ by at most two and no gap opens.

use super::AdaptiveScheme;
use super::net::RefinedNet;

const NO_FACE: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct Sqrt3Face {
    /// In a waiting face the first corner is the new one.
    corners: [u32; 3],
    /// Face across the side from corner i to i + 1.
    across: [u32; 3],
    age: u32,
}

/// Faces with connectivity.
pub struct Sqrt3 {
    faces: Vec<Sqrt3Face>,
}

impl Sqrt3 {
    pub fn new(net: &RefinedNet) -> Self {
        let face = |(f, corners): (usize, &[u32; 3])| {
            let across = [0, 1, 2].map(|e| net.base.across(f as u32, e).unwrap_or(NO_FACE));
            Sqrt3Face { corners: *corners, across, age: 0 }
        };
        Self { faces: net.base.faces.iter().enumerate().map(face).collect() }
    }

    /// Replaces `old` by `new` as a neighbour of `of`.
    fn relink(&mut self, of: u32, old: u32, new: u32) {
        if of != NO_FACE
            && let Some(side) = self.faces[of as usize].across.iter_mut().find(|a| **a == old)
        {
            *side = new;
        }
    }

    /// Splits face `f` at least once; does nothing at a boundary and where the centre is not
    /// defined.
    fn split(&mut self, net: &mut RefinedNet, f: u32) {
        let Sqrt3Face { corners, across, age } = self.faces[f as usize];
        if age % 2 == 1 {
            let partner = across[1];
            if partner == NO_FACE {
                return;
            }
            if self.faces[partner as usize].age + 2 == age {
                self.split(net, partner);
            }
            // That may have flipped it into another face.
            let partner = self.faces[f as usize].across[1];
            if self.faces[f as usize].age == age && partner != NO_FACE {
                self.split(net, partner);
            }
            return;
        }
        let Some(p) = net.centre(corners) else { return };
        let [a, b, c] = corners;
        let second = self.faces.len() as u32;
        let ids = [f, second, second + 1];
        let sides = [(a, b, across[0]), (b, c, across[1]), (c, a, across[2])];
        self.faces.extend([self.faces[f as usize]; 2]);
        for (i, (x, y, other)) in sides.into_iter().enumerate() {
            let around = [ids[(i + 2) % 3], other, ids[(i + 1) % 3]];
            self.faces[ids[i] as usize] =
                Sqrt3Face { corners: [p, x, y], across: around, age: age + 1 };
            self.relink(other, f, ids[i]);
        }
        for (id, (_, _, other)) in ids.into_iter().zip(sides) {
            if other != NO_FACE && self.faces[other as usize].age == age + 1 {
                self.flip_edge(id, other);
            }
        }
    }

    /// Flips the old edge between two waiting faces.
    fn flip_edge(&mut self, f: u32, g: u32) {
        let (one, two) = (self.faces[f as usize], self.faces[g as usize]);
        if one.across[1] != g || two.across[1] != f {
            return;
        }
        let ([p, a, b], [q, ..]) = (one.corners, two.corners);
        // In cyclic order: p, a, q, b. Face g is (q, b, a).
        let age = one.age + 1;
        self.faces[f as usize] =
            Sqrt3Face { corners: [p, a, q], across: [one.across[0], two.across[2], g], age };
        self.faces[g as usize] =
            Sqrt3Face { corners: [q, b, p], across: [two.across[0], one.across[2], f], age };
        self.relink(two.across[2], g, f);
        self.relink(one.across[2], f, g);
    }
}

impl AdaptiveScheme for Sqrt3 {
    fn refine_once(
        &mut self,
        net: &mut RefinedNet,
        exceeds_tolerance: &dyn Fn(&RefinedNet, [u32; 3]) -> bool,
    ) -> usize {
        let marked = |f: &u32| exceeds_tolerance(net, self.faces[*f as usize].corners);
        let marked: Vec<(u32, u32)> = (0..self.faces.len() as u32)
            .filter(marked)
            .map(|f| (f, self.faces[f as usize].age))
            .collect();
        for &(f, age) in &marked {
            // Unless it was split together with a neighbour.
            if self.faces[f as usize].age == age {
                self.split(net, f);
            }
        }
        marked.len()
    }

    fn faces(&self, _: &RefinedNet) -> Vec<[u32; 3]> {
        self.faces.iter().map(|f| f.corners).collect()
    }
}
