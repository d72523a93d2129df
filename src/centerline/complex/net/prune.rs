//! Branch pruning and loops: the rules that drop twigs and end loops about pillars, holes where walls
//! touch, small loops.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use rayon::prelude::*;

use super::forest::Forest;
use super::{Arc, Net};
use crate::task::checkpoint;

/// Rule by which an arc was removed or cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// The arc's cycle stays close to the cycle's own widest place: a pillar, or a fold that
    /// touches.
    Local,
    /// The arc passes a hole in a thin wall and is cut there.
    Window,
    /// The arc's cycle is short.
    Small,
}

/// An arc that a rule ended, or a loop that was kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// The rule that ended it; `None` for one that is kept.
    pub ended: Option<Rule>,
    /// The contact at the narrowest place of the arc.
    pub throat: u32,
    /// Distance to the wall at the throat, mm.
    pub throat_mm: f64,
    /// Length of the narrow passage about the throat, less that of a hole in a thin plate, mm.
    pub passage_mm: f64,
    /// Length of the cycle, mm.
    pub cycle_mm: f64,
    /// Distance to the wall at the next narrowest place of the cycle outside the arc, mm.
    pub next_throat_mm: f64,
}

/// Limits of the pruning rules.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PruneLimits {
    /// Distance from the junction, mm, below which a dead end is a twig.
    pub twig_mm: f64,
    /// Length of a cycle, mm, below which a loop is small.
    pub loop_mm: f64,
}

impl Default for PruneLimits {
    fn default() -> Self {
        Self { twig_mm: 5.0, loop_mm: 15.0 }
    }
}
/// Radius about the widest node of a cycle within which the cycle is local, in the node's distances
/// to the wall.
const LOCAL: f64 = 3.0;
/// Greatest length of a window, in the throat's distances to the wall, or in voxels if those are
/// larger.
pub(super) const WINDOW: f64 = 4.0;
/// Greatest width of a hole, as a share of the lumen's width beside it.
const WIDEST_HOLE: f64 = 0.5;
/// Greatest length, in the unit of [`WINDOW`], of a passage at the narrowest place of a loop that
/// is a window whatever the loop's other places.
const CLEAR_WINDOW: f64 = 2.0;
/// Length of a cycle, in voxels, below which a loop is small.
const SMALL_VOXELS: f64 = 12.0;

/// Measures of an arc that may be a window.
struct Passage {
    halves: usize,
    ratio: f64,
    throat: u32,
    passage_mm: f64,
}

