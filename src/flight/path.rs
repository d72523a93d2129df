//! The flight by arc length: poses, lumen radius, cross-sections.

use glam::DVec3;
use rayon::prelude::*;

use super::{CenterlinePlaces, CrossSection, Flight, MAX_ASTRAY, cross_section};
use crate::geometry::{Centerline, Mesh, Pose, TriangleBvh};

/// Returns the way up to each pose, mm.
///
/// * `cuts`: indices of poses that begin another piece; the jumps to them do not count.
fn flown_mm(poses: &[Pose], cuts: &[usize]) -> Vec<f64> {
    let mut flown = 0.0;
    let up_to = |i: usize| {
        if i > 0 && !cuts.contains(&i) {
            flown += f64::from(poses[i - 1].position_mm.distance(poses[i].position_mm));
        }
        flown
    };
    (0..poses.len()).map(up_to).collect()
}

/// Size of a cross-section.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SectionFigures {
    /// Area, mm².
    pub area_mm2: f64,
    /// Largest Feret diameter, mm.
    pub largest_mm: f64,
    /// Least Feret diameter, mm.
    pub smallest_mm: f64,
}

impl SectionFigures {
    /// Takes the figures of a cross-section.
    pub fn of(s: &CrossSection) -> Self {
        Self {
            area_mm2: s.area_mm2,
            largest_mm: s.largest_diameter_mm,
            smallest_mm: s.smallest_diameter_mm,
        }
    }
}

/// Reasons why there is no cross-section of the lumen at a place.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum NoSection {
    /// No outline of the wall closes about the place.
    NoOutline,
    /// The plane runs along the lumen, which bends there.
    AlongLumen,
    /// The plane runs along another branch.
    AlongBranch,
}

/// Computes the cross-section of the lumen at each pose of a flight; `None` where there is none
/// across the path.
pub fn sections_along(
    path: &FlightPath,
    wall: &Mesh,
    tree: &TriangleBvh,
) -> Vec<Option<SectionFigures>> {
    let at = |i: usize| {
        let p = path.poses[i].position_mm.as_dvec3();
        path.section_at(wall, tree, p, path.across_at(path.arc_mm[i]))
            .ok()
            .as_ref()
            .map(SectionFigures::of)
    };
    (0..path.poses.len()).into_par_iter().map(at).collect()
}

/// Poses of a flight by time and arc length.
pub struct FlightPath {
    poses: Vec<Pose>,
    seconds: Vec<f64>,
    /// Length of the path up to each pose, mm; jumps between pieces do not count.
    arc_mm: Vec<f64>,
    /// Way of the eye up to each pose, mm: it cuts the path's corners.
    flown_mm: Vec<f64>,
    /// Distance to the wall on the path at each pose, mm.
    pub radius_mm: Vec<f64>,
    /// Room about each pose, mm, by which the light is set.
    room_mm: Vec<f32>,
    /// Indices of poses that begin another piece.
    cuts: Vec<usize>,
    /// Cross-section at each pose; empty until they are known.
    pub sections: Vec<Option<SectionFigures>>,
    /// Places of the centerline that was flown along.
    places: CenterlinePlaces,
}

impl FlightPath {
    /// Measures a flight. `None` for a flight of fewer than two poses.
    ///
    /// * `line`: centerline that was flown along.
    pub fn new(flight: &Flight, line: &Centerline) -> Option<Self> {
        let poses = flight.poses.clone();
        if poses.len() < 2 {
            return None;
        }
        let arc_mm = flight.arc_mm.clone();
        let flown_mm = flown_mm(&poses, &flight.cuts);
        let places = CenterlinePlaces::new(line);
        let first = line.branches.first().and_then(|b| b.points.first());
        let radius = |pose: &Pose| {
            let Some(place) = places.nearest(pose.position_mm.as_dvec3()) else {
                return first.map_or(0.0, |p| p.radius_mm);
            };
            let points = &line.branches[place.at.branch].points;
            let [a, b] = [&points[place.at.point], &points[place.at.point + 1]];
            let way = a.position_mm.distance(b.position_mm);
            let t = (a.position_mm.distance(place.position_mm) / way).clamp(0.0, 1.0);
            a.radius_mm + t * (b.radius_mm - a.radius_mm)
        };
        let radius_mm = poses.iter().map(radius).collect();
        let (seconds, cuts) = (flight.seconds.clone(), flight.cuts.clone());
        let room_mm = flight.room_mm.clone();
        let sections = Vec::new();
        Some(Self { poses, seconds, arc_mm, flown_mm, radius_mm, room_mm, cuts, sections, places })
    }

