//! Lower bound of the distance to the wall: the proof that a near plane does not cut it.

use glam::{DAffine3, DMat3, DVec3, IVec3};

use crate::centerline::safe_by_voxels;
use crate::field::Sampler;
use crate::geometry::{Lens, TriangleBvh};
use crate::lod::refined::RefinedWall;
use crate::lumen::Lumen;

/// Least distance to the wall, in near-ball radii.
pub const SAFETY: f64 = 1.05;
/// Nearest near plane before a pose is refused, mm.
pub const MIN_NEAR_MM: f64 = 0.05;

/// A wall as it is drawn, by its distance.
pub trait WallDistance: std::fmt::Debug + Sync {
    /// Returns a distance from a point (LPS mm) that no drawn point is nearer than, mm; `limit_mm` if
    /// that is less.
    fn proven_mm(&self, p_mm: DVec3, limit_mm: f64) -> f64;

    /// Returns the distance from a point (LPS mm) to the wall as it is usually drawn, mm; `limit_mm`
    /// if that is less.
    fn nominal_mm(&self, p_mm: DVec3, limit_mm: f64) -> f64;

    /// Returns the largest distance of any drawn point from the mesh of the wall, mm.
    fn departure_mm(&self) -> f64;
}

impl WallDistance for TriangleBvh {
    fn proven_mm(&self, p_mm: DVec3, limit_mm: f64) -> f64 {
        self.distance(p_mm, limit_mm)
    }

    fn nominal_mm(&self, p_mm: DVec3, limit_mm: f64) -> f64 {
        self.distance(p_mm, limit_mm)
    }

    fn departure_mm(&self) -> f64 {
        0.0
    }
}

impl WallDistance for RefinedWall {
    fn proven_mm(&self, p_mm: DVec3, limit_mm: f64) -> f64 {
        self.distance(p_mm, limit_mm).proven_mm
    }

    fn nominal_mm(&self, p_mm: DVec3, limit_mm: f64) -> f64 {
        self.distance(p_mm, limit_mm).nominal_mm
    }

    fn departure_mm(&self) -> f64 {
        f64::from(RefinedWall::departure_mm(self))
    }
}

/// Lower bounds of the distance from a point to the wall.
///
/// The first bound comes from the distance field: every point of the extracted surface lies in a
/// cell with an external corner, so the wall is at least max(dᵢ − |c − xᵢ|) − ‖h‖ away, over the
/// eight voxels xᵢ about c, less what the drawn wall departs from that surface. It is too small by
/// up to three voxels; if the bound does not suffice and the drawn wall is known, the distance
/// to the drawn wall decides.
///
/// Without the drawn wall the bound holds for the surface as extracted.
pub struct Clearance<'a> {
    distance: Sampler<'a>,
    local_from_world: DAffine3,
    wall: Option<&'a dyn WallDistance>,
}

impl<'a> Clearance<'a> {
    /// Wraps a distance field and, where it is known, the wall.
    ///
    /// * `distance`: exact distance to external voxel centres, mm, in slot order.
    /// * `wall`: the surface that is drawn.
    pub fn new(lumen: &'a Lumen, distance: &'a [f32], wall: Option<&'a dyn WallDistance>) -> Self {
        let scale = DAffine3::from_mat3(DMat3::from_diagonal(lumen.grid.spacing_mm));
        Self {
            distance: Sampler { lumen, field: distance },
            local_from_world: scale * lumen.grid.voxel_from_world(),
            wall,
        }
    }

