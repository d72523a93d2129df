//! A camera path as a file: versioned JSON, so that a flight can be kept, edited and flown again.

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use super::{Clearance, FOV_DEG, Flight, FlightError, MAX_FRAMES};
use crate::geometry::{Lens, Pose};

/// Name and version of the format.
pub const SCHEMA: &str = "intima.path/1";
/// Largest file that is read, bytes.
pub const MAX_BYTES: usize = 256 << 20;
/// Largest deviation of a quaternion from unit length.
const UNIT_SLACK: f64 = 1e-3;
/// Largest distance from the origin, mm: a kilometre.
const FARTHEST_MM: f64 = 1e6;

/// Eye and near plane at a moment.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraPathPose {
    /// Seconds since the start.
    pub seconds: f64,
    /// Position of the eye, LPS mm.
    pub position_mm: DVec3,
    /// Rotation from camera to world, unit; the camera looks along -z with +y up.
    pub rotation: DQuat,
    /// Desired near plane, mm.
    pub near_mm: f64,
    /// Whether the eye jumps to this place: the way from the pose before is not flown.
    pub is_cut: bool,
}

/// A camera path: shots in the order of time, at least one.
#[derive(Clone, Debug, PartialEq)]
pub struct CameraPath {
    /// Vertical field of view, degrees.
    pub fov_y_deg: f64,
    /// The shots, times ascending.
    pub shots: Vec<CameraPathPose>,
}

/// Errors of a camera path.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum CameraPathError {
    /// The file is too large.
    #[error("the camera path has {bytes} bytes; at most {MAX_BYTES} are read")]
    TooLarge {
        /// Size of the file, bytes.
        bytes: usize,
    },
    /// The file is not JSON, or its structure is not that of a camera path.
    #[error("line {line}, column {column} of the camera path: {why}")]
    Json {
        /// Line number, from 1.
        line: usize,
        /// Column number, from 1.
        column: usize,
        /// Message of the JSON reader.
        why: String,
    },
    /// The file has another format or version, or other units.
    #[error("the camera path's {field} must be `{wanted}`")]
    Schema {
        /// Name of the field: `schema`, `space` or `unit`.
        field: &'static str,
        /// Required value of the field.
        wanted: &'static str,
    },
    /// The path has no poses, or too many.
    #[error("the camera path has {0} poses; it must have 1 to {MAX_FRAMES}")]
    Count(usize),
    /// The field of view is out of range.
    #[error(
        "the camera path's `fov_y_deg` is {0}; it must be {low} to {high}",
        low = FOV_DEG.start(), high = FOV_DEG.end()
    )]
    FieldOfView(f64),
    /// A pose is invalid.
    #[error("pose {entry} of the camera path: `{field}` is {value}: {why}")]
    Pose {
        /// Index of the pose, from 0.
        entry: usize,
        /// Name of the field.
        field: &'static str,
        /// Value of the field.
        value: String,
        /// Reason why the value is invalid.
        why: &'static str,
    },
}

/// Content of the file. Unknown fields are ignored: later versions of /1 may add some.
#[derive(Serialize, Deserialize)]
struct File {
    /// Name and version of the layout.
    schema: String,
    /// Coordinate system, `LPS`.
    space: String,
    /// Unit of length, `mm`.
    unit: String,
    /// Vertical field of view.
    fov_y_deg: f64,
    /// Poses in order of time.
    poses: Vec<Entry>,
}

#[derive(Serialize, Deserialize)]
struct Entry {
    /// Time of the pose.
    seconds: f64,
    /// Position of the eye.
    position: [f64; 3],
    /// Components x, y, z, w.
    quaternion: [f64; 4],
    /// Distance of the near plane.
    near: f64,
    /// Whether the eye jumps here.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    cut: bool,
}

impl CameraPath {
    /// Reads a camera path.
    ///
    /// # Errors
    /// [`CameraPathError`] names the place or the pose.
    pub fn parse(json: &[u8]) -> Result<Self, CameraPathError> {
        if json.len() > MAX_BYTES {
            return Err(CameraPathError::TooLarge { bytes: json.len() });
        }
        let file: File = serde_json::from_slice(json).map_err(|e| {
            let why = e.to_string();
            let why = why.split(" at line ").next().unwrap_or_default().to_owned();
            CameraPathError::Json { line: e.line(), column: e.column(), why }
        })?;
        for (field, is, wanted) in [
            ("schema", &file.schema, SCHEMA),
            ("space", &file.space, "LPS"),
            ("unit", &file.unit, "mm"),
        ] {
            if is != wanted {
                return Err(CameraPathError::Schema { field, wanted });
            }
        }
        if file.poses.is_empty() || file.poses.len() > MAX_FRAMES {
            return Err(CameraPathError::Count(file.poses.len()));
        }
        if !FOV_DEG.contains(&file.fov_y_deg) {
            return Err(CameraPathError::FieldOfView(file.fov_y_deg));
        }
        let mut shots: Vec<CameraPathPose> = Vec::with_capacity(file.poses.len());
        for (entry, pose) in file.poses.iter().enumerate() {
            let shot = pose.checked(entry, shots.last().map(|s| s.seconds))?;
            shots.push(shot);
        }
        Ok(Self { fov_y_deg: file.fov_y_deg, shots })
    }

