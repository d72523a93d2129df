//! From the distance map to a path or a tree in patient space.

use glam::{DVec3, IVec3};

use super::centre::{Fixed, cap_centre, centre};
use super::prove::{Proof, mend};
use super::tree::Tree;
use super::{CenterlineError, Graph, NOWHERE, Sampler};
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
    let (from, to) = builder.ends(options.ends)?;
    let (mut tree, mut unreachable) = builder.tree((from, to), options.tree)?;
    if options.tree && options.ends == Ends::default() {
        // The longest path may join two twigs; the trunk then is a tip with more room.
        let room = |e: &End| builder.f.at(e.point);
        let widest = tree.tips().iter().copied().max_by(|a, b| room(a).total_cmp(&room(b)));
        if let Some(root) = widest.filter(|tip| room(tip) > MORE_ROOM * room(&from)) {
            (tree, unreachable) = builder.tree((root, builder.far(root.node)), true)?;
        }
    }
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
            let nearest = (0..self.graph.len() as u32).map(|n| near(n).length());
            CenterlineError::OutsideLumen {
                which,
                at,
                nearest_mm: nearest.fold(f64::MAX, f64::min),
            }
        })?;
        Ok(End { node, point: v * grid.spacing_mm, given: true })
    }

    fn ends(&self, ends: Ends) -> Result<(End, End), CenterlineError> {
        let from = ends.from.map(|p| self.given("--from", p)).transpose()?;
        let to = ends.to.map(|p| self.given("--to", p)).transpose()?;
        Ok(match (from, to) {
            (Some(a), Some(b)) => (a, b),
            (Some(a), None) => (a, self.far(a.node)),
            (None, Some(b)) => (self.far(b.node), b),
            (None, None) => {
                let deepest = (0..self.graph.len() as u32)
                    .max_by(|&a, &b| self.depth(a).total_cmp(&self.depth(b)).then(b.cmp(&a)));
                let a = self.far(deepest.unwrap_or(0));
                let from_a = self.graph.by_length(&[a.node]);
                let b = self.capped(from_a.farthest().unwrap_or(a.node));
                let from_b = self.graph.by_length(&[b.node]);
                // The end with more room is the root: trachea, aorta, rectum.
                let room = |e: &End| self.f.at(e.point);
                let (a, b) = if room(&b) > MORE_ROOM * room(&a) { (b, a) } else { (a, b) };
                // Both may be twigs. The trunk then is the tip farthest off the way between them.
                let detour = |n: &u32| {
                    let n = *n as usize;
                    u64::from(from_a.cost[n].min(NOWHERE / 2))
                        + u64::from(from_b.cost[n].min(NOWHERE / 2))
                };
                let off = from_a.order.iter().copied().max_by_key(|n| (detour(n), u32::MAX - n));
                match off.map(|n| self.capped(n)) {
                    Some(trunk) if room(&trunk) > TRUNK_ROOM * room(&a) => {
                        (trunk, self.far(trunk.node))
                    }
                    _ => (a, b),
                }
            }
        })
    }

    /// The end farthest from a node.
    fn far(&self, from: u32) -> End {
        self.capped(self.graph.by_length(&[from]).farthest().unwrap_or(from))
    }

    /// The path between two ends, or the tree that grows from the first with that path as trunk;
    /// and how many nodes no route reaches.
    fn tree(
        &self,
        (from, to): (End, End),
        grown: bool,
    ) -> Result<(Tree<'_>, usize), CenterlineError> {
        let routes = self.graph.by_centrality(&[from.node], self.d.field);
        if routes.cost[to.node as usize] == NOWHERE {
            return Err(CenterlineError::Unreachable);
        }
        let trunk = routes.path_to(to.node);
        let mut tree = Tree::new(*self);
        let fixed = Fixed { start: from.given, end: to.given };
        tree.add(None, &trunk, (from, to), fixed);
        if grown {
            tree.grow(&routes, from.node, &trunk);
        }
        Ok((tree, self.graph.len() - routes.order.len()))
    }

    pub(super) fn depth(&self, node: u32) -> f32 {
        self.d.field[self.graph.element(node)]
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
        let smooth = centre(route, self.d, self.f, fixed);
        if let Some(mended) = mend(&smooth, route, self.d) {
            return mended;
        }
        let proof = Proof { replaced: route.len(), ..Proof::default() };
        (route.to_vec(), proof)
    }
}
