//! Extraction of a path or a tree in patient space from the distance map.
//!
//! The lumen's cell complex is collapsed onto a graph that has all its loops. Rules remove arcs
//! that are no branches and cut arcs that pass holes in thin walls. Paths and trees run over the
//! remaining arcs.

use std::cmp::Reverse;
use std::collections::BTreeMap;

use glam::DVec3;
use rayon::prelude::*;

use super::CenterlineError;
use super::arc_graph::{ArcGraph, NodeEnd, PathEnd};
use super::branches::{BranchCurves, BranchRoute, grow_branches};
use super::chain_route::{Chain, ChainRouter};
use super::complex::net::{Loop, Net, PruneLimits, Rule};
use super::complex::sweep::{NodeContacts, first_of_each, tips};
use super::complex::{CellComplex, cell, collapse};
use super::containment::Proof;
use super::ends::{Beyond, ChosenEnd, EndCandidates, EndChoice, EndRule, TipChoice};
use super::pieces;
use super::route_options::RouteOptions;
use crate::field::Sampler;
use crate::geometry::Centerline;
use crate::lumen::Lumen;
use crate::organ::ColonEnds;

/// A loop of the lumen, kept or ended by a rule.
#[derive(Clone, Debug, PartialEq)]
pub struct LumenLoop {
    /// Narrowest place of the loop, LPS mm.
    pub throat_at: DVec3,
    /// Lengths, and the rule that ended the loop.
    pub found: Loop,
}

impl LumenLoop {
    /// Whether the loop was cut at one of two places about as narrow: folds may touch at the other
    /// place, and this one be a stricture.
    pub fn is_doubtful(&self) -> bool {
        /// Least width of the other place, in widths of the throat, for the cut to be certain.
        const CLEAR: f64 = 1.25;
        self.found.ended == Some(Rule::Window)
            && self.found.next_throat_mm < CLEAR * self.found.throat_mm
    }
}

/// A centerline and what is known about it.
#[derive(Clone, Debug)]
pub struct Routed {
    /// The curve or tree, LPS mm. Its radius is estimated from the distance to voxel centres, until
    /// [`super::within_wall`] measures the radius on the wall.
    pub line: Centerline,
    /// Proof that the curves stay inside.
    pub proof: Proof,
    /// Number of inside voxels that no legal route joins to the root.
    pub unreachable: usize,
    /// Nodes on the graph's arcs, by ascending elements.
    pub nodes: Vec<GraphNode>,
    /// Loops in the order in which rules ended them, then the kept ones.
    pub loops: Vec<LumenLoop>,
    /// Start and end of the path or trunk, with the rules that chose them.
    pub ends: [ChosenEnd; 2],
    /// Places where branches part, LPS mm.
    pub junctions: Vec<DVec3>,
    /// Length of the narrow lumen beyond start and end, where path and tree begin below it or end
    /// before it, mm.
    pub beyond_mm: [Option<f64>; 2],
}

/// A place on an arc of the graph.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct GraphNode {
    /// Field element of its voxel.
    pub element: u32,
    /// Chord of the arc there, along the index axes, mm; zero where there is none.
    pub chord: DVec3,
}

/// Least ratio of the distance to the wall at the last end of several pieces to that at the first
/// for the last to be the start instead.
const MORE_ROOM: f64 = 1.05;

