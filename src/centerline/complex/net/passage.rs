//! Length of a narrow passage, measured on voxels.

use std::cmp::Reverse;
use std::collections::BinaryHeap;

use glam::{DVec3, IVec3, USizeVec3};

use super::prune::WINDOW;
use super::{Arc, Net};
use crate::centerline::complex::Contact;
use crate::lumen::bricks::near_offset;
use crate::task::checkpoint;

/// Length about a hole in a thin plate along which the lumen is narrower than twice the hole, in
/// distances to the hole's rim.
const PLATE: f64 = 3.5;

impl Net<'_> {
    pub(super) fn passage_of(&self, i: usize) -> f64 {
        checkpoint();
        let Some(arc) = &self.arcs[i] else { return 0.0 };
        let (_, throat, place) = self.throat(&arc.contacts);
        self.passage_mm(arc, place, self.contact_mm(throat))
    }

    /// Length of a narrow passage about a throat, less what a hole in a thin plate has; at most the
    /// length outside the balls at both ends of the arc. Measured on voxels: cells are too coarse
    /// for a wall of two. The chain of cells leaves a passage slantwise; the shortest way
    /// out, on either side of the contact, does not.
    pub(super) fn passage_mm(&self, arc: &Arc, place: usize, throat_mm: f64) -> f64 {
        let contact = &self.complex.contacts[arc.contacts[place] as usize];
        let half = 0.5 * self.distance.lumen.grid.spacing_mm[usize::from(contact.axis)];
        // The contact's low side is towards the arc's beginning or its end.
        let low_first = arc.nodes[place] == contact.nodes[0];
        let side = |forwards: bool| {
            let along = self.narrow_mm(self.way(arc, place, forwards), 2.0 * throat_mm);
            let high = forwards == low_first;
            // A longer passage is no window.
            let longest = (along - half).min((PLATE + WINDOW) * throat_mm.max(self.h));
            let out = self.way_out_mm(contact, high, 2.0 * throat_mm, longest);
            out.map_or(along, |out| half + out)
        };
        let about = side(false) + side(true);
        let balls = self.node_mm(arc.nodes[0]) + self.node_mm(arc.nodes[arc.nodes.len() - 1]);
        let outside = self.length_mm(arc) - balls;
        (about - PLATE * throat_mm).min(outside)
    }

    /// The way from the middle of a contact to the arc's end or beginning, local mm.
    fn way(&self, arc: &Arc, place: usize, forwards: bool) -> Vec<DVec3> {
        let h = self.distance.lumen.grid.spacing_mm;
        let middle = |c: u32| {
            let pair = self.complex.contacts[c as usize].deepest;
            let [p, q] = pair.map(|e| self.distance.lumen.bricks.voxel(e as usize).as_dvec3());
            0.5 * (p + q) * h
        };
        let node = |n: u32| self.adjacency.place_mm[n as usize];
        let mut out = vec![middle(arc.contacts[place])];
        if forwards {
            for (i, n) in arc.nodes.iter().enumerate().skip(place + 1) {
                out.push(node(*n));
                out.extend(arc.contacts.get(i).map(|c| middle(*c)));
            }
        } else {
            for i in (0..=place).rev() {
                out.push(node(arc.nodes[i]));
                out.extend(i.checked_sub(1).map(|c| middle(arc.contacts[c])));
            }
        }
        out
    }

    /// Length of a way up to where the distance to the wall exceeds `most_mm`.
    fn narrow_mm(&self, way: Vec<DVec3>, most_mm: f64) -> f64 {
        let mut length = 0.0;
        for w in way.windows(2) {
            let steps = (w[0].distance(w[1]) / (0.5 * self.h)).ceil().max(1.0);
            for k in 1..=steps as usize {
                if self.distance.at(w[0].lerp(w[1], k as f64 / steps)) > most_mm {
                    return length;
                }
                length += w[0].distance(w[1]) / steps;
            }
        }
        length
    }

    /// Length of the shortest way from a contact's deepest voxel, on one side of it, to where the
    /// distance exceeds `most_mm`; `None` if that is not shorter than `longest_mm`.
    fn way_out_mm(
        &self,
        contact: &Contact,
        high: bool,
        most_mm: f64,
        longest_mm: f64,
    ) -> Option<f64> {
        let h = self.distance.lumen.grid.spacing_mm;
        let axis = usize::from(contact.axis);
        let element = contact.deepest[usize::from(high)];
        let start = self.distance.lumen.bricks.voxel(element as usize);
        // A box about the start that the way does not leave; only one side of the contact.
        let reach = (longest_mm.max(0.0) / h).ceil().as_ivec3() + 1;
        let (mut low, mut size) = (start - reach, 2 * reach + 1);
        size[axis] = reach[axis] + 1;
        low[axis] += if high { reach[axis] } else { 0 };
        let sides = size.as_usizevec3();
        let strides = USizeVec3::new(1, sides.x, sides.x * sides.y);
        let index = |v: IVec3| {
            let p = v - low;
            (p.cmpge(IVec3::ZERO).all() && p.cmplt(size).all())
                .then(|| p.as_usizevec3().dot(strides))
        };
        let voxel = |i: usize| {
            let at = [i % strides.y, i % strides.z / strides.y, i / strides.z];
            low + IVec3::from(at.map(|along| along as i32))
        };
        // Lengths in whole units, so that their order is total.
        let units = |way: IVec3| (way.as_dvec3() * h / self.adjacency.unit_mm).length().round();
        let steps: Vec<(IVec3, u32)> = (0..27)
            .filter(|n| *n != 13)
            .map(near_offset)
            .map(|step| (step, units(step) as u32))
            .collect();
        let mut done = vec![false; sides.element_product()];
        let mut open = BinaryHeap::from([Reverse((0u32, index(start)?))]);
        let mut visits = 0u32;
        while let Some(Reverse((length, at))) = open.pop() {
            visits += 1;
            if visits.is_multiple_of(1 << 16) {
                checkpoint();
            }
            let v = voxel(at);
            let length_mm = f64::from(length) * self.adjacency.unit_mm;
            if length_mm >= longest_mm {
                return None;
            }
            if self.distance.voxel(v) > most_mm {
                return Some(length_mm);
            }
            if std::mem::replace(&mut done[at], true) {
                continue;
            }
            for (step, units) in &steps {
                let to = v + *step;
                let Some(i) = index(to).filter(|i| !done[*i]) else { continue };
                if self.distance.voxel(to) > 0.0 {
                    open.push(Reverse((length + units, i)));
                }
            }
        }
        None
    }
}
