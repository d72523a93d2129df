//! `intima convert`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, VOLUMES};
use super::input::read_checked;
use crate::formats::write_volume;

/// `intima convert INPUT -o VOLUME`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume to read
    input: PathBuf,
    /// Volume to write: .nrrd, .nii, .nii.gz, .mha or .mhd
    #[arg(short, long, value_name = "VOLUME")]
    output: PathBuf,
    /// DICOM series: UID, or index from 0
    #[arg(long, value_name = "UID|INDEX")]
    series: Option<String>,
}

impl Args {
    /// Reads and writes; geometry is kept.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, VOLUMES)?;
        let volume = match read_checked(&self.input, self.series.as_deref(), global) {
            // A sheared grid can be converted as it stands; only distances need a box.
            Err(CliError::Input(_)) => {
                let options = crate::formats::ReadOptions { series: self.series.clone() };
                crate::formats::read_volume(&self.input, &options)?
            }
            other => other?,
        };
        write_volume(&self.output, &volume)?;
        global.say(format_args!("wrote {}", self.output.display()))?;
        global.answer(&crate::pipeline::InputReport::of(&volume))
    }
}