    /// Returns the length of the path that is flown, mm.
    pub fn length_mm(&self) -> f64 {
        self.arc_mm[self.arc_mm.len() - 1]
    }

    /// Returns the length of the path up to each pose, mm.
    pub fn arcs_mm(&self) -> &[f64] {
        &self.arc_mm
    }

    /// Returns the lengths at which another piece begins, mm.
    pub fn cuts_mm(&self) -> impl Iterator<Item = f64> {
        self.cuts.iter().map(|i| self.arc_mm[*i])
    }

    /// Interpolates the pose at an arc length.
    pub fn pose_at(&self, arc_mm: f64) -> Pose {
        self.pose_between(self.sample(&self.arc_mm, arc_mm))
    }

    /// Returns the place of the eye so far along its way from an arc length.
    fn beside(&self, arc_mm: f64, way_mm: f64) -> DVec3 {
        let (i, t) = self.sample(&self.arc_mm, arc_mm);
        let here = self.flown_mm[i] + (self.flown_mm[i + 1] - self.flown_mm[i]) * t;
        self.pose_between(self.sample(&self.flown_mm, here + way_mm)).position_mm.as_dvec3()
    }

    fn pose_between(&self, (i, t): (usize, f64)) -> Pose {
        let (a, b) = (self.poses[i], self.poses[i + 1]);
        if self.cuts.contains(&(i + 1)) {
            return if t < 1.0 { a } else { b };
        }
        let t = t as f32;
        let position_mm = a.position_mm.lerp(b.position_mm, t);
        Pose { position_mm, rotation: a.rotation.slerp(b.rotation, t).normalize() }
    }

    /// Returns the unit direction of the path: over two millimetres about a place where there are
    /// as many.
    pub fn tangent_at(&self, arc_mm: f64) -> DVec3 {
        let across = self.beside(arc_mm, 1.0) - self.beside(arc_mm, -1.0);
        let forward = || self.pose_at(arc_mm).forward().as_dvec3();
        // Not across a jump between two pieces.
        let near = across.length() < 4.0;
        across.try_normalize().filter(|_| near).unwrap_or_else(forward)
    }

    /// Returns the unit direction that a cross-section is across: that of the path over two radii of
    /// the lumen to both sides, as the small turns of a path are not turns of the lumen.
    pub fn across_at(&self, arc_mm: f64) -> DVec3 {
        let reach = (2.0 * self.radius_at(arc_mm)).max(1.0);
        let across = self.beside(arc_mm, reach) - self.beside(arc_mm, -reach);
        // Not across a jump between two pieces.
        let near = across.length() <= 2.0 * reach + 1e-6;
        across.try_normalize().filter(|_| near).unwrap_or_else(|| self.tangent_at(arc_mm))
    }

    /// Returns the direction of the centerline at its place nearest to a point.
    pub fn direction_near(&self, p_mm: DVec3) -> Option<DVec3> {
        self.places.nearest(p_mm).map(|place| place.direction)
    }

    /// Returns the cross-section of the lumen at a point.
    ///
    /// # Errors
    /// The reason where the plane does not cut the lumen across: no outline closes about the point,
    /// or more than [`MAX_ASTRAY`] of the area belongs to another stretch of the centerline.
    pub fn section_at(
        &self,
        wall: &Mesh,
        tree: &TriangleBvh,
        at_mm: DVec3,
        across: DVec3,
    ) -> Result<CrossSection, NoSection> {
        let section = cross_section(wall, tree, at_mm, across).ok_or(NoSection::NoOutline)?;
        let [on_it, on_others] = self.places.astray_shares(&section, at_mm);
        match on_it + on_others <= MAX_ASTRAY {
            true => Ok(section),
            false if on_others > on_it => Err(NoSection::AlongBranch),
            false => Err(NoSection::AlongLumen),
        }
    }

