//! Trees of curves: branches found one after another, farthest tip first (TEASAR: Sato et al. 2000,
//! doi:10.1109/PCCGA.2000.883951). Branch pruning: what is too short, or within the balls that a
//! branch clears about it, makes no branch.

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::NOWHERE;
use super::containment::{Proof, safe_by_voxels};
use super::recenter::{Fixed, arc_lengths};
use super::route::{Builder, End, Trunk};
use crate::geometry::{Attachment, Branch, Centerline, CenterlinePoint};

/// Branch pruning: the shortest branch that is kept, mm, unless twice the distance at its root is more.
const LEAST_BRANCH_MM: f64 = 5.0;
/// A branch clears balls of this many distances about it …
const CLEAR_SCALE: f64 = 1.5;
/// … plus this, mm, before the next is looked for.
const CLEAR_MM: f64 = 3.0;

/// A branch as a route: parents come before children.
pub(super) struct BranchRoute {
    parent: Option<usize>,
    /// From where it leaves its parent, or the root, to its tip.
    nodes: Vec<u32>,
    /// Where it starts and ends; a branch starts on its parent's curve instead, near the first.
    pub ends: (End, End),
}

/// The trunk, and of a tree by TEASAR's loop the rest: the farthest voxel not yet cleared gets a
/// branch, until none is far enough from the tree to make one.
pub(super) fn grow(builder: &Builder<'_>, trunk: &Trunk) -> Vec<BranchRoute> {
    let ends = (trunk.from, trunk.to);
    let mut branch_routes = vec![BranchRoute { parent: None, nodes: trunk.nodes.clone(), ends }];
    let Some(routes) = &trunk.all else { return branch_routes };
    let graph = builder.graph;
    let field_len = graph.lumen().bricks.field_len();
    let mut cleared = vec![false; field_len];
    // Branch each node of the tree belongs to.
    let mut owner = vec![u32::MAX; field_len];
    clear(builder, &trunk.nodes, &mut cleared);
    trunk.nodes.iter().for_each(|n| owner[*n as usize] = 0);
    for &tip in trunk.lengths.order.iter().rev() {
        if cleared[tip as usize] || routes.cost[tip as usize] == NOWHERE {
            continue;
        }
        let mut nodes = vec![tip];
        let mut at = tip;
        while owner[at as usize] == u32::MAX {
            at = routes.parent(graph, at);
            nodes.push(at);
        }
        nodes.reverse();
        clear(builder, &nodes, &mut cleared);
        let route: Vec<DVec3> = nodes.iter().map(|n| builder.local(*n)).collect();
        let length = arc_lengths(&route).last().copied().unwrap_or(0.0);
        let room = 2.0 * f64::from(builder.depth(at));
        if length < room.max(LEAST_BRANCH_MM) || nodes.len() < 4 {
            continue;
        }
        let parent = owner[at as usize] as usize;
        let id = branch_routes.len() as u32;
        nodes[1..].iter().for_each(|n| owner[*n as usize] = id);
        let end = builder.capped(tip);
        // The cap's centre may lie back along the branch: stop where it is passed.
        let until = (1..nodes.len())
            .min_by(|&i, &j| {
                let off = |k: usize| route[k].distance_squared(end.point);
                off(i).total_cmp(&off(j))
            })
            .unwrap_or(nodes.len() - 1);
        nodes.truncate(until.max(1) + 1);
        let start = End { node: at, point: route[0], given: false };
        branch_routes.push(BranchRoute { parent: Some(parent), nodes, ends: (start, end) });
    }
    branch_routes
}