impl Net<'_> {
    /// Prunes by all rules, in rounds until nothing changes, and returns the loops kept.
    pub fn prune(&mut self, limits: PruneLimits) -> Vec<Loop> {
        // Caches by arc; a changed arc has a new number.
        let mut passages: BTreeMap<usize, f64> = BTreeMap::new();
        let mut measured: BTreeMap<usize, Option<Passage>> = BTreeMap::new();
        loop {
            self.drop_twigs(limits);
            let (forest, mut extra) = self.forest();
            extra.sort_by_key(|i| self.arcs[*i].as_ref().map(|a| self.throat(&a.contacts)));
            // Arcs outside the forest do not lie on each other's cycles: ending one does not change
            // the cycles of the others.
            let forest = Forest::new(self, &forest);
            let new: Vec<usize> =
                extra.iter().copied().filter(|i| !passages.contains_key(i)).collect();
            let found: Vec<f64> = new.par_iter().map(|i| self.passage_of(*i)).collect();
            passages.extend(new.into_iter().zip(found));
            let judged: Vec<(usize, Loop)> = extra
                .into_iter()
                .filter_map(|i| {
                    checkpoint();
                    Some((i, self.judge(i, &forest, passages[&i], limits)?))
                })
                .collect();
            let (ended, judged): (Vec<_>, Vec<_>) =
                judged.into_iter().partition(|(_, found)| found.ended.is_some());
            if !ended.is_empty() {
                for (i, found) in ended {
                    self.end(i, &found);
                    self.ended.push(found);
                }
                continue;
            }
            // The narrowest place of a loop may be a stricture, and the hole elsewhere on it.
            let mut changed = BTreeSet::new();
            for (i, found) in &judged {
                checkpoint();
                let cycle = self.cycle(*i, &forest);
                if cycle.iter().any(|i| changed.contains(i)) {
                    continue; // another cut changed it
                }
                if let Some((arc, found)) = self.window_on(&cycle, found, &mut measured, limits) {
                    changed.insert(arc);
                    self.end(arc, &found);
                    self.ended.push(found);
                }
            }
            if !changed.is_empty() {
                continue;
            }
            let is_small = |l: &Loop| l.cycle_mm < limits.loop_mm.max(SMALL_VOXELS * self.h);
            let (small, kept): (Vec<_>, Vec<_>) =
                judged.into_iter().partition(|(_, found)| is_small(found));
            if small.is_empty() {
                return kept.into_iter().map(|k| k.1).collect();
            }
            for (i, mut found) in small {
                found.ended = Some(Rule::Small);
                self.end(i, &found);
                self.ended.push(found);
            }
        }
    }

    /// Counts the halves of an arc, cut at a place, that extend far enough from their junctions to
    /// be no twigs. Where the walls of two lumens touch, none does: the hole is within reach of
    /// both axes. Where the end of one touches another, one does. At a stricture, both do.
    fn long_halves(&self, arc: &Arc, place: usize, limits: PruneLimits) -> usize {
        let at = |n: u32| self.adjacency.place_mm[n as usize];
        let [a, b] = arc.ends();
        let is_long = |junction: u32, half: &[u32]| {
            let far = half.iter().map(|n| at(*n).distance(at(junction))).fold(0.0, f64::max);
            far >= (2.0 * self.node_mm(junction)).max(limits.twig_mm)
        };
        usize::from(is_long(a, &arc.nodes[..=place]))
            + usize::from(is_long(b, &arc.nodes[place + 1..]))
    }

    /// Returns the arcs of the cycle that an arc outside the forest closes.
    fn cycle(&self, i: usize, forest: &Forest) -> Vec<usize> {
        let Some(arc) = &self.arcs[i] else { return Vec::new() };
        let [a, b] = arc.ends();
        forest.path(a, b).into_iter().chain([i]).collect()
    }

    /// Measures an arc; `None` if it cannot be a window, with two long halves, a wide throat or a
    /// long passage for its width.
    fn measure(&self, i: usize, limits: PruneLimits) -> Option<Passage> {
        checkpoint();
        let arc = self.arcs[i].as_ref()?;
        let (_, throat, place) = self.throat(&arc.contacts);
        let halves = self.long_halves(arc, place, limits);
        if halves > 1 {
            return None;
        }
        let width = self.contact_mm(throat);
        let [a, b] = arc.ends().map(|n| self.node_mm(n));
        if width > WIDEST_HOLE * a.max(b) {
            return None;
        }
        let passage_mm = self.passage_mm(arc, place, width);
        let ratio = passage_mm / width.max(self.h);
        (ratio < WINDOW).then_some(Passage { halves, ratio, throat, passage_mm })
    }

    /// Returns the arc of a cycle that is most likely a window, with the loop as ended there: the
    /// arc with the fewest long halves, and of those the one with the shortest passage for its
    /// width.
    fn window_on(
        &self,
        cycle: &[usize],
        found: &Loop,
        measured: &mut BTreeMap<usize, Option<Passage>>,
        limits: PruneLimits,
    ) -> Option<(usize, Loop)> {
        let new: Vec<usize> = cycle.iter().copied().filter(|i| !measured.contains_key(i)).collect();
        let all: Vec<_> = new.par_iter().map(|i| self.measure(*i, limits)).collect();
        measured.extend(new.into_iter().zip(all));
        let windows = cycle.iter().filter_map(|i| Some((*i, measured[i].as_ref()?)));
        let (arc, best) = windows.min_by(|(_, a), (_, b)| {
            let by_ratio = a.ratio.total_cmp(&b.ratio);
            a.halves.cmp(&b.halves).then(by_ratio).then(a.throat.cmp(&b.throat))
        })?;
        let others = cycle.iter().filter(|i| **i != arc).filter_map(|i| self.arcs[*i].as_ref());
        let others = others.flat_map(|a| &a.contacts).map(|c| self.contact_mm(*c));
        let found = Loop {
            ended: Some(Rule::Window),
            throat: best.throat,
            throat_mm: self.contact_mm(best.throat),
            passage_mm: best.passage_mm,
            next_throat_mm: others.fold(f64::INFINITY, f64::min),
            ..found.clone()
        };
        Some((arc, found))
    }

    /// Returns the greatest distance of a dead end from its junction, mm, if it is too short for a
    /// branch. Its length would not do: chains of cells zigzag.
    fn twig(&self, i: usize, limits: PruneLimits) -> Option<f64> {
        let arc = self.arcs[i].as_ref()?;
        let [a, b] = arc.ends();
        let junction = match (self.degree(a), self.degree(b)) {
            (1, d) if d > 1 && !self.held.contains(&a) => b,
            (d, 1) if d > 1 && !self.held.contains(&b) => a,
            _ => return None,
        };
        let from = self.adjacency.place_mm[junction as usize];
        let far = arc.nodes.iter().map(|n| self.adjacency.place_mm[*n as usize]);
        let far = far.map(|p| p.distance(from)).fold(0.0, f64::max);
        (far < (2.0 * self.node_mm(junction)).max(limits.twig_mm)).then_some(far)
    }

    /// Removes dead ends that are too short, the shortest first.
    fn drop_twigs(&mut self, limits: PruneLimits) {
        for node in self.at.keys().copied().collect::<Vec<_>>() {
            self.join_at(node);
        }
        let all = 0..self.arcs.len();
        // Lengths are not negative: their bits are in their order.
        let entry = |this: &Self, i: usize| Some((this.twig(i, limits)?.to_bits(), i));
        let mut twigs: BTreeSet<(u64, usize)> = all.filter_map(|i| entry(self, i)).collect();
        while let Some((length, i)) = twigs.pop_first() {
            checkpoint();
            if entry(self, i) != Some((length, i)) {
                continue; // changed since
            }
            let Some(arc) = self.detach(i) else { continue };
            for node in arc.ends() {
                if let Some(joined) = self.join_at(node) {
                    twigs.extend(entry(self, joined));
                }
                // Another arc at the junction may be a dead end now.
                let meeting = self.at.get(&node).cloned().unwrap_or_default();
                twigs.extend(meeting.into_iter().filter_map(|i| entry(self, i)));
            }
        }
    }

    /// Joins two arcs that meet at a node without others, under a new number.
    fn join_at(&mut self, node: u32) -> Option<usize> {
        let &[i, j] = self.at.get(&node)?.as_slice() else { return None };
        if i == j || self.held.contains(&node) {
            return None; // a ring, or a given end
        }
        let (mut a, mut b) = (self.detach(i)?, self.detach(j)?);
        if a.nodes[0] == node {
            a.reverse();
        }
        if b.nodes[0] != node {
            b.reverse();
        }
        a.nodes.extend(&b.nodes[1..]);
        a.contacts.extend(b.contacts);
        Some(self.push(a))
    }

    /// Judges the loop that an arc closes.
    fn judge(
        &self,
        i: usize,
        forest: &Forest,
        passage_mm: f64,
        limits: PruneLimits,
    ) -> Option<Loop> {
        let arc = self.arcs[i].as_ref()?;
        let [a, b] = arc.ends();
        let rest = forest.path(a, b);
        let others = || rest.iter().filter_map(|i| self.arcs[*i].as_ref());
        let cycle_mm = self.length_mm(arc) + others().map(|o| self.length_mm(o)).sum::<f64>();
        let nodes = || arc.nodes.iter().chain(others().flat_map(|o| &o.nodes)).copied();
        let widest = nodes().min_by_key(|n| (Reverse(self.complex.nodes[*n as usize].key), *n));
        let widest_mm = widest.map_or(0.0, |n| self.node_mm(n));
        let throat = self.throat(&arc.contacts).1;
        let throat_mm = self.contact_mm(throat);
        let next = others().flat_map(|o| &o.contacts).map(|c| self.contact_mm(*c));
        let next_throat_mm = next.fold(f64::INFINITY, f64::min);
        let local = widest.is_some_and(|w| {
            let place = |n: u32| self.adjacency.place_mm[n as usize];
            nodes().all(|n| place(n).distance(place(w)) <= LOCAL * widest_mm)
        });
        let ended = if local {
            Some(Rule::Local)
        } else if passage_mm < CLEAR_WINDOW * throat_mm.max(self.h)
            && self.long_halves(arc, self.throat(&arc.contacts).2, limits) == 0
        {
            Some(Rule::Window)
        } else {
            None
        };
        Some(Loop { ended, throat, throat_mm, passage_mm, cycle_mm, next_throat_mm })
    }

    /// Removes an arc, or cuts it at its throat.
    fn end(&mut self, i: usize, found: &Loop) {
        let Some(arc) = self.detach(i) else { return };
        let throat = arc.contacts.iter().position(|c| *c == found.throat);
        let Some(place) = throat.filter(|_| found.ended == Some(Rule::Window)) else { return };
        let halves = [
            Arc { nodes: arc.nodes[..=place].to_vec(), contacts: arc.contacts[..place].to_vec() },
            Arc {
                nodes: arc.nodes[place + 1..].to_vec(),
                contacts: arc.contacts[place + 1..].to_vec(),
            },
        ];
        for half in halves.into_iter().filter(|h| !h.contacts.is_empty()) {
            self.push(half);
        }
    }
}
