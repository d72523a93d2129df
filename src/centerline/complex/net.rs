//! The graph that a complex collapsed onto, as arcs between tips and junctions, and the rules that
//! prune it: twigs, small loops, windows between folds.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet, BinaryHeap};

use glam::{DVec3, IVec3};
use rayon::prelude::*;

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
const WINDOW: f64 = 4.0;
/// A hole is at most this share as wide as the lumen beside it.
const WIDEST_HOLE: f64 = 0.5;
/// Shorter than this many, a passage at the narrowest place of a loop is a window without a look at
/// its other places.
const CLEAR_WINDOW: f64 = 2.0;
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
    /// Nodes at which arcs end and that no rule prunes: given ends.
    held: BTreeSet<u32>,
    /// Loops that were ended, in the order in which they were.
    pub ended: Vec<Loop>,
}

impl<'a> Net<'a> {
    /// The arcs of what is left of a complex.
    ///
    /// * `held`: nodes at which arcs end and that no rule prunes.
    /// * `distance`: to the wall, mm.
    pub fn new(
        complex: &'a CellComplex,
        adjacency: &'a Adjacency,
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
        // What is left are rings; each begins at its deepest node.
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

    /// Prunes by all rules, in rounds until nothing changes; loops that stay are returned.
    pub fn prune(&mut self, limits: Limits) -> Vec<Loop> {
        // What was measured of each arc; arcs are replaced under new numbers when they change.
        let mut passages: BTreeMap<usize, f64> = BTreeMap::new();
        let mut measured: BTreeMap<usize, Option<Passage>> = BTreeMap::new();
        loop {
            self.drop_twigs(limits);
            let (forest, mut extra) = self.forest();
            extra.sort_by_key(|i| self.arcs[*i].as_ref().map(|a| self.throat(&a.contacts)));
            // Arcs beyond the forest do not lie on each other's cycles: one that ends leaves the
            // others' as they were.
            let forest = Forest::new(self, &forest);
            let new: Vec<usize> =
                extra.iter().copied().filter(|i| !passages.contains_key(i)).collect();
            let found: Vec<f64> = new.par_iter().map(|i| self.passage_of(*i)).collect();
            passages.extend(new.into_iter().zip(found));
            let judged: Vec<(usize, Loop)> = extra
                .into_iter()
                .filter_map(|i| Some((i, self.judge(i, &forest, passages[&i], limits)?)))
                .collect();
            let ended = judged.iter().filter(|(_, found)| found.ended.is_some());
            let ended: Vec<(usize, Loop)> = ended.cloned().collect();
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
            let small = judged.iter().find(|(_, l)| is_small(l)).cloned();
            let Some((i, mut found)) = small else {
                return judged.into_iter().map(|k| k.1).collect();
            };
            found.ended = Some(Rule::Small);
            self.end(i, &found);
            self.ended.push(found);
        }
    }

    /// How many of the halves of an arc, cut at a place, get far enough from the junctions they
    /// begin at to be no twigs. Where the walls of two lumens touch, none does: the hole is within
    /// reach of both axes. Where the end of one touches another, one does. A stricture has two.
    fn long_halves(&self, arc: &Arc, place: usize, limits: Limits) -> usize {
        let at = |n: u32| self.adjacency.place_mm[n as usize];
        let [a, b] = arc.ends();
        let is_long = |junction: u32, half: &[u32]| {
            let far = half.iter().map(|n| at(*n).distance(at(junction))).fold(0.0, f64::max);
            far >= (2.0 * self.node_mm(junction)).max(limits.twig_mm)
        };
        usize::from(is_long(a, &arc.nodes[..=place]))
            + usize::from(is_long(b, &arc.nodes[place + 1..]))
    }

    /// Arcs of the cycle that one beyond the forest closes.
    fn cycle(&self, i: usize, forest: &Forest) -> Vec<usize> {
        let Some(arc) = &self.arcs[i] else { return Vec::new() };
        let [a, b] = arc.ends();
        forest.path(a, b).into_iter().chain([i]).collect()
    }

    /// Whether an arc may be a window: its long halves (one at most), and its passage for its width.
    fn measure(&self, i: usize, limits: Limits) -> Option<Passage> {
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

    /// Of the arcs of a cycle, the one that is most of a window: with the fewest long halves, and
    /// with the shortest passage for its width. With what is found of the loop there.
    fn window_on(
        &self,
        cycle: &[usize],
        found: &Loop,
        measured: &mut BTreeMap<usize, Option<Passage>>,
        limits: Limits,
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

    /// How far a dead end gets from where it begins, if it is too short for a branch. Not its
    /// length: chains of cells zigzag.
    fn twig(&self, i: usize, limits: Limits) -> Option<f64> {
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

    /// Dead ends that are too short, the shortest first.
    fn drop_twigs(&mut self, limits: Limits) {
        for node in self.at.keys().copied().collect::<Vec<_>>() {
            self.join_at(node);
        }
        let all = 0..self.arcs.len();
        // Lengths are not negative: their bits are in their order.
        let entry = |this: &Self, i: usize| Some((this.twig(i, limits)?.to_bits(), i));
        let mut twigs: BTreeSet<(u64, usize)> = all.filter_map(|i| entry(self, i)).collect();
        while let Some((length, i)) = twigs.pop_first() {
            if entry(self, i) != Some((length, i)) {
                continue; // changed since
            }
            let Some(arc) = self.detach(i) else { continue };
            for node in arc.ends() {
                if let Some(joined) = self.join_at(node) {
                    twigs.extend(entry(self, joined));
                }
                // What is left at a junction may be a dead end now.
                let meeting = self.at.get(&node).cloned().unwrap_or_default();
                twigs.extend(meeting.into_iter().filter_map(|i| entry(self, i)));
            }
        }
    }

    /// Makes one arc, under a new number, of two that meet where no other does.
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

    fn push(&mut self, arc: Arc) -> usize {
        self.arcs.push(Some(arc));
        self.attach(self.arcs.len() - 1);
        self.arcs.len() - 1
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
            let [a, b] = arc.ends().map(|n| find(&mut set, n));
            set.insert(a.max(b), a.min(b));
            a != b
        })
    }

    /// What the rules say of the loop that an arc closes.
    fn judge(&self, i: usize, forest: &Forest, passage_mm: f64, limits: Limits) -> Option<Loop> {
        let arc = self.arcs[i].as_ref()?;
        let [a, b] = arc.ends();
        let rest = forest.path(a, b);
        let others = || rest.iter().filter_map(|i| self.arcs[*i].as_ref());
        let cycle_mm = self.length_mm(&arc.contacts)
            + others().map(|o| self.length_mm(&o.contacts)).sum::<f64>();
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

    fn passage_of(&self, i: usize) -> f64 {
        let Some(arc) = &self.arcs[i] else { return 0.0 };
        let (_, throat, place) = self.throat(&arc.contacts);
        self.passage_mm(arc, place, self.contact_mm(throat))
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
            let high = forwards == low_first;
            // Nothing farther is a window.
            let longest = (along - half).min((PLATE + WINDOW) * throat_mm.max(self.h));
            let out = self.way_out_mm(contact, high, 2.0 * throat_mm, longest);
            out.map_or(along, |out| half + out)
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
        let index = |v: IVec3| {
            let p = v - low;
            (p.cmpge(IVec3::ZERO).all() && p.cmplt(size).all())
                .then(|| (p.x + size.x * (p.y + size.y * p.z)) as usize)
        };
        let voxel = |i: usize| {
            let i = i as i32;
            low + IVec3::new(i % size.x, i / size.x % size.y, i / (size.x * size.y))
        };
        // Lengths in whole units, so that their order is total.
        let units = |way: IVec3| (way.as_dvec3() * h / self.adjacency.unit_mm).length().round();
        let steps: Vec<(IVec3, u32)> = (0..27)
            .filter(|n| *n != 13)
            .map(|n| IVec3::new(n % 3, n / 3 % 3, n / 9) - 1)
            .map(|step| (step, units(step) as u32))
            .collect();
        let mut done = vec![false; size.as_usizevec3().element_product()];
        let mut open = BinaryHeap::from([Reverse((0u32, index(start)?))]);
        while let Some(Reverse((length, at))) = open.pop() {
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

    /// Takes an arc away, or cuts it at its throat.
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

    /// Nodes where one arc ends and nothing else meets it: tips, given ends, ends of cut arcs. In
    /// ascending order.
    pub fn leaves(&self) -> Vec<u32> {
        self.at.iter().filter(|a| a.1.len() == 1).map(|a| *a.0).collect()
    }

    /// Nodes where arcs end, ascending.
    pub fn nodes(&self) -> impl Iterator<Item = u32> + '_ {
        self.at.keys().copied()
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

    /// Shortest ways from a node over arcs: length and, but for the node itself, the arc by which
    /// each was reached.
    ///
    /// * `length`: of each arc by its number; a total order of sums makes the ways unique but for
    ///   ties, in which the lower arc counts.
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

    /// Length of an arc in the unit of [`Adjacency::unit_mm`].
    pub fn length(&self, i: usize) -> u64 {
        let contacts = self.arcs[i].iter().flat_map(|a| &a.contacts);
        contacts.map(|c| u64::from(self.adjacency.length[*c as usize])).sum()
    }

    /// ∫(h/d)² along an arc, h the smallest spacing, d the distance to the wall at its contacts, in
    /// the unit of [`Adjacency::unit_mm`] over 256.
    pub fn centrality(&self, i: usize) -> u64 {
        let contacts = self.arcs[i].iter().flat_map(|a| &a.contacts);
        contacts.map(|c| self.contact_centrality(*c)).sum()
    }

    /// The same of one contact. Its key is 4 (d/h)².
    pub fn contact_centrality(&self, contact: u32) -> u64 {
        let key = self.complex.contacts[contact as usize].key.max(1);
        u64::from(self.adjacency.length[contact as usize]) * 1024 / u64::from(key)
    }
}

/// An arc that may be a window.
struct Passage {
    halves: usize,
    ratio: f64,
    throat: u32,
    passage_mm: f64,
}

/// A spanning forest with its roots, to walk up.
struct Forest {
    /// Of each node that is not a root: the arc towards it, the node there, and steps to the root.
    up: BTreeMap<u32, (usize, u32, u32)>,
}

impl Forest {
    fn new(net: &Net<'_>, forest: &[usize]) -> Self {
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

    /// Arcs on the way between two nodes of one tree.
    fn path(&self, mut a: u32, mut b: u32) -> Vec<usize> {
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

impl Arc {
    /// Its first and last node.
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