    /// Returns the lumen that distances are within.
    pub(super) fn lumen(&self) -> &'a Lumen {
        self.distance.lumen
    }

    /// Transforms LPS mm to millimetres along the index axes.
    fn local(&self, p_mm: DVec3) -> DVec3 {
        self.local_from_world.transform_point3(p_mm)
    }

    /// Returns the voxel a point lies in.
    fn voxel(&self, p_mm: DVec3) -> Option<IVec3> {
        let v = self.local(p_mm) / self.distance.lumen.grid.spacing_mm;
        (v.is_finite() && v.abs().max_element() < 1e9).then(|| v.round().as_ivec3())
    }

    /// Whether the point (LPS mm) lies in an inside voxel.
    pub fn holds(&self, p_mm: DVec3) -> bool {
        self.voxel(p_mm).is_some_and(|v| self.distance.lumen.holds(v))
    }

    /// Whether every voxel between two points (LPS mm) is inside.
    pub fn sees(&self, from_mm: DVec3, to_mm: DVec3) -> bool {
        self.voxel(from_mm).is_some()
            && self.voxel(to_mm).is_some()
            && safe_by_voxels(self.local(from_mm), self.local(to_mm), self.distance.lumen)
    }

    /// Returns the distance to the wall that the distance field alone proves, mm; 0 where it proves
    /// none.
    pub fn bound_mm(&self, p_mm: DVec3) -> f64 {
        if !self.holds(p_mm) {
            return 0.0;
        }
        let h = self.distance.lumen.grid.spacing_mm;
        let c = self.local(p_mm);
        let base = (c / h).floor().as_ivec3();
        let bound = (0..8)
            .map(|k| base + IVec3::new(k & 1, k >> 1 & 1, k >> 2))
            .map(|v| self.distance.voxel(v) - c.distance(v.as_dvec3() * h))
            .fold(0.0, f64::max);
        let departure = self.wall.map_or(0.0, |wall| wall.departure_mm());
        (bound - h.length() - departure).max(0.0)
    }

    /// Returns the distance to the drawn wall that can be proven, mm, at most `limit_mm`; 0 outside,
    /// `None` without the wall.
    pub fn exact_mm(&self, p_mm: DVec3, limit_mm: f64) -> Option<f64> {
        let wall = self.wall?;
        if !self.holds(p_mm) || !self.joins_its_voxel(p_mm, wall) {
            return Some(0.0);
        }
        Some(wall.proven_mm(p_mm, limit_mm))
    }

    /// Whether no wall lies between a point and the centre of its voxel, which is inside: the
    /// segment is marched in steps as long as the distance to the wall.
    fn joins_its_voxel(&self, p_mm: DVec3, wall: &dyn WallDistance) -> bool {
        let Some(v) = self.voxel(p_mm) else { return false };
        let goal = self.distance.lumen.grid.world_from_voxel().transform_point3(v.as_dvec3());
        let mut at = p_mm;
        for _ in 0..256 {
            let left = at.distance(goal);
            let free = wall.nominal_mm(at, left + 1e-9);
            if free >= left {
                return true;
            }
            if free < 1e-4 {
                return false;
            }
            at += (goal - at) * (free / left);
        }
        false
    }

    /// Returns the distance to the wall that can be proven, mm: the bound if it is as much as
    /// needed, else the exact distance if the wall is known. 0 outside.
    pub fn proven_mm(&self, p_mm: DVec3, needed_mm: f64) -> f64 {
        let bound = self.bound_mm(p_mm);
        if bound >= needed_mm {
            return bound;
        }
        let exact = self.wall.and_then(|_| self.exact_mm(p_mm, needed_mm.max(bound) + 1e-6));
        exact.map_or(bound, |e| e.max(bound))
    }

    /// Returns the unit direction in which the distance to the wall grows fastest, by the distance
    /// field; `None` where it has no slope.
    pub fn away(&self, p_mm: DVec3) -> Option<DVec3> {
        self.voxel(p_mm)?;
        let grid = &self.distance.lumen.grid;
        let c = self.local(p_mm);
        let slope = |axis: DVec3, h: f64| {
            let e = 0.5 * h * axis;
            (self.distance.at(c + e) - self.distance.at(c - e)) / h
        };
        let h = grid.spacing_mm;
        let (x, y, z) = (slope(DVec3::X, h.x), slope(DVec3::Y, h.y), slope(DVec3::Z, h.z));
        (grid.direction * DVec3::new(x, y, z)).try_normalize()
    }

    /// Returns the near plane for an eye, as desired or as much nearer as needed, and the distance
    /// to the wall that was proven, both mm.
    ///
    /// * `lens`: its `near_mm` is the desired near plane.
    ///
    /// # Errors
    /// The proven distance, where even [`MIN_NEAR_MM`] is too far.
    pub fn near_mm(&self, p_mm: DVec3, lens: Lens) -> Result<(f32, f64), f64> {
        let ball = f64::from(Lens { near_mm: 1.0, ..lens }.near_ball_mm());
        let wish = f64::from(lens.near_mm);
        let room = self.proven_mm(p_mm, SAFETY * ball * wish);
        let near = wish.min(room / (SAFETY * ball));
        // Rounded down: the proof must hold for the number handed out.
        let rounded = near as f32;
        let rounded = if f64::from(rounded) > near { rounded.next_down() } else { rounded };
        if near < MIN_NEAR_MM.min(wish) { Err(room) } else { Ok((rounded, room)) }
    }
}
