//! Refinement criterion: how fine a camera asks a patch to be.

use glam::Vec3;

use super::measure::PatchBounds;
use super::patch::{MORPH_STEPS, PatchVertex};
use super::template::PatchShape;
use crate::lod::view_frustum::{ErrorScale, ProjectedBounds};
use crate::lod::{FULL_SHADING_PX, HierarchicalZ, ViewFrustum};

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
        let by_sphere = self.least(b, lowest, &[self.frustum.error_scale(&b.sphere)]);
        if by_sphere == Some(lowest as Fineness * STEP) {
            return by_sphere;
        }
        // Triangles of the level before the finest, widened by its error, say where the patch is.
        let level = self.shape.finest() - 1;
        self.least(b, lowest, &self.scales(level, b.error_mm[level as usize], vertices))
    }

    /// Returns how errors look at the triangles of a level of a patch. Triangles outside the image are
    /// left out.
    fn scales(&self, level: u32, margin_mm: f32, vertices: &[PatchVertex]) -> Vec<ErrorScale> {
        let mut known: [Option<ProjectedBounds>; SHAPE_POINTS] = [None; SHAPE_POINTS];
        let mut of = |i: usize| {
            *known[i]
                .get_or_insert_with(|| self.frustum.project(vertices[i].own.position(), margin_mm))
        };
        let triangles = self.shape.faces(self.shape.template(level, 0));
        let union = |[a, b, c]: [usize; 3]| of(a).union(&of(b)).union(&of(c));
        triangles.map(union).filter_map(|s| self.frustum.bounds_error_scale(&s)).collect()
    }

    /// [`Self::required`] of a patch at places where errors have these scales.
    fn least(&self, b: &PatchBounds, lowest: u32, scales: &[ErrorScale]) -> Option<Fineness> {
        let allowed_mm = least_of(scales, |s| s.error_mm(self.pixels));
        let is_enough = |level: &u32| {
            f64::from(b.error_mm[*level as usize]) <= allowed_mm
                && self.shades_well(b, *level, scales)
        };
        let level = (lowest..=self.shape.finest()).find(is_enough)?;
        let finest = level as Fineness * STEP;
        if level == lowest || !self.morph {
            return Some(finest);
        }
        let share = self.coarser_share(b, level, allowed_mm, scales);
        let back = (share * f64::from(STEP)) as Fineness;
        Some(finest - back.min(STEP - 1))
    }

    /// Whether the light of a patch at a level is near enough to the original's.
    fn shades_well(&self, b: &PatchBounds, level: u32, scales: &[ErrorScale]) -> bool {
        let angle = f64::from(b.angle_rad[level as usize]);
        let edge_mm = || f64::from(b.edge_mm[level as usize]);
        angle <= self.shading
            || edge_mm() <= least_of(scales, |s| s.error_mm(self.shading_px() / angle))
    }

    /// The share of the way from a level back to the one before it up to which a patch is near enough
    /// to the original. Vertices on the way are between their places at both levels, so figures of
    /// both are interpolated.
    fn coarser_share(
        &self,
        b: &PatchBounds,
        level: u32,
        allowed_mm: f64,
        scales: &[ErrorScale],
    ) -> f64 {
        let of_both = |of: &[f32]| [level, level - 1].map(|l| f64::from(of[l as usize]));
        let share_below = |[fine, coarse]: [f64; 2], most: f64| match (fine <= most, coarse <= most)
        {
            (false, _) => 0.0,
            (true, true) => 1.0,
            (true, false) => (most - fine) / (coarse - fine),
        };
        let by_distance = share_below(of_both(&b.error_mm), allowed_mm);
        let angle = of_both(&b.angle_rad);
        // Large triangles shade well by the angle alone, small ones by angle times size.
        let by_angle = share_below(angle, self.shading);
        if by_angle >= by_distance {
            return by_distance;
        }
        let edge = of_both(&b.edge_mm);
        let by_size = least_of(scales, |s| s.share_of_product(edge, angle, self.shading_px()));
        by_distance.min(by_angle.max(by_size))
    }

    /// Largest product of the angle between normals, radians, and the size of a triangle, pixels.
    fn shading_px(&self) -> f64 {
        self.shading * FULL_SHADING_PX
    }
}

/// The least of some figures; infinite of no figure.
fn least_of<T>(all: &[T], figure: impl Fn(&T) -> f64) -> f64 {
    all.iter().map(figure).fold(f64::INFINITY, f64::min)
}

/// Points of a patch, at most.
const SHAPE_POINTS: usize = 69;
