//! Levels of detail of the wall and its simplified base, and what the report says of them.

use std::path::PathBuf;
use std::sync::Arc;

use serde::Serialize;

use super::settings::{LevelSettings, Lod};
use super::{Clock, Session, SessionError, level_cache, locked, present};
use crate::geometry::{ExteriorGrid, Mesh, TriangleBvh, Vertex};
use crate::lod::clusters::{ClusterLod, Clusters, DEFAULT_SHADING_RAD};
use crate::lod::vds::{
    ParameterizedOriginal, ResidentPatches, SubdivisionSurface, Vds, VdsOptions,
};
use crate::lod::{FaceOctree, LodHierarchy, OcclusionTest, PAGE_BYTES, Tolerance, Worker};
use crate::mesh::{MeshError, Parameterization, SimplifyOptions, make_manifold, simplify};
use crate::render::{Culling, IN_FLIGHT, PagesHandle, RenderError, Renderer};
use crate::vk::{Gpu, return_freed_memory};

/// Bytes written to pages in one step, at most.
const UPLOAD_BYTES: u64 = 4 << 20;
/// Bytes of all pages, at most.
const RESIDENT_BYTES: u64 = 256 << 20;

/// Clusters as they were built or read.
pub(super) struct BuiltClusters {
    pub clusters: Arc<Clusters>,
    /// Whether they were read from the cache.
    cached: bool,
    /// File to keep them in, where they were built.
    keep: Option<PathBuf>,
}

/// A wall at many levels of detail; each flight refines its own [`Levels::hierarchy`] of it.
pub struct Levels {
    kind: LevelKind,
    /// Number of pages a hierarchy is given.
    pub pages: u32,
    /// Report of the levels.
    pub report: LodReport,
    /// Occlusion test of a closed wall, where there is one.
    pub occlusion: Option<Arc<OcclusionTest>>,
}

enum LevelKind {
    Clusters(Arc<Clusters>),
    Subdivision(Arc<SubdivisionSurface>),
}

/// Level of detail.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LodReport {
    /// Kind of levels, `clusters` or `vds`; `culled` or `off` where the whole wall is drawn.
    pub mode: &'static str,
    /// Subdivision scheme, of `vds`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub scheme: Option<&'static str>,
    /// Distance of the finest surface from the wall, mm, of `vds`.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub finest_error_mm: Option<f32>,
    /// Cost by which the base was simplified, where there is one.
    #[serde(skip_serializing_if = "Option::is_none")]
    pub metric: Option<&'static str>,
    /// Largest error of a frame, pixels.
    pub pixel_error: f32,
    /// Faces of the coarsest surface.
    pub base_faces: u64,
    /// Faces of the finest.
    pub finest_faces: u64,
    /// Clusters or leaves.
    pub patches: u64,
    /// Found on disk instead of built.
    pub cached: bool,
    /// Size of all levels.
    pub bytes: u64,
    /// Pages of the persistent buffers.
    pub pages: u32,
}

impl LodReport {
    /// The whole wall of so many faces is drawn, or what cameras can see of it.
    pub(super) fn whole(faces: u64, culled: bool) -> Self {
        let mode = if culled { "culled" } else { "off" };
        Self { mode, base_faces: faces, finest_faces: faces, ..Self::default() }
    }
}

/// Faces of the base under a mesh when nobody says: a twentieth, as in the paper's vessel.
pub fn base_faces(mesh: &Mesh) -> usize {
    (mesh.faces.len() / 20).max(MIN_BASE_FACES.min(mesh.faces.len()))
}

/// A base is made of a surface of so many times its faces, where there is one.
const BASE_OF: u64 = 6;

