//! `intima hessian`.

use std::path::PathBuf;
use std::time::{Duration, Instant};

use super::CliError;
use super::global::{Global, VOLUMES};
use super::input::read_checked;
use super::lumen_args::LumenArgs;
use super::timing::timed;
use crate::field::Response;
use crate::formats::{write_vector_field, write_volume};
use crate::pipeline::{hessian_field, volume_as_bricks};
use crate::volume::{Samples, Volume};

/// `intima hessian INPUT [LUMEN] -o FIELD`
#[derive(Debug, clap::Args)]
pub struct Args {
    /// Volume; may be left out with --mask
    input: Option<PathBuf>,
    /// Field to write: .nrrd (one or three components), or any volume format for one
    #[arg(short, long, value_name = "FIELD")]
    output: PathBuf,
    /// What to analyse: the exact distance in the lumen, or the grey values
    #[arg(long, value_enum, default_value = "distance")]
    of: Of,
    /// Gaussian before the derivatives, mm (default: the smallest voxel spacing)
    #[arg(long, value_name = "MM")]
    sigma: Option<f64>,
    /// ridge: max(0, -l2); tubeness: sqrt(l1 l2) where l2 < 0; eigenvalues: all three, ascending
    #[arg(long, value_enum, default_value = "ridge")]
    response: Kind,
    /// Look for dark ridges (air in grey values) instead of bright ones
    #[arg(long)]
    dark: bool,
    #[command(flatten)]
    lumen: LumenArgs,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Of {
    Distance,
    Grey,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
enum Kind {
    Ridge,
    Tubeness,
    Eigenvalues,
}

impl Args {
    /// Computes the response and writes it.
    pub fn run(&self, global: &Global) -> Result<(), CliError> {
        let three = self.response == Kind::Eigenvalues;
        global.check_output(&self.output, if three { &[".nrrd"] } else { VOLUMES })?;
        let l = &self.lumen;
        let mut copied = Duration::ZERO; // into bricks and out of them
        let whole = self.of == Of::Grey && l.mask.is_none() && l.threshold.is_none();
        let (volume, lumen, grey) = if whole {
            let input = self.input.as_deref();
            let input = input.ok_or_else(|| CliError::Usage("an INPUT is needed".into()))?;
            let volume = read_checked(input, l.series.as_deref(), global)?;
            let start = Instant::now();
            let (lumen, values) = volume_as_bricks(&volume);
            copied += start.elapsed();
            (volume, lumen, Some(values))
        } else if self.of == Of::Grey {
            return Err(CliError::Usage(
                "--of grey analyses the whole volume: leave --mask and --threshold out".into(),
            ));
        } else {
            let chosen = l.load(self.input.as_deref(), global)?;
            let (lumen, _) = chosen.lumen(global)?;
            (chosen.volume, lumen, None)
        };
        let least = volume.grid.spacing_mm.min_element();
        let sigma = self.sigma.unwrap_or(least);
        if !(sigma > 0.0 && sigma <= 50.0 * least) {
            return Err(CliError::Usage(format!(
                "--sigma {sigma}: between 0 and 50 voxels ({} mm)",
                50.0 * least
            )));
        }
        let response = match self.response {
            Kind::Ridge => Response::Ridge,
            Kind::Tubeness => Response::Tubeness,
            Kind::Eigenvalues => Response::Eigenvalues,
        };
        let repeat_edge = whole.then_some(volume.grid.dims);
        let mut device = global.open()?;
        let (field, timing) = timed(global, &mut device, |device, clock| {
            let what = (sigma, response, self.dark);
            Ok(hessian_field(device, &lumen, grey.as_deref(), what, repeat_edge, clock)?)
        })?;
        let start = Instant::now();
        if response == Response::Eigenvalues {
            let triples: &[[f32; 3]] = bytemuck::cast_slice(&field);
            let dense = lumen.dense(triples, [0.0; 3]);
            copied += start.elapsed();
            write_vector_field(&self.output, &lumen.grid, 3, bytemuck::cast_slice(&dense))?;
        } else {
            let dense = lumen.dense(&field, 0.0f32);
            copied += start.elapsed();
            write_volume(&self.output, &Volume::new(lumen.grid, Samples::F32(dense)))?;
        }
        global.say(format_args!("wrote {} (sigma {sigma} mm)", self.output.display()))?;
        global.answer(&timing.with("sigma_mm", sigma).with("dense_s", copied.as_secs_f64()))
    }
}