    /// The file's text, one pose a line; [`CameraPath::parse`] gives back every bit but the sign of zeros.
    pub fn to_json(&self) -> String {
        let n = |v: f64| {
            serde_json::Number::from_f64(v + 0.0).map_or("null".to_owned(), |n| n.to_string())
        };
        let list = |v: &[f64]| v.iter().map(|v| n(*v)).collect::<Vec<_>>().join(",");
        let poses: Vec<String> = self
            .shots
            .iter()
            .map(|s| {
                format!(
                    "{{\"seconds\":{},\"position\":[{}],\"quaternion\":[{}],\"near\":{}{}}}",
                    n(s.seconds),
                    list(&s.position_mm.to_array()),
                    list(&s.rotation.to_array()),
                    n(s.near_mm),
                    if s.is_cut { ",\"cut\":true" } else { "" }
                )
            })
            .collect();
        format!(
            "{{\"schema\":\"{SCHEMA}\",\"space\":\"LPS\",\"unit\":\"mm\",\n\
             \"quaternion_order\":\"x,y,z,w\",\"camera\":\"looks along -z, +y up\",\n\
             \"fov_y_deg\":{},\"poses\":[\n{}\n]}}\n",
            n(self.fov_y_deg),
            poses.join(",\n")
        )
    }

    /// Returns the time from the first shot to the last, s.
    pub fn total_seconds(&self) -> f64 {
        match (self.shots.first(), self.shots.last()) {
            (Some(a), Some(b)) => b.seconds - a.seconds,
            _ => 0.0,
        }
    }

    /// Returns the shot at a time: positions and near planes are interpolated linearly, rotations
    /// along the shorter arc. Before the first shot it is the first, after the last the last.
    ///
    /// # Panics
    /// Without shots.
    pub fn at(&self, seconds: f64) -> CameraPathPose {
        let i = self.shots.partition_point(|s| s.seconds <= seconds);
        if i == 0 || i == self.shots.len() {
            let end = self.shots[i.saturating_sub(1).min(self.shots.len() - 1)];
            return CameraPathPose { seconds, ..end };
        }
        let (a, b) = (self.shots[i - 1], self.shots[i]);
        if b.is_cut {
            return CameraPathPose { seconds, is_cut: false, ..a };
        }
        let t = (seconds - a.seconds) / (b.seconds - a.seconds);
        CameraPathPose {
            seconds,
            position_mm: a.position_mm.lerp(b.position_mm, t),
            rotation: a.rotation.slerp(b.rotation, t),
            near_mm: a.near_mm + t * (b.near_mm - a.near_mm),
            is_cut: false,
        }
    }

    /// Resamples the path to `count` shots at equal steps in time; a shot at the time of one of the
    /// file's equals it. A path of one shot stays as it is.
    pub fn resampled(&self, count: usize) -> Self {
        let count = count.clamp(1, MAX_FRAMES);
        if count == self.shots.len() || self.shots.len() == 1 {
            return self.clone();
        }
        let start = self.shots.first().map_or(0.0, |s| s.seconds);
        let each = self.total_seconds() / (count.max(2) - 1) as f64;
        // A shot's own time, where rounding alone keeps the step beside it.
        let time = |k: usize| {
            let even = start + each * k as f64;
            let hair = 1e-9 * (1.0 + even.abs());
            let next = self.shots.partition_point(|s| s.seconds < even - hair);
            let near = self.shots.get(next).filter(|s| s.seconds <= even + hair);
            near.map_or(even, |s| s.seconds)
        };
        let jumps = |from: f64, to: f64| {
            self.shots.iter().any(|s| s.is_cut && s.seconds > from && s.seconds <= to)
        };
        let shot = |k: usize| {
            let is_cut = k > 0 && jumps(time(k - 1), time(k));
            CameraPathPose { is_cut, ..self.at(time(k)) }
        };
        Self { fov_y_deg: self.fov_y_deg, shots: (0..count).map(shot).collect() }
    }

