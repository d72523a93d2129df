//! Report of a centerline.

use crate::centerline::complex::net::Rule;
use crate::centerline::{ChosenEnd, LumenLoop, Proof};
use crate::geometry::{Branch, Centerline, TreeSummary};
use crate::lumen::BitVolume;
use crate::session::{Centered, Segmented};
use glam::DVec3;
use serde::Serialize;

/// A centerline.
#[derive(Clone, Debug, Serialize)]
pub struct CenterlineReport {
    /// Points of all lines.
    pub points: usize,
    /// Summed length of all lines.
    pub length_mm: f64,
    /// Lines: the path or trunk, and one to each further tip and for each loop.
    pub branches: usize,
    /// Branches between bifurcations by generation, of a tree, an airway or a vessel.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub tree: Option<TreeSummary>,
    /// Pieces of the lumen that are flown one after another.
    pub pieces: usize,
    /// Distance from the end of each piece to the next; nothing proves a way there.
    pub gaps_mm: Vec<f64>,
    /// Least distance of the lines to the wall, between their points too.
    pub min_clearance_mm: f64,
    /// Start and end with the rules that chose them; not of the paper's path.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ends: Option<[ChosenEnd; 2]>,
    /// Length of larynx and pharynx above the start.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beyond_start_mm: Option<f64>,
    /// Length of ileum or appendix beyond the end of a colon's path.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub beyond_end_mm: Option<f64>,
    /// Points that were replaced because the curve passed the wall there.
    pub rerouted_points: usize,
    /// Points beyond the wall: ends that were given there.
    pub points_outside: usize,
    /// Points in filled cavities: within the wall, and outside the mask that was given.
    pub points_in_cavities: usize,
    /// Places that viewers were chosen from: nodes of the graph, or ridge candidates.
    pub viewer_candidates: usize,
    /// Ridge points, of the paper's method and with its reach of viewers.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub ridge_candidates: Option<usize>,
    /// Viewpoints that the visibility test kept, added ones included.
    pub kept: usize,
    /// Viewpoints added for boundary voxels that no candidate sees.
    pub added: usize,
    /// Share of the boundary voxels that the viewpoints of the visibility test see; `coverage` has the
    /// share that frames saw.
    pub viewers_seen_fraction: f64,
    /// Boundary voxels that no viewpoint sees.
    pub viewers_unseen: usize,
    /// Inside voxels that no allowed route joins to the root.
    pub unreachable_voxels: usize,
    /// Loops of the lumen: the ended ones, then the kept ones.
    pub loops: Vec<LoopReport>,
    /// Proof that the curve stays in the lumen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub proof: Option<Proof>,
}

/// A loop of the lumen.
#[derive(Clone, Debug, Serialize)]
pub struct LoopReport {
    /// `kept`, or the rule that ended it: `local`, `window` (where folds touch), `small`.
    pub outcome: &'static str,
    /// Narrowest place of the loop (its throat), LPS mm.
    pub throat_at_mm: [f64; 3],
    /// Distance to the wall there, mm.
    pub throat_mm: f64,
    /// Distance to the wall at the second narrowest place, mm; null if the loop has one narrow place.
    pub next_throat_mm: Option<f64>,
    /// Length of the narrow passage about the throat, mm.
    pub passage_mm: f64,
    /// Length of the loop.
    pub length_mm: f64,
    /// Whether it was cut at one of two places about as narrow: the other may be the one to cut.
    pub doubtful: bool,
}

/// Returns the distance from the end of each piece to the start of the next, mm.
fn gaps_mm(line: &Centerline) -> Vec<f64> {
    let pieces: Vec<&Branch> = line.pieces().collect();
    let gap = |w: &[&Branch]| {
        let (a, b) = (w[0].points.last()?, w[1].points.first()?);
        Some(a.position_mm.distance(b.position_mm))
    };
    pieces.windows(2).filter_map(gap).collect()
}

impl LoopReport {
    fn of(l: &LumenLoop) -> Self {
        let found = &l.found;
        Self {
            outcome: match found.ended {
                None => "kept",
                Some(Rule::Local) => "local",
                Some(Rule::Window) => "window",
                Some(Rule::Small) => "small",
            },
            throat_at_mm: l.throat_at.to_array(),
            throat_mm: found.throat_mm,
            next_throat_mm: found.next_throat_mm.is_finite().then_some(found.next_throat_mm),
            passage_mm: found.passage_mm,
            length_mm: found.cycle_mm,
            doubtful: l.is_doubtful(),
        }
    }
}

impl CenterlineReport {
    /// Figures of a centerline.
    pub fn of(c: &Centered, segmented: &Segmented) -> Self {
        let lumen = &segmented.lumen;
        let boundary = lumen.boundary_voxels.max(1) as f64;
        let in_cavity = |cavities: &BitVolume, at_mm: DVec3| {
            let voxel = lumen.volume_grid().nearest_voxel(at_mm);
            voxel.is_some_and(|v| cavities.at(v.x, v.y, v.z))
        };
        let points_in_cavities = segmented.found.cavities.as_ref().map_or(0, |cavities| {
            let points = c.line.branches.iter().flat_map(|branch| &branch.points);
            points.filter(|point| in_cavity(cavities, point.position_mm)).count()
        });
        Self {
            points: c.line.point_count(),
            length_mm: c.line.length_mm(),
            branches: c.line.branches.len(),
            tree: None,
            pieces: c.line.pieces().count(),
            gaps_mm: gaps_mm(&c.line),
            min_clearance_mm: c.min_clearance_mm,
            ends: c.ends.clone(),
            beyond_start_mm: c.beyond_mm[0],
            beyond_end_mm: c.beyond_mm[1],
            rerouted_points: c.rerouted,
            points_outside: c.outside_mm.len(),
            points_in_cavities,
            viewer_candidates: c.candidates,
            ridge_candidates: c.on_ridge.then_some(c.candidates),
            kept: c.kept,
            added: c.added,
            viewers_seen_fraction: 1.0 - c.unseen.len() as f64 / boundary,
            viewers_unseen: c.unseen.len(),
            unreachable_voxels: c.unreachable,
            loops: c.loops.iter().map(LoopReport::of).collect(),
            proof: c.proof,
        }
    }
}
