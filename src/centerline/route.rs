//! From the distance map to a path or a tree in patient space.

use glam::{DVec3, IVec3};

use super::centre::{Fixed, arc_lengths, cap_centre, centre};
use super::prove::{Proof, mend, safe_by_voxels};
use super::{CenterlineError, Graph, NOWHERE, Routes, Sampler};
use crate::geometry::{Branch, Centerline, CenterlinePoint};
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

/// Shortest branch of a tree that is kept, mm, unless twice the distance at its root is more.
const LEAST_BRANCH_MM: f64 = 5.0;
/// A branch clears balls of this many distances about it …
const CLEAR_SCALE: f64 = 1.5;
/// … plus this, mm, before the next is looked for.
const CLEAR_MM: f64 = 3.0;

/// Extracts a path or tree.
///
/// * `distance`: exact distance, mm; `smooth`: after a Gaussian of one voxel.
///
/// Ends that are not given are the two points farthest apart by geodesic distance (a double
/// sweep), moved to the centres of the caps they lie on. The root is the end with more room. The
/// tree is TEASAR's (Sato et al. 2000, doi:10.1109/PCCGA.2000.883951) with the penalty (h/d)² in
/// place of its exponential.
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
    let routes = graph.by_centrality(&[from.node], distance);
    if routes.cost[to.node as usize] == NOWHERE {
        return Err(CenterlineError::Unreachable);
    }
    let unreachable = graph.len() - routes.order.len();
    let trunk = routes.path_to(to.node);
    let mut tree = Tree { builder, branches: Vec::new(), proof: Proof::default() };
    let fixed = Fixed { start: from.given, end: to.given };
    tree.add(None, &trunk, (from.point, to.point), fixed);
    if options.tree {
        tree.grow(&routes, from.node, &trunk);
    }
    Ok(Routed { line: tree.finish(), proof: tree.proof, unreachable })
}

/// An end of the path.
#[derive(Clone, Copy)]
struct End {
    node: u32,
    /// Local mm.
    point: DVec3,
    /// Given by the user: the curve meets it exactly.
    given: bool,
}

#[derive(Clone, Copy)]
struct Builder<'a> {
    graph: &'a Graph<'a>,
    d: Sampler<'a>,
    f: Sampler<'a>,
}

impl Builder<'_> {
    fn local(&self, node: u32) -> DVec3 {
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
        let far = |from: u32| {
            let far = self.graph.by_length(&[from]).farthest().unwrap_or(from);
            self.capped(far)
        };
        Ok(match (from, to) {
            (Some(a), Some(b)) => (a, b),
            (Some(a), None) => (a, far(a.node)),
            (None, Some(b)) => (far(b.node), b),
            (None, None) => {
                let deepest = (0..self.graph.len() as u32)
                    .max_by(|&a, &b| self.depth(a).total_cmp(&self.depth(b)).then(b.cmp(&a)));
                let a = far(deepest.unwrap_or(0));
                let first = self.graph.by_length(&[a.node]);
                let b = self.capped(first.farthest().unwrap_or(a.node));
                // The end with more room is the root: trachea, aorta, rectum.
                let room = |e: &End| self.f.at(e.point);
                if room(&b) > 1.05 * room(&a) { (b, a) } else { (a, b) }
            }
        })
    }

    fn depth(&self, node: u32) -> f32 {
        self.d.field[self.graph.element(node)]
    }

    /// The centre of the cap a wall voxel lies on.
    fn capped(&self, node: u32) -> End {
        let h = self.d.lumen.grid.spacing_mm;
        let point = cap_centre(self.local(node), self.d, self.f);
        let at: IVec3 = (point / h).round().as_ivec3();
        End { node: self.graph.node_at(at).unwrap_or(node), point, given: false }
    }

    /// A smooth curve along a route, or the route itself where no smooth one can be proven.
    fn curve(&self, route: &[DVec3], fixed: Fixed) -> (Vec<DVec3>, Proof) {
        for tightness in [1.0, 0.5, 0.25] {
            let smooth = centre(route, self.d, self.f, fixed, tightness);
            if let Some((curve, proof)) = mend(&smooth, route, self.d)
                && (proof.replaced == 0 || tightness == 0.25)
            {
                return (curve, proof);
            }
        }
        let proof = Proof { replaced: route.len(), ..Proof::default() };
        (route.to_vec(), proof)
    }
}

struct Tree<'a> {
    builder: Builder<'a>,
    /// Parent and points (local mm) of each branch.
    branches: Vec<(Option<usize>, Vec<DVec3>)>,
    proof: Proof,
}

impl Tree<'_> {
    fn add(&mut self, parent: Option<usize>, nodes: &[u32], ends: (DVec3, DVec3), fixed: Fixed) {
        let mut route: Vec<DVec3> = nodes.iter().map(|n| self.builder.local(*n)).collect();
        let lumen = self.builder.d.lumen;
        // The exact ends replace or extend the voxels they lie in.
        let joins = |a: DVec3, b: DVec3| safe_by_voxels(a, b, lumen);
        if joins(ends.0, route[0]) {
            route.insert(0, ends.0);
        }
        if joins(ends.1, route[route.len() - 1]) {
            route.push(ends.1);
        }
        route.dedup();
        let (points, proof) = self.builder.curve(&route, fixed);
        self.proof.by_distance += proof.by_distance;
        self.proof.by_voxels += proof.by_voxels;
        self.proof.replaced += proof.replaced;
        self.branches.push((parent, points));
    }

    /// TEASAR's loop: the farthest voxel not yet cleared gets a branch, until none is far enough
    /// from the tree to make one.
    fn grow(&mut self, routes: &Routes, root: u32, trunk: &[u32]) {
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
            self.add(Some(parent), nodes, (start, end.point), Fixed { start: true, end: false });
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

    fn finish(&self) -> Centerline {
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