    /// Returns the flight of this path, shot by shot: each is proven clear of the wall, with a
    /// nearer near plane where its own would cut it. No eye is moved.
    ///
    /// * `aspect`: width over height of a frame.
    ///
    /// # Errors
    /// [`FlightError::NoRoom`] names the first pose that is outside or too near to the wall.
    pub fn fly(&self, wall: &Clearance<'_>, aspect: f32) -> Result<Flight, FlightError> {
        let mut flight = Flight::empty(self.fov_y_deg.to_radians() as f32, aspect);
        let start = self.shots.first().map_or(0.0, |s| s.seconds);
        for (frame, s) in self.shots.iter().enumerate() {
            let position_mm = s.position_mm.as_vec3();
            let at = position_mm.as_dvec3();
            let wish = Lens { fov_y_rad: flight.fov_y_rad, aspect, near_mm: s.near_mm as f32 };
            let (near, room) = wall.near_mm(at, wish).map_err(|room_mm| FlightError::NoRoom {
                frame,
                at,
                room_mm,
            })?;
            let pose = Pose { position_mm, rotation: s.rotation.as_quat().normalize() };
            let before = flight.poses.last().filter(|_| !s.is_cut);
            let way_mm = before.map_or(0.0, |b| f64::from(b.position_mm.distance(position_mm)));
            flight.cuts.extend((s.is_cut && frame > 0).then_some(frame));
            let arc_mm = flight.arc_mm.last().copied().unwrap_or(0.0) + way_mm;
            flight.push((pose, near, room), s.seconds - start, arc_mm);
            // The proven distance is less than the room, by up to the diagonal of a voxel.
            let by_near_mm = s.near_mm / super::plan::NEAR_SHARE;
            let room_mm = room.max(by_near_mm).max(super::plan::least_room_mm(wall.lumen()));
            flight.room_mm.push(room_mm as f32);
        }
        Ok(flight)
    }
}

impl From<&Flight> for CameraPath {
    fn from(flight: &Flight) -> Self {
        let shot = |i: usize| {
            let Pose { position_mm, rotation } = flight.poses[i];
            CameraPathPose {
                seconds: flight.seconds[i],
                position_mm: position_mm.as_dvec3(),
                rotation: rotation.as_dquat(),
                near_mm: f64::from(flight.near_mm[i]),
                is_cut: flight.cuts.contains(&i),
            }
        };
        Self {
            // One degree of 32 bits is a little less than one.
            fov_y_deg: f64::from(flight.fov_y_rad)
                .to_degrees()
                .clamp(*FOV_DEG.start(), *FOV_DEG.end()),
            shots: (0..flight.poses.len()).map(shot).collect(),
        }
    }
}

