//! Shortest and cheapest routes on the voxel graph.
//!
//! All searches are Dijkstra's with a circular queue of buckets (Dial 1969,
//! doi:10.1145/363269.363610): costs are integers, and what is settled when is fixed. Two
//! departures make them fast, and both leave every cost as it is:
//!
//! * Lengths do not depend on the place, so in the open most steps lead where another route goes
//!   as cheaply. Only steps that may not be replaced are looked at, as in jump point search
//!   (Harabor & Grastien 2011, doi:10.1609/aaai.v25i1.7994), but settling every node.
//! * A route between two ends is found by A* (Hart, Nilsson & Raphael 1968,
//!   doi:10.1109/TSSC.1968.300136) under a bound from the lengths to the goal: the way there leads
//!   through all lesser lengths, at each of them over no more than the greatest distance to the
//!   wall found there.
//!
//! In bends that bound is weak; a central route is therefore looked for among places in the corridor
//! first.

use rayon::prelude::*;

use super::graph::{FREE, Graph, STAY, number, offset};
use super::queue::Queue;
use super::search_corridor::SearchCorridor;

/// No distance.
pub const NOWHERE: u32 = u32::MAX;
/// Not settled.
const OPEN: u8 = 0x80;

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

    /// Cheapest routes from `sources` when a step costs its length times the mean of
    /// (h/d)² at its ends: far from walls where it can be.
    ///
    /// * `distance`: the exact distance field, mm.
    pub fn by_centrality(&self, sources: &[u32], distance: &[f32]) -> Routes {
        self.cheapest(sources, None, &Centrality::new(self, distance), None, |_| 0)
    }

    /// A central route between two nodes; empty when there is none.
    ///
    /// Costs are those of [`Graph::by_centrality`]. Places in the corridor are looked at first; the
    /// route found there is good enough where none at all can cost less than two thirds of it.
    /// Otherwise it is the cheapest.
    ///
    /// * `lengths`: [`Graph::by_length`] from `to`.
    pub fn central_route(
        &self,
        from: u32,
        to: u32,
        lengths: &Routes,
        distance: &[f32],
    ) -> Vec<u32> {
        if lengths.cost[from as usize] == NOWHERE {
            return Vec::new();
        }
        let centrality = Centrality::new(self, distance);
        let bound = Bound::new(self, lengths, &centrality);
        let corridor = SearchCorridor::new(self, distance, [from, to]);
        let routes =
            self.cheapest(&[from], Some(to), &centrality, Some(&corridor), |v| bound.at(v));
        if u64::from(routes.cost[to as usize]) * 2 <= u64::from(bound.at(from)) * 3 {
            return routes.path_to(self, to);
        }
        let routes = self.cheapest(&[from], Some(to), &centrality, None, |v| bound.at(v));
        routes.path_to(self, to)
    }

    /// A* until `goal`, or all of Dijkstra's search when the bound is 0.
    ///
    /// * `corridor`: where to look; everywhere without.
    /// * `bound`: no more than the cost from a node to the goal, and between neighbours no steeper
    ///   than the step between them.
    fn cheapest(
        &self,
        sources: &[u32],
        goal: Option<u32>,
        centrality: &Centrality<'_>,
        corridor: Option<&SearchCorridor>,
        bound: impl Fn(u32) -> u32,
    ) -> Routes {
        // Cost and weight side by side: what a look at a neighbour needs. Nothing leads more
        // cheaply to where not to look.
        let distance = centrality.distance.par_iter().enumerate().with_min_len(1 << 16);
        let mut state: Vec<(u32, f32)> = distance
            .map(|(e, d)| match corridor {
                Some(corridor) if !corridor.holds(e, *d) => (0, 0.0),
                _ => (NOWHERE, centrality.weight(*d)),
            })
            .collect();
        let mut by = vec![OPEN; state.len()];
        let mut order = Vec::new();
        let first = sources.iter().map(|s| bound(*s)).min().unwrap_or(0);
        let slack = sources.iter().map(|s| bound(*s) - first).max().unwrap_or(0);
        let most = centrality.most * if goal.is_some() { 2 } else { 1 };
        let mut queue = Queue::new(most.max(slack), first);
        for &s in sources {
            state[s as usize].0 = 0;
            by[s as usize] = OPEN | STAY as u8;
            queue.push(bound(s), s);
        }
        let mut batch = Vec::new();
        'search: while queue.next(&mut batch).is_some() {
            crate::task::checkpoint();
            for &u in &batch {
                let came = by[u as usize];
                if came & OPEN == 0 {
                    continue; // settled before, more cheaply
                }
                by[u as usize] = came & !OPEN;
                order.push(u);
                if goal == Some(u) {
                    break 'search;
                }
                let (at, weight) = state[u as usize];
                // Its own half of a step often tells that it leads nowhere new.
                let least = centrality.kinds.map(|l| at.saturating_add((l * weight) as u32));
                for (n, v) in self.steps(u) {
                    let (old, there) = state[v as usize];
                    if old <= least[KIND[n]] {
                        continue;
                    }
                    let step = centrality.length[n] * (weight + there);
                    let c = at.saturating_add(step as u32 + 1);
                    if c < old {
                        state[v as usize].0 = c;
                        by[v as usize] = OPEN | n as u8;
                        queue.push(c.saturating_add(bound(v)), v);
                    }
                }
            }
        }
        crate::task::checkpoint();
        let cost = state.into_par_iter().with_min_len(1 << 16).map(|s| s.0).collect();
        Routes { cost, order, by }
    }
}

