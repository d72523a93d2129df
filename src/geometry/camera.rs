//! Camera pose, perspective lens, and both with the height of the image.

use glam::{Quat, Vec3};

/// A camera pose in patient space. The camera looks along its own -z with +y up.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// Position of the eye, LPS mm.
    pub position_mm: Vec3,
    /// Rotation from camera to world, unit.
    pub rotation: Quat,
}

impl Pose {
    /// Creates a pose that looks along `forward`, with the camera's +y as near to `up` as possible.
    pub fn looking(position_mm: Vec3, forward: Vec3, up: Vec3) -> Self {
        let f = forward.normalize();
        let r = f.cross(up).try_normalize().unwrap_or_else(|| f.any_orthonormal_vector());
        let u = r.cross(f);
        Self { position_mm, rotation: Quat::from_mat3(&glam::Mat3::from_cols(r, u, -f)) }
    }

    /// Returns the unit viewing direction.
    pub fn forward(&self) -> Vec3 {
        self.rotation * Vec3::NEG_Z
    }

    /// Returns the unit up direction.
    pub fn up(&self) -> Vec3 {
        self.rotation * Vec3::Y
    }
}

/// A perspective lens.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Lens {
    /// Vertical field of view, radians, in (0, pi).
    pub fov_y_rad: f32,
    /// Width over height.
    pub aspect: f32,
    /// Near plane, mm.
    pub near_mm: f32,
}

impl Lens {
    /// Returns the distance from the eye to the corners of the near rectangle, mm.
    pub fn near_ball_mm(&self) -> f32 {
        let t = (0.5 * self.fov_y_rad).tan();
        self.near_mm * (1.0 + t * t * (1.0 + self.aspect * self.aspect)).sqrt()
    }
}

/// A camera with the height of its image.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Position and orientation.
    pub pose: Pose,
    /// Field of view and near plane.
    pub lens: Lens,
    /// Height of the image, pixels.
    pub height_px: u32,
}
