//! `intima distance`.

use std::path::PathBuf;

use super::CliError;
use super::global::{Global, VOLUMES};
use super::lumen_args::{LumenArgs, is_layered};
use super::repeat::timed_products;
use crate::formats::{shown, write_layers, write_volume};
use crate::session::{Product, Session, Settings};
use crate::volume::{Samples, Volume};

/// Voxels of a field above which a file that can be written in layers is.
const LARGE_VOXELS: usize = 1 << 28;

/// `intima distance INPUT LUMEN -o FIELD`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Field to write, 32-bit float, mm, 0 outside: .nrrd, .nii, .nii.gz, .mha or .mhd
    #[arg(short, long, value_name = "FIELD")]
    output: PathBuf,
    #[command(flatten)]
    lumen: LumenArgs,
}

impl Args {
    /// Computes the exact distance and writes it.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        global.check_output(&self.output, VOLUMES)?;
        self.lumen.check_outputs(global)?;
        let settings = Settings { lumen: self.lumen.settings()?, ..global.settings() };
        let mut session = Session::new(self.lumen.source(self.input.as_deref())?, settings)?;
        session.expect(&[Product::Distance]);
        let needs = [Product::Lumen, Product::Device];
        let anew = [Product::Distance];
        let (field, timing) =
            timed_products(global, &mut session, &needs, &anew, |s| Ok(s.distance()?))?;
        let segmented = session.lumen()?;
        let lumen = &segmented.lumen;
        let grid = lumen.stored_grid();
        let start = std::time::Instant::now();
        // The time to a dense field in memory is an answer; of a large one there is none.
        let is_large = is_layered(&self.output) && grid.len() > LARGE_VOXELS;
        let dense = (!is_large).then(|| lumen.dense(&field, 0.0f32));
        let dense_s = start.elapsed().as_secs_f64();
        match dense {
            Some(dense) => {
                write_volume(&self.output, &Volume::new(grid, Samples::from(dense)))?;
            }
            None => {
                write_layers(&self.output, &grid, |put| lumen.each_layer(&field, 0.0, put))?;
            }
        }
        self.lumen.write_choice(&session, global)?;
        let deepest = field.iter().copied().fold(0.0f32, f32::max);
        global.say(format_args!(
            "wrote {}: {} inside voxels, deepest {deepest:.3} mm",
            shown(&self.output),
            lumen.inside_voxels()
        ))?;
        let timing = timing
            .with("inside_voxels", lumen.inside_voxels())
            .with("max_distance_mm", f64::from(deepest))
            .with("dense_s", dense_s);
        global.answer(&timing)
    }
}