/// Extracts a path or tree.
///
/// * `distance`: exact distance, mm; `smooth`: after a Gaussian of one voxel.
///
/// Ends that are not given are tips of the graph, chosen by the rules of [`EndRule`], moved to the
/// centres of the caps they lie on. Where several ways join two ends, the one of least ∫(h/d)² is
/// taken.
///
/// # Errors
/// [`CenterlineError`].
pub fn centerline(
    lumen: &Lumen,
    distance: &[f32],
    smooth: &[f32],
    options: RouteOptions,
) -> Result<Routed, CenterlineError> {
    let d = Sampler { lumen, field: distance };
    let from = options.ends.from.map(|p| given(lumen, "start", p)).transpose()?;
    let to = options.ends.to.map(|p| given(lumen, "end", p)).transpose()?;
    let complex = CellComplex::new(lumen, distance);
    if complex.nodes.is_empty() {
        return Err(CenterlineError::Empty);
    }
    let adjacency = NodeContacts::new(&complex, lumen);
    let component = adjacency.components();
    let held = |e: Option<PathEnd>| e.and_then(|e| complex.node_at(e.voxel as usize));
    let (from, to) = (from.zip(held(from)), to.zip(held(to)));
    let held: Vec<u32> = from.iter().chain(&to).map(|e| e.1).collect();
    if held.windows(2).any(|w| component[w[0] as usize] != component[w[1] as usize]) {
        return Err(CenterlineError::Unreachable);
    }
    let mut anchors = ends_of_branches(&complex, &adjacency, &component);
    anchors.extend(&held);
    anchors.sort_unstable();
    anchors.dedup();
    let left = collapse(&complex, &anchors);
    let mut net = Net::new(&complex, &adjacency, &left, &held, d);
    let kept = net.prune(PruneLimits::default());

    // Larynx and pharynx are no part of a tree that begins at the trachea, an ileum none of a colon.
    let beyond = if held.is_empty() {
        beyond_organ(&net, (&complex, &adjacency, &component), (d, smooth), options)
    } else {
        None
    };
    if let Some(beyond) = &beyond {
        net.cut_beyond(beyond.at, beyond.tip);
    }

    let loops = net.ended.iter().chain(&kept).map(|found| LumenLoop {
        throat_at: contact_at(&complex, lumen, found.throat),
        found: found.clone(),
    });
    let loops = loops.collect();
    let router = ChainRouter { complex: &complex, distance: d };
    let f = Sampler { lumen, field: smooth };
    let view = ArcGraph { net: &net, complex: &complex, adjacency: &adjacency, router, d, f };
    let parts = RouteComponent::all(&complex, &component, &net);
    // The deepest part is first, or the one that ends were asked for in.
    let main = held.first().map_or_else(
        || (0..parts.len()).max_by_key(|p| (parts[*p].depth(&complex), Reverse(*p))).unwrap_or(0),
        |n| component[*n as usize] as usize,
    );
    let ChosenRoutes { mut routes, mut ends } = view.routes(&parts[main], (from, to), options);
    let mut unreachable: u64 = parts.iter().map(|p| p.voxels).sum::<u64>() - parts[main].voxels;
    if held.is_empty() {
        let mut pieces = vec![routes];
        let least_mm = PIECE_RADIUS * lumen.grid.spacing_mm.min_element();
        for part in parts.iter().enumerate().filter(|(i, _)| *i != main).map(|(_, part)| part) {
            let route = view.routes(part, (None, None), options).routes;
            let radius_mm = d.at(view.adjacency.place_mm[part.widest as usize]);
            let place = |n: u32| view.adjacency.place_mm[n as usize];
            if radius_mm >= least_mm && route[0].is_long_enough(d, place) {
                unreachable -= part.voxels;
                pieces.push(route);
            }
        }
        let several = pieces.len() > 1;
        routes = in_order(pieces, &view, options.tree);
        if !options.tree && (several || options.starts_near.is_some()) {
            orient(&mut routes, &mut ends, (lumen, &adjacency), options.starts_near);
        }
    }
    let [start, end] = ends;
    let start = start.described(lumen, routes.first().map(|r| r.end(false).point));
    let last = if options.tree { routes.first() } else { routes.last() };
    let end = end.described(lumen, last.map(|r| r.end(true).point));
    routes.par_iter_mut().for_each(|r| r.follow(&view.router));
    let branches = BranchCurves::new(view.d, view.f, &routes);
    Ok(Routed {
        line: branches.finish(),
        proof: branches.proof,
        unreachable: unreachable as usize,
        nodes: view.graph_nodes(Some(parts[main].widest)),
        loops,
        ends: [start, end],
        junctions: view.junctions(),
        beyond_mm: [false, true]
            .map(|after| beyond.filter(|b| b.is_after_end == after).map(|beyond| beyond.length_mm)),
    })
}

