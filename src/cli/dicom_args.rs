//! Flags of DICOM input.

use crate::formats::ReadOptions;

/// DICOM flags.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "DICOM")]
pub struct DicomArgs {
    /// DICOM series: UID, or index from 0
    #[arg(long, value_name = "UID|INDEX")]
    pub series: Option<String>,
    /// Number of the volume among several at the same places (times, echoes, phases), from 0: DICOM, NIfTI, NRRD
    #[arg(long, value_name = "N")]
    pub volume: Option<usize>,
    /// Interpolate where DICOM slices are uneven or missing
    #[arg(long)]
    pub fill_gaps: bool,
    /// Read DICOM pixels that may show who the patient is: burned-in text, a face, a screen capture
    #[arg(long)]
    pub allow_burned_in: bool,
    /// Take this segment of a segmentation (.seg.nrrd, DICOM SEG) given as INPUT or --mask, by its name; may be repeated
    #[arg(long, value_name = "NAME", help_heading = "Choosing the lumen")]
    pub segment: Vec<String>,
    /// Side of the voxels that a closed mesh (.ply .stl .obj .vtp) given as INPUT or --mask is cut into, mm
    #[arg(long, value_name = "MM", help_heading = "Choosing the lumen")]
    pub mesh_spacing: Option<f64>,
}

impl DicomArgs {
    /// Returns the options for reading an input.
    pub fn options(&self) -> ReadOptions {
        ReadOptions {
            series: self.series.clone(),
            volume: self.volume,
            fill_gaps: self.fill_gaps,
            allow_burned_in: self.allow_burned_in,
            segments: self.segment.clone(),
            mesh_spacing_mm: self.mesh_spacing,
        }
    }
}
