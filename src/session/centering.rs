//! Route and visibility test: the centerline.

use std::collections::BTreeMap;
use std::time::Instant;

use glam::DVec3;
use rayon::prelude::*;

use super::{Clock, Fields, Session, SessionError, present};
use crate::centerline::{
    Ends, GraphNode, Loops, LumenLoop, Proof, RouteOptions, Routed, Viewpoint, VisibilityInput,
    add_viewers, centerline,
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
    /// Smallest distance from the line to an external voxel centre, mm.
    pub min_clearance_mm: f64,
}

/// Most viewpoints added for unseen voxels; what is still unseen then is listed.
const MAX_ADDED: usize = 10_000;

/// Outcome of the visibility test.
pub struct Visibility {
    /// Places that viewers were chosen from.
    candidates: usize,
    /// Whether they are ridge points.
    on_ridge: bool,
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
        route(&lumen.lumen, &fields, self.route_options(), clock)
    }

    pub(super) fn route_options(&self) -> RouteOptions {
        let c = self.settings.centerline;
        // A colon is flown from the rectum, an airway from the trachea.
        let lumen = present(&self.slots.lumen);
        let first = lumen.organ.as_ref().and_then(|organ| organ.segments.first());
        let to_world = lumen.lumen.volume_grid().world_from_voxel();
        let starts_near = first.map(|s| to_world.transform_point3(s.seed.as_dvec3()));
        let ends = Ends { from: c.from, to: c.to };
        RouteOptions { ends, tree: c.tree, loops: c.loops, starts_near }
    }

    /// All branches with the loops they close, whatever path or tree is asked for. Of a mode
    /// that has neither, its path.
    ///
    /// # Errors
    /// As [`Session::centerline`].
    pub fn graph(&self) -> Result<CenterlineGraph, SessionError> {
        let (centered, _) = (self.centerline()?, self.lumen()?);
        let options = self.route_options();
        if !self.settings.methods().branches || (options.tree && options.loops == Loops::Keep) {
            return Ok(centered.line.graph());
        }
        let options = RouteOptions { tree: true, loops: Loops::Keep, ..options };
        let (lumen, fields) = (self.lumen()?, self.fields()?);
        let start = Instant::now();
        let all = self
            .pool
            .install(|| centerline(&lumen.lumen, &fields.distance, &fields.smooth, options))?;
        let branches = all.line.branches.len() as u64;
        self.clock().record("all branches", "cpu", start, (branches, "branches"), Vec::new());
        Ok(all.line.graph())
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
        self.visibility_from(&viewpoints, (nodes.len(), false), clock)
    }

    /// Runs the visibility test on viewpoints, and adds some for voxels that none of them sees.
    ///
    /// * `candidates`: number of places that the viewpoints were chosen from.
    /// * `on_ridge`: whether those are ridge points.
    pub(super) fn visibility_from(
        &self,
        viewpoints: &[Viewpoint],
        (candidates, on_ridge): (usize, bool),
        clock: &mut Clock,
    ) -> Result<Visibility, SessionError> {
        let (lumen, device) = (present(&self.slots.lumen), present(&self.slots.device));
        let (lumen, distance) = (&lumen.lumen, &present(&self.slots.fields).distance);
        let (kept, unseen) = visible(&mut device.lock(), lumen, viewpoints, &lumen.inside, clock)?;
        let work = || add_viewers(lumen, &unseen, distance, MAX_ADDED);
        let count = unseen.len() as u64;
        let (added, unseen) = clock.time("unseen", "boundary voxels", work, |_| count);
        let (kept, added) = (kept.len() + added.len(), added.len());
        Ok(Visibility { candidates, on_ridge, kept, added, unseen })
    }

    pub(super) fn run_centerline(&self, _: &mut Clock) -> Result<Centered, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        let (route, seen) = (present(&self.slots.route), present(&self.slots.visibility));
        Ok(Centered::new(&lumen.lumen, &fields, &route, &seen))
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

    /// A route with the outcome of the visibility test in the same lumen.
    fn new(lumen: &Lumen, fields: &Fields, routed: &Routed, seen: &Visibility) -> Self {
        Self {
            min_clearance_mm: clearance(&routed.line, lumen, &fields.distance),
            line: routed.line.clone(),
            proof: Some(routed.proof),
            candidates: seen.candidates,
            on_ridge: seen.on_ridge,
            kept: seen.kept,
            added: seen.added,
            unseen: seen.unseen.clone(),
            unreachable: routed.unreachable,
            loops: routed.loops.clone(),
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

pub(super) fn clearance(line: &Centerline, lumen: &Lumen, distance: &[f32]) -> f64 {
    let d = Sampler { lumen, field: distance };
    let local = lumen.grid.voxel_from_world();
    line.branches
        .iter()
        .flat_map(|b| &b.points)
        .map(|p| d.at(local.transform_point3(p.position_mm) * lumen.grid.spacing_mm))
        .fold(f64::INFINITY, f64::min)
}
