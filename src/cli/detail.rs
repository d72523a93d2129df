//! Flags of level of detail, and its cache on disk.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use super::CliError;
use crate::formats::{FormatError, atomic_file};
use crate::geometry::{Mesh, Vertex};
use crate::lod::clusters::{self, Clusters};
use crate::lod::{ExteriorGrid, OcclusionTest};
use crate::pipeline::{Clock, Detail, Lod, beside, detail, return_freed_memory};

/// Files of the cache are `NAME`, a hash, `SUFFIX`.
const NAME: &str = "clusters-";
const SUFFIX: &str = ".bin";
/// Bytes of all of them together.
const KEPT_BYTES: u64 = 1 << 30;
/// Faces from which reading is faster than building.
const WORTH_KEEPING: u64 = 20_000;

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
            None => atomic_file::user_cache(),
        };
        Ok(DetailSetup { lod, pixel_error: self.pixel_error, cache })
    }
}

impl DetailSetup {
    /// The wall at many levels, or nothing where the whole mesh is to be drawn; and what is to be
    /// kept of it. `closed`: the wall has no hole.
    pub fn build(
        &self,
        mesh: &Mesh,
        vertices: &[Vertex],
        closed: bool,
        clock: &mut Clock,
    ) -> Result<Option<(Detail, Option<Keep>)>, CliError> {
        match self.lod {
            Lod::Off => Ok(None),
            Lod::Clusters => {
                let mut other = clock.beside();
                let (cells, found) = beside(
                    || {
                        let work = || ExteriorGrid::new(mesh);
                        closed.then(|| {
                            other.time("outside", "faces", work, |_| mesh.faces.len() as u64)
                        })
                    },
                    || self.clusters(mesh, vertices, clock),
                );
                clock.take(other);
                let (clusters, cached, keep) = found?;
                let margin = clusters.largest_error_mm();
                let outside = cells.map(|cells| Arc::new(OcclusionTest::new(cells, margin)));
                let detail = Detail::of_clusters(clusters, self.pixel_error, cached, outside);
                Ok(Some((detail, keep)))
            }
            Lod::Vds => {
                return_freed_memory();
                let base = detail::base_faces(mesh);
                let detail = Detail::of_subdivision(mesh, vertices, base, self.pixel_error, clock)?;
                Ok(Some((detail, None)))
            }
        }
    }

    /// Clusters from the cache, or built and to be kept there; and which of the two. A cache that
    /// cannot be read or written costs time and nothing else.
    fn clusters(
        &self,
        mesh: &Mesh,
        vertices: &[Vertex],
        clock: &mut Clock,
    ) -> Result<(Arc<Clusters>, bool, Option<Keep>), CliError> {
        let faces = mesh.faces.len() as u64;
        // A small mesh is clustered sooner than it is looked up.
        let file = self.cache.as_deref().filter(|_| faces >= WORTH_KEEPING).map(|folder| {
            let key = blake3::Hash::from(clusters::key(mesh, vertices));
            folder.join(format!("{NAME}{}{SUFFIX}", &key.to_hex()[..32]))
        });
        let read = |path: &PathBuf| -> Option<Clusters> {
            let most = 200 * faces + 4096;
            if std::fs::metadata(path).ok()?.len() > most {
                return None;
            }
            Clusters::from_bytes(&std::fs::read(path).ok()?, mesh, vertices).ok()
        };
        if let Some(path) = &file
            && let Some(found) = clock.time("kept clusters", "faces", || read(path), |_| faces)
        {
            return Ok((Arc::new(found), true, None));
        }
        return_freed_memory();
        let build = || Clusters::build(mesh, vertices);
        let built = clock.time("clusters", "faces", build, |_| faces);
        let built = Arc::new(built.map_err(crate::pipeline::PipelineError::from)?);
        let keep = file.map(|path| Keep { clusters: Arc::clone(&built), path });
        Ok((built, false, keep))
    }
}

/// Clusters that were built and should be found next time.
pub struct Keep {
    path: PathBuf,
    clusters: Arc<Clusters>,
}

impl Keep {
    /// Writes the file: nobody waits for it, so it can be done beside the drawing.
    pub fn write(self) {
        keep(&self.path, &self.clusters.to_bytes());
    }
}

/// Writes a file of the cache and removes the oldest ones beyond [`KEPT_BYTES`].
fn keep(path: &Path, bytes: &[u8]) {
    let Some(folder) = path.parent() else { return };
    let write = || -> Result<(), FormatError> {
        std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
        atomic_file::write_atomic(path, |o| o.write_all(bytes))
    };
    if let Err(e) = write() {
        tracing::info!("clusters are not kept: {e}");
        return;
    }
    let Ok(listed) = std::fs::read_dir(folder) else { return };
    let mut files: Vec<_> = listed
        .flatten()
        .filter(|f| {
            let name = f.file_name();
            let name = name.to_string_lossy();
            name.starts_with(NAME) && name.ends_with(SUFFIX)
        })
        .filter_map(|f| Some((f.metadata().ok()?, f.path())))
        .filter_map(|(m, path)| Some((m.modified().ok()?, m.len(), path)))
        .collect();
    files.sort();
    let mut total: u64 = files.iter().map(|f| f.1).sum();
    for (_, bytes, old) in files {
        if total <= KEPT_BYTES || old == path {
            break;
        }
        let _ = std::fs::remove_file(old);
        total -= bytes;
    }
}