/// Returns the stretch above the trachea, or beyond the caecum, of the deepest component.
fn beyond_organ(
    net: &Net<'_>,
    (complex, adjacency, component): (&CellComplex, &NodeContacts<'_>, &[u32]),
    (d, smooth): (Sampler<'_>, &[f32]),
    options: RouteOptions,
) -> Option<Beyond> {
    let router = ChainRouter { complex, distance: d };
    let f = Sampler { lumen: d.lumen, field: smooth };
    let view = ArcGraph { net, complex, adjacency, router, d, f };
    let parts = RouteComponent::all(complex, component, net);
    let deepest = parts.iter().max_by_key(|p| (p.depth(complex), Reverse(p.widest)))?;
    let mut leaves = net.leaves();
    leaves.retain(|n| deepest.nodes.binary_search(n).is_ok());
    if leaves.len() < 2 {
        return None;
    }
    let trachea = options.trachea.map(|at| view.local(at));
    EndCandidates::new(view, &leaves, &deepest.nodes).beyond_organ(trachea)
}

/// Routes through a component, and the reasons of the trunk's ends.
struct ChosenRoutes {
    routes: Vec<BranchRoute>,
    ends: [EndChoice; 2],
}

/// Turns the pieces of a path about where it starts at the wrong end: from the rectum on where the
/// place of the ends says which that is, else from the first piece on.
fn orient(
    routes: &mut [BranchRoute],
    ends: &mut [EndChoice; 2],
    (lumen, adjacency): (&Lumen, &NodeContacts<'_>),
    starts_near: Option<DVec3>,
) {
    let (Some(first), Some(last)) = (routes.first(), routes.last()) else { return };
    let (p, q) = (first.end(false).point, last.end(true).point);
    let place = |n: u32| adjacency.place_mm[n as usize];
    let length_mm = routes.iter().map(|r| r.length_mm(place)).sum();
    let world = |p: DVec3| {
        let grid = &lumen.grid;
        grid.world_from_voxel().transform_point3(p / grid.spacing_mm)
    };
    let [a, b] = [p, q].map(world);
    let by_place = ColonEnds::of(a, b, length_mm).filter(|ends| ends.is_sure);
    let (turned, rule) = match (by_place, starts_near) {
        (Some(ends), _) => (!ends.starts_at_rectum, EndRule::Rectum),
        (None, Some(near)) => (b.distance(near) < a.distance(near), EndRule::FirstPiece),
        (None, None) => return,
    };
    if turned {
        routes.reverse();
        routes.iter_mut().for_each(BranchRoute::reverse);
    }
    // The rule of a single tube said so already.
    if rule != ends[0].rule {
        let margin = by_place.map(|_| 1.0);
        *ends = [EndChoice { margin, ..EndChoice::by(rule) }, EndChoice::by(EndRule::FarthestTip)];
    }
}

/// Routes of several parts one after another: paths in the order in which they follow each other,
/// trees as they come.
fn in_order(pieces: Vec<Vec<BranchRoute>>, view: &ArcGraph<'_>, tree: bool) -> Vec<BranchRoute> {
    let mut order: Vec<(usize, bool)> = (0..pieces.len()).map(|i| (i, false)).collect();
    if !tree && pieces.len() > 1 {
        let place = |n: u32| view.adjacency.place_mm[n as usize];
        let inwards = 2 * view.complex.stride();
        order = pieces::order(
            &pieces.iter().map(|p| p[0].path_piece(place, inwards)).collect::<Vec<_>>(),
        );
        // The end with more room comes first, as of one path.
        let room = |(i, back): (usize, bool)| view.f.at(pieces[i][0].end(back).point);
        let (first, last) = (order[0], order[order.len() - 1]);
        if room((last.0, !last.1)) > MORE_ROOM * room(first) {
            order.reverse();
            order.iter_mut().for_each(|o| o.1 = !o.1);
        }
    }
    let mut pieces: Vec<Option<Vec<BranchRoute>>> = pieces.into_iter().map(Some).collect();
    let mut all = Vec::new();
    for (i, back) in order {
        let before = all.len();
        for mut route in pieces[i].take().into_iter().flatten() {
            route.offset_indices(before);
            if back {
                route.reverse();
            }
            all.push(route);
        }
    }
    all
}

/// Least radius of the widest place of a further component, in sides of a voxel: a sheet of single
/// voxels has no room for an eye.
const PIECE_RADIUS: f64 = 1.5;

/// A component of the lumen.
struct RouteComponent {
    /// Nodes at which arcs of the component end, ascending.
    nodes: Vec<u32>,
    /// Deepest node of the component, of several the first.
    widest: u32,
    voxels: u64,
}

impl RouteComponent {
    /// All components by their numbers.
    fn all(complex: &CellComplex, component: &[u32], net: &Net<'_>) -> Vec<Self> {
        let first = |n: u32| Reverse(complex.nodes[n as usize].key);
        let widest = first_of_each(component, first);
        let mut parts: Vec<Self> = widest
            .into_iter()
            .map(|widest| Self { nodes: Vec::new(), widest, voxels: 0 })
            .collect();
        for (n, c) in complex.nodes.iter().zip(component) {
            parts[*c as usize].voxels += u64::from(n.voxels.count_ones());
        }
        net.nodes().for_each(|n| parts[component[n as usize] as usize].nodes.push(n));
        parts
    }

    fn depth(&self, complex: &CellComplex) -> u32 {
        complex.nodes[self.widest as usize].key
    }
}

/// Finds the nodes at which branches may end: in each component the node farthest from the deepest
/// one, and all [`tips`] as seen from that node.
fn ends_of_branches(
    complex: &CellComplex,
    adjacency: &NodeContacts<'_>,
    component: &[u32],
) -> Vec<u32> {
    let nodes = &complex.nodes;
    let first = |n: u32| (Reverse(nodes[n as usize].key), nodes[n as usize].deepest);
    let deepest = first_of_each(component, first);
    let far = adjacency.lengths(&deepest);
    let roots = first_of_each(component, |n| Reverse(far[n as usize]));
    let length = adjacency.lengths(&roots);
    let h = adjacency.unit_mm * super::complex::sweep::UNITS;
    let width_mm = |n: u32| 0.5 * h * f64::from(nodes[n as usize].key).sqrt();
    let units = |mm: f64| (mm / adjacency.unit_mm) as u32;
    let mut found =
        tips(adjacency, &length, |n| units(width_mm(n)), units(PruneLimits::default().twig_mm));
    found.extend(&roots);
    found
}

/// The middle of a contact's deepest pair, LPS mm.
fn contact_at(complex: &CellComplex, lumen: &Lumen, contact: u32) -> DVec3 {
    let pair = complex.contacts[contact as usize].deepest;
    let [p, q] = pair.map(|e| lumen.bricks.voxel(e as usize).as_dvec3());
    lumen.grid.world_from_voxel().transform_point3(0.5 * (p + q))
}

/// Returns an end that the user gave, or an error if it is outside the lumen.
fn given(lumen: &Lumen, which: &'static str, at: DVec3) -> Result<PathEnd, CenterlineError> {
    let grid = &lumen.grid;
    let v = grid.voxel_from_world().transform_point3(at);
    let is_near = v.is_finite() && v.abs().max_element() < 1e6;
    let voxel = lumen.bricks.element(v.round().as_ivec3());
    match voxel.filter(|e| is_near && lumen.is_inside(*e)) {
        Some(e) => Ok(PathEnd { voxel: e as u32, point: v * grid.spacing_mm, given: true }),
        None => {
            let off = |e| ((lumen.bricks.voxel(e).as_dvec3() - v) * grid.spacing_mm).length();
            let nearest_mm = lumen.elements(&lumen.inside).map(off).fold(f64::MAX, f64::min);
            Err(CenterlineError::OutsideLumen { which, at, nearest_mm })
        }
    }
}

impl ArcGraph<'_> {
    /// Deepest voxels of all nodes on arcs, and of the widest node.
    fn graph_nodes(&self, widest: Option<u32>) -> Vec<GraphNode> {
        let place = |n: u32| self.adjacency.place_mm[n as usize];
        let element = |n: u32| self.complex.nodes[n as usize].deepest;
        let reach = 2 * self.complex.stride();
        let mut all: BTreeMap<u32, DVec3> = BTreeMap::new();
        for arc in self.net.arcs() {
            for (i, &n) in arc.nodes.iter().enumerate() {
                let (a, b) = (i.saturating_sub(reach), (i + reach).min(arc.nodes.len() - 1));
                all.entry(element(n)).or_insert(place(arc.nodes[b]) - place(arc.nodes[a]));
            }
        }
        widest.map(|n| all.entry(element(n)).or_default());
        all.into_iter().map(|(element, chord)| GraphNode { element, chord }).collect()
    }

    /// Places where more than two arcs meet, LPS mm.
    fn junctions(&self) -> Vec<DVec3> {
        self.net.nodes().filter(|n| self.net.degree(*n) > 2).map(|n| self.world(n)).collect()
    }

    /// The trunk, of a tree with all other branches.
    ///
    /// Their ways have no points yet.
    fn routes(
        &self,
        part: &RouteComponent,
        (from, to): (Option<NodeEnd>, Option<NodeEnd>),
        options: RouteOptions,
    ) -> ChosenRoutes {
        let nodes = &part.nodes[..];
        let given = EndChoice::by(EndRule::Given);
        if nodes.is_empty() {
            let of =
                |end: Option<NodeEnd>| end.map_or(EndChoice::by(EndRule::FarthestTip), |_| given);
            let ends = [of(from), of(to)];
            return ChosenRoutes { routes: vec![self.within(part.widest, (from, to))], ends };
        }
        let mut leaves = self.net.leaves();
        leaves.retain(|n| nodes.binary_search(n).is_ok());
        if leaves.is_empty() && from.is_none() && to.is_none() {
            // Rings only: the widest is flown once round.
            let routes = grow_branches(self, self.ring(nodes), nodes, options);
            return ChosenRoutes { routes, ends: [EndChoice::by(EndRule::Ring); 2] };
        }
        let candidates = EndCandidates::new(*self, &leaves, nodes);
        let trachea = options.trachea.map(|at| self.local(at));
        let tip = |choice: &TipChoice| (self.tip(choice.node), choice.node);
        let (from, to, ends) = match (from, to) {
            (Some(a), Some(b)) => (a, b, [given; 2]),
            (Some(a), None) => {
                let end = candidates.farthest_from(a.1);
                (a, tip(&end), [given, candidates.reason(&end)])
            }
            (None, Some(b)) => {
                let start = candidates.start_of_path_to(b, trachea);
                (tip(&start), b, [candidates.reason(&start), given])
            }
            (None, None) => {
                let (start, end) = candidates.choose(trachea);
                (tip(&start), tip(&end), [&start, &end].map(|choice| candidates.reason(choice)))
            }
        };
        let trunk = BranchRoute::between(from, to, self.way(from.1, to.1));
        ChosenRoutes { routes: grow_branches(self, trunk, nodes, options), ends }
    }

    /// The longest arc of a component without leaves; a ring if there is one.
    fn ring(&self, nodes: &[u32]) -> BranchRoute {
        let arcs = self.net.arcs_of(nodes);
        let order = |i: &usize| {
            let ends = self.net.arc(*i).map_or([0, 1], |a| a.ends());
            (ends[0] == ends[1], self.net.length(*i), Reverse(*i))
        };
        let longest = arcs.max_by_key(order);
        let arc = longest.and_then(|i| self.net.arc(i));
        let chain = arc.map(|a| Chain { nodes: a.nodes.clone(), contacts: a.contacts.clone() });
        let chain = chain.unwrap_or_default();
        let end = |n: u32| {
            let voxel = self.complex.nodes[n as usize].deepest;
            (PathEnd { voxel, point: self.adjacency.place_mm[n as usize], given: true }, n)
        };
        let (first, last) = (chain.nodes[0], chain.nodes[chain.nodes.len() - 1]);
        let mut route = BranchRoute::between(end(first), end(last), chain);
        route.joined = (first == last).then_some(0);
        route
    }

    /// The way between the voxels farthest apart in a component of one node, or between given ones.
    fn within(&self, node: u32, (from, to): (Option<NodeEnd>, Option<NodeEnd>)) -> BranchRoute {
        let n = &self.complex.nodes[node as usize];
        let end = |bit: u32| {
            let voxel = self.complex.element(node, bit);
            let at = self.d.lumen.bricks.voxel(voxel as usize).as_dvec3();
            PathEnd { voxel, point: at * self.d.lumen.grid.spacing_mm, given: false }
        };
        let far = |from: u32| {
            let steps = |b: u32| (cell::path(n.voxels, from, b).len(), Reverse(b));
            cell::voxels(n.voxels).max_by_key(|b| steps(*b)).unwrap_or(from)
        };
        let a = far(n.voxels.trailing_zeros());
        let (from, to) = (from.map_or(end(a), |e| e.0), to.map_or(end(far(a)), |e| e.0));
        let chain = Chain { nodes: vec![node], contacts: Vec::new() };
        BranchRoute::between((from, node), (to, node), chain)
    }
}
