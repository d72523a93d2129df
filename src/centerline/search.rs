//! Shortest routes on the voxel graph.
//!
//! Dijkstra's search with a circular queue of buckets (Dial 1969, doi:10.1145/363269.363610): costs
//! are integers, and what is settled when is fixed. Lengths do not depend on the place, so in the
//! open most steps lead where another route goes as cheaply. Only steps that may not be replaced are
//! looked at, as in jump point search (Harabor & Grastien 2011, doi:10.1609/aaai.v25i1.7994), but
//! settling every node. The paper's path uses it to bridge what no ray joins.

use rayon::prelude::*;

use super::graph::{FREE, Graph, STAY, number, offset};
use super::queue::Queue;

/// Cost of an element that no route reaches.
pub const NOWHERE: u32 = u32::MAX;

/// Result of a search from one or more sources.
pub struct Routes {
    /// Quantised cost from the source by field element, [`NOWHERE`] where there is no route.
    pub cost: Vec<u32>,
    /// Nodes in the order they were settled.
    pub order: Vec<u32>,
    /// Number of the step by which each node was reached.
    by: Vec<u8>,
}

/// Steps worth taking after a step, where everything around is inside: bits by offset number.
///
/// Step `b` after `a` is not worth it when two other steps, or one, lead to the same place by way
/// of the surroundings and are shorter together, or as short and first in a fixed order of steps,
/// diagonal ones before straight ones. Among the shortest routes to a node the first in that order
/// then takes no step that is left out.
fn worthwhile(length: &[u32; 27]) -> [u32; 27] {
    let rank = |n: usize| (3 - offset(n).abs().element_sum(), n);
    let mut out = [FREE; 27];
    for a in (0..27).filter(|n| *n != STAY) {
        for b in (0..27).filter(|n| *n != STAY) {
            let (to, cost) = (offset(a) + offset(b), length[a] + length[b]);
            let better = |c: usize| {
                let rest = to - offset(c);
                let in_sight = (offset(c) - offset(a)).abs().max_element() <= 1;
                if !in_sight || rest.abs().max_element() > 1 {
                    return false;
                }
                let other = length[c] + length[number(rest)];
                other < cost || (other == cost && rank(c) < rank(a))
            };
            if (0..27).any(better) {
                out[a] &= !(1 << b);
            }
        }
    }
    out
}

impl Graph<'_> {
    /// Resolution of [`Graph::by_length`], mm: a sixty-fourth of the shortest spacing.
    pub fn length_unit_mm(&self) -> f64 {
        self.lumen().grid.spacing_mm.min_element() / 64.0
    }

    /// Lengths of the steps in [`Graph::length_unit_mm`].
    fn lengths(&self) -> [u32; 27] {
        let unit = self.length_unit_mm();
        self.step_lengths_mm().map(|l| (l / unit).round() as u32)
    }

    /// Geodesic distance from `sources`, in [`Graph::length_unit_mm`].
    pub fn by_length(&self, sources: &[u32]) -> Routes {
        let length = self.lengths();
        let worthwhile = worthwhile(&length);
        let n = self.lumen().bricks.field_len();
        // Cost, and steps worth taking after those that led there at that cost.
        let mut state = vec![(NOWHERE, 0u32); n];
        let mut by = vec![STAY as u8; n];
        let mut order = Vec::with_capacity(self.len());
        let mut queue = Queue::new(length.iter().copied().fold(1, u32::max), 0);
        for &s in sources {
            state[s as usize] = (0, FREE);
            queue.push(0, s);
        }
        let mut batch = Vec::new();
        while let Some(at) = queue.next(&mut batch) {
            crate::task::checkpoint();
            for &u in &batch {
                let (cost, mut steps) = state[u as usize];
                if cost != at {
                    continue; // reached sooner since
                }
                order.push(u);
                let legal = self.legal(u);
                if legal != FREE {
                    steps = legal;
                }
                let leads = self.leads(u);
                while steps != 0 {
                    let n = steps.trailing_zeros() as usize;
                    steps &= steps - 1;
                    let v = leads(n);
                    let c = at.saturating_add(length[n]);
                    let old = &mut state[v as usize];
                    if c < old.0 {
                        *old = (c, worthwhile[n]);
                        by[v as usize] = n as u8;
                        queue.push(c, v);
                    } else if c == old.0 {
                        old.1 |= worthwhile[n];
                    }
                }
            }
        }
        crate::task::checkpoint();
        let cost = state.into_par_iter().with_min_len(1 << 16).map(|s| s.0).collect();
        Routes { cost, order, by }
    }
}

