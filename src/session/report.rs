//! `report.json`, schema `intima.report/1`: only numbers that were measured in this run, no path
//! and no patient text.

use std::borrow::Cow;
use std::collections::BTreeMap;

use glam::{DVec3, UVec3};
use serde::Serialize;

use super::levels::LodReport;
use super::surface::{Wall, written_mesh};
use super::{Centered, Clock, Product, Segmented, Session, SessionError, StageTime, WallMethod};
use crate::centerline::complex::net::Rule;
use crate::centerline::{ChosenEnd, LumenLoop, Proof};
use crate::flight::LumenProfile;
use crate::geometry::{Branch, Centerline, Mesh, TreeSummary};
use crate::lumen::{BitVolume, Component, IntensitySelection};
use crate::organ::Segment;
use crate::surface::{Adjacency, Topology};
use crate::volume::{Acquisition, Grid, Volume};

/// The report of a run.
#[derive(Clone, Debug, Default, Serialize)]
pub struct Report {
    /// Name and version of this layout, `intima.report/1`.
    pub schema: &'static str,
    /// Patient coordinates of every point in it: `LPS`, +x left, +y back, +z head.
    pub space: &'static str,
    /// Unit of lengths: `mm`.
    pub unit: &'static str,
    /// Version of intima.
    pub version: &'static str,
    /// Moment at which the report was made, UTC.
    pub date: String,
    /// Statement that this is no medical device.
    pub notice: &'static str,
    /// Name of the device that plans ran on; `cpu` without a GPU.
    pub device: String,
    /// Volume that was read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input: Option<InputReport>,
    /// The label map the lumen was chosen from.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub mask: Option<InputReport>,
    /// Stages that ran, each with its time.
    pub stages: Vec<StageTime>,
    /// Wall time since the clock of the stages began; less than their sum where some ran side by
    /// side.
    pub total_ms: f64,
    /// Lumen that was segmented.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lumen: Option<LumenReport>,
    /// Organ that was found, with `--organ`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub organ: Option<OrganReport>,
    /// Method by which the wall was drawn, and figures of its field.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub wall: Option<WallReport>,
    /// Surface of the lumen.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceReport>,
    /// Path or tree, and the visibility test.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centerline: Option<CenterlineReport>,
    /// Radius and cross-section along the path.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub profile: Option<LumenProfile>,
    /// Wall seen by the flight.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub coverage: Option<CoverageReport>,
    /// Levels of detail.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lod: Option<LodReport>,
    /// Frames that were drawn.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FramesReport>,
    /// Sentences for the user, each about one doubtful thing.
    pub warnings: Vec<String>,
    /// Peak of resident memory, MB (10⁶ bytes).
    pub peak_memory_mb: f64,
    /// Further times of the run, by name.
    #[serde(flatten)]
    pub timing: BTreeMap<&'static str, f64>,
}

/// The volume that was read.
#[derive(Clone, Debug, Serialize)]
pub struct InputReport {
    /// BLAKE3 of the stored samples; absent where only the header was read.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub hash: Option<String>,
    /// Voxels along x, y, z.
    pub dims: [u32; 3],
    /// Distances between voxel centres along x, y, z.
    pub spacing_mm: [f64; 3],
    /// Stored type of a sample, such as `int16`.
    pub sample_type: String,
    /// Modality code such as `CT`, where the file says.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub modality: Option<&'static str>,
    /// Start of the BLAKE3 hash of the series instance UID, of a DICOM series.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub series_hash: Option<String>,
}

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

/// A component of what was selected.
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

/// The surface.
#[derive(Clone, Debug, Serialize)]
pub struct SurfaceReport {
    /// Vertices of the mesh.
    pub vertices: usize,
    /// Triangles of the mesh.
    pub faces: usize,
    /// Connected parts of the mesh.
    pub components: usize,
    /// Euler characteristic: vertices − edges + faces.
    pub euler: i64,
    /// Tunnels through the lumen (handles of its surface): loops that a tree does not follow.
    pub tunnels: i64,
    /// Whether every edge has two faces.
    pub watertight: bool,
    /// Area of all faces.
    pub area_mm2: f64,
}

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
    /// Distance to the wall at the next narrowest place, mm; null if there is none.
    pub next_throat_mm: Option<f64>,
    /// Length of the narrow passage about the throat, mm.
    pub passage_mm: f64,
    /// Length of the loop.
    pub length_mm: f64,
    /// Whether it was cut at one of two places about as narrow: the other may be the one to cut.
    pub doubtful: bool,
}

