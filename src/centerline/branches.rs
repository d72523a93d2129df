//! Branches over the arcs of the graph, and their curves.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BTreeSet};

use glam::DVec3;
use rayon::prelude::*;

use super::arc_graph::{ArcGraph, PathEnd, Ways};
use super::chain_route::{Chain, ChainRouter};
use super::complex::net::PruneLimits;
use super::containment::{Proof, mend, safe, settle};
use super::pieces::PathPiece;
use super::recenter::{Fixed, arc_lengths, recenter};
use super::route_options::{Loops, RouteOptions};
use crate::field::Sampler;
use crate::geometry::{Attachment, Branch, Centerline, CenterlinePoint};

/// A branch as a path on the graph: parents come before children.
pub(super) struct BranchRoute {
    parent: Option<usize>,
    /// Branch on which this branch ends, if it closes a loop; for a ring, the ring itself.
    pub joined: Option<usize>,
    /// Chain from the branching point on the parent, or from the root, to the tip.
    chain: Chain,
    /// Start and end. A branch with a parent starts on the parent's curve instead.
    ends: [PathEnd; 2],
    /// Points of the path, local mm, each piece proven inside.
    points: Vec<DVec3>,
}

impl BranchRoute {
    /// A root between two nodes.
    pub fn between(from: (PathEnd, u32), to: (PathEnd, u32), chain: Chain) -> Self {
        let points = Vec::new();
        Self { parent: None, joined: None, chain, ends: [from.0, to.0], points }
    }

    /// Computes the points of the path.
    pub fn follow(&mut self, router: &ChainRouter<'_>) {
        self.points = router.polyline(&self.chain, self.ends.map(|e| e.voxel));
    }

    /// Reverses the route, which must be a root.
    pub fn reverse(&mut self) {
        self.chain.reverse();
        self.ends.reverse();
    }

    /// Returns the start of the route, or its end if `last`.
    pub fn end(&self, last: bool) -> PathEnd {
        self.ends[usize::from(last)]
    }

    /// Approximate length of the route, mm: the sum of chords between every fourth node.
    ///
    /// * `place`: position of a node, local mm.
    pub fn length_mm(&self, place: impl Fn(u32) -> DVec3) -> f64 {
        const STRIDE: usize = 4;
        let nodes = self.chain.nodes.iter().step_by(STRIDE).chain(self.chain.nodes.last());
        let places: Vec<DVec3> = nodes.map(|n| place(*n)).collect();
        places.windows(2).map(|w| w[0].distance(w[1])).sum()
    }

    /// Adds an offset to the indices of the parent and of the joined branch.
    pub fn offset_indices(&mut self, offset: usize) {
        self.parent = self.parent.map(|parent| parent + offset);
        self.joined = self.joined.map(|joined| joined + offset);
    }

    /// Whether the route is long enough for a flight through its part of the lumen. Ends of a bent or
    /// closed part may lie beside each other.
    ///
    /// * `place`: position of a node, local mm.
    pub fn is_long_enough(&self, d: Sampler<'_>, place: impl Fn(u32) -> DVec3) -> bool {
        let [a, b] = self.ends.map(|e| e.point);
        let length = self.length_mm(place).max(a.distance(b));
        length >= (2.0 * d.at(a).max(d.at(b))).max(PruneLimits::default().twig_mm)
    }

    /// Returns the ends of the route, each with the direction in which the route leaves it.
    ///
    /// * `place`: position of a node, local mm.
    /// * `inwards`: number of nodes from an end to the one that its direction is taken from.
    pub fn path_piece(&self, place: impl Fn(u32) -> DVec3, inwards: usize) -> PathPiece {
        let n = &self.chain.nodes;
        let inner = [n[inwards.min(n.len() - 1)], n[n.len().saturating_sub(1 + inwards)]];
        let ends = self.ends.map(|e| e.point);
        let outward = [0, 1].map(|i| (ends[i] - place(inner[i])).normalize_or_zero());
        PathPiece { ends, outward }
    }
}