/// Simplifies a mesh to few faces. Where fans of faces touch they are parted first.
///
/// The simplification begins with what `clusters` of the mesh have at six times the faces, where
/// there are any: that errs a small part of what the base will, and takes three tenths of the time.
///
/// # Errors
/// [`SessionError::Mesh`] for a mesh that makes no sense.
pub fn base(
    mesh: &Mesh,
    clusters: Option<&Clusters>,
    options: &SimplifyOptions,
    clock: &mut Clock,
) -> Result<Mesh, SessionError> {
    let work = || -> Result<Mesh, MeshError> {
        let begun = clusters.map(|c| c.uniform_cut(BASE_OF * options.faces as u64).0);
        let mesh = begun.as_ref().unwrap_or(mesh);
        match simplify(mesh, options, &mut ()) {
            Err(MeshError::NonManifoldEdge { .. } | MeshError::NonManifoldVertex { .. }) => {
                Ok(simplify(&make_manifold(mesh)?.0, options, &mut ())?.mesh)
            }
            done => Ok(done?.mesh),
        }
    };
    Ok(clock.time("base", "faces", work, |_| mesh.faces.len() as u64)?)
}

/// A GPU draws a wall of at most so many faces sooner than the CPU finds what of it can be seen: an
/// H100 draws 860,000 in 0.7 ms, 16 cores find it in 1.2.
const DRAWN_WHOLE: u64 = 1_000_000;

/// Below this a base saves nothing worth having.
const MIN_BASE_FACES: usize = 500;

impl Levels {
    /// Levels of clusters.
    ///
    /// * `cached`: they were read, not built.
    pub fn of_clusters(clusters: impl Into<Arc<Clusters>>, pixel_error: f32, cached: bool) -> Self {
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
        let least = ClusterLod::new(Arc::clone(&clusters), DEFAULT_SHADING_RAD).least_pages();
        // All of it if it fits: then nothing is ever driven out.
        let most = (RESIDENT_BYTES / PAGE_BYTES) as u32;
        let pages = (count.min(u64::from(most)) as u32).max(least);
        let report = LodReport { pages, ..report };
        Self { kind: LevelKind::Clusters(clusters), pages, report, occlusion: None }
    }

    /// The paper's: the mesh simplified to a base, subdivided where the camera looks, every new vertex
    /// on the original by the record of the collapses.
    ///
    /// * `tree`: hierarchy of the mesh's faces.
    /// * `base`: simplification to the base; kept vertices do not move.
    /// * `vds`: options of the subdivision.
    ///
    /// # Errors
    /// [`SessionError`]: a mesh that half-edges cannot hold, or that is too large.
    pub fn of_subdivision(
        mesh: &Mesh,
        vertices: &[Vertex],
        tree: &TriangleBvh,
        base: SimplifyOptions<'_>,
        vds: VdsOptions,
        pixel_error: f32,
        clock: &mut Clock,
    ) -> Result<Self, SessionError> {
        let mut maps = Parameterization::new(mesh)?;
        // The samples are the original's own: a base that moved would only mislead the bounds.
        let options = SimplifyOptions { relocate: false, ..base };
        let simplified = clock.time(
            "simplify",
            "faces",
            || simplify(mesh, &options, &mut maps),
            |_| mesh.faces.len() as u64,
        )?;
        let original = ParameterizedOriginal::new(mesh, vertices, tree, &simplified, &maps);
        let build = || SubdivisionSurface::new(&simplified.mesh, &original, vds);
        let count = simplified.mesh.faces.len() as u64;
        let surface = clock.time("subdivision", "base faces", build, |_| count)?;
        let report = LodReport {
            mode: "vds",
            scheme: Some(vds.scheme.name()),
            finest_error_mm: Some(surface.finest_error_mm()),
            metric: Some(options.metric.name()),
            pixel_error,
            base_faces: surface.base_faces(),
            finest_faces: surface.finest_faces(),
            patches: surface.patches().patches() as u64,
            bytes: surface.bytes() as u64,
            ..Default::default()
        };
        // Patches stay on the device; there are no pages.
        let kind = LevelKind::Subdivision(Arc::new(surface));
        Ok(Self { kind, pages: 0, report, occlusion: None })
    }

