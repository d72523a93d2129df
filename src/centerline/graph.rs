//! The voxel graph of the lumen and shortest routes on it.
//!
//! Nodes are inside voxels. A diagonal step is legal only when every voxel of the block it spans
//! is inside: the straight segment then stays inside the surface, which separates inside voxels
//! that share only an edge or a corner.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use crate::lumen::Lumen;
use crate::lumen::bricks::{BRICK, NONE, near_index};

/// No parent, no distance.
pub const NOWHERE: u32 = u32::MAX;

/// Inside voxels as nodes, with their legal steps.
pub struct Graph<'a> {
    lumen: &'a Lumen,
    /// Field element of each node, ascending.
    elements: Vec<u32>,
    /// Nodes ahead of each 64-bit word of the inside bits.
    rank: Vec<u32>,
    /// One bit for each of the 27 offsets that is a legal step.
    legal: Vec<u32>,
}

/// Result of a shortest-route search from one or more sources.
pub struct Routes {
    /// Quantised cost from the source, [`NOWHERE`] where there is no route.
    pub cost: Vec<u32>,
    /// Previous node on the route; a source is its own.
    pub parent: Vec<u32>,
    /// Nodes in the order they were settled.
    pub order: Vec<u32>,
}

/// Offset of one of the 27 neighbours.
#[inline]
pub fn offset(n: usize) -> IVec3 {
    let n = n as i32;
    IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1)
}

/// For every offset, the bits of all voxels of the block it spans.
const BLOCK: [u32; 27] = {
    let mut out = [0u32; 27];
    let mut n = 0;
    while n < 27 {
        let d = [n as i32 % 3 - 1, n as i32 / 3 % 3 - 1, n as i32 / 9 - 1];
        let mut m = 0;
        let mut k = 0;
        while k < 8 {
            let at = [
                if k & 1 != 0 { d[0] } else { 0 },
                if k & 2 != 0 { d[1] } else { 0 },
                if k & 4 != 0 { d[2] } else { 0 },
            ];
            m |= 1 << ((at[0] + 1) + 3 * (at[1] + 1) + 9 * (at[2] + 1));
            k += 1;
        }
        out[n] = m;
        n += 1;
    }
    out
};

impl<'a> Graph<'a> {
    /// The graph of a lumen.
    pub fn new(lumen: &'a Lumen) -> Self {
        let elements: Vec<u32> = lumen.elements(&lumen.inside).map(|e| e as u32).collect();
        let rank = lumen
            .inside
            .iter()
            .scan(0u32, |at, w| {
                let r = *at;
                *at += w.count_ones();
                Some(r)
            })
            .collect();
        let legal = elements
            .par_iter()
            .with_min_len(4096)
            .map(|&e| {
                let around = surroundings(lumen, e as usize);
                (0..27).filter(|&n| n != 13 && BLOCK[n] & !around == 0).fold(0, |m, n| m | 1 << n)
            })
            .collect();
        Self { lumen, elements, rank, legal }
    }

