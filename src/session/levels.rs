//! Form in which frames draw the wall, the simplified base, and the report of both.

use std::sync::Arc;

use serde::Serialize;

use super::settings::{LevelSettings, Lod};
use super::{Clock, Session, SessionError, present};
use crate::flight::WallDistance;
use crate::geometry::{Mesh, TriangleBvh, Vertex};
use crate::lod::ExteriorGrid;
use crate::lod::refined::{RefinedWall, RefinedWallInput, SmoothWall};
use crate::lod::vds::{ParameterizedOriginal, SubdividedWall, SubdivisionSurface, VdsOptions};
use crate::lod::{CulledWall, FaceOctree, OcclusionTest, Tolerance};
use crate::mesh::{MeshError, Parameterization, SimplifyOptions, make_manifold, simplify};
use crate::vk::return_freed_memory;
use crate::wall::WallSpline;

/// The wall in the form in which frames draw it.
#[derive(Debug)]
pub struct Levels {
    /// Form of the wall.
    pub form: WallForm,
    /// Report of the levels.
    pub report: LodReport,
}

/// Form in which a wall is drawn.
#[derive(Clone, Debug)]
pub enum WallForm {
    /// The whole mesh.
    Whole,
    /// The whole mesh, less what a camera cannot see.
    Culled(Arc<CulledWall>),
    /// The whole mesh, less what a camera cannot see, with faces near the eye split onto the wall.
    Refined(Arc<RefinedWall>),
    /// The subdivision of a base.
    Subdivided(Arc<SubdividedWall>),
}

/// Level of detail.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct LodReport {
    /// `vds`; `refined`, `culled` or `off` where the whole wall is drawn.
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
    /// Patches of the subdivision.
    pub patches: u64,
    /// Size of all levels.
    pub bytes: u64,
}

impl LodReport {
    /// The whole wall of so many faces is drawn, or what cameras can see of it.
    fn whole(faces: u64, mode: &'static str) -> Self {
        Self { mode, base_faces: faces, finest_faces: faces, ..Self::default() }
    }
}

/// Faces of the base under a mesh when nobody says: a twentieth, as in the paper's vessel.
pub fn base_faces(mesh: &Mesh) -> usize {
    (mesh.faces.len() / 20).max(MIN_BASE_FACES.min(mesh.faces.len()))
}

/// Simplifies a mesh to few faces. Where fans of faces touch they are parted first.
///
/// # Errors
/// [`SessionError::Mesh`] for a mesh that makes no sense.
pub fn base(
    mesh: &Mesh,
    options: &SimplifyOptions,
    clock: &mut Clock,
) -> Result<Mesh, SessionError> {
    let work = || -> Result<Mesh, MeshError> {
        match simplify(mesh, options, &mut ()) {
            Err(MeshError::NonManifoldEdge { .. } | MeshError::NonManifoldVertex { .. }) => {
                Ok(simplify(&make_manifold(mesh)?.0, options, &mut ())?.mesh)
            }
            done => Ok(done?.mesh),
        }
    };
    Ok(clock.time("base", "faces", work, |_| mesh.faces.len() as u64)?)
}

/// Largest distance that a vertex moves onto the smooth wall, least spacings. The linear crossing of
/// a grid edge differs from the spline's by less.
const REACH_VOX: f64 = 0.5;

/// Below this a base saves nothing worth having.
const MIN_BASE_FACES: usize = 500;

impl Levels {
    /// Returns the refined wall; `None` if the drawn wall is as far from a point as the mesh.
    pub fn drawn_distance(&self) -> Option<&dyn WallDistance> {
        match &self.form {
            WallForm::Refined(wall) => Some(&**wall),
            _ => None,
        }
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
        };
        let tolerance = Tolerance { pixels: pixel_error };
        let wall = SubdividedWall::new(Arc::new(surface), tolerance, None);
        Ok(Self { form: WallForm::Subdivided(Arc::new(wall)), report })
    }

    /// Leaves out what a closed wall hides from the eyes inside it.
    ///
    /// * `grid`: exterior of the closed wall whose subdivision this is, if it is known.
    /// * `wall`: that wall.
    #[must_use]
    pub fn with_occlusion(self, grid: Option<Arc<ExteriorGrid>>, wall: &Mesh) -> Self {
        let (WallForm::Subdivided(subdivided), Some(grid)) = (&self.form, grid) else {
            return self;
        };
        let surface = subdivided.surface();
        let closed = Some(Arc::new(surface.occlusion_test(grid, wall)));
        let tolerance = Tolerance { pixels: self.report.pixel_error };
        let hidden = SubdividedWall::new(Arc::clone(surface), tolerance, closed);
        Self { form: WallForm::Subdivided(Arc::new(hidden)), ..self }
    }
}

