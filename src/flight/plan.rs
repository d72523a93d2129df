//! Frames of a flight along a path.

use std::ops::RangeInclusive;

use glam::DVec3;

use super::profile::median;
use super::{Clearance, Profile, Track, WallDistance};
use crate::centerline::arc_lengths;
use crate::geometry::{CenterlinePoint, Lens, Pose};
use crate::lumen::Lumen;

/// Largest number of frames of a flight: ten hours at 25 a second.
pub const MAX_FRAMES: usize = 900_000;
/// Vertical fields of view that a frame may have, degrees.
pub const FOV_DEG: RangeInclusive<f64> = 1.0..=170.0;
/// Near plane as a share of the radius.
pub(super) const NEAR_SHARE: f64 = 0.35;
/// Farthest near plane, mm.
const MAX_NEAR_MM: f64 = 5.0;
/// Cruising speed in median radii a second, where only the number of frames is given.
const CRUISE_RADII: f64 = 1.5;

/// Number of frames, directly or by speed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Frames {
    /// Number of frames, at equal steps in flight time.
    Count(usize),
    /// Number of frames that results from the duration of the flight.
    Speed {
        /// Cruising speed, mm/s; slower in narrow places and turns, never faster.
        mm_per_s: f64,
        /// Frames a second.
        fps: f64,
    },
}

/// Options of a flight.
#[derive(Clone, Copy, Debug)]
pub struct FlightOptions<'a> {
    /// Number of frames.
    pub frames: Frames,
    /// Vertical field of view, radians.
    pub fov_y_rad: f32,
    /// Width over height of a frame.
    pub aspect: f32,
    /// Whether to fly from the last point to the first.
    pub reverse: bool,
    /// The surface that is drawn: lets thin places be proven by its distance.
    pub wall: Option<&'a dyn WallDistance>,
}

impl Default for FlightOptions<'_> {
    fn default() -> Self {
        Self {
            frames: Frames::Count(120),
            fov_y_rad: std::f32::consts::FRAC_PI_2,
            aspect: 4.0 / 3.0,
            reverse: false,
            wall: None,
        }
    }
}

/// Errors that prevent a flight.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum FlightError {
    /// An option is out of range.
    #[error("{what} is {value}; it must be {range}")]
    Option {
        /// Name of the option.
        what: &'static str,
        /// Value of the option.
        value: f64,
        /// Permitted values.
        range: String,
    },
    /// A point of the path is not finite.
    #[error("point {0} of the path is not finite")]
    NotFinite(usize),
    /// The path is too short to fly along.
    #[error("no flight: the path is {length_mm} mm long")]
    TooShort {
        /// Length of the path, mm.
        length_mm: f64,
    },
    /// The centerline has no such branch.
    #[error("there is no branch {branch}; the centerline has {branches}, numbered from 0")]
    NoBranch {
        /// Index of the requested branch.
        branch: usize,
        /// Number of branches.
        branches: usize,
    },
    /// No near plane clears the wall.
    #[error("frame {frame} at ({:.2}, {:.2}, {:.2}) mm: the wall is proven only {room_mm:.3} mm away, too near for any near plane", .at.x, .at.y, .at.z)]
    NoRoom {
        /// Index of the frame, from 0.
        frame: usize,
        /// Position of the eye, LPS mm.
        at: DVec3,
        /// Distance to the wall that could be proven, mm; 0 outside the lumen.
        room_mm: f64,
    },
}

