//! Conversion of a chain of cells to a polyline that is proven inside and keeps away from walls.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::complex::{CellComplex, cell};
use super::containment::safe;
use crate::field::Sampler;
use crate::lumen::bricks::BRICK;
use crate::task::checkpoint;

/// Largest number of nodes that a straight piece passes.
const MAX_NODES: usize = 23;
/// Greatest length of a straight piece, in distances to the wall and in voxels; the longer one
/// counts.
const MAX_LENGTH: (f64, f64) = (2.0, 8.0);
/// Number of samples of a straight piece's cost per distance to the wall.
const SAMPLES: f64 = 4.0;

/// A walk over nodes of the complex, each joined to the next by a contact.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Chain {
    /// Nodes of the walk, one more than contacts.
    pub nodes: Vec<u32>,
    /// Contacts between consecutive nodes.
    pub contacts: Vec<u32>,
}

impl Chain {
    /// Adds a chain that begins with the last node of this one.
    pub fn extend(&mut self, nodes: &[u32], contacts: &[u32]) {
        let skip = usize::from(!self.nodes.is_empty());
        self.nodes.extend(nodes.iter().skip(skip));
        self.contacts.extend(contacts);
    }

    /// Reverses the walk.
    pub fn reverse(&mut self) {
        self.nodes.reverse();
        self.contacts.reverse();
    }
}

/// Straight pieces and walks over voxels along chains.
#[derive(Clone, Copy)]
pub(super) struct ChainRouter<'a> {
    pub complex: &'a CellComplex,
    /// Exact distance, mm.
    pub distance: Sampler<'a>,
}

impl ChainRouter<'_> {
    /// Local place of a voxel, mm.
    fn local(&self, v: IVec3) -> DVec3 {
        v.as_dvec3() * self.distance.lumen.grid.spacing_mm
    }

    fn voxel(&self, element: u32) -> IVec3 {
        self.distance.lumen.bricks.voxel(element as usize)
    }

    /// The way of least ∫(h/d)² between two voxels along a chain, among those of straight pieces
    /// between deepest voxels of its nodes: points in local mm. Every piece is proven inside: by
    /// [`safe`], or as a step between two inside voxels that share a face.
    ///
    /// * `ends`: field elements of voxels of the first and last node.
    pub fn polyline(&self, chain: &Chain, ends: [u32; 2]) -> Vec<DVec3> {
        let (walk, stations) = self.walk(chain, ends);
        let at: Vec<DVec3> = stations.iter().map(|s| self.local(walk[*s])).collect();
        let depth: Vec<f64> = at.iter().map(|p| self.distance.at(*p)).collect();
        let h = self.distance.lumen.grid.spacing_mm.min_element();
        // Pieces that end at each station: where from, and their cost. The last is the step from
        // the one before, which there always is.
        let pieces = (0..at.len()).into_par_iter().with_min_len(16).map(|i| {
            checkpoint();
            let first = i.saturating_sub(MAX_NODES);
            let straight = |j: usize| {
                let most = (MAX_LENGTH.0 * depth[i].max(depth[j])).max(MAX_LENGTH.1 * h);
                let fits = at[i].distance(at[j]) <= most && safe(at[j], at[i], self.distance);
                fits.then(|| (j, true, self.cost(at[j], at[i], depth[i].max(depth[j]))))
            };
            let mut all: Vec<(usize, bool, f64)> = (first..i).filter_map(straight).collect();
            if i > 0 && all.last().is_none_or(|p| p.0 + 1 < i) {
                let steps = walk[stations[i - 1]..=stations[i]].windows(2);
                let each = steps.map(|w| self.cost(self.local(w[0]), self.local(w[1]), 0.0));
                all.push((i - 1, false, each.sum()));
            }
            all
        });
        let pieces: Vec<_> = pieces.collect();
        let mut best: Vec<(f64, usize, bool)> = Vec::with_capacity(at.len());
        for all in &pieces {
            let sums = all.iter().map(|(j, straight, cost)| (best[*j].0 + cost, *j, *straight));
            let least = sums.fold(None, |a: Option<(f64, usize, bool)>, b| match a {
                Some(a) if a.0 <= b.0 => Some(a),
                _ => Some(b),
            });
            best.push(least.unwrap_or((0.0, 0, true)));
        }
        let mut out = vec![at[at.len() - 1]];
        let mut i = at.len() - 1;
        while i > 0 {
            let (_, from, straight) = best[i];
            if straight {
                out.push(at[from]);
            } else {
                let steps = walk[stations[from]..stations[i]].iter().rev();
                out.extend(steps.map(|v| self.local(*v)));
            }
            i = from;
        }
        out.reverse();
        out.dedup();
        out
    }

    /// ∫(h/d)² along a segment, h the smallest spacing, in mm.
    fn cost(&self, a: DVec3, b: DVec3, depth: f64) -> f64 {
        let h = self.distance.lumen.grid.spacing_mm.min_element();
        let length = a.distance(b);
        let n = (length / h.max(depth / SAMPLES)).ceil().max(1.0);
        let at = |t: f64| (h / self.distance.at(a.lerp(b, t)).max(h)).powi(2);
        let sum: f64 = (0..n as usize).map(|k| at((k as f64 + 0.5) / n)).sum();
        sum * length / n
    }

    /// Voxels along a chain, each sharing a face with the next, and which of them are the ends and
    /// the deepest of the nodes.
    fn walk(&self, chain: &Chain, ends: [u32; 2]) -> (Vec<IVec3>, Vec<usize>) {
        let deepest = |n: u32| self.complex.nodes[n as usize].deepest;
        let mut walk = vec![self.voxel(ends[0])];
        let mut stations = vec![0];
        let mut here = ends[0];
        let go = |node: u32, from: u32, to: u32, walk: &mut Vec<IVec3>| {
            let within = cell::path(self.complex.nodes[node as usize].voxels, bit(from), bit(to));
            let corner = self.voxel(from) - offset(bit(from));
            walk.extend(within.iter().skip(1).map(|b| corner + offset(*b)));
        };
        let mut station = |walk: &[IVec3]| {
            if stations[stations.len() - 1] + 1 < walk.len() {
                stations.push(walk.len() - 1);
            }
        };
        for (i, &node) in chain.nodes.iter().enumerate() {
            go(node, here, deepest(node), &mut walk);
            if i % self.complex.stride() == 0 {
                station(&walk);
            }
            here = deepest(node);
            let Some(&c) = chain.contacts.get(i) else { continue };
            let contact = &self.complex.contacts[c as usize];
            let [out, into] = if contact.nodes[0] == node {
                contact.deepest
            } else {
                [contact.deepest[1], contact.deepest[0]]
            };
            go(node, here, out, &mut walk);
            walk.push(self.voxel(into));
            here = into;
        }
        if let Some(&last) = chain.nodes.last() {
            go(last, here, ends[1], &mut walk);
            station(&walk);
        }
        (walk, stations)
    }
}

/// Place of a field element in its cell.
fn bit(element: u32) -> u32 {
    let place = element % BRICK as u32;
    place & 3 | (place >> 3 & 3) << 2 | (place >> 6 & 3) << 4
}

/// Voxel of a bit in its cell.
fn offset(bit: u32) -> IVec3 {
    IVec3::new(bit as i32 & 3, bit as i32 >> 2 & 3, bit as i32 >> 4)
}
