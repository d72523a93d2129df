//! Ends of a path or tree that are not given: each by a rule, with its margin and the runner-up.

use std::cmp::Reverse;
use std::collections::{BTreeMap, BinaryHeap};

use glam::DVec3;
use serde::Serialize;

use super::arc_graph::{ArcGraph, NodeEnd};
use super::complex::net::Net;
use crate::lumen::Lumen;
use crate::organ::ColonEnds;

/// Rule by which an end was chosen.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "snake_case")]
#[non_exhaustive]
pub enum EndRule {
    /// Someone gave the end.
    Given,
    /// The upper end of the trachea that the organ search found.
    Trachea,
    /// The free end of the thickest stem: the tip from which the thickest place of the tree is
    /// reached without passing a thin one.
    ThickestStem,
    /// The end of a long tube without branches that lies farther to feet and back.
    Rectum,
    /// The end nearer to the first piece of the organ.
    FirstPiece,
    /// The wider end of a tube.
    WiderEnd,
    /// End nearest to the head, of ends about as good.
    NearestToHead,
    /// The tip farthest from the start.
    FarthestTip,
    /// A place on a ring, which has no end.
    Ring,
}

impl EndRule {
    /// Describes the rule for a reader.
    pub fn words(self) -> &'static str {
        match self {
            Self::Given => "given",
            Self::Trachea => "upper end of the trachea",
            Self::ThickestStem => "free end of the thickest stem",
            Self::Rectum => "rectum: the end nearer to feet and back",
            Self::FirstPiece => "nearer to the first piece",
            Self::WiderEnd => "the wider end",
            Self::NearestToHead => "nearest to the head of ends about as good",
            Self::FarthestTip => "tip farthest from the start",
            Self::Ring => "a place on a ring",
        }
    }
}

/// An end with the reason why it is one.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ChosenEnd {
    /// Rule that chose the end.
    pub rule: EndRule,
    /// Position of the end, LPS mm.
    pub at_mm: [f64; 3],
    /// Measure of this end over the measure of the runner-up, less 1. Absent without a runner-up.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub margin: Option<f64>,
    /// Position of the next best end, LPS mm.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub runner_up_mm: Option<[f64; 3]>,
}

impl ChosenEnd {
    /// Margin below which an end is in doubt.
    pub const DOUBT: f64 = 0.1;

    /// Whether another end may be meant. Many tips are about as far as the farthest.
    pub fn is_doubtful(&self) -> bool {
        let is_chosen = !matches!(self.rule, EndRule::Given | EndRule::FarthestTip);
        is_chosen && self.margin.is_some_and(|m| m < Self::DOUBT)
    }
}

/// An end among the tips of a graph, before its place in the patient is known.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct TipChoice {
    pub node: u32,
    pub rule: EndRule,
    pub margin: Option<f64>,
    pub runner_up: Option<u32>,
}

/// The reason why an end is one.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EndChoice {
    pub rule: EndRule,
    pub margin: Option<f64>,
    /// Place of the next best end, LPS mm.
    pub runner_up_mm: Option<DVec3>,
}

impl EndChoice {
    pub fn by(rule: EndRule) -> Self {
        Self { rule, margin: None, runner_up_mm: None }
    }

    /// The reason with the place that the end has, local mm.
    pub fn described(&self, lumen: &Lumen, at: Option<DVec3>) -> ChosenEnd {
        let grid = &lumen.grid;
        let at = at.unwrap_or_default() / grid.spacing_mm;
        let rounded = |p: DVec3| p.to_array().map(|v| (v * 1e3).round() / 1e3);
        ChosenEnd {
            rule: self.rule,
            at_mm: rounded(grid.world_from_voxel().transform_point3(at)),
            margin: self.margin.map(|m| (m * 1e3).round() / 1e3),
            runner_up_mm: self.runner_up_mm.map(rounded),
        }
    }
}

impl TipChoice {
    fn only(node: u32, rule: EndRule) -> Self {
        Self { node, rule, margin: None, runner_up: None }
    }
}

/// Share of the best measure within which ends are about as good: then the place in the patient
/// decides.
const ABOUT: f64 = 0.05;
/// Share of the greatest length from the root within which tips are about as far.
const ABOUT_LENGTH: f64 = 0.01;
/// Length of a stem, in its radii, from which it counts in full.
const STEM_LENGTH: f64 = 2.0;
/// Least share of a graph's length that lies on its longest path, of a long tube without branches.
const TUBE_SHARE: f64 = 0.7;

