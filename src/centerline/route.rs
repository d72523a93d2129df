//! From the distance map to a path or a tree in patient space.

use std::cmp::Reverse;

use glam::{DVec3, IVec3};
use rayon::prelude::*;

use super::containment::{Proof, mend};
use super::recenter::{Fixed, cap_centre, recenter};
use super::tree::{Tree, grow};
use super::{CenterlineError, Graph, NOWHERE, Routes};
use crate::field::Sampler;
use crate::geometry::Centerline;
use crate::lumen::Lumen;

/// Given ends, LPS mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Ends {
    /// Where the path starts; the root of a tree.
    pub from: Option<DVec3>,
    /// Where the path ends.
    pub to: Option<DVec3>,
}

/// What to extract.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct RouteOptions {
    /// Given ends; the others are found.
    pub ends: Ends,
    /// All branches instead of one path.
    pub tree: bool,
}

/// A centerline and what is known about it.
#[derive(Clone, Debug)]
pub struct Routed {
    /// The curve or tree, LPS mm, radius the distance to the wall.
    pub line: Centerline,
    /// How it was proven inside.
    pub proof: Proof,
    /// Inside voxels that no legal route joins to the root.
    pub unreachable: usize,
}

/// How many times the room of one end another must have to be the root in its place.
const MORE_ROOM: f64 = 1.05;
/// How many times the room of both ends of the longest path a third tip must have to be the root:
/// a trachea beside two bronchi.
const TRUNK_ROOM: f64 = 1.5;

/// Extracts a path or tree.
///
/// * `distance`: exact distance, mm; `smooth`: after a Gaussian of one voxel.
///
/// Ends that are not given are the two points farthest apart by geodesic distance (a double
/// sweep), moved to the centres of the caps they lie on. The root is the end with more room; where
/// the tip farthest off that path has half as much again, the path starts there; of a tree the tip
/// with the most. The tree is TEASAR's (Sato et al. 2000,
/// doi:10.1109/PCCGA.2000.883951) with the penalty (h/d)² in place of its exponential.
///
/// # Errors
/// [`CenterlineError`].
pub fn centerline(
    lumen: &Lumen,
    distance: &[f32],
    smooth: &[f32],
    options: RouteOptions,
) -> Result<Routed, CenterlineError> {
    let graph = Graph::new(lumen);
    if graph.is_empty() {
        return Err(CenterlineError::Empty);
    }
    let d = Sampler { lumen, field: distance };
    let f = Sampler { lumen, field: smooth };
    let builder = Builder { graph: &graph, d, f };
    let trunk = builder.trunk(options)?;
    let unreachable = graph.len() - trunk.lengths.order.len();
    let mut branch_routes = grow(&builder, &trunk);
    if options.tree && options.ends == Ends::default() {
        // The longest path may join two side branches; the trunk then is a tip with more room.
        let room = |e: &End| f.at(e.point);
        let tips = branch_routes.iter().map(|t| t.ends.1);
        let widest = tips.max_by(|a, b| room(a).total_cmp(&room(b)));
        if let Some(root) = widest.filter(|tip| room(tip) > MORE_ROOM * room(&trunk.from)) {
            branch_routes = grow(&builder, &builder.trunk_from(root, None, true)?);
        }
    }
    let tree = Tree::new(builder, &branch_routes);
    Ok(Routed { line: tree.finish(), proof: tree.proof, unreachable })
}

/// An end of the path.
#[derive(Clone, Copy)]
pub(super) struct End {
    /// The voxel it lies in.
    pub node: u32,
    /// Local mm.
    pub point: DVec3,
    /// Given by the user: the curve meets it exactly.
    pub given: bool,
}

/// The path between two ends and what was found on the way to it.
pub(super) struct Trunk {
    pub from: End,
    pub to: End,
    /// From the first end.
    pub lengths: Routes,
    /// The route between the ends.
    pub nodes: Vec<u32>,
    /// Central routes from the first end, of a tree.
    pub all: Option<Routes>,
}

impl Trunk {
    fn new(
        from: End,
        to: End,
        lengths: Routes,
        (nodes, all): (Vec<u32>, Option<Routes>),
    ) -> Result<Self, CenterlineError> {
        if nodes.is_empty() {
            return Err(CenterlineError::Unreachable);
        }
        Ok(Self { from, to, lengths, nodes, all })
    }
}

/// What curves are built from: the graph, the exact distance, the smoothed one.
#[derive(Clone, Copy)]
pub(super) struct Builder<'a> {
    pub graph: &'a Graph<'a>,
    pub d: Sampler<'a>,
    pub f: Sampler<'a>,
}