/// Frames that were drawn.
#[derive(Clone, Debug, Serialize)]
pub struct FramesReport {
    /// Frames.
    pub count: usize,
    /// Pixels of a row.
    pub width: u32,
    /// Rows of pixels.
    pub height: u32,
    /// Median time of a frame.
    pub p50_ms: f64,
    /// Time that 99 % of the frames stay below.
    pub p99_ms: f64,
    /// Triangles drawn a frame, median.
    pub triangles_p50: u64,
    /// Triangles drawn a frame, 99th percentile.
    pub triangles_p99: u64,
    /// Time from the first frame to the last.
    pub total_ms: f64,
    /// Smallest distance between the near plane's ball and the wall over all frames.
    pub min_near_clearance_mm: f64,
    /// Duration of the flight.
    pub flight_seconds: f64,
    /// Frames that begin another piece of the lumen, or another branch: the eye jumps there.
    pub cuts: Vec<usize>,
    /// Name of the device that drew.
    pub device: String,
}

/// Wall seen by the frames of the flight.
#[derive(Clone, Debug, Serialize)]
pub struct CoverageReport {
    /// Flight whose cameras saw it.
    pub of: CoveredFlight,
    /// Share seen by the flight as it was flown.
    pub one_way_fraction: f64,
    /// Share seen by it or by the same flight in the other direction.
    pub both_ways_fraction: f64,
    /// Quantity of which the shares are.
    pub by: &'static str,
    /// Area of the wall.
    pub area_mm2: f64,
    /// Connected patches that neither direction saw, largest first.
    pub patches: Vec<PatchReport>,
    /// Patches of at least this area are listed.
    pub listed_from_mm2: f64,
    /// Patches smaller than that, and their area together.
    pub smaller_patches: usize,
    /// Area of those patches.
    pub smaller_patches_mm2: f64,
}

/// A flight along which coverage was measured.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct CoveredFlight {
    /// Branches that it follows: `trunk`, `all`, or `leaf:` with a number; `path` of cameras that
    /// were given.
    pub route: String,
    /// Whether it goes from the end to the start.
    pub reverse: bool,
    /// Number of its cameras.
    pub cameras: usize,
    /// Vertical field of view of the first, degrees; 360 where each sees everything about it.
    pub field_of_view_deg: f64,
}

/// A patch that was missed.
#[derive(Clone, Debug, Serialize)]
pub struct PatchReport {
    /// Area of the patch.
    pub area_mm2: f64,
    /// Centre of the patch, LPS.
    pub center_mm: [f64; 3],
    /// Arc length of the path nearest to its centre, mm.
    pub arc_mm: f64,
}

impl Session {
    /// The report of all products that are there, and of these frames.
    ///
    /// # Errors
    /// What computing the inputs' hash fails with.
    pub fn report(&self, frames: Option<&super::FrameStream>) -> Result<Report, SessionError> {
        self.prepare(&[Product::Inputs, Product::Lumen, Product::Wall, Product::Centerline])?;
        self.report_so_far(frames)
    }