impl Session {
    /// Returns the wall with all its faces split so many times onto the smooth wall; the wall itself
    /// if the settings draw another form.
    ///
    /// * `level`: 1 to 4; a split quadruples the faces.
    ///
    /// # Errors
    /// The error of the stage that failed.
    pub fn refined_mesh(&self, level: u32) -> Result<Mesh, SessionError> {
        let (levels, drawn) = (self.levels()?, self.shown_wall()?);
        Ok(match &levels.form {
            WallForm::Refined(wall) => wall.mesh(level, &drawn.mesh().caps),
            _ => drawn.mesh().clone(),
        })
    }

    /// Exterior of the drawn wall. There is none where its caps are left out: through its open ends
    /// an eye sees faces that the whole wall occludes.
    fn exterior_of_closed(&self) -> Option<Arc<ExteriorGrid>> {
        let grid = present(&self.slots.exterior).grid.clone();
        grid.filter(|_| present(&self.slots.shown_wall).closed)
    }

    pub(super) fn run_whole_levels(&self, clock: &mut Clock) -> Result<Levels, SessionError> {
        let drawn = present(&self.slots.shown_wall);
        let faces = drawn.mesh().faces.len() as u64;
        if self.settings.drawn_lod() == Lod::Off {
            return Ok(Levels { form: WallForm::Whole, report: LodReport::whole(faces, "off") });
        }
        let build = || Arc::new(FaceOctree::new(drawn.mesh()));
        let octree = clock.time("octree", "faces", build, |_| faces);
        let test = |grid| Arc::new(OcclusionTest::of_wall(grid));
        let closed = self.exterior_of_closed().map(test);
        let form = WallForm::Culled(Arc::new(CulledWall { octree, closed }));
        Ok(Levels { form, report: LodReport::whole(faces, "culled") })
    }

    pub(super) fn run_spline(&self, clock: &mut Clock) -> Result<WallSpline, SessionError> {
        let drawn = present(&self.slots.shown_wall);
        let found = present(&self.slots.lumen);
        let mesh = drawn.mesh();
        let make = || match &found.wall {
            Some(field) => WallSpline::of_field(&found.lumen, field, &mesh.positions),
            None => WallSpline::of_mesh(&found.lumen, mesh),
        };
        Ok(clock.time("smooth wall", "vertices", make, |_| mesh.positions.len() as u64))
    }

    pub(super) fn run_refined_levels(&self, clock: &mut Clock) -> Result<Levels, SessionError> {
        let drawn = present(&self.slots.shown_wall);
        let shading = present(&self.slots.shading);
        let found = present(&self.slots.lumen);
        let mesh = drawn.mesh();
        let smooth = present(&self.slots.spline) as Arc<dyn SmoothWall>;

        // Vertices of caps stay in the plane of the cut.
        let caps = drawn.whole();
        let mut is_fixed = vec![false; mesh.positions.len()];
        let cut = caps.faces.iter().zip(&caps.caps).filter(|(_, is_cap)| **is_cap);
        cut.flat_map(|(face, _)| face).for_each(|v| is_fixed[*v as usize] = true);
        let pixel_error = self.settings.levels.pixel_error;
        let input = RefinedWallInput {
            mesh,
            shading: &shading,
            is_fixed,
            smooth: Some(smooth),
            exterior: self.exterior_of_closed(),
            reach_mm: (REACH_VOX * found.lumen.grid.spacing_mm.min_element()) as f32,
            tolerance: Tolerance { pixels: pixel_error },
        };
        let faces = mesh.faces.len() as u64;
        let build = || Arc::new(RefinedWall::new(input));
        let wall = clock.time("refined wall", "faces", build, |_| faces);
        let report = LodReport { pixel_error, ..LodReport::whole(faces, "refined") };
        Ok(Levels { form: WallForm::Refined(wall), report })
    }

    pub(super) fn run_subdivision_levels(&self, clock: &mut Clock) -> Result<Levels, SessionError> {
        let drawn = present(&self.slots.shown_wall);
        let shading = present(&self.slots.shading);
        let mesh = drawn.mesh();
        let LevelSettings { scheme, pixel_error, .. } = self.settings.levels;
        return_freed_memory();
        let faces =
            (mesh.faces.len() / scheme.original_faces()).max(MIN_BASE_FACES.min(mesh.faces.len()));
        let metric = self.settings.methods().metric;
        let tree = self.drawn_tree(clock);
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

    pub(super) fn run_base(&self, clock: &mut Clock) -> Result<Mesh, SessionError> {
        let wall = present(&self.slots.wall);
        let faces = self.settings.wall.base_faces.unwrap_or_else(|| base_faces(&wall.mesh));
        let methods = self.settings.methods();
        let options = SimplifyOptions {
            metric: methods.metric,
            relocate: methods.relocate,
            ..SimplifyOptions::to_faces(faces)
        };
        base(&wall.mesh, &options, clock)
    }
}
