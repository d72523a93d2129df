//! Level of detail of a wall: building it, and what the report says of it.

use std::sync::Arc;

use serde::Serialize;

use super::{Clock, PipelineError};
use crate::geometry::{Mesh, Vertex};
use crate::lod::clusters::{ClusterLod, Clusters, DEFAULT_SHADING_RAD};
use crate::lod::{PAGE_BYTES, Refine};

/// How a wall is drawn.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Lod {
    /// Clusters of original triangles and ever coarser ones above them.
    #[default]
    Clusters,
    /// The paper's: a base mesh subdivided where the camera looks.
    Vds,
    /// The whole mesh.
    Off,
}

/// Bytes written to pages in one step, at most.
pub const UPLOAD_BYTES: u64 = 4 << 20;
/// Bytes of all pages, at most.
const RESIDENT_BYTES: u64 = 256 << 20;

/// A wall at many levels.
pub struct Detail {
    /// It, with nothing refined.
    pub refine: Box<dyn Refine>,
    /// Pages it is given.
    pub pages: u32,
    /// What to say of it.
    pub report: LodReport,
}

/// Level of detail.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
#[allow(missing_docs)]
pub struct LodReport {
    pub mode: &'static str,
    pub pixel_error: f32,
    /// Faces of the coarsest surface.
    pub base_faces: u64,
    /// Faces of the finest.
    pub finest_faces: u64,
    /// Clusters or leaves.
    pub patches: u64,
    pub build_ms: f64,
    /// Found on disk instead of built.
    pub cached: bool,
    pub bytes: u64,
    pub pages: u32,
}

/// Clusters of a mesh, from `stored` if those are of this very mesh; also whether they were.
///
/// # Errors
/// [`PipelineError::Clusters`] for a mesh that makes no sense.
pub fn clusters(
    mesh: &Mesh,
    vertices: &[Vertex],
    clock: &mut Clock,
) -> Result<Clusters, PipelineError> {
    let built = clock.time(
        "clusters",
        "faces",
        || Clusters::build(mesh, vertices),
        |_| mesh.faces.len() as u64,
    );
    Ok(built?)
}

impl Detail {
    /// Clusters ready to be refined.
    pub fn of_clusters(clusters: Clusters, pixel_error: f32) -> Self {
        let count = clusters.clusters().len() as u64;
        let base = |c: u32| u64::from(clusters.clusters()[c as usize].triangles);
        let report = LodReport {
            mode: "clusters",
            pixel_error,
            base_faces: clusters.roots().map(base).sum(),
            finest_faces: clusters.finest_faces(),
            patches: count,
            bytes: clusters.bytes() as u64,
            ..Default::default()
        };
        let refine = ClusterLod::new(Arc::new(clusters), DEFAULT_SHADING_RAD);
        // All of it if it fits: then nothing is ever driven out.
        let most = (RESIDENT_BYTES / PAGE_BYTES) as u32;
        let pages = (count.min(u64::from(most)) as u32).max(refine.least_pages());
        Self { refine: Box::new(refine), pages, report: LodReport { pages, ..report } }
    }
}