    /// Number of nodes.
    pub fn len(&self) -> usize {
        self.elements.len()
    }
    /// Whether the lumen is empty.
    pub fn is_empty(&self) -> bool {
        self.elements.is_empty()
    }
    /// The lumen.
    pub fn lumen(&self) -> &'a Lumen {
        self.lumen
    }
    /// Field element of a node.
    #[inline]
    pub fn element(&self, node: u32) -> usize {
        self.elements[node as usize] as usize
    }
    /// Voxel of a node.
    pub fn voxel(&self, node: u32) -> IVec3 {
        self.lumen.bricks.voxel(self.element(node))
    }
    /// Node of a field element that is inside.
    #[inline]
    pub fn node(&self, element: usize) -> u32 {
        let w = element >> 6;
        self.rank[w] + (self.lumen.inside[w] & ((1 << (element & 63)) - 1)).count_ones()
    }
    /// Node of a voxel, if it is inside.
    pub fn node_at(&self, v: IVec3) -> Option<u32> {
        let e = self.lumen.bricks.element(v)?;
        self.lumen.is_inside(e).then(|| self.node(e))
    }
    /// Legal steps of a node: offset number and node.
    #[inline]
    pub fn steps(&self, node: u32) -> impl Iterator<Item = (usize, u32)> + '_ {
        let e = self.element(node);
        let mut bits = self.legal[node as usize];
        std::iter::from_fn(move || {
            (bits != 0).then(|| {
                let n = bits.trailing_zeros() as usize;
                bits &= bits - 1;
                let to = self.lumen.bricks.step(e, offset(n));
                (n, self.node(to.expect("a legal step ends inside")))
            })
        })
    }

    /// Length of each of the 27 steps, mm.
    pub fn step_lengths_mm(&self) -> [f64; 27] {
        let h: DVec3 = self.lumen.grid.spacing_mm;
        std::array::from_fn(|n| (offset(n).as_dvec3() * h).length())
    }

    /// Geodesic distance from `sources`, in [`Graph::length_unit_mm`].
    pub fn by_length(&self, sources: &[u32]) -> Routes {
        let unit = self.length_unit_mm();
        let length = self.step_lengths_mm().map(|l| (l / unit).round() as u32);
        let most = length.iter().copied().max().unwrap_or(1);
        self.search(sources, most, |_, _, n| length[n])
    }

    /// Resolution of [`Graph::by_length`], mm: a sixty-fourth of the shortest spacing.
    pub fn length_unit_mm(&self) -> f64 {
        self.lumen.grid.spacing_mm.min_element() / 64.0
    }

    /// Cheapest routes from `sources` when a step costs its length times the mean of
    /// (h/d)² at its ends: far from walls where it can be.
    ///
    /// * `distance`: the exact distance field, mm.
    pub fn by_centrality(&self, sources: &[u32], distance: &[f32]) -> Routes {
        let h = self.lumen.grid.spacing_mm.min_element() as f32;
        let deepest = self.elements.iter().map(|&e| distance[e as usize]).fold(h, f32::max);
        // The cheapest unit step, deep inside, is worth 64; the dearest is bounded, so that a
        // circular queue of buckets holds every pending cost.
        let cheapest = (h / deepest).powi(2);
        let scale = (64.0 / cheapest).min(65_536.0);
        let weight: Vec<f32> = self
            .elements
            .par_iter()
            .with_min_len(8192)
            .map(|&e| 0.5 * scale * (h / distance[e as usize].max(h)).powi(2))
            .collect();
        let length = self.step_lengths_mm().map(|l| l as f32 / h);
        let longest = length.iter().copied().fold(1.0, f32::max);
        let most = (scale * longest).ceil() as u32 + 1;
        self.search(sources, most, |a, b, n| {
            (length[n] * (weight[a as usize] + weight[b as usize])) as u32 + 1
        })
    }

    /// Dijkstra with a circular bucket queue (Dial 1969, doi:10.1145/363269.363610). Ties go to
    /// the node that was reached first, whose order is fixed: the result is deterministic.
    fn search(
        &self,
        sources: &[u32],
        most: u32,
        cost_of: impl Fn(u32, u32, usize) -> u32,
    ) -> Routes {
        let n = self.len();
        let mut cost = vec![NOWHERE; n];
        let mut parent = vec![NOWHERE; n];
        let mut order = Vec::with_capacity(n);
        let mask = (most + 1).next_power_of_two() - 1;
        let mut buckets: Vec<Vec<u32>> = vec![Vec::new(); mask as usize + 1];
        for &s in sources {
            cost[s as usize] = 0;
            parent[s as usize] = s;
            buckets[0].push(s);
        }
        let mut pending = sources.len();
        let mut at = 0u32;
        while pending > 0 {
            let mut batch = std::mem::take(&mut buckets[(at & mask) as usize]);
            for &u in &batch {
                pending -= 1;
                if cost[u as usize] != at {
                    continue; // reached more cheaply since
                }
                order.push(u);
                for (k, v) in self.steps(u) {
                    let c = at.saturating_add(cost_of(u, v, k).max(1));
                    if c < cost[v as usize] {
                        cost[v as usize] = c;
                        parent[v as usize] = u;
                        buckets[(c & mask) as usize].push(v);
                        pending += 1;
                    }
                }
            }
            batch.clear();
            buckets[(at & mask) as usize] = batch;
            at += 1;
        }
        Routes { cost, parent, order }
    }
}

impl Routes {
    /// The settled node farthest from the sources; the last one settled.
    pub fn farthest(&self) -> Option<u32> {
        self.order.last().copied()
    }

