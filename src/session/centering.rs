//! Route and visibility test: the centerline.

use std::collections::BTreeMap;
use std::time::Instant;

use glam::{DVec3, UVec3};
use rayon::prelude::*;

use super::{Clock, EndPoint, Fields, Session, SessionError, present};
use crate::centerline::{
    CenterlineError, ChosenEnd, Ends, GraphNode, Loops, LumenLoop, Proof, RouteOptions, Routed,
    Viewpoint, VisibilityInput, WithinWall, add_viewers, centerline, within_wall,
};
use crate::compute::Plan;
use crate::device::Device;
use crate::field::{LumenBuffers, Sampler};
use crate::geometry::{Centerline, CenterlineGraph, TreeSummary};
use crate::lumen::Lumen;
use crate::lumen::bricks::near_offset;
use crate::organ::Organ;

/// A centerline with the outcome of the visibility test.
pub struct Centered {
    /// Path or tree, LPS mm.
    pub line: Centerline,
    /// Proof that the line stays inside; `None` for the paper's path, which has none.
    pub proof: Option<Proof>,
    /// Places that viewers were chosen from: nodes of the graph, or ridge points.
    pub candidates: usize,
    /// Whether they are ridge points.
    pub on_ridge: bool,
    /// Viewers kept, added ones included.
    pub kept: usize,
    /// Viewers added for voxels no candidate saw.
    pub added: usize,
    /// Field elements of boundary voxels that no kept viewer sees, ascending.
    pub unseen: Vec<u32>,
    /// Inside voxels no legal route joins to the root.
    pub unreachable: usize,
    /// Loops of the lumen: the ended ones, then the kept ones.
    pub loops: Vec<LumenLoop>,
    /// Start and end of the path or trunk, with their rules; `None` for the paper's path.
    pub ends: Option<[ChosenEnd; 2]>,
    /// Smallest distance from the line to the wall, between its points too, mm.
    pub min_clearance_mm: f64,
    /// Points that were replaced because the curve passed the wall there.
    pub rerouted: usize,
    /// Points beyond the wall, LPS mm: ends that were given there.
    pub outside_mm: Vec<DVec3>,
    /// Places where branches of the lumen part, LPS mm; none of the paper's path.
    pub junctions: Vec<DVec3>,
    /// Length of larynx and pharynx above the start of path and tree, and of ileum or appendix beyond
    /// their end, mm.
    pub beyond_mm: [Option<f64>; 2],
}

/// Most viewpoints added for unseen voxels; what is still unseen then is listed.
const MAX_ADDED: usize = 10_000;

/// Outcome of the visibility test.
pub struct Visibility {
    /// Places that viewers were chosen from.
    candidates: usize,
    /// Viewers kept, added ones included.
    kept: usize,
    /// Viewers added.
    added: usize,
    /// Field elements of boundary voxels that nobody sees, ascending.
    unseen: Vec<u32>,
}

