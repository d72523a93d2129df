//! The path that is flown: the flight of the settings or along a branch, places on it, and the gazes
//! that were set along it.

use std::sync::Arc;

use glam::{DVec3, Quat, Vec3};

use super::super::junctions::choices;
use super::{Bookmark, Model};
use crate::flight::{Flight, FlightPath, KeyedGaze, SectionFigures};
use crate::geometry::Pose;
use crate::session::FlightRoute;

impl Model {
    /// Takes another flight along the same centerline, with its sections; the eye keeps its place.
    pub fn take_branch(
        &mut self,
        flight: Flight,
        sections: &[Option<SectionFigures>],
        route: FlightRoute,
    ) {
        self.is_planned_path = false;
        self.set_path(&flight, route);
        self.set_sections(sections);
        self.set_coverage(None);
        (self.branch_flight, self.is_uncovered) = (Some(Arc::new(flight)), true);
        self.restore_eye();
        self.go_on_along(route);
    }

    /// Begins at a place on the path, at once or when there is one.
    pub(in super::super) fn start_at(&mut self, arc_mm: f64) {
        self.start_mm = arc_mm;
        self.seek(arc_mm);
    }

    /// Returns the place of the eye on the path, or that to begin at, mm.
    pub(in super::super) fn place_on_path_mm(&self) -> f64 {
        let is_there = self.path.is_some() && self.restoring.is_none();
        if is_there { self.arc_mm } else { self.start_mm }
    }

    /// Puts a flight in the place of the path.
    pub(super) fn set_path(&mut self, flight: &Flight, route: FlightRoute) {
        let Some(centerline) = self.products.centerline.clone() else { return };
        let Some(path) = FlightPath::new(flight, &centerline.line) else { return };
        let stays = self.pose.filter(|_| self.path.is_some());
        let start = stays.map_or(self.start_mm, |p| path.nearest_to(p.position_mm.as_dvec3()));
        self.route = route;
        self.choices = choices(&centerline.line, &path, route);
        self.path = Some(path);
        self.name_ends();
        (self.goal_mm, self.gaze_mm, self.way) = (None, None, None);
        if self.on_path {
            self.seek_while(start, self.playing);
        }
    }

    pub(super) fn set_sections(&mut self, sections: &[Option<SectionFigures>]) {
        self.path.iter_mut().for_each(|path| path.set_sections(sections));
    }

    /// Length of the path up to a noted place, mm; `None` where the path that is flown does not pass
    /// there.
    pub(in super::super) fn arc_of(&self, noted: &Bookmark) -> Option<f64> {
        /// Farthest from its place.
        const NEAR_MM: f32 = 1.0;
        let (arc, path) = (noted.arc_mm?, self.path.as_ref()?);
        let place = DVec3::from(noted.position_mm);
        let is_there =
            |arc: f64| path.pose_at(arc).position_mm.distance(place.as_vec3()) <= NEAR_MM;
        // The path may have been counted otherwise when it was noted.
        is_there(arc)
            .then_some(arc)
            .or_else(|| Some(path.nearest_to(place)).filter(|a| is_there(*a)))
    }

    /// Place of the path that a noted eye was beside, mm; `None` where the path does not pass it within
    /// the lumen.
    pub(in super::super) fn arc_beside(&self, noted: &Bookmark) -> Option<f64> {
        /// As far from the path an eye is beside it in any lumen, mm.
        const BESIDE_MM: f64 = 3.0;
        self.arc_of(noted).or_else(|| {
            let (path, place) = (self.path.as_ref()?, DVec3::from(noted.position_mm));
            let arc = path.nearest_to(place);
            let away = path.pose_at(arc).position_mm.as_dvec3().distance(place);
            (away <= path.radius_at(arc).max(BESIDE_MM)).then_some(arc)
        })
    }

    /// Returns the pose of the flight at a place of the path, with the gazes that were set.
    pub(super) fn pose_on_path(&self, path: &FlightPath, arc_mm: f64) -> Pose {
        let pose = path.pose_at(arc_mm);
        let keyed = self.keyed_gaze(path);
        match keyed.is_empty() {
            true => pose,
            false => Pose { rotation: (pose.rotation * keyed.turn_at(arc_mm)).normalize(), ..pose },
        }
    }

    /// Gazes at the findings that the flight looks at in passing.
    fn keyed_gaze(&self, path: &FlightPath) -> KeyedGaze {
        let keyed = self.bookmarks.iter().filter(|b| b.in_flight);
        KeyedGaze::new(path, keyed.filter_map(|finding| self.gaze_at(path, finding)))
    }

    /// Place of the path beside a finding, mm, and the camera that looks from there at the finding, level
    /// as the flight is; the camera of the noted view where no wall was seen. `None` for a finding that
    /// the path does not pass.
    fn gaze_at(&self, path: &FlightPath, finding: &Bookmark) -> Option<(f64, Quat)> {
        let arc = self.arc_beside(finding)?;
        let pose = path.pose_at(arc);
        let to_wall = finding.wall_mm.map(|wall| DVec3::from(wall).as_vec3() - pose.position_mm);
        let looking = |to: Vec3| Pose::looking(pose.position_mm, to, pose.up()).rotation;
        let at_wall = to_wall.filter(|to| to.length() > 1e-3).map(looking);
        let as_noted = || Quat::from_array(finding.rotation.map(|v| v as f32)).normalize();
        Some((arc, at_wall.unwrap_or_else(as_noted)))
    }

    /// Returns the flight as it is flown, with its route and the gazes that were set.
    pub(in super::super) fn flown_flight(&self) -> Option<(FlightRoute, Arc<Flight>)> {
        let planned = self.products.flight.as_ref().filter(|_| self.is_planned_path);
        let flight = planned.or(self.branch_flight.as_ref())?;
        let keyed = self.path.as_ref().map(|path| self.keyed_gaze(path)).unwrap_or_default();
        let flight = match keyed.is_empty() {
            true => Arc::clone(flight),
            false => Arc::new(keyed.turned(flight)),
        };
        Some((self.route, flight))
    }
}