/// Frames of a flight, each proven clear of the wall.
#[derive(Clone, Debug, PartialEq)]
pub struct Flight {
    /// Pose of each frame's eye.
    pub poses: Vec<Pose>,
    /// Near plane of each frame, mm.
    pub near_mm: Vec<f32>,
    /// Time of each frame since the first, s.
    pub seconds: Vec<f64>,
    /// Length of the path up to each frame, mm, as [`Centerline`](crate::geometry::Centerline) has it:
    /// the eye cuts its corners. Jumps between pieces have no length.
    pub arc_mm: Vec<f64>,
    /// Proven lower bound of each frame's distance to the wall, mm.
    pub clearance_mm: Vec<f64>,
    /// Room about the eye, mm: radius of the path, smoothed along it, by which light is scaled.
    pub room_mm: Vec<f32>,
    /// Vertical field of view, radians.
    pub fov_y_rad: f32,
    /// Width over height.
    pub aspect: f32,
    /// Number of frames whose eye was moved along the path to where a near plane fits.
    pub moved: usize,
    /// Indices of frames that begin another piece: the eye jumps there.
    pub cuts: Vec<usize>,
    /// Number of pieces that are too narrow to be flown.
    pub left_out: usize,
}

/// Returns the least room about an eye, mm: in a tube a voxel wide the clearance of the path is
/// less than its distance to the surface that is drawn, and light scaled by the clearance would
/// leave the picture black.
pub(super) fn least_room_mm(lumen: &Lumen) -> f64 {
    lumen.grid.voxel_mm3().cbrt()
}

impl Flight {
    /// Plans a flight along a path.
    ///
    /// * `distance`: exact distance to external voxel centres, mm, in slot order of `lumen`.
    ///
    /// Near planes are a third of the radius or as much nearer as the proof asks for. An eye for
    /// which none can be proven moves to the nearest sample of the path for which one can.
    ///
    /// # Errors
    /// [`FlightError`] names the option, point or frame.
    pub fn new(
        points: &[CenterlinePoint],
        lumen: &Lumen,
        distance: &[f32],
        options: FlightOptions<'_>,
    ) -> Result<Self, FlightError> {
        check(&options)?;
        let mut path = points.to_vec();
        check_points(&path)?;
        path.dedup_by_key(|p| p.position_mm);
        if options.reverse {
            path.reverse();
        }
        let places: Vec<DVec3> = path.iter().map(|p| p.position_mm).collect();
        let length_mm = arc_lengths(&places).last().copied().unwrap_or(0.0);
        if length_mm < 1e-3 {
            return Err(FlightError::TooShort { length_mm });
        }
        let wall = Clearance::new(lumen, distance, options.wall);
        let track = Track::new(&path, &wall, lumen.grid.spacing_mm.min_element());
        let cruise = match options.frames {
            Frames::Count(_) => (CRUISE_RADII * median(&track.radius_mm)).max(0.1),
            Frames::Speed { mm_per_s, .. } => mm_per_s,
        };
        let profile = Profile::new(track.step_mm, &track.radius_mm, &track.turns_rad(), cruise);
        let total = profile.total_seconds();
        let (count, each) = match options.frames {
            Frames::Count(n) => (n, total / n.saturating_sub(1).max(1) as f64),
            Frames::Speed { fps, .. } => ((total * fps).ceil() as usize + 1, 1.0 / fps),
        };
        if count > MAX_FRAMES {
            return Err(too_many(count));
        }
        // Whole frames: the flight is stretched by less than one, which only slows it.
        let stretch = total / (each * (count - 1).max(1) as f64);
        let mut planner = Planner::new(&track, &wall, &options);
        let mut flight = Self::empty(options.fov_y_rad, options.aspect);
        for k in 0..count {
            let seconds = each * k as f64;
            let arc_mm = profile.arc_at(seconds * stretch);
            flight.push(planner.shot(k, arc_mm)?, seconds, arc_mm);
            let room_mm = track.room_mm(arc_mm);
            flight.room_mm.push(room_mm.max(least_room_mm(lumen)) as f32);
        }
        flight.moved = planner.moved;
        Ok(flight)
    }