impl Routes {
    /// The settled node farthest from the sources; of several the first in element order.
    pub fn farthest(&self) -> Option<u32> {
        let most = self.cost[*self.order.last()? as usize];
        self.order.iter().rev().copied().take_while(|n| self.cost[*n as usize] == most).min()
    }

    /// The node before a settled one on its route; a source is its own.
    pub fn parent(&self, graph: &Graph<'_>, node: u32) -> u32 {
        match usize::from(self.by[node as usize]) {
            STAY => node,
            n => graph.step(node, 26 - n),
        }
    }

    /// Nodes from a source to `node`, both included; empty when there is no route.
    pub fn path_to(&self, graph: &Graph<'_>, node: u32) -> Vec<u32> {
        let mut path = Vec::new();
        if self.cost[node as usize] == NOWHERE {
            return path;
        }
        path.push(node);
        let mut at = node;
        loop {
            let up = self.parent(graph, at);
            if up == at {
                break;
            }
            path.push(up);
            at = up;
        }
        path.reverse();
        path
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::{BitVolume, Lumen};
    use crate::volume::Grid;
    use glam::{IVec3, UVec3};

    fn lumen(dims: [u32; 3], spacing: [f64; 3], inside: impl Fn(UVec3) -> bool) -> Lumen {
        let grid = Grid::axis_aligned(dims, spacing);
        let mut bits = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
            bits.set(v.x, v.y, v.z);
        }
        Lumen::new(grid, &bits)
    }

    /// Bellman and Ford's relaxation of every step until nothing changes.
    fn relaxed(g: &Graph<'_>, source: u32, cost: impl Fn(u32, u32, usize) -> u32) -> Vec<u32> {
        let mut out = vec![NOWHERE; g.lumen().bricks.field_len()];
        out[source as usize] = 0;
        let mut again = true;
        while again {
            again = false;
            for u in g.nodes().filter(|u| out[*u as usize] != NOWHERE).collect::<Vec<_>>() {
                for (n, v) in g.steps(u) {
                    let c = out[u as usize] + cost(u, v, n);
                    if c < out[v as usize] {
                        (out[v as usize], again) = (c, true);
                    }
                }
            }
        }
        out
    }

    /// Wide rooms with a pillar, a rough wall and a second part nothing leads to.
    fn rooms(spacing: [f64; 3]) -> Lumen {
        lumen([26, 23, 15], spacing, |v| {
            let rough = (v.x * 7 + v.y * 13 + v.z * 29 + v.x * v.z) % 5 != 0;
            let pillar = (v.x / 3, v.y / 3) == (3, 3);
            let cut = v.x == 20;
            !pillar && !cut && (v.y < 17 || rough)
        })
    }

    #[test]
    fn geodesic_lengths_with_pruned_directions_equal_those_without() {
        for spacing in [[1.0; 3], [0.8, 0.8, 1.25], [1.0, 0.3, 7.0], [0.78125, 0.78125, 0.79]] {
            let l = rooms(spacing);
            let g = Graph::new(&l);
            let length = g.lengths();
            for source in [IVec3::new(1, 1, 7), IVec3::new(14, 8, 0), IVec3::new(23, 4, 4)] {
                let source = g.node_at(source).expect("inside");
                let got = g.by_length(&[source]);
                let want = relaxed(&g, source, |_, _, n| length[n]);
                assert_eq!(got.cost, want);
                let reached = want.iter().filter(|c| **c != NOWHERE).count();
                assert_eq!(got.order.len(), reached);
                assert!(got.order.is_sorted_by_key(|n| want[*n as usize]));
                let far = got.farthest().expect("a node");
                let path = got.path_to(&g, far);
                let sum: u32 = path
                    .windows(2)
                    .map(|w| length[g.steps(w[0]).find(|s| s.1 == w[1]).expect("legal").0])
                    .sum();
                assert_eq!((path[0], sum), (source, want[far as usize]));
            }
        }
    }

    #[test]
    fn pruned_directions_are_most_of_them() {
        let l = lumen([3, 3, 3], [1.0; 3], |_| true);
        let kept = worthwhile(&Graph::new(&l).lengths()).map(u32::count_ones);
        for (n, kept) in kept.into_iter().enumerate().filter(|(n, _)| *n != STAY) {
            let axes = offset(n).abs().element_sum();
            assert!((1..1 << axes).contains(&kept), "{n}: {kept}");
        }
    }
}