impl Builder<'_> {
    pub(super) fn local(&self, node: u32) -> DVec3 {
        self.graph.voxel(node).as_dvec3() * self.d.lumen.grid.spacing_mm
    }

    fn given(&self, which: &'static str, at: DVec3) -> Result<End, CenterlineError> {
        let grid = &self.d.lumen.grid;
        let v = grid.voxel_from_world().transform_point3(at);
        let node = if v.is_finite() && v.abs().max_element() < 1e6 {
            self.graph.node_at(v.round().as_ivec3())
        } else {
            None
        };
        let node = node.ok_or_else(|| {
            let near = |n: u32| (self.graph.voxel(n).as_dvec3() - v) * grid.spacing_mm;
            let nearest = self.graph.nodes().map(|n| near(n).length());
            CenterlineError::OutsideLumen {
                which,
                at,
                nearest_mm: nearest.fold(f64::MAX, f64::min),
            }
        })?;
        Ok(End { node, point: v * grid.spacing_mm, given: true })
    }

    /// Finds the ends and the route that joins them.
    fn trunk(&self, options: RouteOptions) -> Result<Trunk, CenterlineError> {
        let from = options.ends.from.map(|p| self.given("start", p)).transpose()?;
        let to = options.ends.to.map(|p| self.given("end", p)).transpose()?;
        match (from, to) {
            (Some(a), to) => self.trunk_from(a, to, options.tree),
            (None, Some(b)) => {
                let a = self.farthest(&self.graph.by_length(&[b.node]), b.node);
                self.trunk_from(a, Some(b), options.tree)
            }
            (None, None) => self.trunk_between_tips(options.tree),
        }
    }

    /// From a known start to a known end, or to the one farthest away.
    fn trunk_from(&self, from: End, to: Option<End>, tree: bool) -> Result<Trunk, CenterlineError> {
        let lengths = self.graph.by_length(&[from.node]);
        let to = to.unwrap_or_else(|| self.farthest(&lengths, from.node));
        let found = self.central(from, to, (from, &lengths), tree);
        Trunk::new(from, to, lengths, found)
    }

    /// Between the two tips farthest apart, or from a third with far more room.
    fn trunk_between_tips(&self, tree: bool) -> Result<Trunk, CenterlineError> {
        let deepest = self.deepest();
        let a = self.farthest(&self.graph.by_length(&[deepest]), deepest);
        let from_a = self.graph.by_length(&[a.node]);
        let b = self.farthest(&from_a, a.node);
        // The end with more room is the root: trachea, aorta, rectum.
        let room = |e: &End| self.f.at(e.point);
        let swap = room(&b) > MORE_ROOM * room(&a);
        let (root, other) = if swap { (b, a) } else { (a, b) };
        // Whether the second is of use shows when the first has ended; they run side by side.
        let (from_b, found) = rayon::join(
            || self.graph.by_length(&[b.node]),
            || self.central(root, other, (a, &from_a), tree),
        );
        // Both may be side branches. The trunk then is the tip farthest off the way between them.
        let detour = |n: u32| {
            let n = n as usize;
            u64::from(from_a.cost[n].min(NOWHERE / 2)) + u64::from(from_b.cost[n].min(NOWHERE / 2))
        };
        let nodes = from_a.order.par_iter().with_min_len(1 << 16);
        let off = nodes.map(|n| (detour(*n), Reverse(*n))).max();
        match off.map(|(_, Reverse(n))| self.capped(n)) {
            Some(trunk) if room(&trunk) > TRUNK_ROOM * room(&root) => {
                self.trunk_from(trunk, None, tree)
            }
            _ => Trunk::new(root, other, if swap { from_b } else { from_a }, found),
        }
    }

    /// The central route between two ends, of a tree with all others from its root.
    ///
    /// * `lengths`: one of the ends, and lengths from there.
    fn central(
        &self,
        from: End,
        to: End,
        (end, lengths): (End, &Routes),
        tree: bool,
    ) -> (Vec<u32>, Option<Routes>) {
        if tree {
            let all = self.graph.by_centrality(&[from.node], self.d.field);
            return (all.path_to(self.graph, to.node), Some(all));
        }
        let back = end.node == from.node;
        let other = if back { to.node } else { from.node };
        let mut nodes = self.graph.central_route(other, end.node, lengths, self.d.field);
        if back {
            nodes.reverse();
        }
        (nodes, None)
    }

    /// The node farthest from walls, of several the first.
    fn deepest(&self) -> u32 {
        let field = self.d.field.par_iter().enumerate().with_min_len(1 << 16);
        // Distances are not negative: their bits are in their order.
        field.map(|(i, d)| (d.to_bits(), Reverse(i as u32))).max().map_or(0, |(_, n)| n.0)
    }

    /// The end a search got to last.
    fn farthest(&self, routes: &Routes, source: u32) -> End {
        self.capped(routes.farthest().unwrap_or(source))
    }

    pub(super) fn depth(&self, node: u32) -> f32 {
        self.d.field[node as usize]
    }

    /// The centre of the cap a wall voxel lies on.
    pub(super) fn capped(&self, node: u32) -> End {
        let h = self.d.lumen.grid.spacing_mm;
        let point = cap_centre(self.local(node), self.d, self.f);
        let at: IVec3 = (point / h).round().as_ivec3();
        End { node: self.graph.node_at(at).unwrap_or(node), point, given: false }
    }

    /// A smooth curve along a route, or the route itself where no smooth one can be proven.
    pub(super) fn curve(&self, route: &[DVec3], fixed: Fixed) -> (Vec<DVec3>, Proof) {
        let smooth = recenter(route, self.d, self.f, fixed);
        if let Some(mended) = mend(&smooth, route, self.d) {
            return mended;
        }
        let proof = Proof { replaced: route.len(), ..Proof::default() };
        (route.to_vec(), proof)
    }
}
