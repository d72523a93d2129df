//! What a camera sees of a sphere, and how large an error in it can look.

use glam::{DMat3, DQuat, DVec3, Vec3};

use crate::geometry::{Lens, Pose};

/// A camera, and the rows of the picture it makes.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Camera {
    /// Where it stands.
    pub pose: Pose,
    /// What it sees.
    pub lens: Lens,
    /// Rows of the picture.
    pub height_px: u32,
}

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

/// A camera with everything worked out that each test needs. In f64: a test that errs on the safe
/// side must not lose that to rounding.
#[derive(Clone, Copy, Debug)]
pub struct Eye {
    position: DVec3,
    camera_from_world: DMat3,
    /// Tangents of half the field of view.
    tangent: [f64; 2],
    /// 1 / cosine of those half-angles.
    secant: [f64; 2],
    near: f64,
    /// Pixels a radian at the centre.
    focal_px: f64,
    /// Angle off the axis of the picture's corner.
    corner: f64,
}

impl Eye {
    /// Works a camera out.
    pub fn new(camera: &Camera) -> Self {
        let t_y = (0.5 * f64::from(camera.lens.fov_y_rad)).tan();
        let t_x = t_y * f64::from(camera.lens.aspect);
        let turn: DQuat = camera.pose.rotation.as_dquat().normalize();
        Self {
            position: camera.pose.position_mm.as_dvec3(),
            camera_from_world: DMat3::from_quat(turn.conjugate()),
            tangent: [t_x, t_y],
            secant: [(1.0 + t_x * t_x).sqrt(), (1.0 + t_y * t_y).sqrt()],
            near: f64::from(camera.lens.near_mm),
            focal_px: f64::from(camera.height_px) / (2.0 * t_y),
            corner: t_x.hypot(t_y).atan(),
        }
    }

    /// Whether any point of the sphere may be in the picture: false only if none is.
    pub fn sees(&self, s: &Sphere) -> bool {
        let c = self.camera_from_world * (s.centre.as_dvec3() - self.position);
        let r = f64::from(s.radius) * (1.0 + 1e-6) + 1e-6;
        // Planes through the eye, normals inwards (camera looks along -z).
        -c.z >= self.near - r
            && (0..2).all(|k| c[k].abs() - self.tangent[k] * -c.z <= r * self.secant[k])
    }

    /// Upper bound, in pixels, of how far apart two points can look that are at most `error_mm`
    /// apart, one of them in the sphere and in the picture. With F = H / (2 tan(fov/2)), view depth
    /// z and angle θ off the axis it is F ε sec θ / (z − ε): for a displacement δ the picture moves
    /// by F (δ_xy − δ_z tan θ) / (z + δ_z), and the operator norm of (δ_xy, δ_z) ↦ δ_xy − δ_z tan θ
    /// is sec θ. The usual F ε / distance is too small by 1.7 (60° lens) to 14 (120°, corner).
    /// Infinite where the nearest depth is not at least 2 ε.
    pub fn error_px(&self, s: &Sphere, error_mm: f32) -> f64 {
        let e = f64::from(error_mm);
        if e <= 0.0 {
            return 0.0;
        }
        let c = self.camera_from_world * (s.centre.as_dvec3() - self.position);
        let r = f64::from(s.radius) * (1.0 + 1e-6) + 1e-6;
        // Nothing nearer than the near plane is drawn.
        let z = (-c.z - r).max(self.near);
        if z <= 2.0 * e {
            return f64::INFINITY;
        }
        let distance = c.length();
        let off = if distance <= r {
            self.corner
        } else {
            let centre = c.x.hypot(c.y).atan2(-c.z);
            (centre + (r / distance).asin()).min(self.corner)
        };
        self.focal_px * e / ((z - e) * off.cos())
    }

