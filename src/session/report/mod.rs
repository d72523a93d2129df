//! `report.json`, schema `intima.report/1`: only numbers that were measured in this run, no path
//! and no patient text.

mod centerline;
mod frames;
mod input;
mod lumen;
mod surface;

use std::collections::BTreeMap;

use serde::Serialize;

use super::levels::LodReport;
use super::{Clock, Product, Session, SessionError, StageTime};
use crate::flight::LumenProfile;
pub use centerline::CenterlineReport;
pub use frames::{CoverageReport, CoveredFlight, FramesReport, PatchReport};
pub use input::InputReport;
pub(super) use input::hash_of;
pub use lumen::{
    ComponentReport, LumenReport, OrganReport, SegmentReport, SelectionReport, WallFieldReport,
    WallReport,
};
pub use surface::SurfaceReport;

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
    /// Part of it that lies in no stage.
    pub unnamed_ms: f64,
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
            unnamed_ms: clock.unnamed_ms(),
            peak_memory_mb: super::peak_memory_mb(),
            ..Self::default()
        }
    }
}