    /// Plans one flight along several paths, with a cut between them. A number of frames is shared
    /// among them by length, one at least for each. A path that has no room for any near plane is
    /// left out and counted.
    ///
    /// # Errors
    /// As [`Flight::new`]; [`FlightError::NoRoom`] where no path has room.
    pub fn along(
        paths: &[&[CenterlinePoint]],
        lumen: &Lumen,
        distance: &[f32],
        options: FlightOptions<'_>,
    ) -> Result<Self, FlightError> {
        if let [path] = paths {
            return Self::new(path, lumen, distance, options);
        }
        check(&options)?;
        for path in paths {
            check_points(path)?;
        }
        let mut flight = Self::empty(options.fov_y_rad, options.aspect);
        // How long a piece of one frame is shown, s: as a frame of the piece before.
        let mut still = 0.1;
        let mut order: Vec<&[CenterlinePoint]> = paths.to_vec();
        if options.reverse {
            order.reverse();
        }
        let pieces = loop {
            let (pieces, narrow) = Self::each(&order, lumen, distance, options)?;
            let Some((first, _)) = narrow.first() else { break pieces };
            if narrow.len() == order.len() {
                return Err(first.clone());
            }
            // The others share their frames.
            flight.left_out += narrow.len();
            let mut gone = narrow.iter().map(|(_, i)| *i).peekable();
            let mut at = 0..;
            order.retain(|_| gone.next_if_eq(&at.next().unwrap_or(0)).is_none());
        };
        for piece in pieces {
            let step = match options.frames {
                Frames::Speed { fps, .. } => 1.0 / fps,
                Frames::Count(_) => piece.seconds.get(1).copied().unwrap_or(still),
            };
            still = step;
            let start = flight.seconds.last().map_or(0.0, |s| s + step);
            if !flight.poses.is_empty() {
                flight.cuts.push(flight.poses.len());
            }
            flight.seconds.extend(piece.seconds.iter().map(|s| start + s));
            let before_mm = flight.arc_mm.last().copied().unwrap_or(0.0);
            flight.arc_mm.extend(piece.arc_mm.iter().map(|arc| before_mm + arc));
            flight.poses.extend(piece.poses);
            flight.near_mm.extend(piece.near_mm);
            flight.clearance_mm.extend(piece.clearance_mm);
            flight.room_mm.extend(piece.room_mm);
            flight.moved += piece.moved;
        }
        if flight.poses.len() > MAX_FRAMES {
            return Err(too_many(flight.poses.len()));
        }
        if flight.poses.is_empty() {
            return Err(FlightError::TooShort { length_mm: 0.0 });
        }
        Ok(flight)
    }

    /// Plans a flight along each path; paths without room give errors, with their index.
    #[allow(clippy::type_complexity)]
    fn each(
        paths: &[&[CenterlinePoint]],
        lumen: &Lumen,
        distance: &[f32],
        options: FlightOptions<'_>,
    ) -> Result<(Vec<Self>, Vec<(FlightError, usize)>), FlightError> {
        let length = |path: &&[CenterlinePoint]| {
            let places: Vec<DVec3> = path.iter().map(|p| p.position_mm).collect();
            arc_lengths(&places).last().copied().unwrap_or(0.0)
        };
        let lengths: Vec<f64> = paths.iter().map(length).collect();
        let frames = match options.frames {
            Frames::Count(n) => shares(n, &lengths).into_iter().map(Frames::Count).collect(),
            speed => vec![speed; paths.len()],
        };
        let (mut pieces, mut narrow) = (Vec::new(), Vec::new());
        for (i, (path, frames)) in paths.iter().zip(frames).enumerate() {
            match Self::new(path, lumen, distance, FlightOptions { frames, ..options }) {
                Err(e @ FlightError::NoRoom { .. }) => narrow.push((e, i)),
                piece => pieces.push(piece?),
            }
        }
        Ok((pieces, narrow))
    }

    pub(super) fn empty(fov_y_rad: f32, aspect: f32) -> Self {
        Self {
            poses: Vec::new(),
            near_mm: Vec::new(),
            seconds: Vec::new(),
            arc_mm: Vec::new(),
            clearance_mm: Vec::new(),
            room_mm: Vec::new(),
            fov_y_rad,
            aspect,
            moved: 0,
            cuts: Vec::new(),
            left_out: 0,
        }
    }

