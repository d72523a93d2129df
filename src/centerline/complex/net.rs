//! The graph that a complex collapsed onto, as arcs between tips and junctions.

mod forest;
mod passage;
mod prune;

pub use prune::{Loop, PruneLimits, Rule};

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use super::sweep::NodeContacts;
use super::{CellComplex, Collapsed};
use crate::field::Sampler;

/// A chain of nodes between two that are tips or junctions; a ring begins and ends at one.
#[derive(Clone, Debug, PartialEq)]
pub struct Arc {
    /// Nodes of the arc, ends included.
    pub nodes: Vec<u32>,
    /// Contacts between consecutive nodes, one fewer.
    pub contacts: Vec<u32>,
}

/// Graph of arcs between tips and junctions.
pub struct Net<'a> {
    complex: &'a CellComplex,
    adjacency: &'a NodeContacts<'a>,
    distance: Sampler<'a>,
    /// Smallest spacing, mm.
    h: f64,
    /// Arcs by number; `None` where one was removed.
    arcs: Vec<Option<Arc>>,
    /// Numbers of the arcs that end at each node; a ring is listed twice.
    at: BTreeMap<u32, Vec<usize>>,
    /// Nodes at which arcs end and that no rule prunes: given ends.
    held: BTreeSet<u32>,
    /// Loops ended by a rule, in that order.
    pub ended: Vec<Loop>,
}

impl<'a> Net<'a> {
    /// Builds the arcs of a collapsed complex.
    ///
    /// * `held`: nodes at which arcs end and that no rule prunes.
    /// * `distance`: to the wall, mm.
    pub fn new(
        complex: &'a CellComplex,
        adjacency: &'a NodeContacts<'a>,
        left: &Collapsed,
        held: &[u32],
        distance: Sampler<'a>,
    ) -> Self {
        let mut meeting: BTreeMap<u32, Vec<(u32, u32)>> =
            left.nodes.iter().map(|n| (*n, Vec::new())).collect();
        for &c in &left.contacts {
            let [a, b] = complex.contacts[c as usize].nodes;
            for (from, to) in [(a, b), (b, a)] {
                if let Some(all) = meeting.get_mut(&from) {
                    all.push((c, to));
                }
            }
        }
        let held: BTreeSet<u32> = held.iter().copied().collect();
        let through = |n: u32| meeting[&n].len() == 2 && !held.contains(&n);
        let mut used = BTreeSet::new();
        let mut arcs: Vec<Arc> = Vec::new();
        let mut walk = |from: u32, (first, to): (u32, u32), arcs: &mut Vec<Arc>| {
            if !used.insert(first) {
                return;
            }
            let (mut nodes, mut contacts) = (vec![from, to], vec![first]);
            let mut here = to;
            while through(here) && here != from {
                let Some(&(c, next)) = meeting[&here].iter().find(|m| !used.contains(&m.0)) else {
                    break;
                };
                used.insert(c);
                contacts.push(c);
                nodes.push(next);
                here = next;
            }
            arcs.push(Arc { nodes, contacts });
        };
        for (&node, all) in meeting.iter().filter(|m| !through(*m.0)) {
            all.iter().for_each(|m| walk(node, *m, &mut arcs));
        }
        // The remaining contacts form rings; each begins at its deepest node.
        let mut rings: Vec<u32> = left.nodes.iter().copied().filter(|n| through(*n)).collect();
        rings.sort_by_key(|n| (Reverse(complex.nodes[*n as usize].key), *n));
        for node in rings {
            meeting[&node].iter().for_each(|m| walk(node, *m, &mut arcs));
        }
        let arcs = arcs.into_iter().map(Some).collect();
        let h = distance.lumen.grid.spacing_mm.min_element();
        let (at, ended) = (BTreeMap::new(), Vec::new());
        let mut this = Self { complex, adjacency, distance, h, arcs, at, held, ended };
        for i in 0..this.arcs.len() {
            this.attach(i);
        }
        this
    }

    /// Returns the remaining arcs.
    pub fn arcs(&self) -> impl Iterator<Item = &Arc> {
        self.arcs.iter().flatten()
    }

    /// Number of loops: arcs outside a spanning forest.
    pub fn loops(&self) -> usize {
        self.forest().1.len()
    }