    /// Leaves out what the wall itself hides.
    ///
    /// * `grid`: exterior of the closed wall whose levels these are, if it is known; eyes are inside
    ///   the wall.
    /// * `wall`: that wall.
    #[must_use]
    pub fn with_occlusion(self, grid: Option<Arc<ExteriorGrid>>, wall: &Mesh) -> Self {
        let Some(grid) = grid else { return self };
        let occlusion = match &self.kind {
            LevelKind::Clusters(clusters) => {
                OcclusionTest::new(grid, 0.0, clusters.largest_error_mm())
            }
            LevelKind::Subdivision(surface) => surface.occlusion_test(grid, wall),
        };
        Self { occlusion: Some(Arc::new(occlusion)), ..self }
    }

    /// Patches that stay on the device, of levels that have such.
    pub fn resident(&self) -> Option<Arc<ResidentPatches>> {
        match &self.kind {
            LevelKind::Clusters(_) => None,
            LevelKind::Subdivision(surface) => Some(Arc::clone(surface.patches())),
        }
    }

    /// Gives the wall its place on the device.
    ///
    /// # Errors
    /// [`RenderError`]: the device runs out of memory.
    pub fn open(
        &self,
        renderer: &mut Renderer,
        gpu: &mut Gpu,
        mean_radius_mm: f32,
    ) -> Result<PagesHandle, RenderError> {
        let pages = match &self.kind {
            LevelKind::Clusters(_) => renderer.open_pages(gpu, self.pages, mean_radius_mm)?,
            LevelKind::Subdivision(surface) => {
                renderer.open_patches(gpu, surface.patches(), mean_radius_mm)?
            }
        };
        if let Some(occlusion) = &self.occlusion {
            renderer.hide(pages, Arc::clone(occlusion));
        }
        Ok(pages)
    }

    /// A thread that refines for one flight.
    ///
    /// # Errors
    /// [`RenderError::Detail`]: the system could not start it.
    pub fn worker(&self, tolerance: Tolerance) -> Result<Worker, RenderError> {
        let in_flight = IN_FLIGHT as u32;
        Ok(Worker::spawn(self.hierarchy(), tolerance, self.pages, UPLOAD_BYTES, in_flight)?)
    }

    /// A hierarchy with nothing refined, for one flight.
    pub fn hierarchy(&self) -> Box<dyn LodHierarchy> {
        match &self.kind {
            LevelKind::Clusters(clusters) => {
                let lod = ClusterLod::new(Arc::clone(clusters), DEFAULT_SHADING_RAD);
                Box::new(match &self.occlusion {
                    Some(test) => lod.with_occlusion(Arc::clone(test)),
                    None => lod,
                })
            }
            LevelKind::Subdivision(surface) => {
                let lod = Vds::new(Arc::clone(surface));
                Box::new(match &self.occlusion {
                    Some(test) => lod.with_occlusion(Arc::clone(test)),
                    None => lod,
                })
            }
        }
    }
}

impl Session {
    pub(super) fn run_clusters(&self, clock: &mut Clock) -> Result<BuiltClusters, SessionError> {
        let drawn = present(&self.slots.drawn_wall);
        let shading = present(&self.slots.shading);
        let (mesh, vertices) = (drawn.mesh(), &shading.vertices);
        let faces = mesh.faces.len() as u64;
        let folder = self.settings.levels.cache.as_deref();
        let file = folder.and_then(|folder| level_cache::file_of(folder, mesh, vertices));
        let read = |path: &PathBuf| level_cache::read(path, mesh, vertices);
        if let Some(path) = &file
            && let Some(found) = clock.time("kept clusters", "faces", || read(path), |_| faces)
        {
            let clusters = Arc::new(found);
            return Ok(BuiltClusters { clusters, cached: true, keep: None });
        }
        return_freed_memory();
        let tree = present(&self.slots.drawn_tree);
        let build = || Clusters::build(mesh, vertices, &tree);
        let built = Arc::new(clock.time("clusters", "faces", build, |_| faces)?);
        Ok(BuiltClusters { clusters: built, cached: false, keep: file })
    }

