//! View frustum culling, back-face culling, and the screen-space error of a bounded region.

use glam::{DMat3, DQuat, DVec3, Vec3};

use crate::geometry::{Camera, Cone, Sphere};

/// Size in the image of errors at one place: an error of e mm is up to `slope_px` e /
/// (`depth_mm` - e) pixels, and without limit from half the depth on.
#[derive(Clone, Copy, Debug)]
pub struct ErrorScale {
    /// Least depth of the place, mm.
    depth_mm: f64,
    /// Pixels a radian times the secant of the angle off the axis.
    slope_px: f64,
}

impl ErrorScale {
    /// Returns the largest size of an error, pixels.
    pub fn px(&self, error_mm: f64) -> f64 {
        if error_mm <= 0.0 {
            0.0
        } else if self.depth_mm <= 2.0 * error_mm {
            f64::INFINITY
        } else {
            self.slope_px * error_mm / (self.depth_mm - error_mm)
        }
    }

    /// Returns the largest error, mm, of at most a size: the inverse of [`Self::px`].
    pub fn error_mm(&self, px: f64) -> f64 {
        // Half the depth itself is too much.
        let most = 0.5 * self.depth_mm * (1.0 - f64::EPSILON);
        (px * self.depth_mm / (self.slope_px + px)).min(most)
    }

    /// Returns the share of the way from a finer level back to a coarser one up to which the product
    /// of two figures is at most `limit`: the size of an error in pixels, and a factor. Both change
    /// linearly along the way. With n the factor, e the error, s the slope and z the depth, the
    /// product is n s e / (z - e), and the share the first root of n s e - limit (z - e).
    ///
    /// * `error_mm`, `factor`: at the finer level, and at the coarser one.
    pub fn share_of_product(&self, error_mm: [f64; 2], factor: [f64; 2], limit: f64) -> f64 {
        let [e, n] = [error_mm[0], factor[0]];
        let [de, dn] = [error_mm[1] - e, factor[1] - n];
        let a = dn * self.slope_px * de;
        let b = self.slope_px * (n * de + dn * e) + limit * de;
        let c = n * self.slope_px * e - limit * (self.depth_mm - e);
        // Errors of half the depth and more have no limit.
        let left_mm = 0.5 * self.depth_mm - e;
        if left_mm <= 0.0 {
            return 0.0;
        }
        let to_half = if de > 0.0 { left_mm / de } else { f64::INFINITY };
        first_root(a, b, c).min(to_half)
    }
}

/// First root of a u² + b u + c above 0, of a polynomial that is not positive at 0; infinite where it
/// stays so, 0 where it is positive.
fn first_root(a: f64, b: f64, c: f64) -> f64 {
    if c > 0.0 {
        return 0.0;
    }
    let square = b * b - 4.0 * a * c;
    // Without cancellation (Press et al., Numerical Recipes, 5.6).
    let sum = -0.5 * (b + square.max(0.0).sqrt().copysign(b));
    let positive = |root: f64| if root > 0.0 { root } else { f64::INFINITY };
    match square {
        _ if a == 0.0 => positive(-c / b),
        square if square < 0.0 => f64::INFINITY,
        _ => positive(sum / a).min(positive(c / sum)),
    }
}

/// Bounds of a projected convex region, tighter than a bounding sphere: image sides, depth and
/// angle off the axis, each bounded by its values at the corners. Sides and depth are linear, and
/// the set of points within some angle of the axis is convex.
#[derive(Clone, Copy, Debug)]
pub struct ProjectedBounds {
    /// One bit for each side of the image and the near plane that the whole region is beyond.
    outside_planes: u8,
    /// Least depth, mm.
    min_depth_mm: f64,
    /// 1 / cosine of the largest angle off the axis; infinite where it reaches behind the eye.
    secant: f64,
}

impl ProjectedBounds {
    /// Bounds of the convex hull of both.
    pub fn union(self, o: &Self) -> Self {
        Self {
            outside_planes: self.outside_planes & o.outside_planes,
            min_depth_mm: self.min_depth_mm.min(o.min_depth_mm),
            secant: self.secant.max(o.secant),
        }
    }
}

/// The view frustum of a camera, with the products that each test needs. In f64: conservative tests
/// must not be broken by rounding.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewFrustum {
    position: DVec3,
    camera_from_world: DMat3,
    /// Tangents of half the horizontal and vertical field of view.
    tangent: [f64; 2],
    /// 1 / cosine of those half-angles.
    secant: [f64; 2],
    /// Inward normals of the four sides, LPS; all planes pass through the eye.
    sides: [DVec3; 4],
    /// Direction of the view, LPS.
    forward: DVec3,
    near: f64,
    /// Pixels a radian at the centre.
    focal_px: f64,
    /// 1 / cosine of the angle off the axis of the picture's corner.
    corner_secant: f64,
}

