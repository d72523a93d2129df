//! Candidates, visibility and route, in both modes.

use std::collections::BTreeMap;
use std::time::Instant;

use glam::{DVec3, IVec3};

use super::{Clock, Fields, PipelineError};
use crate::centerline::{
    Arrangement, Proof, Radius, RouteOptions, Routed, Sampler, Viewer, add_viewers, centerline,
    paper_path,
};
use crate::compute::Plan;
use crate::device::Device;
use crate::field::{Candidate, LumenBuffers};
use crate::geometry::Centerline;
use crate::lumen::Lumen;

/// What the chain follows.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Mode {
    /// What is right.
    #[default]
    Default,
    /// What the paper says, errors and all.
    Paper,
}

/// How to find the centerline.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Settings {
    /// Ends and tree.
    pub route: RouteOptions,
    /// Reach of the viewers.
    pub radius: Radius,
}

/// A centerline with the outcome of the visibility test.
pub struct Centered {
    /// Path or tree, LPS mm.
    pub line: Centerline,
    /// How it was proven inside; `None` for the paper's path, which has no proof.
    pub proof: Option<Proof>,
    /// Ridge candidates.
    pub candidates: usize,
    /// Viewers kept, added ones included.
    pub kept: usize,
    /// Viewers added for voxels no candidate saw.
    pub added: usize,
    /// Field elements of boundary voxels that no kept viewer sees, ascending.
    pub unseen: Vec<u32>,
    /// Inside voxels no legal route joins to the root.
    pub unreachable: usize,
    /// Smallest distance from the line to an external voxel centre, mm.
    pub min_clearance_mm: f64,
}

/// Most viewers added for unseen voxels; what is still unseen then is listed.
const MOST_ADDED: usize = 10_000;

/// What the visibility test found.
pub struct Seen {
    /// Viewers kept, added ones included.
    kept: usize,
    /// Viewers added.
    added: usize,
    /// Field elements of boundary voxels that nobody sees, ascending.
    unseen: Vec<u32>,
}

/// Centred route and visibility test, one after the other.
///
/// # Errors
/// [`PipelineError::Centerline`] and the device's.
pub fn centered(
    device: &mut Device,
    lumen: &Lumen,
    fields: &Fields,
    settings: Settings,
    clock: &mut Clock,
) -> Result<Centered, PipelineError> {
    let routed = route(lumen, fields, settings.route, clock)?;
    let seen = seen(device, lumen, fields, settings.radius, clock)?;
    Ok(Centered::new(lumen, fields, routed, seen))
}

/// Centred route: needs no device and nothing of the visibility test.
///
/// # Errors
/// [`PipelineError::Centerline`].
pub fn route(
    lumen: &Lumen,
    fields: &Fields,
    options: RouteOptions,
    clock: &mut Clock,
) -> Result<Routed, PipelineError> {
    let work = || centerline(lumen, &fields.distance, &fields.smooth, options);
    Ok(clock.time("route", "voxels", work, |_| lumen.inside_voxels())?)
}

/// Visibility test: viewers from candidates, those kept, those added.
///
/// # Errors
/// The device's.
pub fn seen(
    device: &mut Device,
    lumen: &Lumen,
    fields: &Fields,
    radius: Radius,
    clock: &mut Clock,
) -> Result<Seen, PipelineError> {
    let distance = Sampler { lumen, field: &fields.distance };
    let ranked = ranked(lumen, &fields.candidates);
    let viewers =
        clock.time("reach", "candidates", || radius.viewers(&ranked, distance), |v| v.len() as u64);
    let (kept, unseen) = visible(device, lumen, &viewers, &lumen.inside, clock)?;
    let (added, unseen) = clock.time(
        "unseen",
        "boundary voxels",
        || add_viewers(lumen, &unseen, &fields.distance, MOST_ADDED),
        |_| unseen.len() as u64,
    );
    Ok(Seen { kept: kept.len() + added.len(), added: added.len(), unseen })
}

impl Centered {
    /// A route with the outcome of the visibility test in the same lumen.
    pub fn new(lumen: &Lumen, fields: &Fields, routed: Routed, seen: Seen) -> Self {
        Self {
            min_clearance_mm: clearance(&routed.line, lumen, &fields.distance),
            line: routed.line,
            proof: Some(routed.proof),
            candidates: fields.candidates.len(),
            kept: seen.kept,
            added: seen.added,
            unseen: seen.unseen,
            unreachable: routed.unreachable,
        }
    }
}

/// Candidates this share of their own distance apart see nearly the same wall.
const SPARING: f64 = 0.2;

/// Candidates in the order they are asked: deepest first, since a few wide views come before many
/// narrow ones. A candidate nearer than a fifth of its distance to one before it is left out: wide
/// lumens have ridge sheets of ten thousand voxels that see the same walls. What only such a one
/// would have seen gets a viewer of its own afterwards.
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
            let to = at + IVec3::new(n % 3 - 1, n / 3 % 3 - 1, n / 9 - 1);
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
/// [`PipelineError::Centerline`] and the device's.
pub fn paper_centered(
    device: &mut Device,
    lumen: &Lumen,
    fields: &Fields,
    radius: Radius,
    clock: &mut Clock,
) -> Result<Centered, PipelineError> {
    let distance = Sampler { lumen, field: &fields.distance };
    let viewers = radius.viewers(&fields.candidates, distance);
    let internal: Vec<u64> =
        lumen.inside.iter().zip(&lumen.boundary).map(|(i, b)| i & !b).collect();
    let (kept, unseen) = visible(device, lumen, &viewers, &internal, clock)?;
    let kept: Vec<Viewer> = kept.iter().map(|r| viewers[*r as usize]).collect();
    let line = clock.time(
        "paper path",
        "kept points",
        || paper_path(lumen, &kept, &fields.distance),
        |_| kept.len() as u64,
    )?;
    Ok(Centered {
        min_clearance_mm: clearance(&line, lumen, &fields.distance),
        line,
        proof: None,
        candidates: viewers.len(),
        kept: kept.len(),
        added: 0,
        unseen,
        unreachable: 0,
    })
}

/// Runs the visibility test: ranks kept and elements unseen.
fn visible(
    device: &mut Device,
    lumen: &Lumen,
    viewers: &[Viewer],
    open: &[u64],
    clock: &mut Clock,
) -> Result<(Vec<u32>, Vec<u32>), PipelineError> {
    let start = Instant::now();
    let boundary: Vec<u32> = lumen.elements(&lumen.boundary).map(|e| e as u32).collect();
    let arrangement = Arrangement::new(lumen, viewers, boundary);
    let mut plan = Plan::new();
    let buffers = LumenBuffers::new(&mut plan, lumen);
    let pending = arrangement.launch(&mut plan, &buffers, open);
    let out = device.run(&plan)?;
    clock.plan(
        "visibility",
        device.name(),
        start,
        (lumen.boundary_voxels, "boundary voxels"),
        &out,
    );
    Ok(arrangement.read(pending, &out))
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
