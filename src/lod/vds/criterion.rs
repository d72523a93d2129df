//! Refinement criterion: how fine a camera asks a patch to be.

use glam::Vec3;

use super::measure::PatchBounds;
use super::patch::{MORPH_STEPS, PatchVertex};
use super::template::PatchShape;
use crate::lod::{FULL_SHADING_PX, HierarchicalZ, ProjectedBounds, ViewFrustum};

/// Fineness: [`MORPH_STEPS`] to a level.
pub type Fineness = u16;

/// Steps of fineness to a level.
pub const STEP: Fineness = MORPH_STEPS as Fineness;

/// Demands of a camera.
pub struct Criterion {
    pub frustum: ViewFrustum,
    /// Distance tolerance, pixels.
    pub pixels: f64,
    /// Shading tolerance, radians.
    pub shading: f64,
    /// Depths behind which the wall hides, if they are known.
    pub depths: Option<HierarchicalZ>,
    /// Whether faces that look away from the eye are drawn.
    pub shows_backs: bool,
    /// Shape of all patches.
    pub shape: &'static PatchShape,
    /// Whether levels pass gradually into each other.
    pub morph: bool,
}

impl Criterion {
    /// Whether any point of a patch may be visible.
    pub fn is_visible(&self, b: &PatchBounds) -> bool {
        let faces_away = || self.frustum.is_backfacing(&b.sphere, &b.cone);
        (self.shows_backs || !faces_away()) && self.is_in_sight(b.sphere.centre, b.half)
    }

    /// Whether any point of a box may be inside the view frustum and not occluded.
    pub fn is_in_sight(&self, centre: Vec3, half: Vec3) -> bool {
        let away = centre.as_dvec3() - self.frustum.position();
        self.frustum.intersects_box(away, half.as_dvec3())
            && !self.depths.as_ref().is_some_and(|d| d.hides_box(centre, half))
    }

    /// The least fineness of a patch, counted from its corners and not below level `lowest`, at
    /// which its error is allowed; `None` if its finest level errs too much. First by its sphere,
    /// then by its triangles, much smaller, which tell more tightly how near it is.
    pub fn required(
        &self,
        b: &PatchBounds,
        vertices: &[PatchVertex],
        lowest: u32,
    ) -> Option<Fineness> {
        let by_sphere = self.least(b, lowest, self.frustum.error_px_fn(&b.sphere));
        if by_sphere == Some(lowest as Fineness * STEP) {
            return by_sphere;
        }
        // Triangles of the level before the finest, widened by its error, say where the patch is.
        let level = self.shape.finest() - 1;
        let places = self.places(level, b.error_mm[level as usize], vertices);
        self.least(b, lowest, |mm| {
            places.iter().map(|s| self.frustum.bounds_error_px(s, mm)).fold(0.0, f64::max)
        })
    }

    /// Places of a patch's triangles of a level in the image.
    fn places(&self, level: u32, margin_mm: f32, vertices: &[PatchVertex]) -> Vec<ProjectedBounds> {
        let mut known: [Option<ProjectedBounds>; SHAPE_POINTS] = [None; SHAPE_POINTS];
        let mut of = |i: usize| {
            *known[i]
                .get_or_insert_with(|| self.frustum.project(vertices[i].own.position(), margin_mm))
        };
        let triangles = self.shape.faces(self.shape.template(level, 0));
        let union = |[a, b, c]: [usize; 3]| of(a).union(&of(b)).union(&of(c));
        triangles.map(union).collect()
    }

    /// [`Self::required`] with errors in pixels by `px`.
    fn least(&self, b: &PatchBounds, lowest: u32, px: impl Fn(f32) -> f64) -> Option<Fineness> {
        let level = (lowest..=self.shape.finest()).find(|l| self.is_enough(b, *l, 1.0, &px))?;
        let finest = level as Fineness * STEP;
        if level == lowest || !self.morph {
            return Some(finest);
        }
        let (mut low, mut high) = (0, STEP);
        while high - low > 1 {
            let middle = Fineness::midpoint(low, high);
            let share = f32::from(middle) / f32::from(STEP);
            if self.is_enough(b, level, share, &px) { high = middle } else { low = middle }
        }
        Some(finest - STEP + high)
    }

    /// Whether a patch at a level, its newest vertices moved by `share`, is near enough to the
    /// original. Between two levels vertices are between their places at both, so what was measured
    /// is interpolated.
    fn is_enough(&self, b: &PatchBounds, level: u32, share: f32, px: impl Fn(f32) -> f64) -> bool {
        let at = |of: &[f32]| match share {
            1.0 => of[level as usize],
            _ => of[level as usize - 1] * (1.0 - share) + of[level as usize] * share,
        };
        let size = (px(at(&b.edge_mm)) / FULL_SHADING_PX).min(1.0);
        px(at(&b.error_mm)) <= self.pixels && f64::from(at(&b.angle_rad)) * size <= self.shading
    }
}

/// Points of a patch, at most.
const SHAPE_POINTS: usize = 69;
