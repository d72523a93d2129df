//! The wall as the subdivision draws it.

use std::sync::Arc;

use super::criterion::Criterion;
use super::cut::Cut;
use super::patch::DrawnPatch;
use super::surface::SubdivisionSurface;
use crate::geometry::Camera;
use crate::lod::{DrawnRange, DrawnWall, OcclusionTest, Tolerance, ViewFrustum, VisibleWall};

/// A subdivided wall, as fine as a tolerance asks.
#[derive(Debug)]
pub struct SubdividedWall {
    surface: Arc<SubdivisionSurface>,
    tolerance: Tolerance,
    closed: Option<Arc<OcclusionTest>>,
}

impl SubdividedWall {
    /// * `closed`: occlusion test of a closed wall with the eye inside it; else back faces are drawn.
    pub fn new(
        surface: Arc<SubdivisionSurface>,
        tolerance: Tolerance,
        closed: Option<Arc<OcclusionTest>>,
    ) -> Self {
        Self { surface, tolerance, closed }
    }

    /// Returns the surface.
    pub fn surface(&self) -> &Arc<SubdivisionSurface> {
        &self.surface
    }

    /// Returns all patches of the cut, with a mark at the patches that the camera may see. The cut
    /// depends on the camera alone.
    pub fn cut(&self, camera: &Camera) -> Vec<DrawnPatch> {
        Cut::of(&self.surface, &self.criterion(camera)).drawn_patches()
    }

    /// Criterion by which a camera judges patches.
    pub(super) fn criterion(&self, camera: &Camera) -> Criterion {
        let surface = &*self.surface;
        let frustum = ViewFrustum::new(camera);
        let pixels = f64::from(self.tolerance.pixels);
        let depths = self.closed.as_ref().map(|test| test.depths_within(&frustum, pixels));
        Criterion {
            frustum,
            pixels,
            shading: f64::from(surface.options.shading_rad),
            depths,
            shows_backs: self.shows_backs(),
            shape: surface.shape(),
            morph: surface.options.morph && surface.options.scheme.morphs(),
        }
    }
}

impl DrawnWall for SubdividedWall {
    fn visible(&self, camera: &Camera) -> VisibleWall {
        let vertices = self.surface.patches().patch_vertices();
        let range = |d: DrawnPatch| DrawnRange {
            first_index: d.first_index,
            indices: 3 * d.triangles,
            first_vertex: d.patch * vertices,
            morph: d.morph,
        };
        let cut = self.cut(camera);
        cut.into_iter().filter(|d| d.is_seen && d.triangles > 0).map(range).collect()
    }

    fn shows_backs(&self) -> bool {
        self.closed.is_none()
    }
}
