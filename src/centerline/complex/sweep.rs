//! Geodesic lengths over the contacts of a complex, and the tips they find.

use std::array::from_fn;
use std::cmp::Reverse;

use glam::{DVec3, IVec3};

use super::CellComplex;
use crate::centerline::queue::Queue;
use crate::geometry::{DisjointSets, in_rows};
use crate::lumen::Lumen;
use crate::lumen::bricks::{near_index, near_offset};
use crate::task::checkpoint;

/// Length that no path has: the node was not reached.
pub const UNREACHED: u32 = u32::MAX;
/// Number of length units in the smallest spacing: ties between paths are rare, and sums are exact.
pub const UNITS: f64 = 64.0;

/// Contacts at each node, with their lengths.
pub struct NodeContacts<'a> {
    /// Steps to diagonal neighbors too, where every voxel is a node: contacts alone would measure
    /// lengths along the axes.
    steps: Option<VoxelSteps<'a>>,
    start: Vec<u32>,
    /// Contacts and the nodes at their other ends, by node; contacts ascend.
    meeting: Vec<(u32, u32)>,
    /// Length of each contact: from the deepest voxel of one node through the middle of its deepest
    /// pair to that of the other, in units of [`NodeContacts::unit_mm`].
    pub length: Vec<u32>,
    /// The unit of lengths, mm.
    pub unit_mm: f64,
    /// Deepest voxel of each node, local mm.
    pub place_mm: Vec<DVec3>,
}

impl<'a> NodeContacts<'a> {
    /// Collects all contacts of a complex.
    pub fn new(complex: &'a CellComplex, lumen: &'a Lumen) -> Self {
        let h = lumen.grid.spacing_mm;
        let unit_mm = h.min_element() / UNITS;
        let at = |e: u32| lumen.bricks.voxel(e as usize).as_dvec3() * h;
        let place_mm: Vec<DVec3> = complex.nodes.iter().map(|n| at(n.deepest)).collect();
        let length = complex.contacts.iter().map(|c| {
            let [a, b] = c.nodes.map(|n| place_mm[n as usize]);
            let [p, q] = c.deepest.map(at);
            let middle: DVec3 = 0.5 * (p + q);
            ((a.distance(middle) + middle.distance(b)) / unit_mm).round() as u32
        });
        let length = length.collect();
        let (start, meeting) = in_rows(complex.nodes.len(), || {
            complex.contacts.iter().zip(0u32..).flat_map(|(contact, c)| {
                let [a, b] = contact.nodes;
                [(a, (c, b)), (b, (c, a))]
            })
        });
        let steps = complex.is_fine().then(|| VoxelSteps::new(complex, lumen, unit_mm));
        Self { steps, start, meeting, length, unit_mm, place_mm }
    }

    /// Contacts of a node, each with the node beyond.
    #[inline]
    pub fn of(&self, node: u32) -> &[(u32, u32)] {
        &self.meeting[self.start[node as usize] as usize..self.start[node as usize + 1] as usize]
    }

    /// Visits the nodes a step away, each with the step's length.
    #[inline]
    fn each_step(&self, node: u32, mut visit: impl FnMut(u32, u32)) {
        match &self.steps {
            Some(steps) => steps.each(node, visit),
            None => {
                for &(contact, to) in self.of(node) {
                    visit(to, self.length[contact as usize]);
                }
            }
        }
    }

    /// Number of nodes.
    fn len(&self) -> usize {
        self.start.len() - 1
    }

    /// Length of the shortest path from the nearest of `sources` to each node (Dijkstra's search
    /// with Dial's buckets).
    pub fn lengths(&self, sources: &[u32]) -> Vec<u32> {
        let mut length = vec![UNREACHED; self.len()];
        let most = match &self.steps {
            Some(steps) => steps.length.into_iter().max(),
            None => self.length.iter().copied().max(),
        };
        let most = most.unwrap_or(0);
        let mut queue = Queue::new(most, 0);
        for &s in sources {
            length[s as usize] = 0;
            queue.push(0, s);
        }
        let mut batch = Vec::new();
        while let Some(at) = queue.next(&mut batch) {
            checkpoint();
            for &node in &batch {
                if length[node as usize] != at {
                    continue; // reached sooner since
                }
                self.each_step(node, |to, step| {
                    let new = at.saturating_add(step);
                    if new < length[to as usize] {
                        length[to as usize] = new;
                        queue.push(new, to);
                    }
                });
            }
        }
        length
    }

