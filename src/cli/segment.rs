//! `intima segment`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, SEGMENTS};
use super::lumen_args::{LumenArgs, is_layered, write_mask};
use super::repeat::timed_products;
use crate::device::DeviceChoice;
use crate::formats::{SourceSeries, shown, write_layers};
use crate::session::{LumenReport, OrganReport, Product, Session, Settings, WallReport};

/// `intima segment INPUT LUMEN -o MASK`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Mask to write: .nrrd, .nii, .nii.gz, .mha, .mhd, .seg.nrrd or .dcm
    ///
    /// A segmentation (.seg.nrrd, DICOM SEG .dcm) has one segment, the whole lumen, with the name of
    /// the organ. A DICOM SEG is written where INPUT is a DICOM series.
    #[arg(short, long, value_name = "MASK")]
    output: PathBuf,
    /// Write 0 and 1 instead of the three classes, as a segmentation always does
    #[arg(long)]
    binary: bool,
    /// Describe patient and study in a DICOM SEG as the series does, to store it beside the series
    #[arg(long, help_heading = "DICOM")]
    keep_patient: bool,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl Args {
    /// Chooses the lumen and writes it.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, SEGMENTED)?;
        self.lumen.check_outputs(global)?;
        let series = self.source_series()?;
        let settings = Settings { lumen: self.lumen.settings()?, ..global.settings() };
        let settings = Settings { device: DeviceChoice::Cpu, ..settings };
        let mut session = Session::new(self.lumen.source(self.input.as_deref())?, settings)?;
        let (segmented, timing) =
            timed_products(global, &mut session, &[Product::Volume], &[Product::Core], |s| {
                Ok(s.lumen()?)
            })?;
        let lumen = &segmented.lumen;
        let mut classes = lumen.class_field();
        if self.binary {
            classes.iter_mut().for_each(|c| *c = (*c).min(1));
        }
        let segment = segmented.description();
        let (grid, dense) = (lumen.stored_grid(), || lumen.dense(&classes, 0));
        match series {
            Some(series) => {
                series.write_segment(&self.output, &dense(), &segment, self.keep_patient)?;
            }
            None if is_layered(&self.output) => {
                write_layers(&self.output, &grid, |put| lumen.each_layer(&classes, 0, put))?;
            }
            None => write_mask(&self.output, &grid, dense(), &segment)?,
        }
        self.lumen.write_choice(&session, global)?;
        global.say(format_args!(
            "wrote {}: {} internal and {} boundary voxels, {:.3} ml",
            shown(&self.output),
            lumen.internal_voxels,
            lumen.boundary_voxels,
            lumen.volume_ml()
        ))?;
        let timing = timing.with("lumen", LumenReport::of(&segmented));
        let timing = timing.with("wall", WallReport::of(&segmented));
        match OrganReport::of(&segmented) {
            Some(organ) => global.answer(&timing.with("organ", organ)),
            None => global.answer(&timing),
        }
    }

    /// Opens the series that a DICOM segmentation refers to; `None` for another output.
    fn source_series(&self) -> Result<Option<SourceSeries>, CliError> {
        let is_dicom = self.output.to_string_lossy().to_lowercase().ends_with(DICOM);
        match &self.input {
            Some(input) if is_dicom => {
                Ok(Some(SourceSeries::open(input, &self.lumen.image_options())?))
            }
            None if is_dicom => {
                let why = "a DICOM SEG needs the DICOM series as INPUT; use .seg.nrrd without one";
                Err(CliError::Usage(format!("{}: {why}", shown(&self.output))))
            }
            _ if self.keep_patient => {
                Err(CliError::Usage("--keep-patient needs a DICOM SEG (.dcm) as output".into()))
            }
            _ => Ok(None),
        }
    }
}

const DICOM: &str = ".dcm";
/// Extensions of what is written.
const SEGMENTED: &[&str] = &[".nrrd", ".nii", ".nii.gz", ".mha", ".mhd", SEGMENTS, DICOM];