/// Returns the trunk and, for a tree, its branches. Tips are visited from the farthest to the nearest.
/// The branch to a tip starts where the way from the root leaves the branches found so far. Arcs that
/// close loops come last.
///
/// * `nodes`: nodes at which arcs of the component end, ascending.
pub(super) fn grow_branches(
    graph: &ArcGraph<'_>,
    trunk: BranchRoute,
    nodes: &[u32],
    options: RouteOptions,
) -> Vec<BranchRoute> {
    let root = trunk.chain.nodes[0];
    let mut routes = vec![trunk];
    if !options.tree {
        return routes;
    }

    // 1. Most central ways from the root, and the branch on each node.
    let ways = graph.net.ways(root, |i| graph.net.centrality(i));
    let mut owner: BTreeMap<u32, usize> = BTreeMap::new();
    owner.extend(routes[0].chain.nodes.iter().map(|n| (*n, 0)));

    // 2. Tips, the farthest first.
    let lengths = graph.net.ways(root, |i| graph.net.length(i));
    let mut tips = graph.net.leaves();
    tips.retain(|n| nodes.binary_search(n).is_ok() && !owner.contains_key(n));
    tips.sort_by_key(|n| (Reverse(lengths.get(n).map_or(0, |w| w.0)), *n));

    // 3. A branch to each tip that leads out of the trunk.
    let mut pockets: BTreeSet<u32> = BTreeSet::new();
    for node in tips {
        let chain = graph.chain(&ways, node, |n| owner.contains_key(&n));
        let tip = graph.tip(node);
        let from = chain.nodes[0];
        if !graph.leads_out(from, tip) {
            pockets.extend(&chain.contacts);
            continue;
        }
        let parent = owner.get(&from).copied().or(Some(0));
        own(&mut owner, &chain, routes.len());
        let ends = [junction(graph, from), tip];
        routes.push(BranchRoute { parent, joined: None, chain, ends, points: Vec::new() });
    }

    // 4. Arcs that no branch follows.
    close_loops(graph, (&mut routes, &mut owner), &ways, nodes, &pockets, options.loops);
    routes
}

/// Makes a branch the owner of those nodes of its chain that have no owner.
fn own(owner: &mut BTreeMap<u32, usize>, chain: &Chain, id: usize) {
    for n in &chain.nodes {
        owner.entry(*n).or_insert(id);
    }
}

/// The deepest place of a node, as an end.
fn junction(graph: &ArcGraph<'_>, node: u32) -> PathEnd {
    let voxel = graph.complex.nodes[node as usize].deepest;
    PathEnd { voxel, point: graph.adjacency.place_mm[node as usize], given: false }
}

/// Adds branches along arcs that no branch follows yet. An arc between two branches closes a loop: it
/// becomes one branch, or two halves if loops are cut.
///
/// * `pockets`: contacts of the ways to tips that are no branches.
fn close_loops(
    graph: &ArcGraph<'_>,
    (routes, owner): (&mut Vec<BranchRoute>, &mut BTreeMap<u32, usize>),
    ways: &Ways,
    nodes: &[u32],
    pockets: &BTreeSet<u32>,
    loops: Loops,
) {
    // 1. Collect the arcs that no branch follows. The trunk may follow arcs that the most central ways
    // do not.
    let used_contacts: BTreeSet<u32> =
        routes.iter().flat_map(|r| &r.chain.contacts).chain(pockets).copied().collect();
    let is_unused = |i: &usize| {
        let first_contact = graph.net.arc(*i).and_then(|arc| arc.contacts.first());
        first_contact.is_none_or(|contact| !used_contacts.contains(contact))
    };
    let mut unused_arcs: Vec<usize> = graph.net.arcs_of(nodes).filter(is_unused).collect();

    // 2. Take the first unused arc that touches a branch, until no unused arc touches one.
    while let Some(at) = unused_arcs.iter().position(|i| {
        graph.net.arc(*i).is_some_and(|arc| arc.ends().iter().any(|n| owner.contains_key(n)))
    }) {
        let Some(arc) = graph.net.arc(unused_arcs.remove(at)) else { continue };

        // 3. Start the chain on a branch.
        let mut chain = Chain { nodes: arc.nodes.clone(), contacts: arc.contacts.clone() };
        if !owner.contains_key(&chain.nodes[0]) {
            chain.reverse();
        }
        let [start, end] = [chain.nodes[0], chain.nodes[chain.nodes.len() - 1]];
        let (from, to) = (owner[&start], owner.get(&end).copied());
        own(owner, &chain, routes.len());

        // 4. Keep it as one branch, or cut it.
        if loops == Loops::Keep || to.is_none() {
            let ends = [junction(graph, start), junction(graph, end)];
            let parent = Some(from);
            routes.push(BranchRoute { parent, joined: to, chain, ends, points: Vec::new() });
        } else {
            add_halves(graph, routes, halves(graph, chain, ways), [Some(from), to]);
        }
    }
}