impl Entry {
    fn checked(
        &self,
        entry: usize,
        before: Option<f64>,
    ) -> Result<CameraPathPose, CameraPathError> {
        let wrong =
            |field, value: String, why| Err(CameraPathError::Pose { entry, field, value, why });
        if !self.seconds.is_finite() || self.seconds.abs() > 1e9 {
            return wrong("seconds", self.seconds.to_string(), "no time");
        }
        if before.is_some_and(|b| self.seconds <= b) {
            return wrong("seconds", self.seconds.to_string(), "not later than the pose before");
        }
        let position_mm = DVec3::from(self.position);
        if !self.position.iter().all(|c| c.abs() <= FARTHEST_MM) {
            return wrong("position", format!("{:?}", self.position), "farther than 1 km");
        }
        let rotation = DQuat::from_array(self.quaternion);
        if !(1.0 - UNIT_SLACK..=1.0 + UNIT_SLACK).contains(&rotation.length()) {
            return wrong("quaternion", format!("{:?}", self.quaternion), "not of unit length");
        }
        if !(1e-3..=1e3).contains(&self.near) {
            return wrong("near", self.near.to_string(), "not within 0.001 to 1000 mm");
        }
        let (near_mm, is_cut) = (self.near, self.cut && entry > 0);
        Ok(CameraPathPose { seconds: self.seconds, position_mm, rotation, near_mm, is_cut })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn script() -> CameraPath {
        let shot = |i: u32| CameraPathPose {
            seconds: 0.1 * f64::from(i),
            position_mm: DVec3::new(1.0 / 3.0, -2.5e-7, 1234.5) * f64::from(i),
            rotation: DQuat::from_rotation_y(0.3 * f64::from(i)),
            near_mm: 0.1 + 0.2 * f64::from(i),
            is_cut: i == 3,
        };
        CameraPath { fov_y_deg: 77.7, shots: (0..9).map(shot).collect() }
    }

    #[test]
    fn a_camera_path_round_trips_bit_for_bit() {
        let s = script();
        let text = s.to_json();
        let back = CameraPath::parse(text.as_bytes()).unwrap();
        assert_eq!(back, s);
        assert_eq!(back.to_json(), text);
    }

    #[test]
    fn resampled_poses_lie_between_their_neighbours() {
        let s = script();
        let more = s.resampled(17);
        assert_eq!(more.shots.len(), 17);
        for i in 0..9 {
            let (a, b) = (&more.shots[2 * i], &s.shots[i]);
            assert!(a.position_mm.distance(b.position_mm) < 1e-9);
            assert!(a.rotation.angle_between(b.rotation) < 1e-7);
        }
        let half = more.shots[3];
        assert!(half.rotation.angle_between(DQuat::from_rotation_y(0.45)) < 1e-7);
        assert!((half.near_mm - 0.4).abs() < 1e-9);
        assert_eq!(s.resampled(9), s);
        assert_eq!(s.resampled(1).shots[0].position_mm, DVec3::ZERO);
        // the same turn written with the other sign is still the shorter arc
        let mut flipped = s.clone();
        flipped.shots[1].rotation = -flipped.shots[1].rotation;
        let turn = flipped.at(0.05).rotation.angle_between(DQuat::from_rotation_y(0.15));
        assert!(turn < 1e-7, "{turn}");
        assert_eq!((s.at(-1.0).position_mm, s.at(9.0).near_mm), (DVec3::ZERO, s.shots[8].near_mm));
    }

    #[test]
    fn errors_name_what_is_wrong_with_a_camera_path() {
        let good = script().to_json();
        let error = |from: &str, to: &str| {
            assert!(good.contains(from), "{from}");
            CameraPath::parse(good.replacen(from, to, 1).as_bytes()).unwrap_err().to_string()
        };
        let near = "\"near\":0.1}";
        for (bad, word) in [("1e999", "range"), ("null", "null"), ("\"1\"", "string")] {
            let said = error(near, &format!("\"near\":{bad}}}"));
            assert!(said.contains("line 4") && said.contains(word), "{said}");
        }
        for bad in ["-1", "0", "1e300"] {
            let said = error(near, &format!("\"near\":{bad}}}"));
            assert!(said.starts_with("pose 0 ") && said.contains("`near`"), "{said}");
        }
        let said = error("\"seconds\":0.2,", "\"seconds\":0.1,");
        assert!(said.starts_with("pose 2 ") && said.contains("not later"), "{said}");
        let said = error("[0.0,0.0,0.0,1.0]", "[0.0,0.0,0.0,1.002]");
        assert!(said.contains("pose 0") && said.contains("unit length"), "{said}");
        assert!(error("[0.0,0.0,0.0,1.0]", "[0,0,1]").contains("line 4"));
        assert!(error("1234.5]", "1e7]").contains("pose 1"));
        assert!(error("path/1", "path/2").contains("`intima.path/1`"));
        assert!(error("LPS", "RAS").contains("space"));
        assert!(error("77.7", "180").contains("180"));
        let empty = CameraPath { shots: Vec::new(), ..script() }.to_json();
        assert_eq!(CameraPath::parse(empty.as_bytes()), Err(CameraPathError::Count(0)));
        let deep = "[".repeat(100_000);
        for bad in ["", "{}", "[]", "\u{0}", &deep, &good[..good.len() / 2]] {
            assert!(matches!(CameraPath::parse(bad.as_bytes()), Err(CameraPathError::Json { .. })));
        }
    }

    #[test]
    fn no_pose_of_a_resampled_path_lies_between_two_pieces() {
        let s = script();
        let more = s.resampled(33);
        let cuts: Vec<usize> = (0..33).filter(|k| more.shots[*k].is_cut).collect();
        assert_eq!(cuts, [12]);
        for shot in &more.shots[8..12] {
            assert_eq!(shot.position_mm, s.shots[2].position_mm);
        }
        let back = CameraPath::parse(more.to_json().as_bytes()).unwrap();
        assert_eq!(back, more);
        // Fewer poses than pieces have: the jump is not lost.
        assert!(s.resampled(3).shots[1].is_cut);
        // One pose stays one: many at one time would be no path.
        let one = CameraPath { shots: s.shots[..1].to_vec(), ..s };
        assert_eq!(one.resampled(500), one);
    }
}
