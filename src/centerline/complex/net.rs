//! The graph that a complex collapsed onto, as arcs between tips and junctions, and the rules that
//! prune it: twigs, small loops, windows between folds.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use glam::{DVec3, IVec3};

use super::sweep::Adjacency;
use super::{CellComplex, Collapsed, Contact};
use crate::field::Sampler;

/// A chain of nodes between two that are tips or junctions; a ring begins and ends at one.
#[derive(Clone, Debug, PartialEq)]
pub struct Arc {
    /// Its nodes, ends included.
    pub nodes: Vec<u32>,
    /// The contacts between them, one less.
    pub contacts: Vec<u32>,
}

/// Why an arc was taken away or cut.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Rule {
    /// Its cycle lies about the widest place of itself: a pillar, a fold that touches.
    Local,
    /// It passes a hole in a thin wall: cut there.
    Window,
    /// Its cycle is short.
    Small,
}

/// An arc that a rule ended, or a loop that was kept.
#[derive(Clone, Debug, PartialEq)]
pub struct Loop {
    /// The rule that ended it; `None` for one that is kept.
    pub ended: Option<Rule>,
    /// The contact at its narrowest place.
    pub throat: u32,
    /// Distance to the wall there, mm.
    pub throat_mm: f64,
    /// Length about the throat along which the lumen is as narrow as a wall with a hole in it is
    /// not, mm.
    pub passage_mm: f64,
    /// Length of the cycle, mm.
    pub cycle_mm: f64,
    /// Distance to the wall at the next narrowest place of the cycle outside the arc, mm.
    pub next_throat_mm: f64,
}

/// What the rules go by.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Limits {
    /// Dead ends that get no farther than this are twigs, mm.
    pub twig_mm: f64,
    /// Loops shorter than this are small, mm.
    pub loop_mm: f64,
}

impl Default for Limits {
    fn default() -> Self {
        Self { twig_mm: 5.0, loop_mm: 15.0 }
    }
}

/// A cycle within this many distances to the wall of its widest node is local.
const LOCAL: f64 = 3.0;
/// The lumen on both sides of a hole in a thin plate is narrower than twice the hole for about this
/// many distances to the hole's rim.
const PLATE: f64 = 3.5;
/// Passages longer than this many distances to the wall, and as many voxels, are no windows.
const WINDOW: f64 = 3.0;
/// Loops shorter than this many voxels are small.
const SMALL_VOXELS: f64 = 12.0;

/// Arcs and what is known of the nodes they join.
pub struct Net<'a> {
    complex: &'a CellComplex,
    adjacency: &'a Adjacency,
    distance: Sampler<'a>,
    /// Smallest spacing, mm.
    h: f64,
    /// Arcs; `None` where one was taken away.
    arcs: Vec<Option<Arc>>,
    /// Arcs that end at each node; a ring is there twice.
    at: BTreeMap<u32, Vec<usize>>,
    /// Tips that stay.
    tips: Vec<u32>,
    /// Loops that were ended, in the order in which they were.
    pub ended: Vec<Loop>,
}