    /// Stores cross-sections, one a pose; those of another number of poses are ignored.
    pub fn set_sections(&mut self, sections: &[Option<SectionFigures>]) {
        if sections.len() == self.poses.len() {
            self.sections = sections.to_vec();
        }
    }

    /// Returns the radius on the path, mm.
    pub fn radius_at(&self, arc_mm: f64) -> f64 {
        let (i, t) = self.sample(&self.arc_mm, arc_mm);
        self.radius_mm[i] + (self.radius_mm[i + 1] - self.radius_mm[i]) * t
    }

    /// Returns the room about an eye, mm: that of the path at an arc length if the eye is there,
    /// else at the nearest pose. It depends on the eye alone, so that a picture does not show how
    /// the eye came there.
    pub fn room_at(&self, eye: Pose, arc_mm: f64) -> f64 {
        let is_on_path = self.pose_at(arc_mm).position_mm.distance(eye.position_mm) < 1e-3;
        let nearest = || self.nearest_to(eye.position_mm.as_dvec3());
        let (i, t) = self.sample(&self.arc_mm, if is_on_path { arc_mm } else { nearest() });
        let [a, b] = [i, i + 1].map(|i| f64::from(self.room_mm[i]));
        a + (b - a) * t
    }

    /// Returns the arc length that the flight reaches, mm, after more seconds of flight time, which
    /// may be negative.
    pub fn after(&self, arc_mm: f64, seconds: f64) -> f64 {
        // Poses on both sides of a cut have the same arc length. Backwards, time counts from the first
        // of them: a step shorter than the time between them would stay at the cut.
        let reached = self.arc_mm.partition_point(|arc| *arc < arc_mm);
        let is_left_backwards = seconds < 0.0 && self.arc_mm.get(reached) == Some(&arc_mm);
        let (i, t) = self.sample(&self.arc_mm, arc_mm);
        let now = match is_left_backwards {
            true => self.seconds[reached],
            false => self.seconds[i] + (self.seconds[i + 1] - self.seconds[i]) * t,
        };
        let (j, u) = self.sample(&self.seconds, now + seconds);
        self.arc_mm[j] + (self.arc_mm[j + 1] - self.arc_mm[j]) * u
    }

    /// Returns the arc length of the pose nearest to a point, mm. A jump between two pieces has no
    /// length: the last pose of the first piece is just before it, the first of the second at it.
    pub fn nearest_to(&self, p_mm: DVec3) -> f64 {
        let off = |i: &usize| self.poses[*i].position_mm.as_dvec3().distance_squared(p_mm);
        let near = (0..self.poses.len()).min_by(|a, b| off(a).total_cmp(&off(b)));
        near.map_or(0.0, |i| match self.cuts.contains(&(i + 1)) {
            true => self.arc_mm[i].next_down(),
            false => self.arc_mm[i],
        })
    }

    /// Returns the position of the pose that is nearest to a ray, LPS mm.
    pub fn nearest_to_ray(&self, from_mm: DVec3, along: DVec3) -> Option<DVec3> {
        let along = along.try_normalize()?;
        let off = |p: &DVec3| (*p - from_mm).cross(along).length_squared();
        let places = self.poses.iter().map(|p| p.position_mm.as_dvec3());
        places.min_by(|a, b| off(a).total_cmp(&off(b)))
    }