    pub(super) fn push(&mut self, shot: (Pose, f32, f64), seconds: f64, arc_mm: f64) {
        self.poses.push(shot.0);
        self.near_mm.push(shot.1);
        self.clearance_mm.push(shot.2);
        self.seconds.push(seconds);
        self.arc_mm.push(arc_mm);
    }

    /// Returns the lens of a frame.
    ///
    /// # Panics
    /// If there is no such frame.
    pub fn lens(&self, frame: usize) -> Lens {
        let (fov_y_rad, aspect) = (self.fov_y_rad, self.aspect);
        Lens { fov_y_rad, aspect, near_mm: self.near_mm[frame] }
    }

    /// Returns pose and lens of every frame, as [`super::coverage`] needs them.
    pub fn views(&self) -> Vec<(Pose, Lens)> {
        (0..self.poses.len()).map(|i| (self.poses[i], self.lens(i))).collect()
    }

    /// Returns the least room left between a near ball and the wall, mm: proven distance less the
    /// ball's radius, over all frames. Infinite without frames.
    pub fn min_margin_mm(&self) -> f64 {
        (0..self.poses.len())
            .map(|i| self.clearance_mm[i] - f64::from(self.lens(i).near_ball_mm()))
            .fold(f64::INFINITY, f64::min)
    }
}

fn check(o: &FlightOptions<'_>) -> Result<(), FlightError> {
    let err = |what, value, range: &str| {
        Err(FlightError::Option { what, value, range: range.to_owned() })
    };
    // One degree of 32 bits is a little less than one.
    let fov = 1e-5 * (1e5 * f64::from(o.fov_y_rad).to_degrees()).round();
    if !FOV_DEG.contains(&fov) {
        let range = format!("{} to {}", FOV_DEG.start(), FOV_DEG.end());
        return err("the vertical field of view in degrees", fov, &range);
    }
    if !(0.01..=100.0).contains(&o.aspect) {
        return err("width over height", f64::from(o.aspect), "0.01 to 100");
    }
    match o.frames {
        Frames::Count(0) => err("the number of frames", 0.0, "at least 1"),
        Frames::Count(n) if n > MAX_FRAMES => Err(too_many(n)),
        Frames::Count(_) => Ok(()),
        Frames::Speed { mm_per_s, .. } if !(0.01..=10_000.0).contains(&mm_per_s) => {
            err("the speed in mm/s", mm_per_s, "0.01 to 10000")
        }
        Frames::Speed { fps, .. } if !(0.01..=1000.0).contains(&fps) => {
            err("the frame rate", fps, "0.01 to 1000")
        }
        Frames::Speed { .. } => Ok(()),
    }
}

/// Shares a number of frames out by length, one at least for each: the remaining ones go to the
/// largest remainders, and the longest paths give to the short ones.
fn shares(frames: usize, lengths: &[f64]) -> Vec<usize> {
    let total: f64 = lengths.iter().sum::<f64>().max(1e-9);
    let exact: Vec<f64> = lengths.iter().map(|l| frames as f64 * l / total).collect();
    let mut counts: Vec<usize> = exact.iter().map(|e| (e.floor() as usize).max(1)).collect();
    let over = |counts: &[usize], i: usize| counts[i] as f64 - exact[i];
    let sum = |counts: &[usize]| counts.iter().sum::<usize>();
    let all = 0..lengths.len();
    while sum(&counts) < frames {
        let most = |a: &usize, b: &usize| over(&counts, *b).total_cmp(&over(&counts, *a));
        let Some(i) = all.clone().rev().max_by(most) else { break };
        counts[i] += 1;
    }
    while sum(&counts) > frames {
        let most = |a: &usize, b: &usize| over(&counts, *a).total_cmp(&over(&counts, *b));
        let Some(i) = all.clone().filter(|i| counts[*i] > 1).max_by(most) else { break };
        counts[i] -= 1;
    }
    counts
}

