//! The six faces of a cube about an eye: together they see everything.

use std::f32::consts::{FRAC_PI_2, PI};

use glam::Quat;

use super::{Lens, Pose};

/// Returns pose and lens of the front, right, back, left, up and down view of an eye: squares that
/// meet at their edges.
///
/// * `lens`: lens whose near ball holds no wall; those of the faces have the same ball.
/// * `margin`: width by which each face extends beyond its edge, as a share of half a face; 0 for
///   squares that just meet.
pub fn cube_faces(pose: &Pose, lens: &Lens, margin: f32) -> [(Pose, Lens); 6] {
    let turns = [
        Quat::IDENTITY,
        Quat::from_rotation_y(-FRAC_PI_2),
        Quat::from_rotation_y(PI),
        Quat::from_rotation_y(FRAC_PI_2),
        Quat::from_rotation_x(FRAC_PI_2),
        Quat::from_rotation_x(-FRAC_PI_2),
    ];
    let square = Lens { fov_y_rad: 2.0 * (1.0 + margin).atan(), aspect: 1.0, near_mm: 1.0 };
    let near_mm = lens.near_ball_mm() / square.near_ball_mm();
    let square = Lens { near_mm, ..square };
    turns.map(|turn| (Pose { rotation: (pose.rotation * turn).normalize(), ..*pose }, square))
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::Vec3;

    #[test]
    fn six_faces_see_every_direction_once_and_keep_the_near_ball() {
        let pose = Pose::looking(Vec3::new(3.0, -2.0, 7.0), Vec3::new(0.3, 0.8, -0.5), Vec3::Z);
        let lens = Lens { fov_y_rad: 1.7, aspect: 1.6, near_mm: 0.8 };
        let faces = cube_faces(&pose, &lens, 0.0);
        for (face, l) in &faces {
            assert!((l.near_ball_mm() - lens.near_ball_mm()).abs() < 1e-5);
            assert_eq!(face.position_mm, pose.position_mm);
        }
        assert!(faces[0].0.forward().abs_diff_eq(pose.forward(), 1e-6));
        assert!(faces[4].0.forward().abs_diff_eq(pose.up(), 1e-6));
        // Front's upper edge is the lower edge of what is above.
        assert!(faces[4].0.up().abs_diff_eq(-pose.forward(), 1e-6));
        for i in 0..1000 {
            let a = 0.61803 * i as f32 * std::f32::consts::TAU;
            let z = 1.0 - (i as f32 + 0.5) / 500.0;
            let d = Vec3::new(a.cos() * (1.0 - z * z).sqrt(), a.sin() * (1.0 - z * z).sqrt(), z);
            let holds = |(face, _): &&(Pose, Lens)| {
                let c = face.rotation.conjugate() * d;
                c.z < 0.0 && c.x.abs() < -c.z && c.y.abs() < -c.z
            };
            assert_eq!(faces.iter().filter(holds).count(), 1, "{d}");
        }
    }
}
