//! `intima convert`.

use std::path::PathBuf;

use super::CliError;
use super::dicom_args::DicomArgs;
use super::global::{Global, VOLUMES};
use crate::formats::{inspect, shown, write_volume};
use crate::session::{InputReport, VolumeSource, converting_bytes, read_any_volume};

/// `intima convert INPUT -o VOLUME`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume to read
    input: PathBuf,
    /// Volume to write: .nrrd, .nii, .nii.gz, .mha or .mhd
    #[arg(short, long, value_name = "VOLUME")]
    output: PathBuf,
    #[command(flatten)]
    dicom: DicomArgs,
}

impl Args {
    /// Reads and writes; geometry is kept.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, VOLUMES)?;
        // A sheared grid is converted as it stands; only distances need a box.
        let source = VolumeSource::File { path: self.input.clone(), options: self.dicom.options() };
        if global.asks_memory() {
            self.check_memory(global)?;
        }
        let volume = read_any_volume(&source, global.max_memory)?;
        write_volume(&self.output, &volume)?;
        global.say(format_args!("wrote {}", shown(&self.output)))?;
        global.answer(&InputReport::of(&volume))
    }

    /// Estimates memory from the header; what has none to read is refused where it is read.
    fn check_memory(&self, global: &Global) -> Result<(), CliError> {
        let info = inspect(&self.input, &self.dicom.options());
        match info.ok().and_then(|info| info.image) {
            Some(image) => {
                let bytes = converting_bytes(&image, &self.output);
                global.check_memory(bytes, "estimated for reading and writing")
            }
            None => Ok(()),
        }
    }
}
