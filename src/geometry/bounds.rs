//! Bounds of a set of points and of a set of directions.

use glam::Vec3;

/// A ball, LPS mm.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Sphere {
    /// Centre.
    pub centre: Vec3,
    /// Radius.
    pub radius: f32,
}

/// A cone of directions.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Cone {
    /// Unit axis.
    pub axis: Vec3,
    /// Sine of the half-angle; 1 and more: every direction.
    pub sine: f32,
}

impl Default for Cone {
    fn default() -> Self {
        Self { axis: Vec3::Z, sine: 1.0 }
    }
}
