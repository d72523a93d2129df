//! Clusters kept on disk between runs. A cache that cannot be read or written costs time and
//! nothing else.

use std::path::{Path, PathBuf};

use crate::formats::{FormatError, atomic_file, read_plain};
use crate::geometry::{Mesh, Vertex};
use crate::lod::clusters::{self, Clusters};

/// Files of the cache are `NAME`, a hash, `SUFFIX`.
const NAME: &str = "clusters-";
const SUFFIX: &str = ".bin";
/// Bytes of all of them together.
const CAPACITY_BYTES: u64 = 1 << 30;
/// Faces from which reading is faster than building.
const WORTH_KEEPING: usize = 20_000;

/// Returns the file of a mesh's clusters in `folder`; `None` for a mesh too small to be worth it.
pub(super) fn file_of(folder: &Path, mesh: &Mesh, vertices: &[Vertex]) -> Option<PathBuf> {
    (mesh.faces.len() >= WORTH_KEEPING).then(|| {
        let key = blake3::Hash::from(clusters::key(mesh, vertices));
        folder.join(format!("{NAME}{}{SUFFIX}", &key.to_hex()[..32]))
    })
}

/// Clusters of a mesh from a file, if they are there and are this mesh's.
pub(super) fn read(path: &Path, mesh: &Mesh, vertices: &[Vertex]) -> Option<Clusters> {
    let most = 200 * mesh.faces.len() as u64 + 4096;
    if std::fs::metadata(path).ok()?.len() > most {
        return None;
    }
    Clusters::from_bytes(&read_plain(path, most).ok()?, mesh, vertices).ok()
}

/// Writes a file and removes the oldest ones beyond the capacity.
pub(super) fn write(path: &Path, clusters: &Clusters) {
    let Some(folder) = path.parent() else { return };
    let bytes = clusters.to_bytes();
    let write = || -> Result<(), FormatError> {
        std::fs::create_dir_all(folder).map_err(|e| FormatError::io(folder, e))?;
        atomic_file::write_atomic(path, |o| o.write_all(&bytes))
    };
    if let Err(e) = write() {
        tracing::info!("clusters are not kept: {e}");
        return;
    }
    drop_oldest(folder, path);
}

fn drop_oldest(folder: &Path, newest: &Path) {
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
        if total <= CAPACITY_BYTES || old == newest {
            break;
        }
        let _ = std::fs::remove_file(old);
        total -= bytes;
    }
}