impl ViewFrustum {
    /// Precomputes the frustum of a camera.
    pub fn new(camera: &Camera) -> Self {
        let t_y = (0.5 * f64::from(camera.lens.fov_y_rad)).tan();
        let t_x = t_y * f64::from(camera.lens.aspect);
        let turn: DQuat = camera.pose.rotation.as_dquat().normalize();
        Self {
            position: camera.pose.position_mm.as_dvec3(),
            camera_from_world: DMat3::from_quat(turn.conjugate()),
            tangent: [t_x, t_y],
            secant: [(1.0 + t_x * t_x).sqrt(), (1.0 + t_y * t_y).sqrt()],
            // The camera looks along -z: a place is inside where |x| <= -z tan and |y| <= -z tan.
            sides: [
                DVec3::new(1.0, 0.0, -t_x),
                DVec3::new(-1.0, 0.0, -t_x),
                DVec3::new(0.0, 1.0, -t_y),
                DVec3::new(0.0, -1.0, -t_y),
            ]
            .map(|n| turn * n),
            forward: turn * DVec3::NEG_Z,
            near: f64::from(camera.lens.near_mm),
            focal_px: f64::from(camera.height_px) / (2.0 * t_y),
            corner_secant: (1.0 + t_x * t_x + t_y * t_y).sqrt(),
        }
    }

    /// Returns the position of the eye, LPS mm.
    pub fn position(&self) -> DVec3 {
        self.position
    }

    /// Returns the number of pixels a radian at the centre of the image.
    pub fn focal_px(&self) -> f64 {
        self.focal_px
    }

    /// Returns the tangents of half the horizontal and vertical field of view.
    pub fn tangents(&self) -> [f64; 2] {
        self.tangent
    }

    /// Returns the way, LPS, of the ray through a point of the image, of depth 1: tangents of its
    /// angles off the axis.
    pub fn way(&self, x: f64, y: f64) -> DVec3 {
        self.camera_from_world.transpose() * DVec3::new(x, y, -1.0)
    }

    /// Returns the half extent, along the axes of LPS, of a rectangle across the view.
    ///
    /// * `x`, `y`: half its width and height.
    pub fn reach(&self, x: f64, y: f64) -> DVec3 {
        let turn = self.camera_from_world.transpose();
        turn.x_axis.abs() * x + turn.y_axis.abs() * y
    }

    /// Returns the smallest rectangle, in tangents, around the image of a box, and the box's least
    /// depth; `None` of one that the plane of the eye cuts or that is behind it. Rounded outwards.
    ///
    /// * `centre`, `half`: as for [`Self::intersects_box`].
    pub fn rectangle(&self, centre: DVec3, half: DVec3) -> Option<([f64; 2], [f64; 2], f64)> {
        let c = self.camera_from_world * centre;
        let axes = [
            self.camera_from_world.x_axis * half.x,
            self.camera_from_world.y_axis * half.y,
            self.camera_from_world.z_axis * half.z,
        ];
        let (mut lo, mut hi, mut least) = ([f64::MAX; 2], [f64::MIN; 2], f64::MAX);
        for corner in 0..8 {
            let mut p = c;
            for (k, axis) in axes.iter().enumerate() {
                if corner >> k & 1 == 0 { p -= *axis } else { p += *axis }
            }
            let depth = -p.z;
            if depth <= 1e-6 {
                return None;
            }
            let per = depth.recip();
            for k in 0..2 {
                lo[k] = lo[k].min(p[k] * per);
                hi[k] = hi[k].max(p[k] * per);
            }
            least = least.min(depth);
        }
        let hair = |t: f64| 1e-9 * (1.0 + t.abs());
        Some((lo.map(|t| t - hair(t)), hi.map(|t| t + hair(t)), least * (1.0 - 1e-9)))
    }

    /// Frustum culling: whether any point of the sphere may be in the image; false only if none is.
    pub fn intersects(&self, s: &Sphere) -> bool {
        let c = self.camera_from_world * (s.centre.as_dvec3() - self.position);
        let r = f64::from(s.radius) * (1.0 + 1e-6) + 1e-6;
        // Planes through the eye, normals inwards (camera looks along -z).
        -c.z >= self.near - r
            && (0..2).all(|k| c[k].abs() - self.tangent[k] * -c.z <= r * self.secant[k])
    }

    /// Frustum culling: whether a box may be in the image; false only if all of it is beyond one of
    /// the planes.
    ///
    /// * `centre`: of the box, relative to the eye, along the axes of LPS like `half`, its half
    ///   extent.
    pub fn intersects_box(&self, centre: DVec3, half: DVec3) -> bool {
        let reach = |n: DVec3| n.dot(centre) + n.abs().dot(half);
        reach(self.forward) >= self.near && self.sides.iter().all(|n| reach(*n) >= 0.0)
    }