    /// Exterior of the drawn wall. There is none where its caps are left out: through its open ends
    /// an eye sees faces that the whole wall occludes.
    fn exterior_of_closed(&self) -> Option<Arc<ExteriorGrid>> {
        let grid = present(&self.slots.exterior).grid.clone();
        grid.filter(|_| present(&self.slots.drawn_wall).closed)
    }

    pub(super) fn run_cluster_levels(&self, _: &mut Clock) -> Result<Levels, SessionError> {
        let built = present(&self.slots.clusters);
        let clusters = Arc::clone(&built.clusters);
        let error = self.settings.levels.pixel_error;
        let levels = Levels::of_clusters(clusters, error, built.cached);
        let drawn = present(&self.slots.drawn_wall);
        Ok(levels.with_occlusion(self.exterior_of_closed(), drawn.mesh()))
    }

    pub(super) fn run_culling(&self, clock: &mut Clock) -> Result<Option<Culling>, SessionError> {
        let drawn = present(&self.slots.drawn_wall);
        let faces = drawn.mesh().faces.len() as u64;
        let device = present(&self.slots.device);
        let is_quick = device.draws && device.is_real_gpu && faces <= DRAWN_WHOLE;
        if self.settings.drawn_lod() == Lod::Auto && is_quick {
            return Ok(None);
        }
        let build = || Arc::new(FaceOctree::new(drawn.mesh()));
        let octree = clock.time("octree", "faces", build, |_| faces);
        let test = |grid| Arc::new(OcclusionTest::of_wall(grid));
        Ok(Some(Culling { octree, closed: self.exterior_of_closed().map(test) }))
    }

    pub(super) fn run_subdivision_levels(&self, clock: &mut Clock) -> Result<Levels, SessionError> {
        let drawn = present(&self.slots.drawn_wall);
        let shading = present(&self.slots.shading);
        let mesh = drawn.mesh();
        let LevelSettings { scheme, pixel_error, .. } = self.settings.levels;
        return_freed_memory();
        let faces =
            (mesh.faces.len() / scheme.original_faces()).max(MIN_BASE_FACES.min(mesh.faces.len()));
        let metric = self.settings.methods().metric;
        let tree = present(&self.slots.drawn_tree);
        let spacing = present(&self.slots.lumen).lumen.grid.spacing_mm.min_element();
        // Thin branches must not collapse: a base without them has no place for their vertices.
        let base = SimplifyOptions {
            metric,
            max_error_mm: Some(spacing),
            ..SimplifyOptions::to_faces(faces)
        };
        let finest_mm = (0.1 * spacing) as f32;
        let vds = VdsOptions { finest_mm, scheme, ..VdsOptions::default() };
        let vertices = &shading.vertices;
        let levels = Levels::of_subdivision(mesh, vertices, &tree, base, vds, pixel_error, clock)?;
        Ok(levels.with_occlusion(self.exterior_of_closed(), mesh))
    }

    pub(super) fn run_base_from_clusters(&self, clock: &mut Clock) -> Result<Mesh, SessionError> {
        let built = present(&self.slots.clusters);
        self.make_base(Some(&built.clusters), clock)
    }

    pub(super) fn run_base_from_wall(&self, clock: &mut Clock) -> Result<Mesh, SessionError> {
        self.make_base(None, clock)
    }

    fn make_base(&self, clusters: Option<&Clusters>, c: &mut Clock) -> Result<Mesh, SessionError> {
        let wall = present(&self.slots.wall);
        let faces = self.settings.wall.base_faces.unwrap_or_else(|| base_faces(&wall.mesh));
        let methods = self.settings.methods();
        let options = SimplifyOptions {
            metric: methods.metric,
            relocate: methods.relocate,
            ..SimplifyOptions::to_faces(faces)
        };
        base(&wall.mesh, clusters, &options, c)
    }

    /// Keeps clusters that were built for the next session, where settings name a folder. Nobody
    /// waits for the file, so it can be written beside the drawing.
    pub fn keep_levels(&self) {
        let built = locked(&self.slots.clusters).clone();
        if let Some(built) = built
            && let Some(path) = &built.keep
        {
            level_cache::write(path, &built.clusters);
        }
    }
}