impl Session {
    pub(super) fn run_route(&self, clock: &mut Clock) -> Result<Routed, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        route(&lumen.lumen, &fields, self.route_options()?, clock)
    }

    /// Options of the route, with ends by name as places.
    ///
    /// # Errors
    /// [`CenterlineError::NoTip`] for a branch that the tree does not have; the errors of extracting
    /// the tree.
    pub(super) fn route_options(&self) -> Result<RouteOptions, SessionError> {
        let options = self.found_ends();
        let c = self.settings.centerline;
        let tree = match [c.from, c.to].iter().flatten().all(|e| matches!(e, EndPoint::Point(_))) {
            true => Centerline::default(),
            false => {
                let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
                let options = RouteOptions { tree: true, ..options };
                centerline(&lumen.lumen, &fields.distance, &fields.smooth, options)?.line
            }
        };
        let place = |end: EndPoint| {
            let (branch, last) = match end {
                EndPoint::Point(at) => return Ok(at),
                EndPoint::Root => (0, false),
                EndPoint::Tip(branch) => (branch, true),
            };
            let points = tree.branches.get(branch).map(|b| &b.points[..]).unwrap_or_default();
            let at = if last { points.last() } else { points.first() };
            let branches = tree.branches.len();
            at.map(|p| p.position_mm).ok_or(CenterlineError::NoTip { branch, branches })
        };
        let ends = Ends { from: c.from.map(place).transpose()?, to: c.to.map(place).transpose()? };
        Ok(RouteOptions { ends, ..options })
    }

    /// Options of a route whose ends are all found.
    fn found_ends(&self) -> RouteOptions {
        let c = self.settings.centerline;
        let lumen = present(&self.slots.lumen);
        let organ = lumen.organ.as_ref();
        let to_world = lumen.lumen.volume_grid().world_from_voxel();
        let place = |voxel: UVec3| to_world.transform_point3(voxel.as_dvec3());
        let colon = organ.filter(|found| found.organ == Organ::Colon);
        let starts_near = colon.and_then(|c| c.segments.first()).map(|s| place(s.seed));
        let trachea = organ.and_then(|found| found.root).map(place);
        let ends = Ends::default();
        RouteOptions { ends, tree: c.tree, loops: c.loops, starts_near, trachea }
    }

    /// All branches with the loops they close, whatever path or tree is asked for. Of a mode
    /// that has neither, its path.
    ///
    /// # Errors
    /// As [`Session::centerline`].
    pub fn graph(&self) -> Result<CenterlineGraph, SessionError> {
        let (centered, asked) = (self.centerline()?, self.settings.centerline);
        if !self.settings.methods().branches || (asked.tree && asked.loops == Loops::Keep) {
            return Ok(centered.line.graph());
        }
        // A run lets go of its fields; ends by name are found in them.
        let (lumen, fields) = (self.lumen()?, self.fields()?);
        let options = RouteOptions { tree: true, loops: Loops::Keep, ..self.route_options()? };
        let start = Instant::now();
        let all = self
            .pool
            .install(|| centerline(&lumen.lumen, &fields.distance, &fields.smooth, options))?;
        let branches = all.line.branches.len() as u64;
        self.triangle_tree()?;
        let line = self.pool.install(|| self.within_wall(&all.line)).line;
        self.clock().record("all branches", "cpu", start, (branches, "branches"), Vec::new());
        Ok(line.graph())
    }

    /// Branches by generation, where a tree was asked for or the organ is one: an airway or a
    /// vessel. `None` of another lumen and in a mode that has no tree.
    ///
    /// # Errors
    /// As [`Session::centerline`].
    pub fn tree(&self) -> Result<Option<TreeSummary>, SessionError> {
        let organ = self.lumen()?.organ.as_ref().map(|found| found.organ);
        if !self.settings.methods().branches {
            return Ok(None);
        }
        Ok(match organ {
            _ if self.settings.centerline.tree => Some(self.centerline()?.line.graph().tree()),
            Some(Organ::Airway | Organ::Vessel) => Some(self.graph()?.tree()),
            _ => None,
        })
    }

    pub(super) fn run_visibility(&self, clock: &mut Clock) -> Result<Visibility, SessionError> {
        let (fields, route) = (present(&self.slots.fields), present(&self.slots.route));
        let lumen = &present(&self.slots.lumen).lumen;
        let sampler = Sampler { lumen, field: &fields.distance };
        let nodes = &route.nodes;
        let of = |n: &GraphNode| (n.element as usize, fields.distance[n.element as usize]);
        let ranked = ranked(lumen, &nodes.iter().map(of).collect::<Vec<_>>());
        let viewpoint = |at: &usize| {
            let n = &nodes[*at];
            let axis = n.chord.normalize_or_zero().as_vec3();
            Viewpoint::measured(n.element as usize, axis, sampler)
        };
        let work = || ranked.par_iter().with_min_len(64).map(viewpoint).collect::<Vec<_>>();
        let viewpoints = clock.time("reach", "candidates", work, |v| v.len() as u64);
        self.visibility_from(&viewpoints, nodes.len(), clock)
    }

    /// Runs the visibility test on viewpoints, and adds some for voxels that none of them sees.
    ///
    /// * `candidates`: number of places that the viewpoints were chosen from.
    fn visibility_from(
        &self,
        viewpoints: &[Viewpoint],
        candidates: usize,
        clock: &mut Clock,
    ) -> Result<Visibility, SessionError> {
        let (lumen, device) = (present(&self.slots.lumen), present(&self.slots.device));
        let (lumen, distance) = (&lumen.lumen, &present(&self.slots.fields).distance);
        let (kept, unseen) = visible(&mut device.lock(), lumen, viewpoints, &lumen.inside, clock)?;
        let work = || add_viewers(lumen, &unseen, distance, MAX_ADDED);
        let count = unseen.len() as u64;
        let (added, unseen) = clock.time("unseen", "boundary voxels", work, |_| count);
        let (kept, added) = (kept.len() + added.len(), added.len());
        Ok(Visibility { candidates, kept, added, unseen })
    }

    pub(super) fn run_centerline(&self, _: &mut Clock) -> Result<Centered, SessionError> {
        let (route, seen) = (present(&self.slots.route), present(&self.slots.visibility));
        Ok(Centered::new(self.within_wall(&route.line), &route, &seen))
    }

    /// A line with the radius of the wall, on the lumen's side of it.
    fn within_wall(&self, line: &Centerline) -> WithinWall {
        let (lumen, tree) = (present(&self.slots.lumen), present(&self.slots.triangle_tree));
        let c = self.settings.centerline;
        within_wall(
            line,
            &lumen.lumen,
            &tree,
            [c.from, c.to].map(|end| matches!(end, Some(EndPoint::Point(_)))),
        )
    }
}