/// Greatest length of a sac, in its radii, and its radius over that of its neck.
const SAC_LENGTH: f64 = 5.0;
const SAC_WIDER: f64 = 1.5;
/// Radius, as a share of the trachea's, below which the lumen above it is no trachea, and length of
/// such a stretch, in radii of the trachea, from which it is left out: a rounded end is shorter.
const NARROWER: f64 = 0.6;
const LONGER: f64 = 1.5;
/// Least radius of a trachea that is known by its shape, mm; its length, in its radii; its distance from end to end over
/// its length; and the cosine of its angle to the patient's axis.
const TRACHEA_MM: f64 = 3.5;
const TRACHEA_LENGTH: f64 = 4.0;
const TRACHEA_STRAIGHT: f64 = 0.85;
const TRACHEA_UPRIGHT: f64 = 0.7;

/// Lumen beyond the caecum is as narrow as this share of the colon before it, over a length of this
/// range, mm, and of so many radii of the colon: an appendix has 50 to 100 mm, a pointed end less. The
/// colon's radius is the median over this length, mm.
const CAECUM_NARROWER: f64 = 0.5;
const BEYOND_CAECUM_MM: std::ops::RangeInclusive<f64> = 40.0..=250.0;
const CAECUM_LONGER: f64 = 2.0;
const CAECUM_BEFORE_MM: f64 = 100.0;

/// A stretch of the lumen beyond an end of path and tree: larynx and pharynx beyond the start, ileum or
/// appendix beyond the end.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Beyond {
    /// Node at which path and tree end instead.
    pub at: u32,
    /// Tip of the stretch.
    pub tip: u32,
    pub length_mm: f64,
    /// Whether it lies beyond the end, else beyond the start.
    pub is_after_end: bool,
}

/// Thickness of an arc.
#[derive(Clone, Copy, Debug, Default)]
struct Thickness {
    /// Median distance to the wall outside the balls of the junctions at its ends, mm.
    radius_mm: f64,
    /// Length of the arc outside those balls, mm.
    outside_mm: f64,
}

/// The tips of a part of a net as candidates for its ends.
pub(super) struct EndCandidates<'a, 'b> {
    view: ArcGraph<'b>,
    leaves: &'a [u32],
    nodes: &'a [u32],
}

impl<'a, 'b> EndCandidates<'a, 'b> {
    /// * `leaves`: tips; `nodes`: all nodes at which arcs of the part end, ascending.
    pub fn new(view: ArcGraph<'b>, leaves: &'a [u32], nodes: &'a [u32]) -> Self {
        Self { view, leaves, nodes }
    }

