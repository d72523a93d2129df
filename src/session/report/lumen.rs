//! Report of the lumen: its choice, its organ, the method of its wall.

use crate::lumen::{Component, IntensitySelection};
use crate::organ::Segment;
use crate::session::{Segmented, WallMethod};
use crate::volume::Grid;
use glam::UVec3;
use serde::Serialize;

/// Values that count as inside, real units; neither of an organ, which has its threshold.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct SelectionReport {
    /// Ends of the range, both inside; null where it is open.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub range: Option<[Option<f64>; 2]>,
    /// Labels; every label but 0 if the list is empty.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub labels: Option<Vec<i64>>,
    /// Voxel of the component that was kept, x fastest.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub seed_voxel: Option<[u32; 3]>,
}

/// The lumen.
#[derive(Clone, Debug, Serialize)]
pub struct LumenReport {
    /// Values that it was selected by.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub selection: Option<SelectionReport>,
    /// Voxels with all six neighbours in the lumen.
    pub internal_voxels: u64,
    /// Voxels with an external neighbour.
    pub boundary_voxels: u64,
    /// Volume of the lumen.
    pub volume_ml: f64,
    /// Bricks of 8³ voxels that hold the lumen and its rim.
    pub bricks: usize,
    /// Voxels of closed cavities that were filled.
    pub filled_voxels: u64,
    /// Closed cavities that were filled.
    pub filled_cavities: usize,
    /// Voxels added to a label map where parts of it touched by an edge or a corner.
    pub joined_voxels: usize,
    /// Places of the first of them, LPS mm.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub joined_at_mm: Vec<[f64; 3]>,
    /// Components left out though they lie in the body.
    pub other_components: usize,
    /// Voxels of those components.
    pub other_voxels: u64,
    /// Components left out because they lie outside the body.
    pub outside_components: usize,
    /// Volume of those components.
    pub outside_ml: f64,
    /// The component that was taken, where no seed chose it.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub taken: Option<ComponentReport>,
    /// The largest of those left out.
    #[serde(skip_serializing_if = "Vec::is_empty")]
    pub left_out: Vec<ComponentReport>,
    /// Whether the lumen reaches the edge of the volume.
    pub touches_edge: bool,
    /// Threshold leak control settled on, where it ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leak_threshold: Option<f64>,
}

/// An organ that was looked for and found.
#[derive(Clone, Debug, Serialize)]
pub struct OrganReport {
    /// Organ as `--organ` names it.
    pub name: &'static str,
    /// End of the range of values that was chosen.
    pub threshold: f64,
    /// A point deep inside each segment, LPS.
    pub seeds_mm: Vec<[f64; 3]>,
    /// Connected parts, in the order in which they follow each other.
    pub segments: Vec<SegmentReport>,
    /// Least margin by which a gate was passed, 0 to 1.
    pub confidence: f64,
    /// Measurements and decisions, a sentence each.
    pub reasons: Vec<String>,
}

/// Method and figures of the wall, in real units (HU of a CT); only a wall field has figures.
#[derive(Clone, Debug, Serialize)]
pub struct WallReport {
    /// Method by which the wall was placed.
    pub method: WallMethod,
    /// Figures of the wall field.
    #[serde(flatten)]
    pub field: Option<WallFieldReport>,
}

/// A wall field.
#[derive(Clone, Debug, Serialize)]
pub struct WallFieldReport {
    /// Thresholds at 5, 25, 50, 75 and 95 % of the wall.
    pub threshold_percentiles: [f64; 5],
    /// Share of the wall that was drawn because a sheet is there.
    pub sheet_share: f64,
    /// Share of the wall that a limit of growth has closed: no wall was seen there.
    pub closed_by_limit_share: f64,
    /// Median value of the lumen.
    pub lumen_value: f64,
    /// Median value of the wall.
    pub wall_value: f64,
    /// Standard deviation of noise in the lumen.
    pub noise: f64,
    /// Standard deviation of the scan's blur.
    pub sigma_mm: f64,
}

/// A connected part of an organ.
#[derive(Clone, Debug, Serialize)]
pub struct SegmentReport {
    /// Volume of the part.
    pub volume_ml: f64,
    /// Voxel deep inside, x fastest.
    pub seed_voxel: [u32; 3],
}

/// A component of the selected voxels.
#[derive(Clone, Debug, Serialize)]
pub struct ComponentReport {
    /// Voxels of the component.
    pub voxels: u64,
    /// Volume of the component.
    pub volume_ml: f64,
    /// First voxel of the component, x fastest: a seed that takes it.
    pub first_voxel: [u32; 3],
    /// Centre of that voxel, LPS.
    pub first_mm: [f64; 3],
    /// Whether it was left out because it lies outside the body.
    pub outside_body: bool,
}