    fn attach(&mut self, i: usize) {
        let Some(arc) = &self.arcs[i] else { return };
        let ends = arc.ends();
        ends.into_iter().for_each(|n| self.at.entry(n).or_default().push(i));
    }

    fn detach(&mut self, i: usize) -> Option<Arc> {
        let arc = self.arcs[i].take()?;
        for n in arc.ends() {
            let all = self.at.get_mut(&n)?;
            all.retain(|a| *a != i);
            if all.is_empty() {
                self.at.remove(&n);
            }
        }
        Some(arc)
    }

    /// Number of arcs that end at a node.
    pub fn degree(&self, node: u32) -> usize {
        self.at.get(&node).map_or(0, Vec::len)
    }

    /// Distance to the wall at a depth, mm.
    fn width_mm(&self, key: u32) -> f64 {
        0.5 * self.h * f64::from(key).sqrt()
    }

    /// Distance to the wall at the deepest voxel of a node, mm.
    pub fn node_mm(&self, node: u32) -> f64 {
        self.width_mm(self.complex.nodes[node as usize].key)
    }

    fn contact_mm(&self, contact: u32) -> f64 {
        self.width_mm(self.complex.contacts[contact as usize].key)
    }

    fn length_mm(&self, arc: &Arc) -> f64 {
        self.units(arc) as f64 * self.adjacency.unit_mm
    }

    /// Length of an arc in the unit of [`NodeContacts::unit_mm`]. Where every voxel is a node, a
    /// chain of them is a stair: its length is that of chords between nodes some steps apart.
    fn units(&self, arc: &Arc) -> u64 {
        if !self.complex.is_fine() {
            return self.contact_units(arc);
        }
        let stride = self.complex.stride();
        let last = arc.nodes.len() - 1;
        let chord = |i: usize| {
            let [a, b] = [i, (i + stride).min(last)].map(|i| arc.nodes[i] as usize);
            let apart = self.adjacency.place_mm[a].distance(self.adjacency.place_mm[b]);
            (apart / self.adjacency.unit_mm).round() as u64
        };
        (0..last).step_by(stride).map(chord).sum()
    }

    /// Sum of the lengths of an arc's contacts.
    fn contact_units(&self, arc: &Arc) -> u64 {
        arc.contacts.iter().map(|c| u64::from(self.adjacency.length[*c as usize])).sum()
    }

    /// Returns key, number and index of the narrowest contact, of several the lowest.
    fn throat(&self, contacts: &[u32]) -> (u32, u32, usize) {
        let each = contacts.iter().enumerate();
        let key = |c: u32| self.complex.contacts[c as usize].key;
        each.map(|(i, c)| (key(*c), *c, i)).min().unwrap_or((0, 0, 0))
    }

    fn push(&mut self, arc: Arc) -> usize {
        self.arcs.push(Some(arc));
        self.attach(self.arcs.len() - 1);
        self.arcs.len() - 1
    }

    /// Nodes where one arc ends and nothing else meets it: tips, given ends, ends of cut arcs. In
    /// ascending order.
    pub fn leaves(&self) -> Vec<u32> {
        self.at.iter().filter(|a| a.1.len() == 1).map(|a| *a.0).collect()
    }

