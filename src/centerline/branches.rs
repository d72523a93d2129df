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
    /// The branch that it ends on: it closes a loop.
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

    /// Length of the route, about, mm: of chords between nodes some steps apart.
    ///
    /// * `place`: position of a node, local mm.
    pub fn length_mm(&self, place: impl Fn(u32) -> DVec3) -> f64 {
        const STRIDE: usize = 4;
        let nodes = self.chain.nodes.iter().step_by(STRIDE).chain(self.chain.nodes.last());
        let places: Vec<DVec3> = nodes.map(|n| place(*n)).collect();
        places.windows(2).map(|w| w[0].distance(w[1])).sum()
    }

    /// Numbers the branches it is attached to from another start.
    pub fn shift(&mut self, by: usize) {
        self.parent = self.parent.map(|p| p + by);
        self.joined = self.joined.map(|j| j + by);
    }

    /// Whether a part of the lumen with this way through it is long enough to be flown.
    pub fn is_piece(&self, d: Sampler<'_>) -> bool {
        let [a, b] = self.ends.map(|e| e.point);
        a.distance(b) >= (2.0 * d.at(a).max(d.at(b))).max(PruneLimits::default().twig_mm)
    }

    /// Returns the ends of the route with the directions out of it.
    ///
    /// * `place`: position of a node, local mm.
    /// * `inwards`: number of nodes from an end to the one that its direction is taken from.
    pub fn piece(&self, place: impl Fn(u32) -> DVec3, inwards: usize) -> PathPiece {
        let n = &self.chain.nodes;
        let inner = [n[inwards.min(n.len() - 1)], n[n.len().saturating_sub(1 + inwards)]];
        let ends = self.ends.map(|e| e.point);
        let outward = [0, 1].map(|i| (ends[i] - place(inner[i])).normalize_or_zero());
        PathPiece { ends, outward }
    }
}

/// Returns the trunk, followed by the other branches if a tree is asked for: tips are taken from
/// the farthest from the root on, and each branch starts where its path leaves the branches before
/// it. Arcs that close loops come last.
///
/// * `nodes`: nodes at which arcs of the component end, ascending.
pub(super) fn grow(
    view: &ArcGraph<'_>,
    trunk: BranchRoute,
    nodes: &[u32],
    options: RouteOptions,
) -> Vec<BranchRoute> {
    let root = trunk.chain.nodes[0];
    let mut routes = vec![trunk];
    if options.tree {
        let ways = view.net.ways(root, |i| view.net.centrality(i));
        // Branch that each node of the graph is on.
        let mut owner: BTreeMap<u32, usize> = BTreeMap::new();
        owner.extend(routes[0].chain.nodes.iter().map(|n| (*n, 0)));
        let lengths = view.net.ways(root, |i| view.net.length(i));
        let mut leaves = view.net.leaves();
        leaves.retain(|n| nodes.binary_search(n).is_ok() && !owner.contains_key(n));
        leaves.sort_by_key(|n| (Reverse(lengths.get(n).map_or(0, |w| w.0)), *n));
        for leaf in leaves {
            let chain = view.chain(&ways, leaf, |n| owner.contains_key(&n));
            let tip = view.tip(leaf);
            let from = chain.nodes[0];
            if !view.leads_out(from, tip) {
                continue;
            }
            let parent = owner.get(&from).copied().unwrap_or(0);
            let id = routes.len();
            own(&mut owner, &chain, id);
            let ends = [junction(view, from), tip];
            routes.push(BranchRoute {
                parent: Some(parent),
                joined: None,
                chain,
                ends,
                points: Vec::new(),
            });
        }
        close_loops(view, &mut routes, &mut owner, &ways, (nodes, options.loops));
    }
    routes
}

/// Makes a branch the owner of those nodes of its chain that have no owner.
fn own(owner: &mut BTreeMap<u32, usize>, chain: &Chain, id: usize) {
    for n in &chain.nodes {
        owner.entry(*n).or_insert(id);
    }
}

fn junction(view: &ArcGraph<'_>, node: u32) -> PathEnd {
    let voxel = view.complex.nodes[node as usize].deepest;
    PathEnd { voxel, point: view.adjacency.place_mm[node as usize], given: false }
}