/// Adds each half of a cut chain as a branch if it reaches far enough from its start.
fn add_halves(
    graph: &ArcGraph<'_>,
    routes: &mut Vec<BranchRoute>,
    halves: [Chain; 2],
    parents: [Option<usize>; 2],
) {
    let place = |node: u32| graph.adjacency.place_mm[node as usize];
    for (chain, parent) in halves.into_iter().zip(parents) {
        let [start, end] = [chain.nodes[0], chain.nodes[chain.nodes.len() - 1]];
        let min_reach_mm = (2.0 * graph.d.at(place(start))).max(PruneLimits::default().twig_mm);
        if chain.nodes.iter().any(|n| place(*n).distance(place(start)) >= min_reach_mm) {
            let ends = [junction(graph, start), junction(graph, end)];
            routes.push(BranchRoute { parent, joined: None, chain, ends, points: Vec::new() });
        }
    }
}

/// Cuts a chain where the ways from the root over its two ends cost the same. Each half runs from an
/// end of the chain to the cut.
fn halves(graph: &ArcGraph<'_>, mut chain: Chain, ways: &Ways) -> [Chain; 2] {
    let cost = |node: u32| ways.get(&node).map_or(0, |w| w.0);
    let end = chain.nodes[chain.nodes.len() - 1];
    let [start_cost, end_cost] = [cost(chain.nodes[0]), cost(end)];
    let contact_costs: Vec<u64> =
        chain.contacts.iter().map(|c| graph.net.contact_centrality(*c)).collect();
    let total: u64 = contact_costs.iter().sum();

    // The contact at the cut belongs to neither half.
    let mut cost_to_cut = start_cost;
    let mut cut = contact_costs.len() - 1;
    for (i, cost) in contact_costs.iter().enumerate() {
        cost_to_cut += cost;
        if 2 * cost_to_cut > start_cost + end_cost + total {
            cut = i;
            break;
        }
    }
    let mut second = Chain {
        nodes: chain.nodes.split_off(cut + 1),
        contacts: chain.contacts.split_off(cut + 1),
    };
    chain.contacts.truncate(cut);
    second.reverse();
    [chain, second]
}

/// Length of the repeats at either end of a ring, in distances to the wall at its start. It is longer
/// than the influence of the ends of a curve.
const RING_OVERLAP: f64 = 8.0;
/// Fewest points of a route that is smoothed as a ring.
const MIN_LAP: usize = 8;

/// The curve along a route, local mm, and its proof.
struct ProvenCurve {
    points: Vec<DVec3>,
    proof: Proof,
}

/// A curve, and the branches on which it starts and ends.
struct AttachedCurve {
    parent: Option<usize>,
    joined: Option<usize>,
    /// Points, local mm.
    points: Vec<DVec3>,
}

/// Curves of branches.
pub(super) struct BranchCurves<'a> {
    d: Sampler<'a>,
    f: Sampler<'a>,
    curves: Vec<AttachedCurve>,
    /// Sum of the proofs of all curves.
    pub proof: Proof,
}

