//! Graph of arcs over which paths and trees run, and the ends of a path in it.

use std::collections::BTreeMap;

use glam::DVec3;

use super::chain_route::{Chain, ChainRouter};
use super::complex::net::Net;
use super::complex::sweep::NodeContacts;
use super::complex::{CellComplex, cell};
use super::recenter::cap_centre;
use crate::field::Sampler;

/// An end of the path.
#[derive(Clone, Copy, Debug)]
pub(super) struct PathEnd {
    /// Field element of the voxel in which the path to this end terminates.
    pub voxel: u32,
    /// Position of the end, local mm.
    pub point: DVec3,
    /// Whether the user gave the end: the curve then meets it exactly.
    pub given: bool,
}

/// Graph of arcs with the data that routes over it need.
#[derive(Clone, Copy)]
pub(super) struct ArcGraph<'a> {
    pub net: &'a Net<'a>,
    pub complex: &'a CellComplex,
    pub adjacency: &'a NodeContacts<'a>,
    pub router: ChainRouter<'a>,
    pub d: Sampler<'a>,
    pub f: Sampler<'a>,
}

/// An end with its node.
pub(super) type NodeEnd = (PathEnd, u32);

/// Length to each node and the arc that leads there.
pub(super) type Ways = BTreeMap<u32, (u64, Option<usize>)>;

impl ArcGraph<'_> {
    /// Place of a node in the patient, LPS mm.
    pub fn world(&self, node: u32) -> DVec3 {
        let grid = &self.d.lumen.grid;
        let voxel = self.adjacency.place_mm[node as usize] / grid.spacing_mm;
        grid.world_from_voxel().transform_point3(voxel)
    }

    /// Whether the centre of a cap lies outside the ball at the junction its branch begins at: a
    /// pocket of a wide lumen has none there.
    pub fn leads_out(&self, junction: u32, tip: PathEnd) -> bool {
        let at = self.adjacency.place_mm[junction as usize];
        tip.point.distance(at) >= self.d.at(at)
    }

    /// Local place of a point in the patient, mm.
    pub fn local(&self, at: DVec3) -> DVec3 {
        let grid = &self.d.lumen.grid;
        grid.voxel_from_world().transform_point3(at) * grid.spacing_mm
    }

    /// The most central way between two nodes.
    pub fn way(&self, from: u32, to: u32) -> Chain {
        let ways = self.net.ways(from, |i| self.net.centrality(i));
        self.chain(&ways, to, |_| false)
    }

    /// The way to a node as a chain, from where it leaves the nodes that `owned` says.
    pub fn chain(&self, ways: &Ways, to: u32, owned: impl Fn(u32) -> bool) -> Chain {
        let mut chain = Chain { nodes: vec![to], contacts: Vec::new() };
        let mut node = to;
        while let Some(arc) = ways.get(&node).and_then(|w| self.net.arc(w.1?)) {
            if owned(node) {
                break;
            }
            let mut piece = Chain { nodes: arc.nodes.clone(), contacts: arc.contacts.clone() };
            if arc.nodes[0] != node {
                piece.reverse();
            }
            chain.extend(&piece.nodes, &piece.contacts);
            node = arc.other_end(node);
        }
        chain.reverse();
        chain
    }

    /// The end of an arc at a node that no other meets: the voxel of the node that lies farthest
    /// along, and the centre of the cap there.
    pub fn tip(&self, node: u32) -> PathEnd {
        let lumen = self.d.lumen;
        let n = &self.complex.nodes[node as usize];
        let before = self.net.beside(node).unwrap_or(node);
        let from = self.adjacency.place_mm[before as usize];
        let at = |bit: u32| {
            let voxel = lumen.bricks.voxel(self.complex.element(node, bit) as usize);
            voxel.as_dvec3() * lumen.grid.spacing_mm
        };
        let off = |bit: u32| at(bit).distance(from);
        let bits = cell::voxels(n.voxels);
        let far = bits.max_by(|a, b| off(*a).total_cmp(&off(*b)).then(b.cmp(a))).unwrap_or(0);
        let voxel = self.complex.element(node, far);
        PathEnd { voxel, point: cap_centre(at(far), self.d, self.f), given: false }
    }
}