    fn net(&self) -> &Net<'_> {
        self.view.net
    }

    /// Place in the patient, LPS mm.
    fn world(&self, node: u32) -> DVec3 {
        self.view.world(node)
    }

    /// Start and end of a path.
    ///
    /// * `root_mm`: upper end of a trachea that the organ search found, local mm.
    pub fn choose(&self, root_mm: Option<DVec3>) -> (TipChoice, TipChoice) {
        let root = match root_mm {
            Some(at) => self.nearest_to(at),
            None => match self.ends_of_tube() {
                Some(ends) => return ends,
                None => self.thickest_stem(),
            },
        };
        (root, self.farthest_from(root.node))
    }

    /// The tip nearest to a place.
    fn nearest_to(&self, at: DVec3) -> TipChoice {
        let off = |n: &u32| self.view.tip(*n).point.distance(at);
        let by = |a: &u32, b: &u32| off(a).total_cmp(&off(b)).then(a.cmp(b));
        let node = self.leaves.iter().copied().min_by(by).unwrap_or(self.leaves[0]);
        TipChoice::only(node, EndRule::Trachea)
    }

    /// Length from a node to each other.
    fn lengths(&self, from: u32) -> BTreeMap<u32, u64> {
        let ways = self.net().ways(from, |i| self.net().length(i));
        ways.into_iter().map(|(node, way)| (node, way.0)).collect()
    }

    /// The tip farthest from a node along the graph; of tips about as far the one nearest to the
    /// feet.
    pub fn farthest_from(&self, root: u32) -> TipChoice {
        let lengths = self.lengths(root);
        let of = |n: u32| lengths.get(&n).copied().unwrap_or(0) as f64;
        let others: Vec<u32> = self.leaves.iter().copied().filter(|n| *n != root).collect();
        let others = if others.is_empty() { self.nodes.to_vec() } else { others };
        self.best_of(&others, of, EndRule::FarthestTip, ABOUT_LENGTH, |p| -p.z)
    }

    /// The node of the greatest measure; of several within `about` of it the one with the highest
    /// `place`.
    fn best_of(
        &self,
        all: &[u32],
        measure: impl Fn(u32) -> f64,
        rule: EndRule,
        about: f64,
        place: impl Fn(DVec3) -> f64,
    ) -> TipChoice {
        let mut order: Vec<(f64, u32)> = all.iter().map(|n| (measure(*n), *n)).collect();
        order.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
        let most = order[0].0;
        let near = order.iter().take_while(|(m, _)| *m >= (1.0 - about) * most);
        let by = |a: &&(f64, u32), b: &&(f64, u32)| {
            let [p, q] = [a.1, b.1].map(|n| place(self.world(n)));
            p.total_cmp(&q).then(b.1.cmp(&a.1))
        };
        let (best, node) = near.max_by(by).copied().unwrap_or(order[0]);
        let second = order.iter().find(|(_, n)| *n != node);
        let margin = second.filter(|s| s.0 > 0.0).map(|s| best / s.0 - 1.0);
        let is_tie = margin.is_some_and(|m| m < about);
        let rule = match rule {
            EndRule::ThickestStem | EndRule::WiderEnd if is_tie => EndRule::NearestToHead,
            rule => rule,
        };
        TipChoice { node, rule, margin: margin.map(|m| m.max(0.0)), runner_up: second.map(|s| s.1) }
    }

    /// Both ends of a long tube without branches, a colon: the rectum first.
    fn ends_of_tube(&self) -> Option<(TipChoice, TipChoice)> {
        let a = self.farthest_from(self.leaves[0]).node;
        let end = self.farthest_from(a);
        let unit_mm = self.view.adjacency.unit_mm;
        let path_mm = *self.lengths(a).get(&end.node)? as f64 * unit_mm;
        let all: u64 = self.net().arcs_of(self.nodes).map(|i| self.net().length(i)).sum();
        let is_tube = path_mm >= TUBE_SHARE * all as f64 * unit_mm;
        let [p, q] = [a, end.node].map(|n| self.world(n));
        let ends = ColonEnds::of(p, q, path_mm).filter(|_| is_tube)?;
        let (start, last) = if ends.starts_at_rectum { (a, end.node) } else { (end.node, a) };
        let margin = Some(if ends.is_sure { 1.0 } else { 0.0 });
        let rectum =
            TipChoice { node: start, rule: EndRule::Rectum, margin, runner_up: Some(last) };
        Some((rectum, TipChoice::only(last, EndRule::FarthestTip)))
    }

    fn thickness(&self, i: usize) -> Thickness {
        let Some(arc) = self.net().arc(i) else { return Thickness::default() };
        let place = |n: u32| self.view.adjacency.place_mm[n as usize];
        let junctions: Vec<u32> =
            arc.ends().into_iter().filter(|n| self.net().degree(*n) > 1).collect();
        let is_outside = |n: &u32| {
            junctions.iter().all(|j| place(*n).distance(place(*j)) >= self.net().node_mm(*j))
        };
        let mut outside: Vec<f64> =
            arc.nodes.iter().filter(|n| is_outside(n)).map(|n| self.net().node_mm(*n)).collect();
        if outside.is_empty() {
            // A pocket: as thick as its tip.
            let least = arc.nodes.iter().map(|n| self.net().node_mm(*n)).fold(f64::MAX, f64::min);
            return Thickness { radius_mm: least, outside_mm: 0.0 };
        }
        outside.sort_by(f64::total_cmp);
        let share = outside.len() as f64 / arc.nodes.len() as f64;
        let length_mm = self.net().length(i) as f64 * self.view.adjacency.unit_mm;
        Thickness { radius_mm: outside[outside.len() / 2], outside_mm: share * length_mm }
    }

    /// The thickest arc that is long enough for a stem, and the thickness of every arc.
    fn trunk(&self) -> Option<(usize, BTreeMap<usize, Thickness>)> {
        let arcs = self.net().arcs_of(self.nodes);
        let thickness: BTreeMap<usize, Thickness> = arcs.map(|i| (i, self.thickness(i))).collect();
        let weight = |i: &usize| {
            let t = thickness[i];
            t.radius_mm * (t.outside_mm / (STEM_LENGTH * t.radius_mm)).min(1.0)
        };
        let by = |a: &usize, b: &usize| weight(a).total_cmp(&weight(b)).then(b.cmp(a));
        let trunk = thickness.keys().copied().max_by(by)?;
        Some((trunk, thickness))
    }

    /// Returns the stretch above a trachea, larynx and pharynx, or beyond a caecum, ileum or appendix.
    pub fn beyond_organ(&self, root_mm: Option<DVec3>) -> Option<Beyond> {
        let (start, end) = self.choose(root_mm);
        let nodes = self.view.way(start.node, end.node).nodes;
        match start.rule {
            EndRule::Rectum => self.beyond_caecum(&nodes),
            _ => self.beyond_trachea(&nodes, start, root_mm),
        }
    }

    /// Distance of each node of a way from its first, mm. Stairs of voxels are longer than what they
    /// run along, so the way is measured by chords.
    fn chord_lengths(&self, nodes: &[u32]) -> Vec<f64> {
        let place = |n: u32| self.view.adjacency.place_mm[n as usize];
        let stride = self.view.complex.stride();
        let mut corner = (0.0, nodes.first().map_or(DVec3::ZERO, |n| place(*n)));
        let mut lengths = Vec::with_capacity(nodes.len());
        for (i, n) in nodes.iter().enumerate() {
            let length = corner.0 + corner.1.distance(place(*n));
            if i % stride == 0 {
                corner = (length, place(*n));
            }
            lengths.push(length);
        }
        lengths
    }

    /// The longest narrow stretch at the end of a way through a colon.
    fn beyond_caecum(&self, nodes: &[u32]) -> Option<Beyond> {
        let at_mm = self.chord_lengths(nodes);
        let all_mm = *at_mm.last()?;
        let width = |i: usize| self.net().node_mm(nodes[i]);
        let mut widest = 0.0f64;
        let mut found = None;
        for i in (0..nodes.len()).rev() {
            let beyond_mm = all_mm - at_mm[i];
            if beyond_mm > *BEYOND_CAECUM_MM.end() || at_mm[i] < ColonEnds::MIN_LENGTH_MM {
                break;
            }
            widest = widest.max(width(i));
            let from = at_mm.partition_point(|s| *s < at_mm[i] - CAECUM_BEFORE_MM);
            let mut before: Vec<f64> = (from..=i).map(width).collect();
            before.sort_by(f64::total_cmp);
            let colon_mm = before[before.len() / 2];
            let is_long = beyond_mm >= BEYOND_CAECUM_MM.start().max(CAECUM_LONGER * colon_mm);
            if is_long && widest <= CAECUM_NARROWER * colon_mm {
                found = Some((nodes[i], beyond_mm));
            }
        }
        let (at, length_mm) = found?;
        Some(Beyond { at, tip: *nodes.last()?, length_mm, is_after_end: true })
    }

    fn beyond_trachea(
        &self,
        nodes: &[u32],
        start: TipChoice,
        root_mm: Option<DVec3>,
    ) -> Option<Beyond> {
        let place = |n: u32| self.view.adjacency.place_mm[n as usize];
        let (at, least_mm) = match (start.rule, root_mm) {
            (EndRule::Trachea, Some(root)) => {
                let off = |i: &usize| place(nodes[*i]).distance_squared(root);
                let nearest = (0..nodes.len()).min_by(|a, b| off(a).total_cmp(&off(b)))?;
                (nearest, (1.0 + LONGER) * self.net().node_mm(nodes[nearest]))
            }
            (EndRule::ThickestStem | EndRule::NearestToHead, _) => {
                let (trunk, thickness) = self.trunk()?;
                let radius_mm = self.trachea_radius_mm(trunk, thickness[&trunk], start.node)?;
                let is_wide = |n: &u32| self.net().node_mm(*n) >= NARROWER * radius_mm;
                (nodes.iter().position(is_wide)?, LONGER * radius_mm)
            }
            _ => return None,
        };
        let length_mm = *self.chord_lengths(&nodes[..=at]).last()?;
        let beyond = Beyond { at: nodes[at], tip: start.node, length_mm, is_after_end: false };
        (length_mm > least_mm).then_some(beyond)
    }

    /// Radius of an arc that has the shape of a trachea: long, straight, upright, with the tip at
    /// its upper end.
    fn trachea_radius_mm(&self, arc: usize, thickness: Thickness, tip: u32) -> Option<f64> {
        let ends = self.net().arc(arc)?.ends().map(|n| self.world(n));
        let length_mm = self.net().length(arc) as f64 * self.view.adjacency.unit_mm;
        let chord = ends[0] - ends[1];
        let is_straight = chord.length() >= TRACHEA_STRAIGHT * length_mm;
        let is_upright = chord.z.abs() >= TRACHEA_UPRIGHT * chord.length();
        let is_long =
            thickness.radius_mm >= TRACHEA_MM && length_mm >= TRACHEA_LENGTH * thickness.radius_mm;
        let is_above = self.world(tip).z > 0.5 * (ends[0].z + ends[1].z);
        (is_straight && is_upright && is_long && is_above).then_some(thickness.radius_mm)
    }

    /// The tip from which the thickest arc is reached over arcs that are all as thick as possible.
    fn thickest_stem(&self) -> TipChoice {
        let Some((trunk, thickness)) = self.trunk() else {
            return TipChoice::only(self.leaves[0], EndRule::ThickestStem);
        };
        let trunk_ends = self.net().arc(trunk).map_or([0; 2], |a| a.ends());
        if trunk_ends.iter().all(|n| self.leaves.contains(n)) {
            return self.wider_end(trunk, trunk_ends);
        }
        // Greatest thickness of a way from the trunk: widest paths by a search from its ends.
        let most = thickness[&trunk].radius_mm;
        let mut widest: BTreeMap<u32, f64> = BTreeMap::new();
        let mut open: BinaryHeap<(u64, Reverse<u32>)> =
            trunk_ends.iter().map(|n| (most.to_bits(), Reverse(*n))).collect();
        while let Some((bits, Reverse(node))) = open.pop() {
            let here = f64::from_bits(bits);
            if widest.contains_key(&node) {
                continue;
            }
            widest.insert(node, here);
            for i in self.net().arcs_of(&[node]) {
                let Some(arc) = self.net().arc(i) else { continue };
                let way = here.min(thickness[&i].radius_mm);
                open.push((way.to_bits(), Reverse(arc.other_end(node))));
            }
        }
        let measure = |n: u32| widest.get(&n).copied().unwrap_or(0.0);
        let stems: Vec<u32> = self.leaves.iter().copied().filter(|n| !self.is_sac(*n)).collect();
        let stems = if stems.is_empty() { self.leaves } else { &stems };
        self.best_of(stems, measure, EndRule::ThickestStem, ABOUT, |p| p.z)
    }

    /// Whether a tip is that of a sac, an aneurysm: short, and wider than its neck.
    fn is_sac(&self, leaf: u32) -> bool {
        let Some(i) = self.net().arcs_of(&[leaf]).next() else { return false };
        let Some(arc) = self.net().arc(i) else { return false };
        let width = |n: &u32| self.net().node_mm(*n);
        let widest = arc.nodes.iter().map(width).fold(0.0, f64::max);
        let junction = width(&arc.other_end(leaf));
        let length_mm = self.net().length(i) as f64 * self.view.adjacency.unit_mm;
        let neck = {
            let deepest = arc.nodes.iter().position(|n| width(n) == widest).unwrap_or(0);
            let towards = match arc.nodes[0] == leaf {
                true => &arc.nodes[deepest..],
                false => &arc.nodes[..=deepest],
            };
            towards.iter().map(width).fold(junction, f64::min)
        };
        length_mm < SAC_LENGTH * widest && widest > SAC_WIDER * neck
    }

    /// The end of a tube whose outer third is wider.
    fn wider_end(&self, trunk: usize, ends: [u32; 2]) -> TipChoice {
        let nodes = self.net().arc(trunk).map_or(&[][..], |a| &a.nodes);
        let third = (nodes.len() / 3).max(1);
        let mean = |nodes: &[u32]| {
            nodes.iter().map(|n| self.net().node_mm(*n)).sum::<f64>() / nodes.len().max(1) as f64
        };
        let (first, last) = (mean(&nodes[..third]), mean(&nodes[nodes.len() - third..]));
        let measure = |n: u32| if n == ends[0] { first } else { last };
        self.best_of(&ends, measure, EndRule::WiderEnd, ABOUT, |p| p.z)
    }

    /// The start of a path to a given end: the root, unless the end lies there.
    pub fn start_of_path_to(&self, end: NodeEnd, root_mm: Option<DVec3>) -> TipChoice {
        if self.leaves.is_empty() {
            return self.farthest_from(end.1);
        }
        let (root, _) = self.choose(root_mm);
        let apart = self.view.tip(root.node).point.distance(end.0.point);
        let is_there = root.node == end.1 || apart < 2.0 * self.view.d.at(end.0.point);
        if is_there { self.farthest_from(end.1) } else { root }
    }

    /// The reason of a choice.
    pub fn reason(&self, choice: &TipChoice) -> EndChoice {
        EndChoice {
            rule: choice.rule,
            margin: choice.margin,
            runner_up_mm: choice.runner_up.map(|n| self.world(n)),
        }
    }
}