    /// Whether a point, relative to the eye, is in the image.
    pub fn contains(&self, p: DVec3) -> bool {
        self.forward.dot(p) >= self.near && self.sides.iter().all(|n| n.dot(p) >= 0.0)
    }

    /// Screen-space error: upper bound, in pixels, of the projected distance of two points that are
    /// at most `error_mm` apart, one of them in the sphere and in the image. With F = H / (2
    /// tan(fov/2)), view depth z and angle θ off the axis it is F ε sec θ / (z − ε): for a
    /// displacement δ the image point moves by F (δ_xy − δ_z tan θ) / (z + δ_z), and the operator
    /// norm of (δ_xy, δ_z) ↦ δ_xy − δ_z tan θ is sec θ. The usual F ε / distance is too small by
    /// 1.7 (60° lens) to 14 (120°, corner). Infinite where the nearest depth is not at least 2 ε.
    pub fn error_scale(&self, s: &Sphere) -> ErrorScale {
        let c = self.camera_from_world * (s.centre.as_dvec3() - self.position);
        let r = f64::from(s.radius) * (1.0 + 1e-6) + 1e-6;
        // Nothing nearer than the near plane is drawn.
        let depth_mm = (-c.z - r).max(self.near);
        // The largest angle off the axis is the centre's and half of what the sphere spans; the
        // cosine of the sum, without the angles. Beyond the picture's corner nothing is drawn.
        let (square, span) = (c.length_squared(), c.length_squared() - r * r);
        let mut cosine = self.corner_secant.recip();
        if span > 0.0 {
            cosine = cosine.max((-c.z * span.sqrt() - c.truncate().length() * r) / square);
        }
        ErrorScale { depth_mm, slope_px: self.focal_px / cosine }
    }

    /// Projects the ball of radius `margin_mm` around `p`.
    pub fn project(&self, p: Vec3, margin_mm: f32) -> ProjectedBounds {
        let c = self.camera_from_world * (p.as_dvec3() - self.position);
        let m = f64::from(margin_mm) * (1.0 + 1e-6) + 1e-6;
        let mut outside_planes = u8::from(-c.z < self.near - m);
        for k in 0..2 {
            let (reach, slack) = (self.tangent[k] * -c.z, m * self.secant[k]);
            outside_planes |= u8::from(c[k] > reach + slack) << (2 * k + 1);
            outside_planes |= u8::from(-c[k] > reach + slack) << (2 * k + 2);
        }
        let min_depth_mm = -c.z - m;
        let secant =
            if min_depth_mm > 0.0 { (c.length() + m) / min_depth_mm } else { f64::INFINITY };
        ProjectedBounds { outside_planes, min_depth_mm, secant }
    }

    /// Returns [`Self::error_scale`] of projected bounds instead of a sphere; `None` where they are
    /// outside the image.
    pub fn bounds_error_scale(&self, s: &ProjectedBounds) -> Option<ErrorScale> {
        (s.outside_planes == 0).then(|| ErrorScale {
            depth_mm: s.min_depth_mm.max(self.near),
            slope_px: self.focal_px * s.secant.min(self.corner_secant),
        })
    }