/// Clears balls about a route: they will not start branches.
fn clear(builder: &Builder<'_>, nodes: &[u32], cleared: &mut [bool]) {
    let graph = builder.graph;
    let h = builder.d.lumen.grid.spacing_mm;
    let mut last: Option<(DVec3, f64)> = None;
    for (i, &n) in nodes.iter().enumerate() {
        let p = builder.local(n);
        let r = CLEAR_SCALE * f64::from(builder.depth(n)) + CLEAR_MM;
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

/// The curve along a route between its ends; of a branch from its parent's curve.
fn curve(
    builder: &Builder<'_>,
    branch_route: &BranchRoute,
    parent: Option<&Vec<DVec3>>,
) -> (Vec<DVec3>, Proof) {
    let mut route: Vec<DVec3> = branch_route.nodes.iter().map(|n| builder.local(*n)).collect();
    // A branch starts on its parent's curve, at the point nearest to the voxel it left.
    let near = |p: &DVec3| p.distance_squared(route[0]);
    let nearest = parent.and_then(|c| c.iter().min_by(|a, b| near(a).total_cmp(&near(b))).copied());
    let (start, end) = (nearest.unwrap_or(branch_route.ends.0.point), branch_route.ends.1);
    let fixed = match parent {
        None => Fixed { start: branch_route.ends.0.given, end: end.given },
        Some(_) => Fixed { start: true, end: false },
    };
    // The exact ends replace or extend the voxels they lie in.
    let joins = |a: DVec3, b: DVec3| safe_by_voxels(a, b, builder.d.lumen);
    if joins(start, route[0]) {
        route.insert(0, start);
    }
    if joins(end.point, route[route.len() - 1]) {
        route.push(end.point);
    }
    route.dedup();
    builder.curve(&route, fixed)
}

/// Branches as curves.
pub(super) struct Tree<'a> {
    builder: Builder<'a>,
    /// Parent and points (local mm) of each branch.
    branches: Vec<(Option<usize>, Vec<DVec3>)>,
    /// How all curves together were proven.
    pub proof: Proof,
}

impl<'a> Tree<'a> {
    /// Curves along all routes: those whose parents have theirs side by side.
    pub fn new(builder: Builder<'a>, branch_routes: &[BranchRoute]) -> Self {
        let mut curves: Vec<Option<(Vec<DVec3>, Proof)>> =
            branch_routes.iter().map(|_| None).collect();
        loop {
            let made: Vec<(usize, (Vec<DVec3>, Proof))> = (0..branch_routes.len())
                .into_par_iter()
                .filter(|&i| curves[i].is_none())
                .filter_map(|i| match branch_routes[i].parent {
                    None => Some((i, curve(&builder, &branch_routes[i], None))),
                    Some(p) => curves[p]
                        .as_ref()
                        .map(|up| (i, curve(&builder, &branch_routes[i], Some(&up.0)))),
                })
                .collect();
            if made.is_empty() {
                break;
            }
            made.into_iter().for_each(|(i, c)| curves[i] = Some(c));
        }
        let mut tree = Self { builder, branches: Vec::new(), proof: Proof::default() };
        for (branch_route, (points, proof)) in
            branch_routes.iter().zip(curves.into_iter().flatten())
        {
            tree.proof.by_distance += proof.by_distance;
            tree.proof.by_voxels += proof.by_voxels;
            tree.proof.replaced += proof.replaced;
            tree.branches.push((branch_route.parent, points));
        }
        tree
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
            // A branch starts at one of its parent's points.
            let start = parent.map(|branch| {
                let first = world.transform_point3(points[0] / grid.spacing_mm);
                let up: &[CenterlinePoint] = &line.branches[branch].points;
                let off = |i: &usize| up[*i].position_mm.distance_squared(first);
                let nearest = (0..up.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
                Attachment { branch, point: nearest.unwrap_or(0) }
            });
            let offset = start.map_or(0.0, |s| line.branches[s.branch].points[s.point].abscissa_mm);
            let points = points
                .iter()
                .zip(arc_lengths(points))
                .map(|(p, s)| CenterlinePoint {
                    position_mm: world.transform_point3(*p / grid.spacing_mm),
                    radius_mm: (self.builder.d.at(*p) - half).max(0.0),
                    abscissa_mm: offset + s,
                })
                .collect();
            line.branches.push(Branch { start, end: None, points });
        }
        line
    }
}
