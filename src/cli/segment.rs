//! `intima segment`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, VOLUMES};
use super::lumen_args::LumenArgs;
use super::timing::timed;
use crate::device::Device;
use crate::formats::write_volume;
use crate::volume::{Samples, Volume};

/// `intima segment INPUT LUMEN -o MASK`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Mask to write: .nrrd, .nii, .nii.gz, .mha or .mhd
    #[arg(short, long, value_name = "MASK")]
    output: PathBuf,
    /// Write 0 and 1 instead of the three classes
    #[arg(long)]
    binary: bool,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl Args {
    /// Chooses the lumen and writes it.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, VOLUMES)?;
        let chosen = self.lumen.load(self.input.as_deref(), global)?;
        let ((lumen, found), timing) = timed(global, &mut Device::Cpu, |_, clock| {
            let work = || chosen.lumen(global);
            clock.time("segment", "voxels", work, |r| {
                r.as_ref().map_or(0, |(l, _)| l.inside_voxels())
            })
        })?;
        let mut classes = lumen.classes();
        if self.binary {
            classes.iter_mut().for_each(|c| *c = (*c).min(1));
        }
        write_volume(&self.output, &Volume::new(lumen.grid, Samples::U8(classes)))?;
        global.say(format_args!(
            "wrote {}: {} internal and {} boundary voxels, {:.3} ml",
            self.output.display(),
            lumen.internal_voxels,
            lumen.boundary_voxels,
            lumen.volume_ml()
        ))?;
        let report = crate::pipeline::LumenReport::of(&lumen, &found);
        let report = serde_json::to_value(report).unwrap_or_default();
        global.answer(&timing.with("lumen", report))
    }
}
