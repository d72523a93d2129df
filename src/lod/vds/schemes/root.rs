//! √3: a vertex in the middle of a triangle, then the old edge between two such is turned.
//!
//! After Kobbelt 2000, section 4: a triangle of even age is split from its middle; the three that
//! come of it are of odd age and wait for the triangle across their old edge. When both are there
//! the edge is turned and both are of even age again. To split a waiting one is to make the one
//! across catch up. Ages across an edge thus differ by no more than two and no gap ever opens.

use super::Work;
use super::net::Net;

const NONE: u32 = u32::MAX;

#[derive(Clone, Copy)]
struct Face {
    /// Of a waiting face the first corner is the new one.
    corners: [u32; 3],
    /// Across the side from corner i to i + 1.
    across: [u32; 3],
    age: u32,
}

/// The faces and who lies across their sides.
pub struct Root {
    faces: Vec<Face>,
}

impl Root {
    pub fn new(net: &Net) -> Self {
        let face = |(f, corners): (usize, &[u32; 3])| {
            let across = [0, 1, 2].map(|e| net.base.across(f as u32, e).unwrap_or(NONE));
            Face { corners: *corners, across, age: 0 }
        };
        Self { faces: net.base.faces.iter().enumerate().map(face).collect() }
    }

    /// Tells `of` that `new` lies across where `old` did.
    fn meet(&mut self, of: u32, old: u32, new: u32) {
        if of != NONE
            && let Some(side) = self.faces[of as usize].across.iter_mut().find(|a| **a == old)
        {
            *side = new;
        }
    }

    /// Makes face `f` one age older at least; gives up at a boundary and where the net cannot say
    /// where the middle is.
    fn split(&mut self, net: &mut Net, f: u32) {
        let Face { corners, across, age } = self.faces[f as usize];
        if age % 2 == 1 {
            let mate = across[1];
            if mate == NONE {
                return;
            }
            if self.faces[mate as usize].age + 2 == age {
                self.split(net, mate);
            }
            // It may have been turned into another face by that.
            let mate = self.faces[f as usize].across[1];
            if self.faces[f as usize].age == age && mate != NONE {
                self.split(net, mate);
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
            self.faces[ids[i] as usize] = Face { corners: [p, x, y], across: around, age: age + 1 };
            self.meet(other, f, ids[i]);
        }
        for (id, (_, _, other)) in ids.into_iter().zip(sides) {
            if other != NONE && self.faces[other as usize].age == age + 1 {
                self.turn(id, other);
            }
        }
    }

    /// Turns the old edge between two waiting faces.
    fn turn(&mut self, f: u32, g: u32) {
        let (one, two) = (self.faces[f as usize], self.faces[g as usize]);
        if one.across[1] != g || two.across[1] != f {
            return;
        }
        let ([p, a, b], [q, ..]) = (one.corners, two.corners);
        // Around: p, a, q, b. Face g is (q, b, a).
        let age = one.age + 1;
        self.faces[f as usize] =
            Face { corners: [p, a, q], across: [one.across[0], two.across[2], g], age };
        self.faces[g as usize] =
            Face { corners: [q, b, p], across: [two.across[0], one.across[2], f], age };
        self.meet(two.across[2], g, f);
        self.meet(one.across[2], f, g);
    }
}

impl Work for Root {
    fn round(&mut self, net: &mut Net, too_far: &dyn Fn(&Net, [u32; 3]) -> bool) -> usize {
        let named = |f: &u32| too_far(net, self.faces[*f as usize].corners);
        let named: Vec<(u32, u32)> = (0..self.faces.len() as u32)
            .filter(named)
            .map(|f| (f, self.faces[f as usize].age))
            .collect();
        for &(f, age) in &named {
            // Unless a neighbour has seen to it.
            if self.faces[f as usize].age == age {
                self.split(net, f);
            }
        }
        named.len()
    }

    fn faces(&self, _: &Net) -> Vec<[u32; 3]> {
        self.faces.iter().map(|f| f.corners).collect()
    }
}
