//! Trees of curves: branches found one after another, farthest tip first.

use glam::{DVec3, IVec3};

use super::centre::{Fixed, arc_lengths};
use super::prove::{Proof, safe_by_voxels};
use super::route::{Builder, End};
use super::{NOWHERE, Routes};
use crate::geometry::{Branch, Centerline, CenterlinePoint};

/// Shortest branch of a tree that is kept, mm, unless twice the distance at its root is more.
const LEAST_BRANCH_MM: f64 = 5.0;
/// A branch clears balls of this many distances about it …
const CLEAR_SCALE: f64 = 1.5;
/// … plus this, mm, before the next is looked for.
const CLEAR_MM: f64 = 3.0;

/// Branches as they are found; parents come before children.
pub(super) struct Tree<'a> {
    builder: Builder<'a>,
    /// Parent and points (local mm) of each branch.
    branches: Vec<(Option<usize>, Vec<DVec3>)>,
    /// Where each branch ends.
    tips: Vec<End>,
    /// How all curves together were proven.
    pub proof: Proof,
}

impl<'a> Tree<'a> {
    pub fn new(builder: Builder<'a>) -> Self {
        Self { builder, branches: Vec::new(), tips: Vec::new(), proof: Proof::default() }
    }

    /// Where the branches end.
    pub fn tips(&self) -> &[End] {
        &self.tips
    }

    /// Adds the curve along a route between two ends.
    pub fn add(&mut self, parent: Option<usize>, nodes: &[u32], ends: (End, End), fixed: Fixed) {
        let mut route: Vec<DVec3> = nodes.iter().map(|n| self.builder.local(*n)).collect();
        let lumen = self.builder.d.lumen;
        // The exact ends replace or extend the voxels they lie in.
        let joins = |a: DVec3, b: DVec3| safe_by_voxels(a, b, lumen);
        if joins(ends.0.point, route[0]) {
            route.insert(0, ends.0.point);
        }
        if joins(ends.1.point, route[route.len() - 1]) {
            route.push(ends.1.point);
        }
        route.dedup();
        let (points, proof) = self.builder.curve(&route, fixed);
        self.proof.by_distance += proof.by_distance;
        self.proof.by_voxels += proof.by_voxels;
        self.proof.replaced += proof.replaced;
        self.branches.push((parent, points));
        self.tips.push(ends.1);
    }

    /// TEASAR's loop: the farthest voxel not yet cleared gets a branch, until none is far enough
    /// from the tree to make one.
    pub fn grow(&mut self, routes: &Routes, root: u32, trunk: &[u32]) {
        let graph = self.builder.graph;
        let mut by_length = graph.by_length(&[root]).order;
        by_length.reverse();
        let mut cleared = vec![false; graph.len()];
        // Branch each node of the tree belongs to.
        let mut owner = vec![u32::MAX; graph.len()];
        self.clear(trunk, &mut cleared);
        trunk.iter().for_each(|n| owner[*n as usize] = 0);
        for tip in by_length {
            if cleared[tip as usize] || routes.cost[tip as usize] == NOWHERE {
                continue;
            }
            let mut nodes = vec![tip];
            let mut at = tip;
            while owner[at as usize] == u32::MAX {
                at = routes.parent[at as usize];
                nodes.push(at);
            }
            nodes.reverse();
            self.clear(&nodes, &mut cleared);
            let route: Vec<DVec3> = nodes.iter().map(|n| self.builder.local(*n)).collect();
            let length = arc_lengths(&route).last().copied().unwrap_or(0.0);
            let room = 2.0 * f64::from(self.builder.depth(at));
            if length < room.max(LEAST_BRANCH_MM) || nodes.len() < 4 {
                continue;
            }
            let parent = owner[at as usize] as usize;
            let id = self.branches.len() as u32;
            nodes[1..].iter().for_each(|n| owner[*n as usize] = id);
            // The branch starts on its parent's curve, at the point nearest to the voxel it left.
            let start = self.branches[parent]
                .1
                .iter()
                .copied()
                .min_by(|a, b| {
                    a.distance_squared(route[0]).total_cmp(&b.distance_squared(route[0]))
                })
                .unwrap_or(route[0]);
            let end = self.builder.capped(tip);
            // The cap's centre may lie back along the branch: stop where it is passed.
            let until = (1..nodes.len())
                .min_by(|&i, &j| {
                    route[i]
                        .distance_squared(end.point)
                        .total_cmp(&route[j].distance_squared(end.point))
                })
                .unwrap_or(nodes.len() - 1);
            let nodes = &nodes[..=until.max(1)];
            let start = End { node: at, point: start, given: false };
            self.add(Some(parent), nodes, (start, end), Fixed { start: true, end: false });
        }
    }

    /// Clears balls about a route: they will not start branches.
    fn clear(&self, nodes: &[u32], cleared: &mut [bool]) {
        let graph = self.builder.graph;
        let h = self.builder.d.lumen.grid.spacing_mm;
        let mut last: Option<(DVec3, f64)> = None;
        for (i, &n) in nodes.iter().enumerate() {
            let p = self.builder.local(n);
            let r = CLEAR_SCALE * f64::from(self.builder.depth(n)) + CLEAR_MM;
            // Balls overlap heavily: the next one is due when this one has moved on by a fifth.
            let due = last.is_none_or(|(q, s)| p.distance(q) > 0.2 * s || r > 1.1 * s);
            if !due && i + 1 < nodes.len() {
                continue;
            }
            last = Some((p, r));
            let c = graph.voxel(n);
            let reach = (r / h).floor().as_ivec3();
            for z in -reach.z..=reach.z {
                for y in -reach.y..=reach.y {
                    let rest = r * r - (f64::from(z) * h.z).powi(2) - (f64::from(y) * h.y).powi(2);
                    if rest < 0.0 {
                        continue;
                    }
                    let x = (rest.sqrt() / h.x).floor() as i32;
                    for x in -x..=x {
                        if let Some(m) = graph.node_at(c + IVec3::new(x, y, z)) {
                            cleared[m as usize] = true;
                        }
                    }
                }
            }
        }
    }

    /// The branches in patient space.
    pub fn finish(&self) -> Centerline {
        let lumen = self.builder.d.lumen;
        let grid = &lumen.grid;
        let world = grid.world_from_voxel();
        // The distance is to external voxel centres; the wall lies half a voxel before them.
        let half = 0.5 * (grid.spacing_mm.element_product()).cbrt();
        let mut line = Centerline::default();
        for (parent, points) in &self.branches {
            let offset = match parent {
                None => 0.0,
                Some(p) => {
                    let up: &Branch = &line.branches[*p];
                    let start = world.transform_point3(points[0] / grid.spacing_mm);
                    up.points
                        .iter()
                        .min_by(|a, b| {
                            let d = |p: &CenterlinePoint| p.position_mm.distance_squared(start);
                            d(a).total_cmp(&d(b))
                        })
                        .map_or(0.0, |p| p.abscissa_mm)
                }
            };
            let points = points
                .iter()
                .zip(arc_lengths(points))
                .map(|(p, s)| CenterlinePoint {
                    position_mm: world.transform_point3(*p / grid.spacing_mm),
                    radius_mm: (self.builder.d.at(*p) - half).max(0.0),
                    abscissa_mm: offset + s,
                })
                .collect();
            line.branches.push(Branch { parent: *parent, points });
        }
        line
    }
}
