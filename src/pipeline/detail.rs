//! Level of detail of a wall: building it, and what the report says of it.

use std::sync::Arc;

use serde::Serialize;

use super::{Clock, Mode, PipelineError};
use crate::geometry::{Mesh, Vertex};
use crate::lod::clusters::{ClusterLod, Clusters, DEFAULT_SHADING_RAD};
use crate::lod::vds::{ParameterizedOriginal, Surface, Vds, VdsOptions};
use crate::lod::{LodHierarchy, OcclusionTest, PAGE_BYTES};
use crate::mesh::{MeshError, Metric, Parameterization, SimplifyOptions, make_manifold, simplify};

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
    pub refine: Box<dyn LodHierarchy>,
    /// Pages it is given.
    pub pages: u32,
    /// What to say of it.
    pub report: LodReport,
    /// The clusters, if it is these.
    pub clusters: Option<Arc<Clusters>>,
    /// What a closed wall hides, if that is known.
    pub outside: Option<Arc<OcclusionTest>>,
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
    /// Found on disk instead of built.
    pub cached: bool,
    pub bytes: u64,
    pub pages: u32,
}

/// Faces of the base under a mesh when nobody says: a twentieth, as in the paper's vessel.
pub fn base_faces(mesh: &Mesh) -> usize {
    (mesh.faces.len() / 20).max(MIN_BASE_FACES.min(mesh.faces.len()))
}

/// A base is made of a surface of so many times its faces, where there is one.
const BASE_OF: u64 = 6;

/// A mesh with so many faces: by the default metric with vertices moved to where they stand best,
/// or by the paper's with vertices that stay. Where fans of faces touch they are parted first.
///
/// By default it begins with what `clusters` of the mesh have at six times the faces, where
/// there are any: that errs a small part of what the base will, and takes three tenths of the time.
///
/// # Errors
/// [`PipelineError::Mesh`] for a mesh that makes no sense.
pub fn base(
    mesh: &Mesh,
    clusters: Option<&Clusters>,
    faces: usize,
    mode: Mode,
    clock: &mut Clock,
) -> Result<Mesh, PipelineError> {
    let options = SimplifyOptions {
        metric: if mode == Mode::Paper { Metric::Paper } else { Metric::NormalQem },
        relocate: mode == Mode::Default,
        ..SimplifyOptions::to_faces(faces)
    };
    let work = || -> Result<Mesh, MeshError> {
        let begun = clusters.filter(|_| mode == Mode::Default);
        let begun = begun.map(|c| c.uniform_cut(BASE_OF * faces as u64).0);
        let mesh = begun.as_ref().unwrap_or(mesh);
        match simplify(mesh, &options, &mut ()) {
            Err(MeshError::NonManifoldEdge { .. } | MeshError::NonManifoldVertex { .. }) => {
                Ok(simplify(&make_manifold(mesh)?.0, &options, &mut ())?.mesh)
            }
            done => Ok(done?.mesh),
        }
    };
    Ok(clock.time("base", "faces", work, |_| mesh.faces.len() as u64)?)
}

/// Below this a base saves nothing worth having.
const MIN_BASE_FACES: usize = 500;

impl Detail {
    /// Clusters ready to be refined.
    ///
    /// * `cached`: they were read, not built.
    /// * `outside`: of a closed wall, with as much margin as the largest error of any group.
    pub fn of_clusters(
        clusters: impl Into<Arc<Clusters>>,
        pixel_error: f32,
        cached: bool,
        outside: Option<Arc<OcclusionTest>>,
    ) -> Self {
        let clusters = clusters.into();
        let count = clusters.clusters().len() as u64;
        let base = |c: u32| u64::from(clusters.clusters()[c as usize].triangles);
        let report = LodReport {
            mode: "clusters",
            pixel_error,
            base_faces: clusters.roots().map(base).sum(),
            finest_faces: clusters.finest_faces(),
            patches: count,
            bytes: clusters.bytes() as u64,
            cached,
            ..Default::default()
        };
        let mut refine = ClusterLod::new(Arc::clone(&clusters), DEFAULT_SHADING_RAD);
        if let Some(outside) = &outside {
            refine = refine.with_occlusion(Arc::clone(outside));
        }
        // All of it if it fits: then nothing is ever driven out.
        let most = (RESIDENT_BYTES / PAGE_BYTES) as u32;
        let pages = (count.min(u64::from(most)) as u32).max(refine.least_pages());
        let report = LodReport { pages, ..report };
        Self { refine: Box::new(refine), pages, report, clusters: Some(clusters), outside }
    }

    /// The paper's: the mesh simplified to `base` faces, subdivided where the camera looks, every
    /// new vertex on the original by the record of the collapses.
    ///
    /// # Errors
    /// [`PipelineError`]: a mesh that half-edges cannot hold, or that is too large.
    pub fn of_subdivision(
        mesh: &Mesh,
        vertices: &[Vertex],
        base: usize,
        pixel_error: f32,
        clock: &mut Clock,
    ) -> Result<Self, PipelineError> {
        let mut maps = Parameterization::new(mesh)?;
        // The samples are the original's own: a base that moved would only mislead the bounds.
        let options = SimplifyOptions { relocate: false, ..SimplifyOptions::to_faces(base) };
        let simplified = clock.time(
            "simplify",
            "faces",
            || simplify(mesh, &options, &mut maps),
            |_| mesh.faces.len() as u64,
        )?;
        let original = ParameterizedOriginal::new(mesh, vertices, &simplified, &maps);
        let build = || Surface::new(&simplified.mesh, &original, VdsOptions::default());
        let count = simplified.mesh.faces.len() as u64;
        let surface = clock.time("subdivision", "base faces", build, |_| count)?;
        let report = LodReport {
            mode: "vds",
            pixel_error,
            base_faces: surface.base_faces(),
            finest_faces: surface.base_faces() << (2 * surface.depth()),
            patches: surface.leaves() as u64,
            bytes: surface.bytes() as u64,
            ..Default::default()
        };
        let refine = Vds::new(Arc::new(surface));
        let most = (RESIDENT_BYTES / PAGE_BYTES) as u32;
        let pages = most.max(refine.least_pages());
        let report = LodReport { pages, ..report };
        let refine = Box::new(refine);
        Ok(Self { refine, pages, report, clusters: None, outside: None })
    }
}