    /// Component of each node, numbered in the order of their lowest nodes.
    pub fn components(&self) -> Vec<u32> {
        let mut component = vec![u32::MAX; self.len()];
        let (mut open, mut count) = (Vec::new(), 0);
        for first in 0..self.len() as u32 {
            if component[first as usize] != u32::MAX {
                continue;
            }
            component[first as usize] = count;
            open.push(first);
            while let Some(node) = open.pop() {
                for &(_, to) in self.of(node) {
                    if component[to as usize] == u32::MAX {
                        component[to as usize] = count;
                        open.push(to);
                    }
                }
            }
            count += 1;
        }
        component
    }
}

/// Steps from voxel to voxel. A diagonal one is legal where every voxel of the block that it spans is
/// inside: the straight segment then stays inside the surface.
struct VoxelSteps<'a> {
    complex: &'a CellComplex,
    lumen: &'a Lumen,
    /// Length of each step, by its place among the 27 neighbors.
    length: [u32; 27],
    /// Voxels that have to be inside for each step, as bits of the 27 neighbors.
    block: [u32; 27],
}

impl<'a> VoxelSteps<'a> {
    fn new(complex: &'a CellComplex, lumen: &'a Lumen, unit_mm: f64) -> Self {
        let h = lumen.grid.spacing_mm;
        let length = |n| ((near_offset(n).as_dvec3() * h).length() / unit_mm).round() as u32;
        let block = |n| {
            let corner = |k: i32| near_offset(n) * IVec3::new(k & 1, k >> 1 & 1, k >> 2);
            let bit = |d: IVec3| 1u32 << near_index(d.x, d.y, d.z);
            (0..8).fold(0, |bits, k| bits | bit(corner(k)))
        };
        Self { complex, lumen, length: from_fn(length), block: from_fn(block) }
    }

    #[inline]
    fn each(&self, node: u32, mut visit: impl FnMut(u32, u32)) {
        const OWN: usize = near_index(0, 0, 0);
        let element = self.complex.nodes[node as usize].deepest as usize;
        let mut near = [u32::MAX; 27];
        let mut inside = 0u32;
        for (n, near) in near.iter_mut().enumerate() {
            let to = self.lumen.bricks.step(element, near_offset(n));
            if let Some(to) = to.and_then(|to| self.complex.node_at(to)) {
                *near = to;
                inside |= 1 << n;
            }
        }
        for n in (0..27).filter(|n| *n != OWN) {
            if self.block[n] & inside == self.block[n] {
                visit(near[n], self.length[n]);
            }
        }
    }
}

/// Per component the node that comes first by `order`.
pub fn first_of_each<K: Ord>(component: &[u32], order: impl Fn(u32) -> K) -> Vec<u32> {
    let count = component.iter().max().map_or(0, |c| *c as usize + 1);
    let mut best: Vec<Option<(K, u32)>> = (0..count).map(|_| None).collect();
    for (node, c) in (0u32..).zip(component) {
        let key = (order(node), node);
        let best = &mut best[*c as usize];
        if best.as_ref().is_none_or(|b| key < *b) {
            *best = Some(key);
        }
    }
    best.into_iter().flatten().map(|b| b.1).collect()
}

/// Nodes where a branch may end: maxima of the length from the root that rise above the saddle which
/// joins them to a longer one by at least the distance to the wall there, and by `least`.
///
/// * `length`: from the roots. `width`: distance to the wall at each node; `least`: both in units of
///   length.
///
/// Of each component the farthest node is one. In ascending order.
pub fn tips(
    adjacency: &NodeContacts<'_>,
    length: &[u32],
    width: impl Fn(u32) -> u32,
    least: u32,
) -> Vec<u32> {
    let mut order: Vec<u32> = (0..adjacency.len() as u32).collect();
    order.sort_unstable_by_key(|n| (Reverse(length[*n as usize]), *n));
    // Nodes that were met, in sets; the set's maximum at its root.
    let mut sets = DisjointSets::new(adjacency.len());
    let mut is_met = vec![false; adjacency.len()];
    let mut top: Vec<u32> = (0..adjacency.len() as u32).collect();
    let mut found = Vec::new();
    for &node in &order {
        is_met[node as usize] = true;
        let mut has_set = false;
        for &(_, to) in adjacency.of(node) {
            if !is_met[to as usize] {
                continue;
            }
            let [own, other] = [node, to].map(|n| top[sets.root(n) as usize]);
            let rank = |tip: u32| (Reverse(length[tip as usize]), tip);
            let (keep, end) = if rank(own) <= rank(other) { (own, other) } else { (other, own) };
            // The first neighbour's set takes the node in.
            if sets.join(node, to) && has_set {
                let rise = length[end as usize] - length[node as usize];
                if rise >= width(node).max(least) {
                    found.push(end);
                }
            }
            has_set = true;
            top[sets.root(node) as usize] = keep;
        }
    }
    let roots = (0..adjacency.len() as u32).filter(|n| sets.root(*n) == *n);
    found.extend(roots.map(|n| top[n as usize]));
    found.sort_unstable();
    found
}