fn check_points(path: &[CenterlinePoint]) -> Result<(), FlightError> {
    let finite = |p: &CenterlinePoint| p.position_mm.is_finite() && p.radius_mm.is_finite();
    path.iter().position(|p| !finite(p)).map_or(Ok(()), |i| Err(FlightError::NotFinite(i)))
}

fn too_many(count: usize) -> FlightError {
    let range = format!("at most {MAX_FRAMES}");
    FlightError::Option { what: "the number of frames", value: count as f64, range }
}

/// Places eyes on a track and proves their near planes.
struct Planner<'a> {
    track: &'a Track,
    wall: &'a Clearance<'a>,
    lens: Lens,
    /// Near plane and proven distance of the samples that were tested.
    known: Vec<Option<Result<(f32, f64), f64>>>,
    moved: usize,
}

impl<'a> Planner<'a> {
    fn new(track: &'a Track, wall: &'a Clearance<'a>, options: &FlightOptions<'_>) -> Self {
        let lens = Lens { fov_y_rad: options.fov_y_rad, aspect: options.aspect, near_mm: 0.0 };
        Self { track, wall, lens, known: vec![None; track.eye.len()], moved: 0 }
    }

    fn prove(&self, eye: DVec3, radius_mm: f64) -> Result<(f32, f64), f64> {
        let wish = (NEAR_SHARE * radius_mm).clamp(super::MIN_NEAR_MM, MAX_NEAR_MM);
        // What is drawn from is the rounded eye.
        let eye = eye.as_vec3().as_dvec3();
        self.wall.near_mm(eye, Lens { near_mm: wish as f32, ..self.lens })
    }

    fn shot(&mut self, frame: usize, arc_mm: f64) -> Result<(Pose, f32, f64), FlightError> {
        let (eye, gaze, up, radius) = self.track.at(arc_mm);
        match self.prove(eye, radius) {
            Ok((near, room)) => Ok((pose(eye, gaze, up), near, room)),
            Err(room_mm) => {
                let at = (arc_mm / self.track.step_mm).round() as usize;
                let moved = self.nearest_safe(at);
                let Some((i, near, room)) = moved else {
                    return Err(FlightError::NoRoom { frame, at: eye, room_mm });
                };
                self.moved += 1;
                // The gaze stays that of the planned place: only the eye may jump.
                Ok((pose(self.track.eye[i], gaze, up), near, room))
            }
        }
    }

    /// Returns the sample nearest to sample `at` along the path that has room.
    fn nearest_safe(&mut self, at: usize) -> Option<(usize, f32, f64)> {
        let n = self.track.eye.len();
        for k in 0..n {
            for i in [at.checked_sub(k), Some(at + k).filter(|i| *i < n)].into_iter().flatten() {
                let answer = match self.known[i] {
                    Some(a) => a,
                    None => self.prove(self.track.eye[i], self.track.radius_mm[i]),
                };
                self.known[i] = Some(answer);
                if let Ok((near, room)) = answer {
                    return Some((i, near, room));
                }
            }
        }
        None
    }
}

fn pose(eye: DVec3, gaze: DVec3, up: DVec3) -> Pose {
    Pose::looking(eye.as_vec3(), gaze.as_vec3(), up.as_vec3())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn frames_are_shared_out_by_length_and_none_is_left_over() {
        assert_eq!(shares(10, &[30.0, 10.0, 60.0]), [3, 1, 6]);
        assert_eq!(shares(10, &[1.0, 1.0, 1.0]), [4, 3, 3]);
        assert_eq!(shares(12, &[500.0, 1.0, 1.0, 1.0]), [9, 1, 1, 1]);
        assert_eq!(shares(2, &[5.0, 5.0, 5.0]), [1, 1, 1], "each path is seen");
        assert_eq!(shares(5, &[0.0, 0.0]).iter().sum::<usize>(), 5);
    }
}
