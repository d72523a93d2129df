//! Flags of the surface and its normals.

use super::CliError;
use crate::pipeline::SurfaceOptions;
use crate::surface::{Fairing, Smoothing, Weights};

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
    /// Normals: auto smooths each vertex as far as its surroundings allow (paper mode: 30 steps);
    /// a number takes so many steps of the paper's smoothing everywhere
    #[arg(long, value_name = "N|auto", default_value = "auto")]
    pub smooth: String,
    /// Share of the neighbours' mean in a step, between 0 and 1 (default: 0.5)
    #[arg(long, value_name = "L")]
    pub lambda: Option<f32>,
    /// Weights of the neighbours in a step (default: uniform)
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
    /// The smoothing asked for: `automatic`, unless anything about steps is said.
    pub fn smoothing(&self, automatic: Smoothing) -> Result<Smoothing, CliError> {
        let steps =
            match self.smooth.as_str() {
                "auto" => None,
                n => Some(n.parse().ok().filter(|n| *n <= 10_000).ok_or_else(|| {
                    CliError::Usage(format!("--smooth `{n}`: 0 to 10000, or auto"))
                })?),
            };
        if steps.is_none() && self.lambda.is_none() && self.weights.is_none() {
            return Ok(automatic);
        }
        let paper = Fairing::PAPER;
        let lambda = self.lambda.unwrap_or(paper.lambda);
        if !(lambda > 0.0 && lambda < 1.0) {
            return Err(CliError::Usage(format!(
                "--lambda {lambda}: between 0 and 1; at 1 the steps oscillate"
            )));
        }
        let weights = match self.weights {
            None => paper.weights,
            Some(WeightArg::Uniform) => Weights::Uniform,
            Some(WeightArg::InverseDistance) => Weights::InverseDistance,
        };
        Ok(Smoothing::Steps(Fairing { steps: steps.unwrap_or(paper.steps), lambda, weights }))
    }
}

impl SurfaceArgs {
    /// Options of the surface; `automatic` smooths where the user leaves it open.
    pub fn options(
        &self,
        from_grey: bool,
        automatic: Smoothing,
        track_from: Option<glam::IVec3>,
    ) -> Result<SurfaceOptions, CliError> {
        Ok(SurfaceOptions { from_grey, smoothing: self.fair.smoothing(automatic)?, track_from })
    }
}