impl<'a> Net<'a> {
    /// The arcs of what is left of a complex.
    ///
    /// * `tips`: ascending; those passed through are none afterwards.
    /// * `distance`: to the wall, mm.
    pub fn new(
        complex: &'a CellComplex,
        adjacency: &'a Adjacency,
        left: &Collapsed,
        tips: &[u32],
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
        let degree = |n: u32| meeting[&n].len();
        let tips = tips.iter().copied().filter(|n| degree(*n) < 2).collect();
        let mut used = BTreeSet::new();
        let mut arcs: Vec<Arc> = Vec::new();
        let mut walk = |from: u32, (first, to): (u32, u32), arcs: &mut Vec<Arc>| {
            if !used.insert(first) {
                return;
            }
            let (mut nodes, mut contacts) = (vec![from, to], vec![first]);
            let mut here = to;
            while degree(here) == 2 && here != from {
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
        for (&node, all) in meeting.iter().filter(|m| m.1.len() != 2) {
            all.iter().for_each(|m| walk(node, *m, &mut arcs));
        }
        // What is left are rings; each begins at its deepest node.
        let mut rings: Vec<u32> = left.nodes.iter().copied().filter(|n| degree(*n) == 2).collect();
        rings.sort_by_key(|n| (Reverse(complex.nodes[*n as usize].key), *n));
        for node in rings {
            meeting[&node].iter().for_each(|m| walk(node, *m, &mut arcs));
        }
        let arcs = arcs.into_iter().map(Some).collect();
        let h = distance.lumen.grid.spacing_mm.min_element();
        let (at, ended) = (BTreeMap::new(), Vec::new());
        let mut this = Self { complex, adjacency, distance, h, arcs, at, tips, ended };
        for i in 0..this.arcs.len() {
            this.attach(i);
        }
        this
    }

    /// The arcs there are.
    pub fn arcs(&self) -> impl Iterator<Item = &Arc> {
        self.arcs.iter().flatten()
    }

    /// Loops: arcs beyond a spanning forest.
    pub fn loops(&self) -> usize {
        self.forest().1.len()
    }

    fn attach(&mut self, i: usize) {
        let Some(arc) = &self.arcs[i] else { return };
        let ends = [arc.nodes[0], arc.nodes[arc.nodes.len() - 1]];
        ends.into_iter().for_each(|n| self.at.entry(n).or_default().push(i));
    }

    fn detach(&mut self, i: usize) -> Option<Arc> {
        let arc = self.arcs[i].take()?;
        for n in [arc.nodes[0], arc.nodes[arc.nodes.len() - 1]] {
            let all = self.at.get_mut(&n)?;
            all.retain(|a| *a != i);
            if all.is_empty() {
                self.at.remove(&n);
            }
        }
        Some(arc)
    }

    fn degree(&self, node: u32) -> usize {
        self.at.get(&node).map_or(0, Vec::len)
    }

    /// Distance to the wall at a depth, mm.
    fn width_mm(&self, key: u32) -> f64 {
        0.5 * self.h * f64::from(key).sqrt()
    }

    fn node_mm(&self, node: u32) -> f64 {
        self.width_mm(self.complex.nodes[node as usize].key)
    }

    fn contact_mm(&self, contact: u32) -> f64 {
        self.width_mm(self.complex.contacts[contact as usize].key)
    }

    fn length_mm(&self, contacts: &[u32]) -> f64 {
        let units = contacts.iter().map(|c| u64::from(self.adjacency.length[*c as usize]));
        units.sum::<u64>() as f64 * self.adjacency.unit_mm
    }

    /// The narrowest contact, of several the lowest, with its place.
    fn throat(&self, contacts: &[u32]) -> (u32, u32, usize) {
        let each = contacts.iter().enumerate();
        let key = |c: u32| self.complex.contacts[c as usize].key;
        each.map(|(i, c)| (key(*c), *c, i)).min().unwrap_or((0, 0, 0))
    }

    /// Prunes by all rules until nothing changes; loops that stay are returned.
    pub fn prune(&mut self, limits: Limits) -> Vec<Loop> {
        loop {
            self.drop_twigs(limits);
            self.join_chains();
            let (forest, mut extra) = self.forest();
            extra.sort_by_key(|i| self.arcs[*i].as_ref().map(|a| self.throat(&a.contacts)));
            let mut kept = Vec::new();
            let mut changed = false;
            for i in extra {
                let found = self.judge(i, &forest, limits);
                let Some(rule) = found.ended else {
                    kept.push(found);
                    continue;
                };
                self.end(i, rule, &found);
                self.ended.push(found);
                changed = true;
                break;
            }
            if !changed {
                return kept;
            }
        }
    }

    /// Dead ends that are too short, the shortest first.
    fn drop_twigs(&mut self, limits: Limits) {
        loop {
            let twigs = self.arcs.iter().enumerate().filter_map(|(i, arc)| {
                let arc = arc.as_ref()?;
                let (a, b) = (arc.nodes[0], arc.nodes[arc.nodes.len() - 1]);
                let junction = match (self.degree(a), self.degree(b)) {
                    (1, d) if d > 1 => b,
                    (d, 1) if d > 1 => a,
                    _ => return None,
                };
                // As far as it gets, not its length: chains of cells zigzag.
                let from = self.adjacency.place_mm[junction as usize];
                let far = arc.nodes.iter().map(|n| self.adjacency.place_mm[*n as usize]);
                let far = far.map(|p| p.distance(from)).fold(0.0, f64::max);
                let short = far < (2.0 * self.node_mm(junction)).max(limits.twig_mm);
                short.then_some((far, i))
            });
            let shortest = twigs.min_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            let Some((_, i)) = shortest else { return };
            self.detach(i);
            self.join_chains();
        }
    }

    /// Makes one arc of two that meet where no other does.
    fn join_chains(&mut self) {
        let through: Vec<u32> = self.at.iter().filter(|a| a.1.len() == 2).map(|a| *a.0).collect();
        for node in through {
            let Some(&[i, j]) = self.at.get(&node).map(Vec::as_slice) else { continue };
            if i == j {
                continue; // a ring
            }
            let (Some(mut a), Some(mut b)) = (self.detach(i), self.detach(j)) else { continue };
            if a.nodes[0] == node {
                a.reverse();
            }
            if b.nodes[0] != node {
                b.reverse();
            }
            a.nodes.extend(&b.nodes[1..]);
            a.contacts.extend(b.contacts);
            self.arcs[i] = Some(a);
            self.attach(i);
        }
    }

    /// The spanning forest of widest throats (Kruskal), and the arcs beyond it.
    fn forest(&self) -> (Vec<usize>, Vec<usize>) {
        let mut order: Vec<usize> =
            (0..self.arcs.len()).filter(|i| self.arcs[*i].is_some()).collect();
        order.sort_by_key(|i| {
            let throat = self.arcs[*i].as_ref().map_or(0, |a| self.throat(&a.contacts).0);
            (Reverse(throat), *i)
        });
        let mut set: BTreeMap<u32, u32> = self.at.keys().map(|n| (*n, *n)).collect();
        fn find(set: &mut BTreeMap<u32, u32>, mut n: u32) -> u32 {
            while set[&n] != n {
                let up = set[&set[&n]];
                set.insert(n, up);
                n = up;
            }
            n
        }
        order.into_iter().partition(|i| {
            let Some(arc) = &self.arcs[*i] else { return false };
            let [a, b] = [arc.nodes[0], arc.nodes[arc.nodes.len() - 1]].map(|n| find(&mut set, n));
            set.insert(a.max(b), a.min(b));
            a != b
        })
    }

    /// Arcs of the forest on the way between two nodes.
    fn forest_path(&self, forest: &[usize], from: u32, to: u32) -> Vec<usize> {
        let mut came: BTreeMap<u32, (usize, u32)> = BTreeMap::new();
        let mut open = vec![from];
        let inside: BTreeSet<usize> = forest.iter().copied().collect();
        while let Some(node) = open.pop() {
            if node == to {
                break;
            }
            for i in self.at.get(&node).into_iter().flatten().filter(|i| inside.contains(i)) {
                let Some(arc) = &self.arcs[*i] else { continue };
                let ends = [arc.nodes[0], arc.nodes[arc.nodes.len() - 1]];
                let next = if ends[0] == node { ends[1] } else { ends[0] };
                if next != from && !came.contains_key(&next) {
                    came.insert(next, (*i, node));
                    open.push(next);
                }
            }
        }
        let mut path = Vec::new();
        let mut node = to;
        while node != from {
            let Some((i, before)) = came.get(&node) else { break };
            path.push(*i);
            node = *before;
        }
        path
    }

    /// What the rules say of the loop that an arc closes.
    fn judge(&self, i: usize, forest: &[usize], limits: Limits) -> Loop {
        let Some(arc) = &self.arcs[i] else { unreachable!("an arc of the net") };
        let (a, b) = (arc.nodes[0], arc.nodes[arc.nodes.len() - 1]);
        let rest = self.forest_path(forest, a, b);
        let others = || rest.iter().filter_map(|i| self.arcs[*i].as_ref());
        let cycle_mm = self.length_mm(&arc.contacts)
            + others().map(|o| self.length_mm(&o.contacts)).sum::<f64>();
        let nodes = || arc.nodes.iter().chain(others().flat_map(|o| &o.nodes)).copied();
        let widest = nodes().min_by_key(|n| (Reverse(self.complex.nodes[*n as usize].key), *n));
        let widest_mm = widest.map_or(0.0, |n| self.node_mm(n));
        let (_, throat, place) = self.throat(&arc.contacts);
        let throat_mm = self.contact_mm(throat);
        let next = others().flat_map(|o| &o.contacts).map(|c| self.contact_mm(*c));
        let next_throat_mm = next.fold(f64::INFINITY, f64::min);
        let passage_mm = self.passage_mm(arc, place, throat_mm);
        let local = widest.is_some_and(|w| {
            let place = |n: u32| self.adjacency.place_mm[n as usize];
            nodes().all(|n| place(n).distance(place(w)) <= LOCAL * widest_mm)
        });
        let ended = if local {
            Some(Rule::Local)
        } else if passage_mm < WINDOW * throat_mm.max(self.h) {
            Some(Rule::Window)
        } else if cycle_mm < limits.loop_mm.max(SMALL_VOXELS * self.h) {
            Some(Rule::Small)
        } else {
            None
        };
        Loop { ended, throat, throat_mm, passage_mm, cycle_mm, next_throat_mm }
    }

    /// Length of a narrow passage about a throat, less what a hole in a thin plate has; at most the
    /// length outside the balls at both ends of the arc. Measured on voxels: cells are too coarse
    /// for a wall of two. The chain of cells leaves a passage slantwise; the shortest way
    /// out, on either side of the contact, does not.
    fn passage_mm(&self, arc: &Arc, place: usize, throat_mm: f64) -> f64 {
        let contact = &self.complex.contacts[arc.contacts[place] as usize];
        let half = 0.5 * self.distance.lumen.grid.spacing_mm[usize::from(contact.axis)];
        // The contact's low side is towards the arc's beginning or its end.
        let low_first = arc.nodes[place] == contact.nodes[0];
        let side = |forwards: bool| {
            let along = self.narrow_mm(self.way(arc, place, forwards), 2.0 * throat_mm);
            let out = self.way_out_mm(contact, forwards == low_first, 2.0 * throat_mm);
            out.map_or(along, |out| along.min(half + out))
        };
        let about = side(false) + side(true);
        let balls = self.node_mm(arc.nodes[0]) + self.node_mm(arc.nodes[arc.nodes.len() - 1]);
        let outside = self.length_mm(&arc.contacts) - balls;
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
    /// distance exceeds `most_mm`; `None` if that is far.
    fn way_out_mm(&self, contact: &Contact, high: bool, most_mm: f64) -> Option<f64> {
        /// Voxels to look at.
        const MOST: usize = 1 << 14;
        let h = self.distance.lumen.grid.spacing_mm;
        let axis = usize::from(contact.axis);
        let element = contact.deepest[usize::from(high)];
        let start = self.distance.lumen.bricks.voxel(element as usize);
        let on_side = |v: IVec3| {
            if high { v[axis] >= start[axis] } else { v[axis] <= start[axis] }
        };
        // Lengths in whole units, so that their order is total.
        let units = |way: IVec3| (way.as_dvec3() * h / self.adjacency.unit_mm).length().round();
        let mut open = BinaryHeap::from([Reverse((0u64, start.to_array()))]);
        let mut done = BTreeSet::new();
        while let Some(Reverse((length, at))) = open.pop() {
            let v = IVec3::from(at);
            if self.distance.voxel(v) > most_mm {
                return Some(length as f64 * self.adjacency.unit_mm);
            }
            if !done.insert(at) {
                continue;
            }
            if done.len() > MOST {
                return None;
            }
            for n in (0..27).filter(|n| *n != 13) {
                let step = IVec3::new(n % 3, n / 3 % 3, n / 9) - 1;
                let to = v + step;
                if on_side(to) && self.distance.voxel(to) > 0.0 && !done.contains(&to.to_array()) {
                    open.push(Reverse((length + units(step) as u64, to.to_array())));
                }
            }
        }
        None
    }

    /// Takes an arc away, or cuts it at its throat.
    fn end(&mut self, i: usize, rule: Rule, found: &Loop) {
        let Some(arc) = self.detach(i) else { return };
        if rule != Rule::Window {
            return;
        }
        let Some(place) = arc.contacts.iter().position(|c| *c == found.throat) else { return };
        let halves = [
            Arc { nodes: arc.nodes[..=place].to_vec(), contacts: arc.contacts[..place].to_vec() },
            Arc {
                nodes: arc.nodes[place + 1..].to_vec(),
                contacts: arc.contacts[place + 1..].to_vec(),
            },
        ];
        for half in halves.into_iter().filter(|h| !h.contacts.is_empty()) {
            self.arcs.push(Some(half));
            self.attach(self.arcs.len() - 1);
        }
    }

    /// Nodes where arcs end and that nothing else meets: tips that were kept, ends of cut arcs.
    pub fn ends(&self) -> Vec<u32> {
        self.at.iter().filter(|a| a.1.len() == 1).map(|a| *a.0).collect()
    }

    /// Tips given that lie on no arc's inside.
    pub fn tips(&self) -> &[u32] {
        &self.tips
    }
}

impl Arc {
    fn reverse(&mut self) {
        self.nodes.reverse();
        self.contacts.reverse();
    }
}