    /// Back-face culling: whether every face with its normal in the cone and its position in the
    /// sphere faces away.
    pub fn is_backfacing(&self, s: &Sphere, cone: &Cone) -> bool {
        let away = s.centre.as_dvec3() - self.position;
        let (r, sine) = (f64::from(s.radius), f64::from(cone.sine));
        // Facing means: normal · (eye − point) > 0.
        sine < 1.0 && cone.axis.as_dvec3().dot(away) >= away.length() * sine + r * (1.0 + 1e-6)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Lens, Pose};

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
    fn screen_space_error_bounds_every_displacement_and_is_nearly_attained() {
        let seed = &mut 7;
        for fov in [60.0, 90.0, 120.0] {
            let cam = camera(fov);
            let frustum = ViewFrustum::new(&cam);
            let (t_y, focal) = ((0.5 * f64::from(fov).to_radians()).tan(), frustum.focal_px);
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
                let world = frustum.position + frustum.camera_from_world.transpose() * at;
                let s = Sphere { centre: world.as_vec3(), radius: 1e-4 };
                assert!(frustum.intersects(&s));
                let bound = frustum.error_scale(&s).px(error * 1.000_001);
                assert!(seen <= bound * 1.001, "{seen} px, bound {bound}");
                closest = closest.max(seen / bound);
            }
            assert!(closest > 0.9, "the bound is loose: {closest}");
        }
    }

    #[test]
    fn the_largest_error_and_the_share_of_a_product_agree_with_a_search() {
        let seed = &mut 23;
        let mut v = |s: f64| s * noise(seed);
        for _ in 0..20_000 {
            let scale = ErrorScale { depth_mm: 0.5 + v(20.0), slope_px: 50.0 + v(500.0) };
            let px = v(30.0);
            let error_mm = scale.error_mm(px);
            assert!(scale.px(error_mm) <= px * (1.0 + 1e-9));
            assert!(scale.px(error_mm * 1.000_001) > px * (1.0 - 1e-9), "{scale:?} {px}");
            let (error, angle, limit) = ([v(1.0), v(4.0)], [v(1.0), v(1.0)], v(100.0));
            let share = scale.share_of_product(error, angle, limit);
            let product = |u: f64| {
                let at = |f: [f64; 2]| f[0] + u * (f[1] - f[0]);
                at(angle) * scale.px(at(error))
            };
            let steps = (0..=1000).map(|k| f64::from(k) / 1000.0);
            let found = steps.take_while(|u| product(*u) <= limit).last().unwrap_or(0.0);
            assert!((share.min(1.0) - found).abs() < 1.1e-3, "{share} {found} {scale:?}");
        }
    }

    #[test]
    fn projected_bounds_of_the_corners_bound_the_error_of_the_whole_triangle() {
        let seed = &mut 11;
        let frustum = ViewFrustum::new(&camera(90.0));
        let (focal, mut closest, mut unseen) = (frustum.focal_px, 0.0f64, 0);
        for _ in 0..20_000 {
            let mut v = |s: f64| DVec3::from_array([(); 3].map(|()| s * (2.0 * noise(seed) - 1.0)));
            let middle = v(8.0);
            let corners = [(); 3].map(|()| (frustum.position + middle + v(1.0)).as_vec3());
            let error = 0.1 * v(1.0).x.abs() as f32;
            let [a, b, c] = corners.map(|p| frustum.project(p, error));
            let bounds = a.union(&b).union(&c);
            let bound =
                frustum.bounds_error_scale(&bounds).map_or(0.0, |scale| scale.px(error.into()));
            // Points of the triangle and points no farther than the error from those, seen or not.
            for _ in 0..4 {
                let w = v(1.0).abs();
                let [a, b, c] = corners.map(|p| p.as_dvec3());
                let on = (a * w.x + b * w.y + c * w.z) / (w.x + w.y + w.z);
                let near = on + v(1.0).normalize_or_zero() * f64::from(error);
                let [p, q] = [on, near].map(|p| frustum.camera_from_world * (p - frustum.position));
                let inside = |p: DVec3| {
                    let side = |k: usize| p[k].abs() <= frustum.tangent[k] * -p.z;
                    -p.z >= frustum.near && side(0) && side(1)
                };
                if !inside(p) && !inside(q) {
                    continue;
                }
                if bounds.outside_planes != 0 {
                    unseen += 1;
                }
                let px = |p: DVec3| p.truncate() * (focal / -p.z);
                let seen = px(p).distance(px(q));
                assert!(seen <= bound * 1.001, "{seen} px, bound {bound}");
                closest = closest.max(seen / bound);
            }
        }
        assert_eq!(unseen, 0);
        assert!(closest > 0.8, "the bound is loose: {closest}");
    }

    #[test]
    fn visibility_and_error_are_monotonic_in_the_bounding_sphere() {
        let seed = &mut 3;
        let frustum = ViewFrustum::new(&camera(90.0));
        for _ in 0..20_000 {
            let mut v = |s: f64| {
                DVec3::from_array([(); 3].map(|()| s * (2.0 * noise(seed) - 1.0))).as_vec3()
            };
            let small = Sphere { centre: v(20.0), radius: v(2.0).x.abs() };
            let shift = v(3.0);
            let large =
                Sphere { centre: small.centre + shift, radius: small.radius + shift.length() };
            assert!(frustum.intersects(&large) || !frustum.intersects(&small));
            let [large, small] = [large, small].map(|s| frustum.error_scale(&s).px(0.05));
            assert!(large >= small * 0.9999);
        }
    }

    #[test]
    fn a_patch_is_backfacing_only_if_all_of_its_faces_are() {
        let frustum = ViewFrustum::new(&camera(90.0));
        let s = Sphere { centre: Vec3::new(13.0, -2.0, 5.0), radius: 1.0 };
        let cone = |axis, sine| Cone { axis, sine };
        assert!(frustum.is_backfacing(&s, &cone(Vec3::X, 0.2)));
        assert!(!frustum.is_backfacing(&s, &cone(Vec3::NEG_X, 0.2)));
        assert!(!frustum.is_backfacing(&s, &cone(Vec3::Y, 0.2)));
        assert!(!frustum.is_backfacing(&s, &cone(Vec3::X, 0.95)));
        assert!(!frustum.is_backfacing(&s, &Cone::default()));
    }
}