    /// Nodes from a source to `node`, both included; empty when there is no route.
    pub fn path_to(&self, node: u32) -> Vec<u32> {
        let mut path = Vec::new();
        if self.cost[node as usize] == NOWHERE {
            return path;
        }
        let mut at = node;
        loop {
            path.push(at);
            let up = self.parent[at as usize];
            if up == at {
                break;
            }
            at = up;
        }
        path.reverse();
        path
    }
}

/// Inside bits of the 27 voxels about an element.
fn surroundings(lumen: &Lumen, element: usize) -> u32 {
    let near = &lumen.bricks.near()[element / BRICK];
    let l = (element % BRICK) as i32;
    let p = IVec3::new(l & 7, l >> 3 & 7, l >> 6);
    let mut out = 0;
    for dz in -1..=1 {
        let z = p.z + dz;
        for dy in -1..=1 {
            let y = p.y + dy;
            let byte = |dx: i32| -> u32 {
                match near[near_index(dx, y >> 3, z >> 3)] {
                    NONE => 0,
                    s => {
                        let word = lumen.inside[s as usize * 8 + (z & 7) as usize];
                        (word >> (8 * (y & 7)) & 0xff) as u32
                    }
                }
            };
            // Ten bits: the row with a voxel of either neighbour.
            let mut row = byte(0) << 1;
            if p.x == 0 {
                row |= byte(-1) >> 7;
            } else if p.x == 7 {
                row |= (byte(1) & 1) << 9;
            }
            out |= (row >> p.x & 7) << (3 * (dy + 1) + 9 * (dz + 1));
        }
    }
    out
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::lumen::BitVolume;
    use crate::volume::Grid;
    use glam::UVec3;

    fn lumen(dims: [u32; 3], inside: impl Fn(UVec3) -> bool) -> Lumen {
        let grid = Grid::axis_aligned(dims, [1.0; 3]);
        let mut bits = BitVolume::new(grid.dims);
        for v in (0..grid.len()).map(|i| grid.voxel(i)).filter(|v| inside(*v)) {
            bits.set(v.x, v.y, v.z);
        }
        Lumen::new(grid, &bits)
    }

    #[test]
    fn steps_are_those_whose_whole_block_is_inside() {
        let l = lumen([19, 11, 13], |v| (v.x * 7 + v.y * 13 + v.z * 29 + v.x * v.z) % 4 != 0);
        let g = Graph::new(&l);
        for node in 0..g.len() as u32 {
            let v = g.voxel(node);
            assert_eq!(g.node_at(v), Some(node));
            let got: Vec<_> = g.steps(node).map(|(_, to)| g.voxel(to)).collect();
            let want: Vec<_> = (0..27)
                .filter(|&n| n != 13)
                .map(offset)
                .filter(|d| {
                    (0..8).all(|k| {
                        let part = IVec3::new(k & 1, k >> 1 & 1, k >> 2) * *d;
                        l.holds(v + part)
                    })
                })
                .map(|d| v + d)
                .collect();
            assert_eq!(got, want);
        }
    }

    #[test]
    fn a_u_bend_is_followed_along_its_middle() {
        let l = lumen([40, 40, 9], |v| {
            let p = v.as_dvec3() - DVec3::new(20.0, 4.0, 4.0);
            let r = (p.truncate().length() - 14.0).hypot(p.z);
            p.y > 0.0 && r < 4.0
        });
        let g = Graph::new(&l);
        let start = g.node_at(IVec3::new(34, 6, 4)).unwrap();
        let end = g.node_at(IVec3::new(6, 6, 4)).unwrap();
        let mut plan = crate::compute::Plan::new();
        let b = crate::field::LumenBuffers::new(&mut plan, &l);
        let d = crate::field::distance(&mut plan, &b);
        plan.download(d);
        let out = crate::compute::run_cpu(&plan);
        let path = g.by_centrality(&[start], out.get(d)).path_to(end);
        let off = |n: &u32| {
            let p = g.voxel(*n).as_dvec3() - DVec3::new(20.0, 4.0, 4.0);
            (p.truncate().length() - 14.0).hypot(p.z)
        };
        let worst = path.iter().map(off).fold(0.0, f64::max);
        assert!(worst < 1.3, "{worst}");
        // The shortest route hugs the wall instead.
        let short = g.by_length(&[start]).path_to(end);
        assert!(short.iter().map(off).fold(0.0, f64::max) > 2.0);
    }
}
