//! `intima segment`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, VOLUMES};
use super::lumen_args::LumenArgs;
use super::repeat::timed_products;
use crate::device::DeviceChoice;
use crate::formats::{shown, write_volume};
use crate::session::{LumenReport, OrganReport, Product, Session, Settings, WallReport};
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
        let settings = Settings { lumen: self.lumen.settings()?, ..global.settings() };
        let settings = Settings { device: DeviceChoice::Cpu, ..settings };
        let mut session = Session::new(self.lumen.source(self.input.as_deref())?, settings)?;
        let (segmented, timing) =
            timed_products(global, &mut session, &[Product::Volume], &[Product::Core], |s| {
                Ok(s.lumen()?)
            })?;
        let lumen = &segmented.lumen;
        let mut classes = lumen.classes();
        if self.binary {
            classes.iter_mut().for_each(|c| *c = (*c).min(1));
        }
        write_volume(&self.output, &Volume::new(lumen.grid, Samples::from(classes)))?;
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
}