/// Centred route: needs no device and nothing of the visibility test.
///
/// # Errors
/// [`SessionError::Centerline`].
fn route(
    lumen: &Lumen,
    fields: &Fields,
    options: RouteOptions,
    clock: &mut Clock,
) -> Result<Routed, SessionError> {
    let work = || centerline(lumen, &fields.distance, &fields.smooth, options);
    Ok(clock.time("route", "voxels", work, |_| lumen.inside_voxels())?)
}

/// Most loops of which a warning gives the place, the longest; the report lists all.
const MAX_LOOPS: usize = 5;

impl Centered {
    /// Returns the notes for a reader of the centerline.
    pub(super) fn notes(&self) -> Vec<String> {
        let mut out = Vec::new();
        if self.unreachable > 0 {
            let n = self.unreachable;
            out.push(format!(
                "{n} inside voxels are joined to the rest by edges or corners only; no path goes there"
            ));
        }
        let [above, after] = self.beyond_mm;
        if let Some(mm) = above {
            out.push(format!(
                "{mm:.0} mm of the airway lie above the start of the path and are narrower than the \
                 trachea: larynx or pharynx"
            ));
        }
        if let Some(mm) = after {
            out.push(format!(
                "{mm:.0} mm beyond the end of the path are less than half as wide as the colon before \
                 it: ileum or appendix"
            ));
        }
        for (end, name) in self.ends.iter().flatten().zip(["start", "end"]) {
            if let Some([x, y, z]) = end.runner_up_mm.filter(|_| end.is_doubtful()) {
                out.push(format!(
                    "the {name} of the path may be another: ({x:.1}, {y:.1}, {z:.1}) mm is as good \
                     within {:.0} %",
                    100.0 * end.margin.unwrap_or(0.0)
                ));
            }
        }
        if !self.outside_mm.is_empty() {
            let at = self.outside_mm[0];
            out.push(format!(
                "{} points of the line lie beyond the wall, the first at ({:.1}, {:.1}, {:.1}) mm",
                self.outside_mm.len(),
                at.x,
                at.y,
                at.z
            ));
        }
        let mut doubtful: Vec<_> = self.loops.iter().filter(|l| l.is_doubtful()).collect();
        doubtful.sort_by(|a, b| b.found.cycle_mm.total_cmp(&a.found.cycle_mm));
        for l in doubtful.iter().take(MAX_LOOPS) {
            let (at, found) = (l.throat_at, &l.found);
            out.push(format!(
                "a loop of {:.0} mm was cut at ({:.1}, {:.1}, {:.1}) mm, where the lumen is {:.1} mm \
                 from wall to middle; another place of it has {:.1} mm: if that is where folds touch, \
                 and this a true narrowing, the way goes round the other side",
                found.cycle_mm, at.x, at.y, at.z, found.throat_mm, found.next_throat_mm,
            ));
        }
        if doubtful.len() > MAX_LOOPS {
            let n = doubtful.len() - MAX_LOOPS;
            out.push(format!("{n} more loops were cut at one of two places about as narrow"));
        }
        out
    }

