//! Gazes that a reader sets at places of a path: the flight takes them up there.

use glam::Quat;

use super::{Flight, FlightPath};

/// Turns of the gaze along a path, from the way the flight looks to the way a reader wants it to.
///
/// At each key the gaze is the reader's; between two keys it turns along the shortest way, from rest
/// to rest (3 t² − 2 t³). Both ends of the path are keys without a turn, unless they have one.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct KeyedGaze {
    /// Millimetres along the path, ascending, and the turn in the frame of the flight's camera.
    keys: Vec<(f64, Quat)>,
}

impl KeyedGaze {
    /// Takes over gazes: millimetres along the path, and rotations of the camera (world from camera).
    pub fn new(path: &FlightPath, gazes: impl IntoIterator<Item = (f64, Quat)>) -> Self {
        let turn = |(arc, gaze): (f64, Quat)| {
            (arc, (path.pose_at(arc).rotation.inverse() * gaze).normalize())
        };
        let mut keys: Vec<_> = gazes.into_iter().map(turn).filter(|k| k.1.is_finite()).collect();
        if keys.is_empty() {
            return Self { keys };
        }
        keys.sort_by(|a, b| a.0.total_cmp(&b.0));
        if keys[0].0 > 0.0 {
            keys.insert(0, (0.0, Quat::IDENTITY));
        }
        if keys[keys.len() - 1].0 < path.length_mm() {
            keys.push((path.length_mm(), Quat::IDENTITY));
        }
        Self { keys }
    }

    /// Whether no gaze is set.
    pub fn is_empty(&self) -> bool {
        self.keys.is_empty()
    }

    /// Returns the turn of the camera at a place, after which it looks as wanted: to be multiplied from
    /// the right to the rotation of the flight's own pose.
    pub fn turn_at(&self, arc_mm: f64) -> Quat {
        let next = self.keys.partition_point(|k| k.0 < arc_mm);
        let (before, after) = (next.checked_sub(1), self.keys.get(next));
        match (before.map(|i| self.keys[i]), after) {
            (Some((from, a)), Some(&(to, b))) => {
                let t = ((arc_mm - from) / (to - from)).clamp(0.0, 1.0);
                a.slerp(b, (t * t * (3.0 - 2.0 * t)) as f32)
            }
            (Some((_, turn)), None) | (None, Some(&(_, turn))) => turn,
            (None, None) => Quat::IDENTITY,
        }
    }

    /// Turns the poses of a flight along that path. Places, near planes and proofs of clearance stay:
    /// they hold for every direction.
    pub fn turned(&self, flight: &Flight) -> Flight {
        let mut turned = flight.clone();
        for (pose, arc) in turned.poses.iter_mut().zip(&flight.arc_mm) {
            pose.rotation = (pose.rotation * self.turn_at(*arc)).normalize();
        }
        turned
    }
}

#[cfg(test)]
mod tests {
    use glam::{DVec3, Vec3};

    use super::*;
    use crate::geometry::{Branch, Centerline, CenterlinePoint, Pose};

    /// A straight flight of a hundred millimetres along x.
    fn straight() -> (Flight, FlightPath) {
        let count = 101;
        let pose = |i: i32| Pose::looking(Vec3::X * i as f32, Vec3::X, Vec3::Z);
        let flight = Flight {
            poses: (0..count).map(pose).collect(),
            near_mm: vec![1.0; 101],
            seconds: (0..count).map(f64::from).collect(),
            arc_mm: (0..count).map(f64::from).collect(),
            clearance_mm: vec![2.0; 101],
            room_mm: vec![5.0; 101],
            fov_y_rad: 1.0,
            aspect: 1.0,
            moved: 0,
            cuts: Vec::new(),
            left_out: 0,
        };
        let point = |i: i32| CenterlinePoint {
            position_mm: DVec3::X * f64::from(i),
            radius_mm: 5.0,
            abscissa_mm: f64::from(i),
        };
        let points = (0..count).map(point).collect();
        let line = Centerline { branches: vec![Branch { points, ..Branch::default() }] };
        let path = FlightPath::new(&flight, &line).unwrap();
        (flight, path)
    }

    #[test]
    fn the_gaze_is_the_readers_at_its_place_and_the_flights_at_the_ends() {
        let (flight, path) = straight();
        let aside = Pose::looking(Vec3::ZERO, Vec3::Y, Vec3::Z).rotation;
        let back = Pose::looking(Vec3::ZERO, Vec3::NEG_Y, Vec3::Z).rotation;
        let keyed = KeyedGaze::new(&path, [(70.0, back), (40.0, aside)]);
        let turned = keyed.turned(&flight);
        let forward = |i: usize| turned.poses[i].forward();
        for (i, wanted) in [(0, Vec3::X), (40, Vec3::Y), (70, Vec3::NEG_Y), (100, Vec3::X)] {
            assert!(forward(i).distance(wanted) < 1e-5, "at {i} mm: {}", forward(i));
        }
        // From rest to rest, never away from both, and the places stay.
        let half = forward(20);
        assert!(half.x > 0.7 && half.y > 0.7 && half.z.abs() < 1e-5, "{half}");
        let angle = |i: usize| forward(i).angle_between(forward(i + 1));
        assert!(angle(0) < 0.02 && angle(39) < 0.02 && angle(20) > 0.05);
        let places = |f: &Flight| f.poses.iter().map(|p| p.position_mm).collect::<Vec<_>>();
        assert_eq!(places(&turned), places(&flight));
        assert_eq!((turned.near_mm, turned.clearance_mm), (flight.near_mm, flight.clearance_mm));
    }

    #[test]
    fn a_flight_without_gazes_of_its_own_keeps_every_bit() {
        let (flight, path) = straight();
        let none = KeyedGaze::new(&path, []);
        assert!(none.is_empty());
        assert_eq!(none.turn_at(50.0), Quat::IDENTITY);
        // A gaze at the end of the path is the gaze of the end; a rotation that is not finite is left out.
        let aside = Pose::looking(Vec3::ZERO, Vec3::Y, Vec3::Z).rotation;
        let wrong = Quat::from_xyzw(f32::NAN, 0.0, 0.0, 1.0);
        let keyed = KeyedGaze::new(&path, [(100.0, aside), (10.0, wrong)]);
        let last = keyed.turned(&flight).poses[100].forward();
        assert!(last.distance(Vec3::Y) < 1e-5, "{last}");
    }
}
