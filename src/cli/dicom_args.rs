//! Flags of DICOM input.

use crate::formats::ReadOptions;

/// Which series, and how it is read.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "DICOM")]
pub struct DicomArgs {
    /// DICOM series: UID, or index from 0
    #[arg(long, value_name = "UID|INDEX")]
    pub series: Option<String>,
    /// Interpolate where DICOM slices are uneven or missing
    #[arg(long)]
    pub fill_gaps: bool,
}

impl DicomArgs {
    /// How to read.
    pub fn options(&self) -> ReadOptions {
        ReadOptions { series: self.series.clone(), fill_gaps: self.fill_gaps }
    }
}