    /// Nodes where arcs end, ascending.
    pub fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        self.at.keys().copied()
    }

    /// Removes what lies beyond a node of an arc, on the side of a tip; the node is a tip then.
    /// Leaves everything as it is where the other side is reached from there too.
    pub fn cut_beyond(&mut self, node: u32, tip: u32) {
        let holds = |arc: &Option<Arc>| {
            arc.as_ref().and_then(|arc| arc.nodes.iter().position(|n| *n == node))
        };
        let inner = (0..self.arcs.len()).find_map(|i| Some((i, holds(&self.arcs[i])?)));
        let Some((i, at)) = inner else { return };
        // Parts the arc at the node, unless it ends there.
        if at > 0 && !self.at.contains_key(&node) {
            let Some(arc) = self.detach(i) else { return };
            let (nodes, contacts) = (arc.nodes, arc.contacts);
            let first = Arc { nodes: nodes[..=at].to_vec(), contacts: contacts[..at].to_vec() };
            let last = Arc { nodes: nodes[at..].to_vec(), contacts: contacts[at..].to_vec() };
            self.push(first);
            self.push(last);
        }
        let mut beyond = BTreeSet::new();
        let (mut open, mut seen) = (vec![tip], BTreeSet::from([tip, node]));
        while let Some(here) = open.pop() {
            for &i in self.at.get(&here).into_iter().flatten() {
                beyond.insert(i);
                let next = self.arcs[i].as_ref().map_or(here, |arc| arc.other_end(here));
                if seen.insert(next) {
                    open.push(next);
                }
            }
        }
        let length = |i: &usize| self.length(*i);
        let all: u64 = (0..self.arcs.len()).map(|i| self.length(i)).sum();
        if 2 * beyond.iter().map(length).sum::<u64>() < all {
            beyond.into_iter().for_each(|i| drop(self.detach(i)));
        }
    }

    /// The node next to a leaf on its arc.
    pub fn beside(&self, leaf: u32) -> Option<u32> {
        let arc = self.arc(*self.at.get(&leaf)?.first()?)?;
        Some(arc.nodes[if arc.nodes[0] == leaf { 1 } else { arc.nodes.len() - 2 }])
    }

    /// Numbers of the arcs that end at nodes, ascending.
    pub fn arcs_of(&self, nodes: &[u32]) -> impl Iterator<Item = usize> + '_ {
        let all: BTreeSet<usize> =
            nodes.iter().filter_map(|n| self.at.get(n)).flatten().copied().collect();
        all.into_iter()
    }

    /// An arc by its number.
    pub fn arc(&self, i: usize) -> Option<&Arc> {
        self.arcs.get(i)?.as_ref()
    }

    /// Computes shortest paths from a node over arcs: the length to each node and, except for the
    /// start, the arc by which it was reached.
    ///
    /// * `length`: length of an arc by its number, an integer so that sums have a total order; of
    ///   equal paths the one with the lower arc counts.
    pub fn ways(
        &self,
        from: u32,
        length: impl Fn(usize) -> u64,
    ) -> BTreeMap<u32, (u64, Option<usize>)> {
        let mut found: BTreeMap<u32, (u64, Option<usize>)> = BTreeMap::new();
        let mut open = BinaryHeap::from([Reverse((0u64, None, from))]);
        while let Some(Reverse((at, by, node))) = open.pop() {
            if found.contains_key(&node) {
                continue;
            }
            found.insert(node, (at, by));
            for &i in self.at.get(&node).into_iter().flatten() {
                let Some(arc) = &self.arcs[i] else { continue };
                let next = arc.other_end(node);
                if !found.contains_key(&next) {
                    open.push(Reverse((at + length(i), Some(i), next)));
                }
            }
        }
        found
    }

    /// Length of an arc in the unit of [`NodeContacts::unit_mm`].
    pub fn length(&self, i: usize) -> u64 {
        self.arcs[i].as_ref().map_or(0, |arc| self.units(arc))
    }

    /// ∫(h/d)² along an arc, h the smallest spacing, d the distance to the wall at its contacts, in
    /// the unit of [`NodeContacts::unit_mm`] over 256.
    pub fn centrality(&self, i: usize) -> u64 {
        let Some(arc) = &self.arcs[i] else { return 0 };
        let sum: u64 = arc.contacts.iter().map(|c| self.contact_centrality(*c)).sum();
        // Contacts count with their lengths, of which a stair has too much.
        let share = self.units(arc) as f64 / self.contact_units(arc).max(1) as f64;
        (sum as f64 * share).round() as u64
    }

    /// Computes ∫(h/d)² along one contact, in the unit of [`Self::centrality`]. The contact's key
    /// is 4 (d/h)².
    pub fn contact_centrality(&self, contact: u32) -> u64 {
        let key = self.complex.contacts[contact as usize].key.max(1);
        u64::from(self.adjacency.length[contact as usize]) * 1024 / u64::from(key)
    }
}

impl Arc {
    /// First and last node of the arc.
    pub fn ends(&self) -> [u32; 2] {
        [self.nodes[0], self.nodes[self.nodes.len() - 1]]
    }

    /// The end that is not `node`; of a ring the same.
    pub fn other_end(&self, node: u32) -> u32 {
        let [a, b] = self.ends();
        if a == node { b } else { a }
    }

    fn reverse(&mut self) {
        self.nodes.reverse();
        self.contacts.reverse();
    }
}