/// Which axes a step runs along, one bit each: steps of a kind are of one length.
const KIND: [usize; 27] = {
    let mut out = [0; 27];
    let mut n = 0;
    while n < 27 {
        let d = offset(n);
        out[n] = (d.x & 1 | (d.y & 1) << 1 | (d.z & 1) << 2) as usize;
        n += 1;
    }
    out
};

/// What a step costs.
struct Centrality<'a> {
    distance: &'a [f32],
    /// Shortest spacing, mm.
    h: f32,
    /// Cost of the cheapest unit step over (h/d)².
    scale: f32,
    /// Lengths of the steps over h.
    length: [f32; 27],
    /// The same by [`KIND`].
    kinds: [f32; 8],
    /// The dearest step.
    most: u32,
}

impl<'a> Centrality<'a> {
    fn new(graph: &Graph<'_>, distance: &'a [f32]) -> Self {
        let h = graph.lumen().grid.spacing_mm.min_element() as f32;
        let deepest = distance.par_iter().with_min_len(1 << 16).copied().reduce(|| h, f32::max);
        // The cheapest unit step, deep inside, is worth 64; the dearest is bounded, so that a
        // circular queue of buckets holds every pending cost.
        let cheapest = (h / deepest).powi(2);
        let scale = (64.0 / cheapest).min(65_536.0);
        let length = graph.step_lengths_mm().map(|l| l as f32 / h);
        let longest = length.iter().copied().fold(1.0, f32::max);
        let mut kinds = [0.0; 8];
        for (n, l) in length.into_iter().enumerate() {
            kinds[KIND[n]] = l;
        }
        Self { distance, h, scale, length, kinds, most: (scale * longest).ceil() as u32 + 1 }
    }

    /// Half of what a unit step costs in the direction of a node, by its distance.
    #[inline]
    fn weight(&self, distance: f32) -> f32 {
        0.5 * self.scale * (self.h / distance.max(self.h)).powi(2)
    }
}

/// Least cost from a node to the goal of a search, from its length to it.
struct Bound<'a> {
    /// Length to the goal by element.
    length: &'a [u32],
    /// Lengths of a class.
    class: u32,
    /// For each class the bound at its start and what a unit of length adds, in 2⁻²⁰.
    table: Vec<(u64, u64)>,
}

impl<'a> Bound<'a> {
    const SHIFT: u32 = 20;

    fn new(graph: &Graph<'_>, lengths: &'a Routes, centrality: &Centrality<'_>) -> Self {
        let quantised = graph.lengths();
        // A step then stays in its class or goes to the next.
        let class = quantised.iter().copied().fold(1, u32::max);
        let farthest = lengths.farthest().map_or(0, |f| lengths.cost[f as usize]);
        let classes = (farthest / class) as usize + 1;
        let deepest = lengths
            .order
            .par_chunks(1 << 16)
            .map(|nodes| {
                let mut deepest = vec![0f32; classes];
                for &n in nodes {
                    let c = &mut deepest[(lengths.cost[n as usize] / class) as usize];
                    *c = c.max(centrality.distance[n as usize]);
                }
                deepest
            })
            .reduce(
                || vec![0f32; classes],
                |a, b| a.iter().zip(&b).map(|(a, b)| a.max(*b)).collect(),
            );
        // A step's cost is rounded up, its length to the nearest: the least true length of a unit.
        // The last factor is for the rounding of costs in single precision.
        let unit = (0..27)
            .filter(|n| *n != STAY)
            .map(|n| f64::from(centrality.length[n]) / f64::from(quantised[n]))
            .fold(f64::INFINITY, f64::min)
            * (1.0 - 1e-5);
        let mut start = 0;
        let table = (0..classes)
            .map(|i| {
                let around = &deepest[i.saturating_sub(1)..(i + 2).min(classes)];
                let d = around.iter().copied().fold(centrality.h, f32::max);
                let weight = f64::from(centrality.scale) * f64::from(centrality.h / d).powi(2);
                let each = (weight * unit * f64::from(1u32 << Self::SHIFT)) as u64;
                let entry = (start, each);
                start += each * u64::from(class);
                entry
            })
            .collect();
        Self { length: &lengths.cost, class, table }
    }