/// Most components left out that are listed, in the body and outside it.
const LISTED: usize = 5;

impl SelectionReport {
    fn of(Segmented { lumen, options, organ, .. }: &Segmented) -> Option<Self> {
        let stored = |seed: UVec3| lumen.volume_grid().stored_voxel(seed.as_ivec3());
        let seed_voxel = options.seed.map(|seed| stored(seed).as_uvec3().to_array());
        let end = |v: f64| v.is_finite().then_some(v);
        let (range, labels) = match &options.selection {
            IntensitySelection::Range { lo, hi } => (Some([end(*lo), end(*hi)]), None),
            IntensitySelection::Labels(labels) => (None, Some(labels.clone())),
        };
        organ.is_none().then_some(Self { range, labels, seed_voxel })
    }
}

impl LumenReport {
    /// Counts of a lumen.
    pub fn of(segmented: &Segmented) -> Self {
        let Segmented { lumen, found, .. } = segmented;
        let component =
            |c: &Component, outside_body| ComponentReport::of(c, lumen.volume_grid(), outside_body);
        let listed = |all: &[Component], outside_body| -> Vec<ComponentReport> {
            all.iter().take(LISTED).map(|c| component(c, outside_body)).collect()
        };
        let to_world = lumen.volume_grid().world_from_voxel();
        let place = |v: &UVec3| to_world.transform_point3(v.as_dvec3()).to_array();
        let mut left_out = listed(&found.others, false);
        left_out.extend(listed(&found.outside, true));
        Self {
            selection: SelectionReport::of(segmented),
            internal_voxels: lumen.internal_voxels,
            boundary_voxels: lumen.boundary_voxels,
            volume_ml: lumen.volume_ml(),
            bricks: lumen.bricks.len(),
            filled_voxels: found.filled.0,
            filled_cavities: found.filled.1,
            joined_voxels: found.joined.len(),
            joined_at_mm: found.joined.iter().take(LISTED).map(place).collect(),
            other_components: found.others.len(),
            other_voxels: found.other_voxels,
            outside_components: found.outside.len(),
            outside_ml: found.outside.iter().map(|c| c.volume_ml(lumen.volume_grid())).sum(),
            taken: found.taken.map(|c| component(&c, false)),
            left_out,
            touches_edge: lumen.touches_edge,
            leak_threshold: found.leak.map(|l| l.threshold),
        }
    }
}

impl WallReport {
    /// Reports the wall of a lumen.
    pub fn of(Segmented { wall, method, .. }: &Segmented) -> Self {
        let field = wall.as_ref().map(|wall| {
            let stats = &wall.stats;
            WallFieldReport {
                threshold_percentiles: stats.threshold_percentiles,
                sheet_share: stats.sheet_share,
                closed_by_limit_share: stats.closed_by_limit_share,
                lumen_value: stats.contrast.lumen,
                wall_value: stats.contrast.wall,
                noise: stats.contrast.noise,
                sigma_mm: stats.sigma_mm,
            }
        });
        Self { method: *method, field }
    }
}

impl OrganReport {
    /// Reports the organ that was found, if one was looked for.
    pub fn of(Segmented { lumen, organ, .. }: &Segmented) -> Option<Self> {
        let organ = organ.as_ref()?;
        let grid = lumen.volume_grid();
        let to_world = grid.world_from_voxel();
        let stored = |v: UVec3| grid.stored_voxel(v.as_ivec3()).as_uvec3().to_array();
        let point = |v: UVec3| to_world.transform_point3(v.as_dvec3()).to_array();
        let segment =
            |s: &Segment| SegmentReport { volume_ml: s.volume_ml, seed_voxel: stored(s.seed) };
        Some(Self {
            name: organ.organ.name(),
            threshold: organ.threshold,
            seeds_mm: organ.segments.iter().map(|s| point(s.seed)).collect(),
            segments: organ.segments.iter().map(segment).collect(),
            confidence: organ.confidence,
            reasons: organ.reasons.clone(),
        })
    }
}

impl ComponentReport {
    fn of(c: &Component, grid: &Grid, outside_body: bool) -> Self {
        Self {
            voxels: c.voxels,
            volume_ml: c.volume_ml(grid),
            first_voxel: grid.stored_voxel(c.first.as_ivec3()).as_uvec3().to_array(),
            first_mm: grid.world_from_voxel().transform_point3(c.first.as_dvec3()).to_array(),
            outside_body,
        }
    }
}
