//! Flags of level of detail, and its cache on disk.

use std::path::PathBuf;

use super::CliError;
use crate::geometry::{Mesh, Vertex};
use crate::pipeline::{Clock, Detail, Lod, detail};

/// Flags of level of detail.
#[derive(Clone, Debug, clap::Args)]
#[command(next_help_heading = "Level of detail")]
pub struct DetailArgs {
    /// clusters: original triangles near, coarser ones far; vds: the paper's subdivision; off
    #[arg(long, value_enum, default_value = "clusters")]
    pub lod: LodArg,
    /// Pixels that what is drawn may be away from the full mesh
    #[arg(long, value_name = "T", default_value_t = 1.0)]
    pub pixel_error: f32,
    /// Folder where clusters are kept between runs, or off (default: the user's cache folder)
    #[arg(long, value_name = "DIR|off")]
    pub lod_cache: Option<PathBuf>,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq, clap::ValueEnum)]
pub enum LodArg {
    Clusters,
    Vds,
    Off,
}

/// Checked flags.
#[derive(Clone, Debug)]
pub struct DetailSetup {
    pub lod: Lod,
    pub pixel_error: f32,
    cache: Option<PathBuf>,
}

impl DetailArgs {
    /// Checks the flags.
    pub fn check(&self) -> Result<DetailSetup, CliError> {
        if !(0.01..=100.0).contains(&self.pixel_error) {
            return Err(CliError::Usage(format!(
                "--pixel-error {}: 0.01 to 100 pixels",
                self.pixel_error
            )));
        }
        let lod = match self.lod {
            LodArg::Clusters => Lod::Clusters,
            LodArg::Vds => Lod::Vds,
            LodArg::Off => Lod::Off,
        };
        let cache = match &self.lod_cache {
            Some(off) if off.as_os_str() == "off" => None,
            Some(folder) => Some(folder.clone()),
            None => crate::formats::whole::user_cache(),
        };
        Ok(DetailSetup { lod, pixel_error: self.pixel_error, cache })
    }
}

impl DetailSetup {
    /// The wall at many levels, or nothing where the whole mesh is to be drawn.
    pub fn build(
        &self,
        mesh: &Mesh,
        vertices: &[Vertex],
        clock: &mut Clock,
    ) -> Result<Option<Detail>, CliError> {
        match self.lod {
            Lod::Off => Ok(None),
            Lod::Clusters => {
                let clusters = detail::clusters(mesh, vertices, clock)?;
                Ok(Some(Detail::of_clusters(clusters, self.pixel_error)))
            }
            Lod::Vds => Err(CliError::Usage("vds is not there".into())),
        }
    }
}