impl<'a> BranchCurves<'a> {
    /// Computes the curves of all routes. A route waits for the curves that it starts and ends on;
    /// routes that are ready run in parallel.
    ///
    /// * `d`, `f`: distance to the wall, exact and smoothed.
    pub fn new(d: Sampler<'a>, f: Sampler<'a>, routes: &[BranchRoute]) -> Self {
        let mut this = Self { d, f, curves: Vec::new(), proof: Proof::default() };
        let mut computed: Vec<Option<ProvenCurve>> = routes.iter().map(|_| None).collect();
        loop {
            let is_ready = |i: &usize| {
                // A ring ends on itself.
                let needed = [routes[*i].parent, routes[*i].joined.filter(|joined| joined != i)];
                computed[*i].is_none() && needed.iter().flatten().all(|n| computed[*n].is_some())
            };
            let ready: Vec<usize> = (0..routes.len()).filter(is_ready).collect();
            if ready.is_empty() {
                break;
            }
            let points_of = |branch: Option<usize>| Some(&computed[branch?].as_ref()?.points[..]);
            let curve = |i: &usize| {
                this.curve(&routes[*i], points_of(routes[*i].parent), points_of(routes[*i].joined))
            };
            let curves: Vec<ProvenCurve> = ready.par_iter().map(curve).collect();
            for (i, curve) in ready.into_iter().zip(curves) {
                computed[i] = Some(curve);
            }
        }
        for (route, ProvenCurve { points, proof }) in
            routes.iter().zip(computed.into_iter().flatten())
        {
            this.proof.by_distance += proof.by_distance;
            this.proof.by_voxels += proof.by_voxels;
            this.proof.replaced += proof.replaced;
            let BranchRoute { parent, joined, .. } = *route;
            this.curves.push(AttachedCurve { parent, joined, points });
        }
        this
    }

    /// The curve along a route between its ends, which lie on the curves that it leaves and joins.
    fn curve(
        &self,
        route: &BranchRoute,
        parent: Option<&[DVec3]>,
        joined: Option<&[DVec3]>,
    ) -> ProvenCurve {
        let [from, to] = route.ends;
        let mut points = dense(&route.points, self.d.lumen.grid.spacing_mm.min_element());
        let is_ring = route.parent.is_none() && route.joined.is_some();
        let start_fixed = self.attach_start(&mut points, from, parent, is_ring);
        points.reverse();
        let end_fixed = self.attach_start(&mut points, to, joined, is_ring);
        points.reverse();
        points.dedup();
        let fixed = Fixed { start: start_fixed, end: end_fixed };
        let smooth = if is_ring && points.len() >= MIN_LAP {
            self.ring(&points)
        } else {
            recenter(&points, self.d, self.f, fixed)
        };
        let mended = mend(&smooth, &points, self.d);
        let (curve, proof) = mended.unwrap_or_else(|| {
            let replaced = points.len();
            (points, Proof { replaced, ..Proof::default() })
        });
        let points = settle(&curve, [!fixed.start, !fixed.end], self.d.lumen);
        ProvenCurve { points, proof }
    }

    /// Recentres a ring. Part of the lap is repeated before its start and after its end, so that the ends
    /// of the curve do not influence the lap. Then one lap is cut out and closed.
    fn ring(&self, route: &[DVec3]) -> Vec<DVec3> {
        // 1. Unroll the ring, with repeats at both ends.
        let lap = &route[..route.len() - 1];
        let overlap_mm = RING_OVERLAP * self.d.at(route[0]);
        let repeated = arc_lengths(lap).iter().take_while(|s| **s < overlap_mm).count();
        let places = (0..lap.len() + 2 * repeated + 1).map(|i| i + lap.len() - repeated);
        let unrolled: Vec<DVec3> = places.map(|i| lap[i % lap.len()]).collect();
        let mut curve = recenter(&unrolled, self.d, self.f, Fixed { start: false, end: false });

        // 2. Cut one lap out. It starts where the first repeat ends. It ends at the point nearest to its
        // start, searched from one and a half repeats before the end of the curve.
        let s = arc_lengths(&curve);
        let total = s[s.len() - 1];
        let repeated_share = repeated as f64 / unrolled.len() as f64;
        let first = s.partition_point(|s| *s < repeated_share * total).min(curve.len() - 2);
        let search_mm = (1.0 - 1.5 * repeated_share) * total;
        let search_from = s.partition_point(|s| *s < search_mm).max(first + 1);
        let to_start = |i: &usize| curve[*i].distance_squared(curve[first]);
        let last = (search_from..curve.len()).min_by(|a, b| to_start(a).total_cmp(&to_start(b)));
        let last = last.unwrap_or(curve.len() - 1);

        // 3. Close the lap: spread the gap between its ends over its last overlap.
        let gap = curve[first] - curve[last];
        for i in first..=last {
            let overlaps_to_end = (s[last] - s[i]) / overlap_mm.max(1e-9);
            curve[i] += gap * (1.0 - overlaps_to_end).max(0.0).powi(2);
        }
        curve[last] = curve[first];
        curve.truncate(last + 1);
        curve.split_off(first)
    }

