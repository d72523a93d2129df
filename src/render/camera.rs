//! Projection, and a camera that shows the whole organ.

use glam::{DMat3, DVec3, Mat4, Quat, Vec2, Vec3, Vec4};

use crate::geometry::{Lens, Pose};

/// Returns the transform from LPS mm to clip space: infinite far plane, depth 1 at the near plane
/// falling to 0, y down as Vulkan has it.
pub fn clip_from_world(pose: &Pose, lens: &Lens) -> Mat4 {
    let f = focal(lens);
    let clip_from_camera = Mat4::from_cols(
        Vec4::new(f.x, 0.0, 0.0, 0.0),
        Vec4::new(0.0, f.y, 0.0, 0.0),
        Vec4::new(0.0, 0.0, 0.0, -1.0),
        Vec4::new(0.0, 0.0, lens.near_mm, 0.0),
    );
    let turn = pose.rotation.conjugate();
    clip_from_camera * Mat4::from_rotation_translation(turn, turn * -pose.position_mm)
}

/// Returns the focal scales: clip x and y of a point one unit right of the axis and one above it,
/// one unit before the eye.
pub(super) fn focal(lens: &Lens) -> Vec2 {
    let f = 1.0 / (0.5 * lens.fov_y_rad).tan();
    Vec2::new(f / lens.aspect, -f)
}

/// Margin around the organ, as a share of the frame.
const MARGIN: f32 = 0.08;
/// Vertical field of view of the overview, radians: narrow, so that near and far parts keep their
/// proportions.
const FOV_Y: f32 = 0.35;

/// Returns a pose and lens that show the box `low` to `high` from in front of the patient: head up,
/// the patient's left on the right.
pub fn framing(low: Vec3, high: Vec3, aspect: f32) -> (Pose, Lens) {
    let centre = 0.5 * (low + high);
    let half = (0.5 * (high - low)).max(Vec3::splat(1e-3));
    let t = (0.5 * FOV_Y).tan() * (1.0 - 2.0 * MARGIN);
    // The nearest face of the box is the one that has to fit: distance to it, then to the centre.
    let distance = (half.z / t).max(half.x / (t * aspect)) + half.y;
    let eye = centre - distance * Vec3::Y;
    let pose = Pose { position_mm: eye, rotation: facing_posterior() };
    let near = (distance - half.y) * 0.1;
    (pose, Lens { fov_y_rad: FOV_Y, aspect, near_mm: near })
}

/// Side from which the overview shows an organ, and how near.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Framing {
    /// Rotation of the organ about its vertical axis and then about the picture's horizontal one,
    /// radians; zero is from in front.
    pub orbit: [f32; 2],
    /// Enlargement; 1 shows all of the organ.
    pub zoom: f32,
    /// Way of the camera to its right and up from the organ's middle, mm.
    pub pan_mm: [f32; 2],
}

impl Default for Framing {
    fn default() -> Self {
        Self { orbit: [0.0; 2], zoom: 1.0, pan_mm: [0.0; 2] }
    }
}

/// Steps of half a turn about the vertical axis, among which the side of an overview is chosen.
const SIDES: u32 = 12;
/// Share of the largest spread from any side that the spread from the front has to have: else the
/// overview looks from another side.
const MIN_FRONT_SPREAD: f64 = 0.5;

impl Framing {
    /// Returns the side, head up, that shows a path: the front, or where the path lies nearly along
    /// the line of sight there, the side from which it spreads most.
    pub fn of_path(points: impl Iterator<Item = DVec3> + Clone) -> Self {
        let count = points.clone().count().max(1) as f64;
        let mean = points.clone().sum::<DVec3>() / count;
        let mut covariance = DMat3::ZERO;
        for p in points.map(|p| p - mean) {
            covariance += DMat3::from_cols(p * p.x, p * p.y, p * p.z) * (1.0 / count);
        }
        let all = (0..3).map(|i| covariance.col(i)[i]).sum::<f64>();
        // Product of the standard deviations along the principal axes of the picture, each with a
        // tenth of that of the whole path: a straight path spreads along one axis alone.
        let spread = |about: f64| {
            let right = DVec3::new(about.cos(), -about.sin(), 0.0);
            let [xx, xy, yy] = [(right, right), (right, DVec3::Z), (DVec3::Z, DVec3::Z)]
                .map(|(a, b)| a.dot(covariance * b));
            let (mean, half) = (0.5 * (xx + yy), (0.5 * (xx - yy)).hypot(xy));
            let sd = |variance: f64| variance.max(0.0).sqrt() + 0.1 * all.sqrt();
            sd(mean + half) * sd(mean - half)
        };
        let sides = (0..SIDES).map(|i| -std::f64::consts::PI * f64::from(i) / f64::from(SIDES));
        let best = sides.max_by(|a, b| spread(*a).total_cmp(&spread(*b)).then(b.total_cmp(a)));
        let best = best.filter(|side| spread(0.0) < MIN_FRONT_SPREAD * spread(*side));
        let orbit = best.map_or(0.0, |side| side.rem_euclid(std::f64::consts::TAU) as f32);
        Self { orbit: [orbit, 0.0], ..Self::default() }
    }

