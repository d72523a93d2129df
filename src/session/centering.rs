//! Route and visibility test: the centerline, in both modes.

use std::collections::BTreeMap;
use std::time::Instant;

use glam::{DVec3, Vec3};

use super::{Clock, Fields, Mode, Session, SessionError, present};
use crate::centerline::{
    Ends, GraphNode, Loops, LumenLoop, Proof, Radius, RouteOptions, Routed, Viewpoint,
    VisibilityInput, add_viewers, centerline, paper_path,
};
use crate::compute::Plan;
use crate::device::Device;
use crate::field::{Candidate, LumenBuffers, Sampler};
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
    /// Places that viewers were chosen from: nodes of the graph, in paper mode ridge candidates.
    pub candidates: usize,
    /// Whether they are ridge candidates.
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

    fn route_options(&self) -> RouteOptions {
        let c = self.settings.centerline;
        // A colon is flown from the rectum, an airway from the trachea.
        let lumen = present(&self.slots.lumen);
        let first = lumen.organ.as_ref().and_then(|organ| organ.segments.first());
        let to_world = lumen.lumen.grid.world_from_voxel();
        let starts_near = first.map(|s| to_world.transform_point3(s.seed.as_dvec3()));
        let ends = Ends { from: c.from, to: c.to };
        RouteOptions { ends, tree: c.tree, loops: c.loops, starts_near }
    }

    /// All branches with the loops they close, whatever path or tree is asked for. Of the paper's
    /// mode, which has neither, its path.
    ///
    /// # Errors
    /// As [`Session::centerline`].
    pub fn graph(&self) -> Result<CenterlineGraph, SessionError> {
        let (centered, _) = (self.centerline()?, self.lumen()?);
        let options = self.route_options();
        if self.settings.mode == Mode::Paper || (options.tree && options.loops == Loops::Keep) {
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
    /// vessel. `None` of another lumen and in the paper's mode, which has no tree.
    ///
    /// # Errors
    /// As [`Session::centerline`].
    pub fn tree(&self) -> Result<Option<TreeSummary>, SessionError> {
        let organ = self.lumen()?.organ.as_ref().map(|found| found.organ);
        if self.settings.mode == Mode::Paper {
            return Ok(None);
        }
        Ok(match organ {
            _ if self.settings.centerline.tree => Some(self.centerline()?.line.graph().tree()),
            Some(Organ::Airway | Organ::Vessel) => Some(self.graph()?.tree()),
            _ => None,
        })
    }

    pub(super) fn run_visibility(&self, clock: &mut Clock) -> Result<Visibility, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        let (route, device) = (present(&self.slots.route), present(&self.slots.device));
        let radius = self.settings.radius();
        // Eq. 5 needs the eigenvalues at ridge candidates.
        let candidates = match radius {
            Radius::Paper => fields.candidates.clone(),
            Radius::Measured => on_graph(&fields.distance, &route.nodes),
        };
        let of = (&fields.distance[..], &candidates[..]);
        let device = &mut device.lock();
        visibility(device, &lumen.lumen, of, radius, clock)
    }

    pub(super) fn run_centerline(&self, _: &mut Clock) -> Result<Centered, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        let (route, seen) = (present(&self.slots.route), present(&self.slots.visibility));
        let mut centered = Centered::new(&lumen.lumen, &fields, &route, &seen);
        centered.on_ridge = self.settings.radius() == Radius::Paper;
        Ok(centered)
    }

    pub(super) fn run_paper_centerline(&self, clock: &mut Clock) -> Result<Centered, SessionError> {
        let (lumen, fields) = (present(&self.slots.lumen), present(&self.slots.fields));
        let device = present(&self.slots.device);
        let radius = self.settings.radius();
        let how = (radius, self.route_options());
        let device = &mut device.lock();
        paper_centered(device, &lumen.lumen, &fields, how, clock)
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

/// Nodes of the graph as candidates.
fn on_graph(distance: &[f32], nodes: &[GraphNode]) -> Vec<Candidate> {
    let candidate = |n: &GraphNode| Candidate {
        element: n.element as usize,
        offset_mm: Vec3::ZERO,
        distance_mm: distance[n.element as usize],
        axis: n.chord.normalize_or_zero().as_vec3(),
        gradient: 0.0,
        across: [0.0; 2],
    };
    nodes.iter().map(candidate).collect()
}

/// Visibility test: viewpoints from candidates, those kept, those added.
///
/// # Errors
/// The device's.
fn visibility(
    device: &mut Device,
    lumen: &Lumen,
    (distance, candidates): (&[f32], &[Candidate]),
    radius: Radius,
    clock: &mut Clock,
) -> Result<Visibility, SessionError> {
    let sampler = Sampler { lumen, field: distance };
    let ranked = ranked(lumen, candidates);
    let count = |v: &Vec<Viewpoint>| v.len() as u64;
    let viewpoints =
        clock.time("reach", "candidates", || radius.viewpoints(&ranked, sampler), count);
    let (kept, unseen) = visible(device, lumen, &viewpoints, &lumen.inside, clock)?;
    let (added, unseen) = clock.time(
        "unseen",
        "boundary voxels",
        || add_viewers(lumen, &unseen, distance, MAX_ADDED),
        |_| unseen.len() as u64,
    );
    let candidates = candidates.len();
    Ok(Visibility { candidates, kept: kept.len() + added.len(), added: added.len(), unseen })
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
            on_ridge: false,
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

/// Candidates in the order they are asked: deepest first, since a few wide views come before many
/// narrow ones. A candidate nearer than a fifth of its distance to one before it is left out: they
/// see the same walls.
fn ranked(lumen: &Lumen, candidates: &[Candidate]) -> Vec<Candidate> {
    let mut ranked = candidates.to_vec();
    ranked.sort_by(|a, b| b.distance_mm.total_cmp(&a.distance_mm).then(a.element.cmp(&b.element)));
    let Some(deepest) = ranked.first() else { return ranked };
    let cell = (SPARING * f64::from(deepest.distance_mm)).max(lumen.grid.spacing_mm.max_element());
    let mut taken: BTreeMap<[i32; 3], Vec<DVec3>> = BTreeMap::new();
    ranked.retain(|c| {
        let p = lumen.bricks.voxel(c.element).as_dvec3() * lumen.grid.spacing_mm;
        let at = (p / cell).floor().as_ivec3();
        let apart = SPARING * f64::from(c.distance_mm);
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

/// The paper's chain: candidates without the gate in index order, radius by Eq. 5, boundary voxels
/// block, kept points joined by Dijkstra.
///
/// # Errors
/// [`SessionError::Centerline`] and the device's.
fn paper_centered(
    device: &mut Device,
    lumen: &Lumen,
    fields: &Fields,
    (radius, options): (Radius, RouteOptions),
    clock: &mut Clock,
) -> Result<Centered, SessionError> {
    let distance = Sampler { lumen, field: &fields.distance };
    let viewpoints = radius.viewpoints(&fields.candidates, distance);
    let internal: Vec<u64> =
        lumen.inside.iter().zip(&lumen.boundary).map(|(i, b)| i & !b).collect();
    let (kept, unseen) = visible(device, lumen, &viewpoints, &internal, clock)?;
    let kept: Vec<Viewpoint> = kept.iter().map(|r| viewpoints[*r as usize]).collect();
    let line = clock.time(
        "paper path",
        "kept points",
        || paper_path(lumen, &kept, &fields.distance, options),
        |_| kept.len() as u64,
    )?;
    Ok(Centered {
        min_clearance_mm: clearance(&line, lumen, &fields.distance),
        line,
        proof: None,
        candidates: viewpoints.len(),
        on_ridge: true,
        kept: kept.len(),
        added: 0,
        unseen,
        unreachable: 0,
        loops: Vec::new(),
    })
}

/// Runs the visibility test: ranks kept and elements unseen.
fn visible(
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

fn clearance(line: &Centerline, lumen: &Lumen, distance: &[f32]) -> f64 {
    let d = Sampler { lumen, field: distance };
    let local = lumen.grid.voxel_from_world();
    line.branches
        .iter()
        .flat_map(|b| &b.points)
        .map(|p| d.at(local.transform_point3(p.position_mm) * lumen.grid.spacing_mm))
        .fold(f64::INFINITY, f64::min)
}