    /// Moves the start of a route to its proper place: the nearest point of the curve it starts on, a
    /// given end, or the centre of the cap. Returns whether the start must stay where it is.
    ///
    /// * `curve`: curve on which the route starts, if any.
    /// * `is_ring`: the route ends where it starts.
    fn attach_start(
        &self,
        points: &mut Vec<DVec3>,
        end: PathEnd,
        curve: Option<&[DVec3]>,
        is_ring: bool,
    ) -> bool {
        let to_start = |p: &DVec3| p.distance_squared(points[0]);
        let nearest_on_curve = curve
            .and_then(|c| c.iter().min_by(|a, b| to_start(a).total_cmp(&to_start(b))).copied());
        if let Some(at) = nearest_on_curve {
            if safe(at, points[0], self.d) {
                points.insert(0, at);
            }
            return true;
        }
        if is_ring {
            return true;
        }
        if !end.given {
            // The centre of the cap may lie back along the way.
            let to_end = |i: usize| points[i].distance_squared(end.point);
            let nearest = (0..points.len() - 1).min_by(|i, j| to_end(*i).total_cmp(&to_end(*j)));
            points.drain(..nearest.unwrap_or(0));
        }
        if safe(end.point, points[0], self.d) {
            points.insert(0, end.point);
        }
        end.given
    }

    /// The branches in patient space.
    pub fn finish(&self) -> Centerline {
        let grid = &self.d.lumen.grid;
        let world = grid.world_from_voxel();
        // The distance is to external voxel centres; the wall lies half a voxel before them.
        let half = 0.5 * (grid.spacing_mm.element_product()).cbrt();
        let mut line = Centerline::default();
        for AttachedCurve { parent, points, .. } in &self.curves {
            // A branch starts at one of its parent's points.
            let first = world.transform_point3(points[0] / grid.spacing_mm);
            let start = parent.map(|branch| nearest(&line, branch, first));
            let offset = start.map_or(0.0, |s| line.branches[s.branch].points[s.point].abscissa_mm);
            let points = points
                .iter()
                .zip(arc_lengths(points))
                .map(|(p, s)| CenterlinePoint {
                    position_mm: world.transform_point3(*p / grid.spacing_mm),
                    radius_mm: (self.d.at(*p) - half).max(0.0),
                    abscissa_mm: offset + s,
                })
                .collect();
            line.branches.push(Branch { start, end: None, points });
        }
        for (i, curve) in self.curves.iter().enumerate() {
            let Some(joined) = curve.joined else { continue };
            let last = line.branches[i].points.last().map(|p| p.position_mm);
            line.branches[i].end = last.map(|p| match joined == i {
                true => Attachment { branch: i, point: 0 },
                false => nearest(&line, joined, p),
            });
        }
        line
    }
}

/// The point of a branch nearest to a place.
fn nearest(line: &Centerline, branch: usize, to: DVec3) -> Attachment {
    let points: &[CenterlinePoint] = &line.branches[branch].points;
    let off = |i: &usize| points[*i].position_mm.distance_squared(to);
    let nearest = (0..points.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
    Attachment { branch, point: nearest.unwrap_or(0) }
}

/// Points no farther than `step_mm` apart along the same pieces: parts of a proven piece are proven.
fn dense(points: &[DVec3], step_mm: f64) -> Vec<DVec3> {
    let mut out: Vec<DVec3> = points.iter().take(1).copied().collect();
    for w in points.windows(2) {
        let n = (w[0].distance(w[1]) / step_mm).ceil().max(1.0);
        out.extend((1..n as usize).map(|k| w[0].lerp(w[1], k as f64 / n)));
        out.push(w[1]);
    }
    out
}
