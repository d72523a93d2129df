//! Spanning forests of a net, by which the cycles of its other arcs are found.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use super::Net;
use crate::geometry::DisjointSets;

impl Net<'_> {
    /// Computes the spanning forest of widest throats (Kruskal), and the arcs outside it.
    pub(super) fn forest(&self) -> (Vec<usize>, Vec<usize>) {
        let mut order: Vec<usize> =
            (0..self.arcs.len()).filter(|i| self.arcs[*i].is_some()).collect();
        order.sort_by_key(|i| {
            let throat = self.arcs[*i].as_ref().map_or(0, |a| self.throat(&a.contacts).0);
            (Reverse(throat), *i)
        });
        let mut sets = DisjointSets::new(self.complex.nodes.len());
        order.into_iter().partition(|i| {
            let Some(arc) = &self.arcs[*i] else { return false };
            let [a, b] = arc.ends();
            sets.join(a, b)
        })
    }
}

/// A rooted spanning forest.
pub(super) struct Forest {
    /// Arc towards the root, node at its other end, and number of arcs to the root, for each node
    /// that is not a root.
    up: BTreeMap<u32, (usize, u32, u32)>,
}

impl Forest {
    pub fn new(net: &Net<'_>, forest: &[usize]) -> Self {
        let inside: BTreeSet<usize> = forest.iter().copied().collect();
        let mut up = BTreeMap::new();
        let mut seen = BTreeSet::new();
        for &root in net.at.keys() {
            let mut open = vec![(root, 0)];
            if !seen.insert(root) {
                continue;
            }
            while let Some((node, steps)) = open.pop() {
                for &i in net.at[&node].iter().filter(|i| inside.contains(i)) {
                    let Some(arc) = &net.arcs[i] else { continue };
                    let next = arc.other_end(node);
                    if seen.insert(next) {
                        up.insert(next, (i, node, steps + 1));
                        open.push((next, steps + 1));
                    }
                }
            }
        }
        Self { up }
    }

    /// Returns the arcs on the path between two nodes of one tree.
    pub fn path(&self, mut a: u32, mut b: u32) -> Vec<usize> {
        let steps = |n: u32| self.up.get(&n).map_or(0, |u| u.2);
        let mut path = Vec::new();
        while a != b {
            let deeper = if steps(a) >= steps(b) { &mut a } else { &mut b };
            let Some(&(arc, node, _)) = self.up.get(deeper) else { break };
            path.push(arc);
            *deeper = node;
        }
        path
    }
}