    /// Whether every face with its normal in the cone and its place in the sphere shows its back.
    pub fn behind(&self, s: &Sphere, cone: &Cone) -> bool {
        let away = s.centre.as_dvec3() - self.position;
        let (r, sine) = (f64::from(s.radius), f64::from(cone.sine));
        // Facing means: normal · (eye − point) > 0.
        sine < 1.0 && cone.axis.as_dvec3().dot(away) >= away.length() * sine + r * (1.0 + 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera(fov_deg: f32) -> Camera {
        Camera {
            pose: Pose::looking(Vec3::new(3.0, -2.0, 5.0), Vec3::new(1.0, 2.0, -0.5), Vec3::Z),
            lens: Lens { fov_y_rad: fov_deg.to_radians(), aspect: 16.0 / 9.0, near_mm: 0.5 },
            height_px: 720,
        }
    }

    /// Numbers in 0..1 that only look random.
    fn noise(seed: &mut u64) -> f64 {
        *seed = seed.wrapping_mul(6364136223846793005).wrapping_add(1442695040888963407);
        (*seed >> 40) as f64 / (1u64 << 24) as f64
    }

    #[test]
    fn no_displacement_moves_further_on_screen_than_the_bound_and_some_come_near() {
        let seed = &mut 7;
        for fov in [60.0, 90.0, 120.0] {
            let cam = camera(fov);
            let eye = Eye::new(&cam);
            let (t_y, focal) = ((0.5 * f64::from(fov).to_radians()).tan(), eye.focal_px);
            let t_x = t_y * f64::from(cam.lens.aspect);
            let mut closest: f64 = 0.0;
            for _ in 0..20_000 {
                let z = 1.0 + 20.0 * noise(seed);
                let at = DVec3::new(
                    (2.0 * noise(seed) - 1.0) * t_x * z,
                    (2.0 * noise(seed) - 1.0) * t_y * z,
                    -z,
                );
                let error = 0.3 * noise(seed);
                let ball = DVec3::from_array([(); 3].map(|()| 2.0 * noise(seed) - 1.0));
                let moved = at + ball.normalize_or_zero() * error;
                let px = |p: DVec3| p.truncate() * (focal / -p.z);
                let seen = px(moved).distance(px(at));
                let world = eye.position + eye.camera_from_world.transpose() * at;
                let s = Sphere { centre: world.as_vec3(), radius: 1e-4 };
                assert!(eye.sees(&s));
                let bound = eye.error_px(&s, error as f32 * 1.000_001);
                assert!(seen <= bound * 1.001, "{seen} px, bound {bound}");
                closest = closest.max(seen / bound);
            }
            assert!(closest > 0.9, "the bound is loose: {closest}");
        }
    }

    #[test]
    fn a_larger_sphere_is_seen_whenever_a_smaller_one_in_it_is_and_errs_no_less() {
        let seed = &mut 3;
        let eye = Eye::new(&camera(90.0));
        for _ in 0..20_000 {
            let mut v = |s: f64| {
                DVec3::from_array([(); 3].map(|()| s * (2.0 * noise(seed) - 1.0))).as_vec3()
            };
            let small = Sphere { centre: v(20.0), radius: v(2.0).x.abs() };
            let shift = v(3.0);
            let large =
                Sphere { centre: small.centre + shift, radius: small.radius + shift.length() };
            assert!(eye.sees(&large) || !eye.sees(&small));
            assert!(eye.error_px(&large, 0.05) >= eye.error_px(&small, 0.05) * 0.9999);
        }
    }

    #[test]
    fn a_patch_is_behind_only_if_all_of_it_turns_its_back() {
        let eye = Eye::new(&camera(90.0));
        let s = Sphere { centre: Vec3::new(13.0, -2.0, 5.0), radius: 1.0 };
        let cone = |axis, sine| Cone { axis, sine };
        assert!(eye.behind(&s, &cone(Vec3::X, 0.2)));
        assert!(!eye.behind(&s, &cone(Vec3::NEG_X, 0.2)));
        assert!(!eye.behind(&s, &cone(Vec3::Y, 0.2)));
        assert!(!eye.behind(&s, &cone(Vec3::X, 0.95)));
        assert!(!eye.behind(&s, &Cone::default()));
    }
}