    /// The report of the products that are there, and of these frames; none is computed for it but
    /// the branches of a tree.
    ///
    /// # Errors
    /// Errors of the branches.
    pub fn report_so_far(
        &self,
        frames: Option<&super::FrameStream>,
    ) -> Result<Report, SessionError> {
        let there = self.products(&[
            Product::Device,
            Product::Volume,
            Product::Identity,
            Product::Lumen,
            Product::Wall,
            Product::Centerline,
        ]);
        let inputs = there.has(Product::Identity).then(|| self.inputs()).transpose()?;
        let lumen = there.lumen.as_deref();
        let line = there.centerline.as_deref().zip(lumen);
        let centerline = line.map(|(centered, lumen)| {
            let tree = self.tree()?;
            Ok::<_, SessionError>(CenterlineReport {
                tree,
                ..CenterlineReport::of(centered, lumen)
            })
        });
        let surface = there.wall.as_deref();
        let surface = surface.map(|w| SurfaceReport::of_written(w, self.settings.wall.open_ends));
        let (flight, coverage) = (&self.slots.flight, &self.slots.coverage);
        let (flight, coverage) = (super::locked(flight).clone(), super::locked(coverage).clone());
        let mut warnings = self.warnings();
        warnings.extend(frames.map(super::FrameStream::warnings).unwrap_or_default());
        Ok(Report {
            input: inputs.as_ref().and_then(|i| i.input.clone()),
            mask: inputs.as_ref().and_then(|i| i.mask.clone()),
            lumen: lumen.map(LumenReport::of),
            organ: lumen.and_then(OrganReport::of),
            wall: lumen.map(WallReport::of),
            surface,
            centerline: centerline.transpose()?,
            profile: super::locked(&self.slots.lumen_profile).as_deref().cloned(),
            coverage: coverage.zip(flight).map(|(c, flight)| self.coverage_report(&c, &flight)),
            lod: frames.map(|f| f.lod().clone()),
            frames: frames.map(super::FrameStream::report),
            warnings,
            ..Report::new(there.device.as_ref().map_or("", |d| &d.name), &self.clock())
        })
    }
}

impl Report {
    /// Takes this run's own time, less the reading, as the one measured.
    pub fn add_own_timing(&mut self) {
        let read: f64 = self.stages.iter().filter(|s| s.name == "read").map(|s| s.ms).sum();
        let seconds = (self.total_ms - read) / 1000.0;
        self.timing = BTreeMap::from([("median_s", seconds), ("min_s", seconds)]);
    }

    /// A report of what a clock holds.
    pub fn new(device: &str, clock: &Clock) -> Self {
        Self {
            schema: "intima.report/1",
            space: "LPS",
            unit: "mm",
            version: env!("CARGO_PKG_VERSION"),
            date: super::date::now(),
            notice: crate::formats::NOTICE,
            device: device.to_owned(),
            stages: clock.stages.clone(),
            total_ms: clock.elapsed_ms(),
            peak_memory_mb: super::peak_memory_mb(),
            ..Self::default()
        }
    }
}

/// BLAKE3 of a volume's samples.
pub(super) fn hash_of(volume: &Volume) -> String {
    blake3::hash(volume.samples.bytes()).to_hex().to_string()
}

impl InputReport {
    /// Hash and geometry of a volume.
    pub fn of(volume: &Volume) -> Self {
        Self { hash: Some(hash_of(volume)), ..Self::without_hash(volume) }
    }

    /// Geometry and acquisition of a volume.
    pub(super) fn without_hash(volume: &Volume) -> Self {
        let sample_type = volume.samples.sample_type().name().to_owned();
        Self::of_header(&volume.grid, sample_type).of_acquisition(volume.acquisition.as_ref())
    }

    /// Geometry of an image of which only the header was read.
    pub(super) fn of_header(grid: &Grid, sample_type: String) -> Self {
        let stored = grid.as_stored();
        let (dims, spacing_mm) = (stored.dims.to_array(), stored.spacing_mm.to_array());
        Self { hash: None, dims, spacing_mm, sample_type, modality: None, series_hash: None }
    }

    /// Adds what is known of the acquisition.
    pub(super) fn of_acquisition(self, acquisition: Option<&Acquisition>) -> Self {
        let Some(a) = acquisition else { return self };
        Self { modality: Some(a.modality), series_hash: a.series_hash.clone(), ..self }
    }
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

impl SurfaceReport {
    /// Counts of a wall as it is written.
    pub fn of_written(wall: &Wall, open_ends: bool) -> Self {
        match written_mesh(&wall.mesh, open_ends) {
            Cow::Borrowed(mesh) => Self::of(wall.topology, mesh.area_mm2()),
            Cow::Owned(mesh) => Self::of_mesh(&mesh),
        }
    }

    /// Counts of any mesh.
    pub fn of_mesh(mesh: &Mesh) -> Self {
        let (adjacency, watertight) = Adjacency::of(mesh);
        Self::of(adjacency.topology(mesh, watertight), mesh.area_mm2())
    }

    /// Counts of a surface.
    pub fn of(topology: Topology, area_mm2: f64) -> Self {
        let Topology { vertices, faces, components, euler, watertight, .. } = topology;
        let tunnels = topology.tunnels();
        Self { vertices, faces, components, euler, tunnels, watertight, area_mm2 }
    }
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
