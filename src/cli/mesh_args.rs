//! Flags of the surface and its normals.

use super::CliError;
use crate::pipeline::SurfaceOptions;
use crate::surface::{Fairing, Weights};

/// `--from`, which names where the surface lies and where the path starts: in `run` it may be
/// given once for each.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct FromArgs {
    /// Sub-voxel crossings from grey values; the default wherever there is a threshold.
    pub grey: bool,
    /// Where the path starts, LPS mm.
    pub start: Option<glam::DVec3>,
}

impl FromArgs {
    /// Sorts the values of `--from` by what they are.
    pub fn of(values: &[String]) -> Result<Self, CliError> {
        let mut out = Self { grey: true, start: None };
        for v in values {
            match v.as_str() {
                "grey" => out.grey = true,
                "mask" => out.grey = false,
                _ => out.start = Some(super::lumen_args::point(v, "--from")?),
            }
        }
        Ok(out)
    }
}

/// Fairing flags.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Surface")]
pub struct FairArgs {
    /// Steps of normal smoothing, or auto (30)
    #[arg(long, value_name = "N|auto", default_value = "auto")]
    pub smooth: String,
    /// Share of the neighbours' mean in a step, between 0 and 1
    #[arg(long, value_name = "L", default_value_t = 0.5)]
    pub lambda: f32,
    /// Weights of the neighbours (default: by spacing and radius)
    #[arg(long, value_enum)]
    pub weights: Option<WeightArg>,
}

/// Surface flags.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Surface")]
pub struct SurfaceArgs {
    #[command(flatten)]
    pub fair: FairArgs,
    /// Leave caps at the edge of the volume out
    #[arg(long)]
    pub open_ends: bool,
    /// Faces of the simplified surface: what `surface` writes, and the base of `run`
    #[arg(long, value_name = "FACES", value_parser = clap::value_parser!(u32).range(4..))]
    pub decimate: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum WeightArg {
    Uniform,
    InverseDistance,
}

impl FairArgs {
    /// The fairing asked for; `automatic` fills what was left open.
    pub fn fairing(&self, automatic: Fairing) -> Result<Fairing, CliError> {
        let steps =
            match self.smooth.as_str() {
                "auto" => automatic.steps,
                n => n.parse().ok().filter(|n| *n <= 10_000).ok_or_else(|| {
                    CliError::Usage(format!("--smooth `{n}`: 0 to 10000, or auto"))
                })?,
            };
        if !(self.lambda > 0.0 && self.lambda < 1.0) {
            return Err(CliError::Usage(format!(
                "--lambda {}: between 0 and 1; at 1 the steps oscillate",
                self.lambda
            )));
        }
        let weights = match self.weights {
            None => automatic.weights,
            Some(WeightArg::Uniform) => Weights::Uniform,
            Some(WeightArg::InverseDistance) => Weights::InverseDistance,
        };
        Ok(Fairing { steps, lambda: self.lambda, weights })
    }
}

impl SurfaceArgs {
    /// Options for a lumen whose widest inscribed ball has this radius, or a guess of it.
    pub fn options(
        &self,
        from_grey: bool,
        automatic: Fairing,
        track_from: Option<glam::IVec3>,
    ) -> Result<SurfaceOptions, CliError> {
        Ok(SurfaceOptions { from_grey, fairing: self.fair.fairing(automatic)?, track_from })
    }
}