    /// Returns a pose and lens that show the box as [`framing`] does, from this side and so near.
    pub fn camera(&self, low: Vec3, high: Vec3, aspect: f32) -> (Pose, Lens) {
        let (mut pose, mut lens) = framing_turned(low, high, aspect, self.orbit);
        let [x, y] = self.pan_mm;
        pose.position_mm += pose.rotation * Vec3::new(x, y, 0.0);
        if self.zoom != 1.0 {
            // The eye stays where it is in front of all of the organ; its lens gets longer.
            lens.fov_y_rad = 2.0 * ((0.5 * lens.fov_y_rad).tan() / self.zoom).atan();
        }
        (pose, lens)
    }
}

fn framing_turned(low: Vec3, high: Vec3, aspect: f32, orbit: [f32; 2]) -> (Pose, Lens) {
    if orbit == [0.0; 2] {
        return framing(low, high, aspect);
    }
    let rotation =
        Quat::from_rotation_z(-orbit[0]) * facing_posterior() * Quat::from_rotation_x(-orbit[1]);
    let centre = 0.5 * (low + high);
    let half = (0.5 * (high - low)).max(Vec3::splat(1e-3));
    // Half the box's extent along an axis of the camera.
    let extent = |axis: Vec3| (rotation * axis).abs().dot(half);
    let (x, y, z) = (extent(Vec3::X), extent(Vec3::Y), extent(Vec3::Z));
    let t = (0.5 * FOV_Y).tan() * (1.0 - 2.0 * MARGIN);
    let distance = (y / t).max(x / (t * aspect)) + z;
    let pose = Pose { position_mm: centre + rotation * Vec3::Z * distance, rotation };
    (pose, Lens { fov_y_rad: FOV_Y, aspect, near_mm: (distance - z) * 0.1 })
}