    #[inline]
    fn at(&self, node: u32) -> u32 {
        let length = self.length[node as usize];
        let (start, each) = self.table[(length / self.class) as usize];
        let bound = (start + each * u64::from(length % self.class)) >> Self::SHIFT;
        u32::try_from(bound).unwrap_or(NOWHERE)
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
    use glam::{DVec3, IVec3, UVec3};

    fn lumen(dims: [u32; 3], spacing: [f64; 3], inside: impl Fn(UVec3) -> bool) -> Lumen {
        let grid = Grid::axis_aligned(dims, spacing);
        let mut bits = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
            bits.set(v.x, v.y, v.z);
        }
        Lumen::new(grid, &bits)
    }

    fn distance(l: &Lumen) -> Vec<f32> {
        let mut plan = crate::compute::Plan::new();
        let b = crate::field::LumenBuffers::new(&mut plan, l);
        let d = crate::field::distance(&mut plan, &b);
        plan.download(d);
        crate::compute::run_cpu(&plan).get(d).to_vec()
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

    #[test]
    fn a_route_in_the_corridor_costs_what_the_whole_search_says() {
        for spacing in [[1.0; 3], [0.8, 0.8, 1.25]] {
            let l = rooms(spacing);
            let d = distance(&l);
            let g = Graph::new(&l);
            let c = Centrality::new(&g, &d);
            let cost = |a: u32, b: u32, n: usize| {
                (c.length[n] * (c.weight(d[a as usize]) + c.weight(d[b as usize]))) as u32 + 1
            };
            let from = g.node_at(IVec3::new(1, 1, 7)).expect("inside");
            let all = g.by_centrality(&[from], &d);
            assert_eq!(all.cost, relaxed(&g, from, cost));
            let mut fewer = 0;
            for to in g.nodes().filter(|n| all.cost[*n as usize] != NOWHERE).step_by(211) {
                let lengths = g.by_length(&[to]);
                let bound = Bound::new(&g, &lengths, &c);
                for u in lengths.order.iter().copied() {
                    for (n, v) in g.steps(u) {
                        assert!(bound.at(u) <= bound.at(v) + cost(u, v, n));
                    }
                }
                let some = g.cheapest(&[from], Some(to), &c, None, |v| bound.at(v));
                assert_eq!(some.cost[to as usize], all.cost[to as usize]);
                fewer += usize::from(some.order.len() * 2 < all.order.len());
                let route = g.central_route(from, to, &lengths, &d);
                assert_eq!((route[0], route[route.len() - 1]), (from, to));
                let step = |w: &[u32]| {
                    let n = g.steps(w[0]).find(|s| s.1 == w[1]).expect("legal").0;
                    cost(w[0], w[1], n)
                };
                let found: u32 = route.windows(2).map(step).sum();
                assert!(2 * found <= 3 * all.cost[to as usize].max(1), "{found}");
            }
            assert!(fewer > 10, "{fewer}");
            let beyond = g.node_at(IVec3::new(23, 4, 4)).expect("inside");
            assert!(g.central_route(from, beyond, &g.by_length(&[beyond]), &d).is_empty());
        }
    }

    #[test]
    fn a_u_bend_is_followed_along_its_middle() {
        let l = lumen([40, 40, 9], [1.0; 3], |v| {
            let p = v.as_dvec3() - DVec3::new(20.0, 4.0, 4.0);
            let r = (p.truncate().length() - 14.0).hypot(p.z);
            p.y > 0.0 && r < 4.0
        });
        let g = Graph::new(&l);
        let start = g.node_at(IVec3::new(34, 6, 4)).expect("inside");
        let end = g.node_at(IVec3::new(6, 6, 4)).expect("inside");
        let lengths = g.by_length(&[end]);
        let path = g.central_route(start, end, &lengths, &distance(&l));
        assert_eq!((path[0], path[path.len() - 1]), (start, end));
        let off = |n: &u32| {
            let p = g.voxel(*n).as_dvec3() - DVec3::new(20.0, 4.0, 4.0);
            (p.truncate().length() - 14.0).hypot(p.z)
        };
        let worst = path.iter().map(off).fold(0.0, f64::max);
        assert!(worst < 1.3, "{worst}");
        // Places near walls are not looked at.
        let d = distance(&l);
        let (c, corridor) = (Centrality::new(&g, &d), SearchCorridor::new(&g, &d, [start, start]));
        let settled = |corridor| g.cheapest(&[start], Some(end), &c, corridor, |_| 0).order.len();
        assert!(settled(Some(&corridor)) * 10 < 9 * settled(None));
        // The shortest route hugs the wall instead.
        let short = lengths.path_to(&g, start);
        assert!(short.iter().map(off).fold(0.0, f64::max) > 2.0);
    }
}