/// Adds branches along the arcs that belong to no branch yet: each closes a loop, or is cut in two.
fn close_loops(
    view: &ArcGraph<'_>,
    routes: &mut Vec<BranchRoute>,
    owner: &mut BTreeMap<u32, usize>,
    ways: &Ways,
    (nodes, loops): (&[u32], Loops),
) {
    let mut left: Vec<usize> = view.net.arcs_of(nodes).collect();
    // The trunk may run along arcs that the ways from its root do not.
    let taken: BTreeSet<u32> =
        routes.iter().flat_map(|r| r.chain.contacts.iter().copied()).collect();
    let first = |i: usize| view.net.arc(i).and_then(|a| a.contacts.first());
    left.retain(|i| first(*i).is_none_or(|c| !taken.contains(c)));
    // An arc whose ends no branch has waits for one that leads there.
    while let Some(at) = left.iter().position(|i| {
        view.net.arc(*i).is_some_and(|a| a.ends().iter().any(|n| owner.contains_key(n)))
    }) {
        let i = left.remove(at);
        let Some(arc) = view.net.arc(i) else { continue };
        let mut chain = Chain { nodes: arc.nodes.clone(), contacts: arc.contacts.clone() };
        if !owner.contains_key(&chain.nodes[0]) {
            chain.reverse();
        }
        let last = chain.nodes[chain.nodes.len() - 1];
        let (from, to) = (owner[&chain.nodes[0]], owner.get(&last).copied());
        let id = routes.len();
        own(owner, &chain, id);
        let ends = [junction(view, chain.nodes[0]), junction(view, last)];
        if loops == Loops::Keep || to.is_none() {
            routes.push(BranchRoute {
                parent: Some(from),
                joined: to,
                chain,
                ends,
                points: Vec::new(),
            });
            continue;
        }
        for (half, parent) in halves(view, chain, ways).into_iter().zip([Some(from), to]) {
            let start = half.nodes[0];
            let place = |n: u32| view.adjacency.place_mm[n as usize];
            let far = half.nodes.iter().map(|n| place(*n).distance(place(start)));
            let least = (2.0 * view.d.at(place(start))).max(PruneLimits::default().twig_mm);
            if far.fold(0.0, f64::max) < least {
                continue;
            }
            let ends = [start, half.nodes[half.nodes.len() - 1]].map(|n| junction(view, n));
            routes.push(BranchRoute {
                parent,
                joined: None,
                chain: half,
                ends,
                points: Vec::new(),
            });
        }
    }
}

/// A chain cut where both ends are equally far from the root; both halves lead there.
fn halves(view: &ArcGraph<'_>, mut chain: Chain, ways: &Ways) -> [Chain; 2] {
    let cost = |n: u32| ways.get(&n).map_or(0, |w| w.0);
    let (a, b) = (cost(chain.nodes[0]), cost(chain.nodes[chain.nodes.len() - 1]));
    let each: Vec<u64> = chain.contacts.iter().map(|c| view.net.contact_centrality(*c)).collect();
    let total: u64 = each.iter().sum();
    let mut along = a;
    let before = each.iter().take_while(|c| {
        along += **c;
        2 * along <= a + b + total
    });
    let cut = before.count().min(each.len() - 1);
    let mut second = Chain {
        nodes: chain.nodes.split_off(cut + 1),
        contacts: chain.contacts.split_off(cut + 1),
    };
    chain.contacts.truncate(cut);
    second.reverse();
    [chain, second]
}

/// Length by which a ring is repeated at either end, in distances to the wall: more than the length
/// over which the ends of a curve influence it.
const RING_OVERLAP: f64 = 8.0;
/// Fewest points of a route that is smoothed as a ring.
const MIN_LAP: usize = 8;

/// Curves of branches.
pub(super) struct Branches<'a> {
    d: Sampler<'a>,
    f: Sampler<'a>,
    /// Parent, branch joined at the end, and points (local mm) of each branch.
    branches: Vec<(Option<usize>, Option<usize>, Vec<DVec3>)>,
    /// Sum of the proofs of all curves.
    pub proof: Proof,
}

