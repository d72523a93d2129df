//! The surface of the lumen: iso-surface extraction by a consistent cell table, topology, smooth
//! normals, and curvature tint.

mod extract;
mod fair;
mod grey;
mod heat;
mod multiscale;
mod relax;
mod shading;
pub mod table;
mod topology;

pub use extract::{Crossing, GridEdge, Midpoint, clamp_fraction, extract, vertex_edges};
pub use fair::{DEFAULT_STEPS, Fairing, Smoothing, Weights, face_normals, fair, weights};
pub use grey::Grey;
pub use multiscale::{MultiscaleNormals, VoxelFrame, multiscale_normals};
pub use relax::{MAX_SPACING_RATIO, RelaxError, RelaxInput, relax, relaxes_by_default};
pub use shading::{Shading, shading};
pub use topology::{Adjacency, Topology, keep_component};

use crate::geometry::Mesh;
use crate::lumen::Lumen;

/// The surface of a lumen with its adjacency and counts.
pub struct Surface {
    /// Mesh of the surface; normals still empty.
    pub mesh: Mesh,
    /// Adjacent vertices.
    pub adjacency: Adjacency,
    /// Topological counts.
    pub topology: Topology,
}

impl Surface {
    /// Extracts the surface. With `seed` (an inside voxel) only the component that a ray from there
    /// along +x leaves through is kept: the single-surface tracking of Li et al. 2004.
    pub fn new(lumen: &Lumen, crossing: &impl Crossing, seed: Option<glam::IVec3>) -> Self {
        Self::of(extract(lumen, crossing), lumen, seed)
    }

    /// Computes adjacency and counts of a lumen's extracted mesh; `seed` as in [`Surface::new`].
    pub fn of(mesh: Mesh, lumen: &Lumen, seed: Option<glam::IVec3>) -> Self {
        let (adjacency, watertight) = Adjacency::of(&mesh);
        let topology = adjacency.topology(&mesh, watertight);
        if topology.components > 1
            && let Some(v) = seed.and_then(|s| extract::vertex_beyond(lumen, s))
        {
            let mesh = keep_component(&mesh, &adjacency.components(), v);
            let (adjacency, watertight) = Adjacency::of(&mesh);
            let topology = adjacency.topology(&mesh, watertight);
            return Self { mesh, adjacency, topology };
        }
        Self { mesh, adjacency, topology }
    }
}

#[cfg(test)]
mod tests;