    /// A route within its wall with the outcome of the visibility test in the same lumen.
    fn new(within: WithinWall, routed: &Routed, seen: &Visibility) -> Self {
        let mut ends = routed.ends.clone();
        let places = [within.line.branches.first(), within.line.last_of_trunk()];
        let [first, last] = places.map(|b| b.map_or(&[][..], |b| &b.points));
        for (end, at) in ends.iter_mut().zip([first.first(), last.last()]) {
            end.at_mm = at.map_or(end.at_mm, |p| p.position_mm.to_array());
        }
        Self {
            min_clearance_mm: within.clearance_mm,
            rerouted: within.rerouted,
            outside_mm: within.outside_mm,
            beyond_mm: routed.beyond_mm,
            junctions: routed.junctions.clone(),
            line: within.line,
            proof: Some(routed.proof),
            candidates: seen.candidates,
            on_ridge: false,
            kept: seen.kept,
            added: seen.added,
            unseen: seen.unseen.clone(),
            unreachable: routed.unreachable,
            loops: routed.loops.clone(),
            ends: Some(ends),
        }
    }
}

/// Candidates this share of their own distance apart see nearly the same wall.
const SPARING: f64 = 0.2;

/// Places to see from in the order they are asked, by their numbers: deepest first, since a few wide
/// views come before many narrow ones. One nearer than a fifth of its distance to one before it is
/// left out: they see the same walls.
///
/// * `places`: field element and distance, mm.
pub(super) fn ranked(lumen: &Lumen, places: &[(usize, f32)]) -> Vec<usize> {
    let mut ranked: Vec<usize> = (0..places.len()).collect();
    let key = |at: usize| (places[at].1, places[at].0);
    ranked.sort_by(|a, b| {
        let ((a_mm, a), (b_mm, b)) = (key(*a), key(*b));
        b_mm.total_cmp(&a_mm).then(a.cmp(&b))
    });
    let Some(deepest) = ranked.first() else { return ranked };
    let cell = (SPARING * f64::from(places[*deepest].1)).max(lumen.grid.spacing_mm.max_element());
    let mut taken: BTreeMap<[i32; 3], Vec<DVec3>> = BTreeMap::new();
    ranked.retain(|at| {
        let (element, distance_mm) = places[*at];
        let p = lumen.bricks.voxel(element).as_dvec3() * lumen.grid.spacing_mm;
        let at = (p / cell).floor().as_ivec3();
        let apart = SPARING * f64::from(distance_mm);
        let crowded = (0..27).any(|n| {
            let to = at + near_offset(n);
            let near = taken.get(&to.to_array());
            near.is_some_and(|all| all.iter().any(|q| q.distance(p) < apart))
        });
        if !crowded {
            taken.entry(at.to_array()).or_default().push(p);
        }
        !crowded
    });
    ranked
}

/// Runs the visibility test: ranks kept and elements unseen.
pub(super) fn visible(
    device: &mut Device,
    lumen: &Lumen,
    viewpoints: &[Viewpoint],
    open: &[u64],
    clock: &mut Clock,
) -> Result<(Vec<u32>, Vec<u32>), SessionError> {
    let start = Instant::now();
    let boundary: Vec<u32> = lumen.elements(&lumen.boundary).map(|e| e as u32).collect();
    let input = VisibilityInput::new(lumen, viewpoints, boundary);
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let pending = input.launch(&mut plan, &buffers, open);
    let out = device.run(&plan)?;
    clock.record_plan(
        "visibility",
        device.name(),
        start,
        (lumen.boundary_voxels, "boundary voxels"),
        &out,
    );
    Ok(input.read(pending, &out))
}