    /// Returns the index of the interval of ascending values that contains `at`, and the fraction
    /// of the interval before it.
    fn sample(&self, values: &[f64], at: f64) -> (usize, f64) {
        let i = values.partition_point(|v| *v <= at).clamp(1, values.len() - 1) - 1;
        let span = values[i + 1] - values[i];
        let t = if span > 0.0 { ((at - values[i]) / span).clamp(0.0, 1.0) } else { 0.0 };
        (i, t)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::geometry::{Branch, CenterlinePoint};
    use glam::{Quat, Vec3};

    fn flight() -> (Flight, Centerline) {
        let at = |x: f32| Pose { position_mm: Vec3::X * x, rotation: Quat::IDENTITY };
        // Twice as slow in the second half; a jump of 50 mm at the fourth pose.
        let places = [0.0, 2.0, 4.0, 54.0, 55.0];
        let flight = Flight {
            poses: places.map(at).to_vec(),
            near_mm: vec![1.0; 5],
            seconds: vec![0.0, 1.0, 2.0, 3.0, 4.0],
            arc_mm: vec![0.0, 2.0, 4.0, 4.0, 5.0],
            clearance_mm: vec![5.0; 5],
            room_mm: vec![5.0; 5],
            fov_y_rad: 1.0,
            aspect: 1.0,
            moved: 0,
            cuts: vec![3],
            left_out: 0,
        };
        let point = |x: &f32| CenterlinePoint {
            position_mm: DVec3::X * f64::from(*x),
            radius_mm: f64::from(*x),
            abscissa_mm: 0.0,
        };
        let points = places.iter().map(point).collect();
        (flight, Centerline { branches: vec![Branch { points, ..Branch::default() }] })
    }

    #[test]
    fn jumps_between_pieces_have_no_length_and_are_not_flown_through() {
        let (flight, line) = flight();
        let path = FlightPath::new(&flight, &line).unwrap();
        assert_eq!(path.length_mm(), 5.0);
        assert_eq!(path.cuts_mm().collect::<Vec<_>>(), [4.0]);
        let x = |arc: f64| path.pose_at(arc).position_mm.x;
        assert_eq!((x(-1.0), x(1.0), x(3.0), x(4.5), x(99.0)), (0.0, 1.0, 3.0, 54.5, 55.0));
        assert!((3.99..4.0).contains(&x(3.999)));
    }

    /// The eye went to the other piece, and looked through the body at what was asked for.
    #[test]
    fn the_place_nearest_to_either_side_of_a_cut_is_on_that_side() {
        let (flight, line) = flight();
        let path = FlightPath::new(&flight, &line).unwrap();
        let x = |p: f64| path.pose_at(path.nearest_to(DVec3::X * p)).position_mm.x;
        assert!((x(5.0) - 4.0).abs() < 1e-5, "{}", x(5.0));
        assert_eq!(x(53.0), 54.0);
    }

    #[test]
    fn time_and_length_follow_the_flight_in_both_directions() {
        let (flight, line) = flight();
        let path = FlightPath::new(&flight, &line).unwrap();
        assert_eq!(path.after(0.0, 1.5), 3.0);
        assert_eq!(path.after(3.0, -1.5), 0.0);
        assert_eq!(path.after(4.5, 99.0), 5.0);
        assert_eq!(path.nearest_to(DVec3::new(53.9, 3.0, 0.0)), 4.0);
        // Back over a cut in steps that are shorter than it is on the clock: the eye stood there.
        let mut arc = 4.3;
        for _ in 0..40 {
            let next = path.after(arc, -0.1);
            assert!(next < arc || arc == 0.0, "it stands at {arc} mm");
            arc = next;
        }
        assert_eq!(arc, 0.0);
        assert_eq!(path.radius_at(1.0), 1.0);
    }

    #[test]
    fn the_radius_on_a_branch_is_that_of_the_branch_and_not_of_the_trunk_beside_it() {
        // A branch that leaves a wide trunk at so small an angle that they stay within 5 mm.
        let along = |slope: f64, radius_mm: f64| Branch {
            points: (0..40)
                .map(|i| CenterlinePoint {
                    position_mm: DVec3::new(f64::from(i), slope * f64::from(i), 0.0),
                    abscissa_mm: f64::from(i),
                    radius_mm,
                })
                .collect(),
            ..Branch::default()
        };
        let line = Centerline { branches: vec![along(0.0, 9.0), along(0.1, 2.0)] };
        let pose = |i: i32| Pose {
            position_mm: Vec3::new(i as f32, 0.1 * i as f32, 0.0),
            rotation: Quat::IDENTITY,
        };
        let (base, _) = flight();
        let flight = Flight {
            poses: (10..30).map(pose).collect(),
            near_mm: vec![0.5; 20],
            seconds: (0..20).map(f64::from).collect(),
            arc_mm: (0..20).map(f64::from).collect(),
            clearance_mm: vec![1.0; 20],
            room_mm: vec![2.0; 20],
            cuts: Vec::new(),
            ..base
        };
        let path = FlightPath::new(&flight, &line).unwrap();
        assert!(path.radius_mm.iter().all(|r| (r - 2.0).abs() < 1e-9), "{:?}", path.radius_mm);
    }
}
