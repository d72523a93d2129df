//! Flags of the surface and its normals.

use super::CliError;
use crate::formats::Facing;
use crate::session::WallSettings;
use crate::surface::{Fairing, Smoothing, Weights};

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
    pub weights: Option<Weights>,
}

/// Surface flags.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Surface")]
pub struct SurfaceArgs {
    #[command(flatten)]
    pub fair: FairArgs,
    /// Vertices of an exact wall: grey interpolates the threshold between voxels, mask is half way
    #[arg(long, value_enum, default_value = "grey")]
    pub surface_from: SurfaceFrom,
    /// Leave caps at the edge of the volume out
    #[arg(long)]
    pub open_ends: bool,
    /// Side that faces and normals of mesh files look to
    #[arg(long, value_enum, default_value = "out")]
    pub facing: Facing,
    /// Faces of the simplified surface: what `surface` writes, and base.ply of `run`
    #[arg(long, value_name = "FACES", value_parser = clap::value_parser!(u32).range(4..))]
    pub decimate: Option<u32>,
}

/// Splitting of the surface that `surface` writes.
#[derive(Clone, Debug, clap::Args)]
pub struct RefineArgs {
    /// Split every face 1-to-4 so many times onto the smooth wall
    #[arg(
        long,
        value_name = "N",
        conflicts_with = "decimate",
        value_parser = clap::value_parser!(u32).range(1..=3),
        help_heading = "Surface"
    )]
    pub refine: Option<u32>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum SurfaceFrom {
    Grey,
    Mask,
}

impl FairArgs {
    /// The smoothing asked for; `None` where it is left open.
    pub fn smoothing(&self) -> Result<Option<Smoothing>, CliError> {
        let steps = match self.smooth.as_str() {
            "auto" => None,
            n => Some(n.parse().map_err(|_| {
                CliError::Usage(format!("--smooth `{n}`: a number of steps, or auto"))
            })?),
        };
        if steps.is_none() && self.lambda.is_none() && self.weights.is_none() {
            return Ok(None);
        }
        let paper = Fairing::PAPER;
        let fairing = Fairing {
            steps: steps.unwrap_or(paper.steps),
            lambda: self.lambda.unwrap_or(paper.lambda),
            weights: self.weights.unwrap_or(paper.weights),
        };
        fairing.check()?;
        Ok(Some(Smoothing::Steps(fairing)))
    }
}

impl SurfaceArgs {
    /// Settings of the wall.
    pub fn settings(&self) -> Result<WallSettings, CliError> {
        Ok(WallSettings {
            from_mask: self.surface_from == SurfaceFrom::Mask,
            smoothing: self.fair.smoothing()?,
            open_ends: self.open_ends,
            facing: self.facing,
            base_faces: self.decimate.map(|n| n as usize),
        })
    }
}