/// Returns the rotation of a camera that looks along +y (posterior) with +z (superior) up.
fn facing_posterior() -> Quat {
    Quat::from_rotation_x(std::f32::consts::FRAC_PI_2)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn from_every_side_the_whole_box_is_in_the_picture_and_in_front_of_the_near_plane() {
        let (low, high) = (Vec3::new(-40.0, 10.0, 300.0), Vec3::new(25.0, 60.0, 420.0));
        for (i, aspect) in [0.6, 1.0, 1.8].into_iter().enumerate() {
            let front = framing_turned(low, high, aspect, [1e-6, 0.0]).0;
            let plain = framing(low, high, aspect).0;
            assert!(front.position_mm.distance(plain.position_mm) < 0.01, "no jump from the front");
            for step in 0..24 {
                let orbit = [0.4 * step as f32 + i as f32, 0.13 * (step as f32 - 12.0)];
                let (pose, lens) = framing_turned(low, high, aspect, orbit);
                let clip = clip_from_world(&pose, &lens);
                for k in 0..8u32 {
                    let pick = |axis: u32| k >> axis & 1 == 1;
                    let corner =
                        Vec3::select(glam::BVec3::new(pick(0), pick(1), pick(2)), high, low);
                    let c = clip * corner.extend(1.0);
                    assert!(c.w > lens.near_mm, "{orbit:?}");
                    assert!(c.x.abs() < c.w && c.y.abs() < c.w, "{orbit:?}: {c}");
                }
            }
        }
    }

    #[test]
    fn zoom_enlarges_about_the_middle_and_pan_takes_another_place_there() {
        let (low, high) = (Vec3::new(-40.0, 10.0, 300.0), Vec3::new(25.0, 60.0, 420.0));
        let at = |framing: Framing, p: Vec3| {
            let (pose, lens) = framing.camera(low, high, 1.3);
            seen(clip_from_world(&pose, &lens), p)
        };
        let orbit = [0.7, -0.2];
        let plain = Framing { orbit, ..Framing::default() };
        let place = Vec3::new(10.0, 20.0, 350.0);
        let (near, all) = (at(Framing { zoom: 3.0, ..plain }, place), at(plain, place));
        assert!((near.truncate() - 3.0 * all.truncate()).length() < 1e-4, "{near} {all}");
        let middle = 0.5 * (low + high);
        let (pose, _) = plain.camera(low, high, 1.3);
        let right = middle + 8.0 * (pose.rotation * Vec3::X) + 5.0 * pose.up();
        let panned = at(Framing { pan_mm: [8.0, 5.0], ..plain }, right);
        assert!(panned.truncate().length() < 1e-4, "{panned}");
    }

    #[test]
    fn a_path_that_runs_from_front_to_back_is_not_shown_end_on() {
        let path = |ahead: f64, across: f64, up: f64| {
            (0..50).map(move |i| {
                let t = f64::from(i) / 49.0;
                DVec3::new(
                    across * (9.0 * t).sin(),
                    ahead * t,
                    up * (1.0 - 4.0 * (t - 0.5).powi(2)),
                )
            })
        };
        // An arch from front to back: seen from the patient's left, the front on the left.
        let side = Framing::of_path(path(300.0, 15.0, 30.0));
        let (pose, _) = side.camera(Vec3::splat(-50.0), Vec3::splat(50.0), 1.0);
        assert!(pose.forward().x < -0.9 && (pose.rotation * Vec3::X).y > 0.9, "{side:?}");
        assert!(pose.up().z > 0.999, "head up");
        // A path that the front shows, if not at its best, is shown from there.
        for at in [path(30.0, 15.0, 300.0), path(100.0, 80.0, 200.0), path(0.0, 0.0, 0.0)] {
            assert_eq!(Framing::of_path(at), Framing::default());
        }
        assert_eq!(Framing::of_path(std::iter::empty()), Framing::default());
    }

    fn seen(m: Mat4, p: Vec3) -> Vec3 {
        let c = m * p.extend(1.0);
        c.truncate() / c.w
    }

    #[test]
    fn depth_falls_from_one_at_the_near_plane_to_zero() {
        let pose = Pose::looking(Vec3::new(1.0, 2.0, 3.0), Vec3::X, Vec3::Z);
        let lens = Lens { fov_y_rad: 1.2, aspect: 1.5, near_mm: 0.25 };
        let m = clip_from_world(&pose, &lens);
        let at = |d: f32| seen(m, pose.position_mm + d * Vec3::X).z;
        assert!((at(0.25) - 1.0).abs() < 1e-5);
        assert!(at(0.5) > at(1.0) && at(1.0) > at(1e4) && at(1e4) > 0.0);
        // Up is up: smaller y in Vulkan.
        assert!(seen(m, pose.position_mm + Vec3::X + 0.1 * Vec3::Z).y < 0.0);
        assert!(seen(m, pose.position_mm + Vec3::X - 0.1 * Vec3::Y).x > 0.0);
    }

    #[test]
    fn the_framing_shows_all_of_the_box_with_the_patients_left_on_the_right() {
        for (size, aspect) in [
            (Vec3::new(300.0, 200.0, 450.0), 1.33),
            (Vec3::new(10.0, 400.0, 5.0), 0.5),
            (Vec3::new(400.0, 1.0, 20.0), 1.0),
        ] {
            let low = Vec3::new(-20.0, -140.0, 900.0);
            let (pose, lens) = framing(low, low + size, aspect);
            let m = clip_from_world(&pose, &lens);
            let mut reach: f32 = 0.0;
            for i in 0..8 {
                let pick = Vec3::new((i & 1) as f32, (i >> 1 & 1) as f32, (i >> 2) as f32);
                let p = seen(m, low + pick * size);
                assert!(p.x.abs() < 1.0 && p.y.abs() < 1.0 && p.z < 1.0 && p.z > 0.0, "{p}");
                reach = reach.max(p.x.abs()).max(p.y.abs());
            }
            assert!(reach > 0.8, "the organ fills only {reach} of the frame");
            let mid = low + 0.5 * size;
            assert!(seen(m, mid + Vec3::X).x > seen(m, mid).x);
            assert!(seen(m, mid + Vec3::Z).y < seen(m, mid).y);
        }
    }
}