impl<'a> Branches<'a> {
    /// Curves along all routes, in parallel as soon as the curves they are attached to exist.
    pub fn new(d: Sampler<'a>, f: Sampler<'a>, routes: &[BranchRoute]) -> Self {
        let mut curves: Vec<Option<(Vec<DVec3>, Proof)>> = routes.iter().map(|_| None).collect();
        let mut this = Self { d, f, branches: Vec::new(), proof: Proof::default() };
        loop {
            let ready = |i: usize| {
                let needs = [routes[i].parent, routes[i].joined.filter(|j| *j != i)];
                curves[i].is_none() && needs.iter().flatten().all(|n| curves[*n].is_some())
            };
            let made: Vec<(usize, (Vec<DVec3>, Proof))> = (0..routes.len())
                .into_par_iter()
                .filter(|i| ready(*i))
                .map(|i| {
                    let of = |n: Option<usize>| {
                        n.filter(|n| *n != i).and_then(|n| curves[n].as_ref()).map(|c| &c.0[..])
                    };
                    (i, this.curve(&routes[i], of(routes[i].parent), of(routes[i].joined)))
                })
                .collect();
            if made.is_empty() {
                break;
            }
            made.into_iter().for_each(|(i, c)| curves[i] = Some(c));
        }
        for (route, (points, proof)) in routes.iter().zip(curves.into_iter().flatten()) {
            this.proof.by_distance += proof.by_distance;
            this.proof.by_voxels += proof.by_voxels;
            this.proof.replaced += proof.replaced;
            this.branches.push((route.parent, route.joined, points));
        }
        this
    }

    /// The curve along a route between its ends, which lie on the curves that it leaves and joins.
    fn curve(
        &self,
        route: &BranchRoute,
        parent: Option<&[DVec3]>,
        joined: Option<&[DVec3]>,
    ) -> (Vec<DVec3>, Proof) {
        let [from, to] = route.ends;
        let mut points = dense(&route.points, self.d.lumen.grid.spacing_mm.min_element());
        let is_ring = route.parent.is_none() && route.joined.is_some();
        let start_fixed = self.meet(&mut points, from, (parent, is_ring));
        points.reverse();
        let end_fixed = self.meet(&mut points, to, (joined, route.joined.is_some()));
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
        (settle(&curve, [!fixed.start, !fixed.end], self.d.lumen), proof)
    }

    /// The closed curve along a route that ends where it begins: centred with a stretch of it
    /// repeated at either end, of which one lap away from both ends is kept.
    fn ring(&self, route: &[DVec3]) -> Vec<DVec3> {
        let lap = &route[..route.len() - 1];
        let overlap_mm = RING_OVERLAP * self.d.at(route[0]);
        let repeated = arc_lengths(lap).iter().take_while(|s| **s < overlap_mm).count();
        let places = (0..lap.len() + 2 * repeated + 1).map(|i| i + lap.len() - repeated);
        let unrolled: Vec<DVec3> = places.map(|i| lap[i % lap.len()]).collect();
        let mut curve = recenter(&unrolled, self.d, self.f, Fixed { start: false, end: false });

        let s = arc_lengths(&curve);
        let total = s[s.len() - 1];
        let share = repeated as f64 / unrolled.len() as f64;
        let first = s.partition_point(|s| *s < share * total).min(curve.len() - 2);
        let off = |i: &usize| curve[*i].distance_squared(curve[first]);
        let late = s.partition_point(|s| *s < (1.0 - 1.5 * share) * total).max(first + 1);
        let last = (late..curve.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
        let last = last.unwrap_or(curve.len() - 1);
        // The two laps differ by little where they overlap; the first fades into the second.
        let gap = curve[first] - curve[last];
        for i in first..=last {
            let before = (s[last] - s[i]) / overlap_mm.max(1e-9);
            curve[i] += gap * (1.0 - before).max(0.0).powi(2);
        }
        curve[last] = curve[first];
        curve.truncate(last + 1);
        curve.split_off(first)
    }

    /// Makes a route begin where it should: at the nearest point of a curve it is attached to, at a
    /// given end, at the centre of a cap. Whether that place is fixed.
    fn meet(
        &self,
        points: &mut Vec<DVec3>,
        end: PathEnd,
        (on, is_ring): (Option<&[DVec3]>, bool),
    ) -> bool {
        let near = |p: &DVec3| p.distance_squared(points[0]);
        let attached =
            on.and_then(|c| c.iter().min_by(|a, b| near(a).total_cmp(&near(b))).copied());
        if let Some(at) = attached {
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
            let off = |i: usize| points[i].distance_squared(end.point);
            let nearest = (0..points.len() - 1).min_by(|i, j| off(*i).total_cmp(&off(*j)));
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
        for (parent, _, points) in &self.branches {
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
        for (i, joined) in self.branches.iter().enumerate().filter_map(|(i, b)| Some((i, b.1?))) {
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
