//! `report.json`, schema `intima.report/1`: only numbers that were measured in this run, no path
//! and no patient text.

use std::collections::BTreeMap;

use serde::Serialize;

use super::detail::LodReport;
use super::{Centered, Clock, Stage};
use crate::centerline::Proof;
use crate::lumen::{Found, Lumen};
use crate::surface::Topology;
use crate::volume::Volume;

/// The report of a run.
#[derive(Clone, Debug, Default, Serialize)]
#[allow(missing_docs)]
pub struct Report {
    pub schema: &'static str,
    pub version: &'static str,
    pub notice: &'static str,
    pub device: String,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub input: Option<InputReport>,
    pub stages: Vec<Stage>,
    /// Wall time since the clock of the stages began; less than their sum where some ran side by
    /// side.
    pub total_ms: f64,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lumen: Option<LumenReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub surface: Option<SurfaceReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub centerline: Option<CenterlineReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub modes: Option<Modes>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub lod: Option<LodReport>,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub frames: Option<FramesReport>,
    pub warnings: Vec<String>,
    pub peak_memory_mb: f64,
    #[serde(flatten)]
    pub timing: BTreeMap<&'static str, f64>,
}

/// The volume that was read.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct InputReport {
    /// BLAKE3 of the stored samples.
    pub hash: String,
    pub dims: [u32; 3],
    pub spacing_mm: [f64; 3],
    pub sample_type: &'static str,
}

/// The lumen.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct LumenReport {
    pub internal_voxels: u64,
    pub boundary_voxels: u64,
    pub volume_ml: f64,
    pub bricks: usize,
    pub filled_voxels: u64,
    pub filled_cavities: usize,
    pub other_components: usize,
    pub other_voxels: u64,
    pub touches_edge: bool,
    /// Threshold leak control settled on, where it ran.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub leak_threshold: Option<f64>,
}

/// The surface.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct SurfaceReport {
    pub vertices: usize,
    pub faces: usize,
    pub components: usize,
    pub euler: i64,
    /// Tunnels through the lumen (handles of its surface): loops that a tree does not follow.
    pub tunnels: i64,
    pub watertight: bool,
    pub area_mm2: f64,
}

/// A centerline.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct CenterlineReport {
    pub points: usize,
    pub length_mm: f64,
    pub branches: usize,
    /// To the nearest external voxel centre.
    pub min_clearance_mm: f64,
    pub ridge_candidates: usize,
    pub kept: usize,
    pub added: usize,
    pub boundary_seen_fraction: f64,
    pub unseen: usize,
    pub unreachable_voxels: usize,
    #[serde(skip_serializing_if = "Option::is_none")]
    pub proof: Option<Proof>,
}

/// Both modes side by side.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct Modes {
    pub default: CenterlineReport,
    pub paper: CenterlineReport,
}

/// Frames that were drawn.
#[derive(Clone, Debug, Serialize)]
#[allow(missing_docs)]
pub struct FramesReport {
    pub count: usize,
    pub width: u32,
    pub height: u32,
    pub p50_ms: f64,
    pub p99_ms: f64,
    pub triangles_p50: u64,
    pub triangles_p99: u64,
    /// Written to patches on the device.
    pub uploaded_bytes_p50: u64,
    pub uploaded_bytes_p99: u64,
    /// Octree leaves that changed their state.
    pub leaves_changed_p50: u64,
    pub leaves_changed_p99: u64,
    /// Frames coarser than asked for, for want of room.
    pub degraded: usize,
    pub total_ms: f64,
    /// Smallest distance between the near plane's ball and the wall over all frames.
    pub min_near_clearance_mm: f64,
    pub flight_seconds: f64,
    pub device: String,
}

impl Report {
    /// A report of what a clock holds.
    pub fn new(device: &str, clock: &Clock) -> Self {
        Self {
            schema: "intima.report/1",
            version: env!("CARGO_PKG_VERSION"),
            notice: crate::formats::NOTICE,
            device: device.to_owned(),
            stages: clock.stages.clone(),
            total_ms: clock.elapsed_ms(),
            peak_memory_mb: super::peak_memory_mb(),
            ..Self::default()
        }
    }
}

impl InputReport {
    /// Hash and geometry of a volume.
    pub fn of(volume: &Volume) -> Self {
        Self {
            hash: blake3::hash(volume.samples.bytes()).to_hex().to_string(),
            dims: volume.grid.dims.to_array(),
            spacing_mm: volume.grid.spacing_mm.to_array(),
            sample_type: volume.samples.sample_type().name(),
        }
    }
}

impl LumenReport {
    /// Counts of a lumen.
    pub fn of(lumen: &Lumen, found: &Found) -> Self {
        Self {
            internal_voxels: lumen.internal_voxels,
            boundary_voxels: lumen.boundary_voxels,
            volume_ml: lumen.volume_ml(),
            bricks: lumen.bricks.len(),
            filled_voxels: found.filled.0,
            filled_cavities: found.filled.1,
            other_components: found.others.len(),
            other_voxels: found.other_voxels,
            touches_edge: lumen.touches_edge,
            leak_threshold: found.leak.map(|l| l.threshold),
        }
    }
}

impl SurfaceReport {
    /// Counts of a surface.
    pub fn of(topology: Topology, area_mm2: f64) -> Self {
        let Topology { vertices, faces, components, euler, watertight, .. } = topology;
        let tunnels = topology.tunnels();
        Self { vertices, faces, components, euler, tunnels, watertight, area_mm2 }
    }
}

impl CenterlineReport {
    /// Figures of a centerline.
    pub fn of(c: &Centered, lumen: &Lumen) -> Self {
        let boundary = lumen.boundary_voxels.max(1) as f64;
        Self {
            points: c.line.point_count(),
            length_mm: c.line.length_mm(),
            branches: c.line.branches.len(),
            min_clearance_mm: c.min_clearance_mm,
            ridge_candidates: c.candidates,
            kept: c.kept,
            added: c.added,
            boundary_seen_fraction: 1.0 - c.unseen.len() as f64 / boundary,
            unseen: c.unseen.len(),
            unreachable_voxels: c.unreachable,
            proof: c.proof,
        }
    }
}
