//! Bookmarks and measurements.

use glam::{DVec3, Quat};

use super::super::action::{FOV_DEG, Ruler};
use super::super::finding::{FindingEdit, OWN_REACH_MM, wall_at};
use super::super::measure::Measurement;
use super::super::session_file::{AddedNotes, content_id};
use super::{Bookmark, Model};
use crate::flight::LesionDiameter;
use crate::geometry::Pose;
use crate::organ::{ColonEnds, Organ};
use crate::session::FlightRoute;

/// Name of a measurement that the program has made.
const FOUND: &str = "found";

impl Model {
    /// Names the ends of the path where the lumen is a colon, or someone has said so.
    pub(super) fn name_ends(&mut self) {
        let lumen = self.products.lumen.as_ref();
        let is_colon =
            lumen.and_then(|l| l.organ.as_ref()).is_some_and(|o| o.organ == Organ::Colon);
        let path = self.path.as_ref().filter(|_| self.route == FlightRoute::Trunk);
        self.ends = path.and_then(|path| {
            let sure = |starts_at_rectum| ColonEnds { starts_at_rectum, is_sure: true };
            let [start, end] = [0.0, path.length_mm()].map(|arc| path.pose_at(arc).position_mm);
            let by_rule = || ColonEnds::of(start.as_dvec3(), end.as_dvec3(), path.length_mm());
            self.rectum_at_start.map(sure).or_else(|| is_colon.then(by_rule).flatten())
        });
    }

    /// Takes in what a file says of the ends.
    pub(in super::super) fn restore_ends(&mut self, rectum_at_start: Option<bool>) {
        self.rectum_at_start = rectum_at_start;
        self.name_ends();
    }

    pub(super) fn set_rectum_at_start(&mut self, at_start: bool) {
        self.rectum_at_start = Some(at_start);
        self.notes_changed();
        self.name_ends();
    }

    /// Takes notes in that came from elsewhere, and are in a file already.
    pub(in super::super) fn add_notes(&mut self, added: &AddedNotes) {
        added.put_into(&mut self.bookmarks, &mut self.measurements);
        self.history.add(added);
        self.notes_changed();
    }

    /// A number for a note that no other has, here or in another window.
    fn new_id(&self, says: &impl serde::Serialize) -> u64 {
        let mut id = content_id(says, [self.notes_version, self.window_number]);
        let is_taken = |id: u64| {
            self.bookmarks.iter().any(|b| b.id == id)
                || self.measurements.iter().any(|m| m.id == id)
        };
        while id == 0 || is_taken(id) {
            id += 1;
        }
        id
    }

    pub(super) fn mark(&mut self, p: DVec3, in_slice: bool) {
        let Some(ruler) = self.ruler else { return };
        self.marks_mm.push(p);
        if let Some(done) = Measurement::of(ruler, &self.marks_mm) {
            let finding = self.finding_at(&self.marks_mm);
            let done = Measurement { in_slice, finding, ..done };
            let id = self.new_id(&done);
            self.measurements.push(Measurement { id, ..done });
            // The next click is for something else.
            self.ruler = None;
            self.marks_mm.clear();
            self.notes_changed();
        }
    }

    /// Measures the largest diameter of a finding, which its reader may correct.
    pub(super) fn measure_finding(&mut self, i: usize) {
        let Some(finding) = self.bookmarks.get(i) else { return };
        let (place, id) = (finding.wall_mm.map(DVec3::from), finding.id);
        let p = &self.products;
        let (Some(wall), Some(tree), Some(lumen)) = (&p.wall, &p.triangle_tree, &p.lumen) else {
            return;
        };
        let voxel_mm = lumen.lumen.grid.voxel_mm3().cbrt();
        let found = place.and_then(|at| LesionDiameter::find(&wall.mesh, tree, at, voxel_mm));
        let Some(found) = found else {
            let why =
                "no edge of a lesion was found about the middle of that view: measure by hand";
            self.message = Some(why.into());
            return;
        };
        let Some(measured) = Measurement::of(Ruler::Length, &found.ends_mm) else { return };
        let measured = Measurement { name: FOUND.into(), finding: Some(id), ..measured };
        // One is enough: a second try takes the place of the first.
        self.measurements.retain(|m| m.finding != Some(id) || m.name != FOUND);
        let measurement_id = self.new_id(&measured);
        self.message = Some(format!("{:.1} mm; its ends can be dragged", found.length_mm()));
        self.measurements.push(Measurement { id: measurement_id, ..measured });
        self.notes_changed();
    }

    /// Number of the selected finding, if all of these places are near to it.
    fn finding_at(&self, places: &[DVec3]) -> Option<u64> {
        let finding = self.bookmarks.get(self.selected?)?;
        let at = DVec3::from(finding.wall_mm.unwrap_or(finding.position_mm));
        places.iter().all(|p| p.distance(at) <= OWN_REACH_MM).then_some(finding.id)
    }

    /// Forgets a noted place, with what was measured of it.
    pub(super) fn remove_bookmark(&mut self, i: usize) {
        let Bookmark { id, text, .. } = self.bookmarks.remove(i);
        self.message = Some(format!("deleted: {text}; Ctrl + Z brings it back"));
        self.measurements.retain(|m| m.finding != Some(id));
        self.selected = None;
        self.notes_changed();
    }

    pub(super) fn edit_finding(&mut self, i: usize, edit: &FindingEdit) {
        let Some(finding) = self.bookmarks.get_mut(i) else { return };
        match edit {
            FindingEdit::Name(name) => name.clone_into(&mut finding.text),
            FindingEdit::Segment(name) => {
                finding.segment = Some(name.clone()).filter(|name| !name.is_empty());
            }
            FindingEdit::Shape(shape) => finding.shape = *shape,
            FindingEdit::Confidence(confidence) => finding.confidence = *confidence,
            FindingEdit::InFlight(looks) => finding.in_flight = *looks,
        }
        self.notes_changed();
        if matches!(edit, FindingEdit::InFlight(_)) && self.on_path {
            self.seek(self.arc_mm);
        }
    }

    /// Moves the eye to the noted place so many places after the selected one in the list, which
    /// goes round.
    pub(super) fn go_to_finding_beside(&mut self, by: isize) {
        let count = self.bookmarks.len() as isize;
        if count > 0 {
            let from = self.selected.map_or(if by > 0 { -1 } else { 0 }, |i| i as isize);
            self.go_to_bookmark((from + by).rem_euclid(count) as usize);
        }
    }

    pub(super) fn name_measurement(&mut self, i: usize, name: &str) {
        if let Some(m) = self.measurements.get_mut(i) {
            name.clone_into(&mut m.name);
            self.notes_changed();
        }
    }

    pub(super) fn move_mark(&mut self, i: usize, point: usize, to: [f64; 3]) {
        let measured = self.measurements.get_mut(i);
        if let Some(p) = measured.and_then(|m| m.points_mm.get_mut(point)) {
            *p = to;
            self.notes_changed();
        }
    }

    pub(super) fn bookmark(&mut self, text: &str) {
        let Some(pose) = self.pose else { return };
        let text = match text.trim() {
            "" => format!("Place {}", self.bookmarks.len() + 1),
            text => text.to_owned(),
        };
        self.notes_changed();
        // The list may be scrolled away, or another pane fill the window.
        self.message = Some(format!("finding {}: {text}", self.bookmarks.len() + 1));
        let noted = Bookmark {
            text,
            position_mm: pose.position_mm.as_dvec3().to_array(),
            rotation: pose.rotation.as_dquat().to_array(),
            fov_deg: self.fov_deg,
            arc_mm: self.on_path.then_some(self.arc_mm),
            picture: None,
            png: None,
            id: 0,
            wall_mm: None,
            segment: None,
            shape: None,
            confidence: None,
            in_flight: false,
        };
        let wall_mm = self.products.triangle_tree.as_ref().and_then(|tree| wall_at(&noted, tree));
        let noted = Bookmark { wall_mm, ..noted };
        let id = self.new_id(&noted);
        self.bookmarks.push(Bookmark { id, ..noted });
        self.selected = Some(self.bookmarks.len() - 1);
    }

    pub(super) fn go_to_bookmark(&mut self, i: usize) {
        let Some(b) = self.bookmarks.get(i).cloned() else { return };
        self.selected = Some(i);
        let rotation = Quat::from_array(b.rotation.map(|v| v as f32));
        let position_mm = DVec3::from(b.position_mm).as_vec3();
        self.fov_deg = b.fov_deg.clamp(*FOV_DEG.start(), *FOV_DEG.end());
        self.playing = false;
        match self.arc_of(&b) {
            Some(arc) => self.seek(arc),
            None => {
                self.on_path = false;
                self.place(Pose { position_mm, rotation: rotation.normalize() });
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::app::action::Action;
    use crate::session::{Product, Session, Settings, Source, VolumeSource};
    use crate::volume::Volume;
    use crate::volume::phantom::{Kind, Phantom};

    /// A label map of a tube with a half ball of 5 mm on its wall.
    #[test]
    fn a_lesion_is_measured_by_the_program_once_and_a_flat_wall_is_not() {
        let tube = Phantom::new(Kind::Tube, 48, [1.0; 3]).unwrap().mask();
        let grid = tube.grid;
        let is_tube = |i: usize| tube.real(i) != 0.0;
        let middle = 0.5 * (grid.dims.as_dvec3() - 1.0);
        let index = |p: DVec3| grid.index(p.round().as_uvec3());
        let floor = (0..24).map(|k| middle - DVec3::X * f64::from(k)).find(|p| !is_tube(index(*p)));
        let floor = floor.unwrap();
        let radius = 5.0;
        let label = |i: usize| {
            let off = grid.voxel(i).as_dvec3().distance(floor);
            u8::from(is_tube(i) && off > radius)
        };
        let labels: Vec<u8> = (0..grid.len()).map(label).collect();
        let volume = Arc::new(Volume::new(grid, labels.into()));
        let session =
            Session::new(Source::Image(VolumeSource::Memory(volume)), Settings::default()).unwrap();
        let wanted = [Product::Lumen, Product::Wall, Product::TriangleTree, Product::Fields];
        session.prepare(&wanted).unwrap();
        let mut model = Model::new(20.0);
        model.update(session.products(&wanted));
        let world = |p: DVec3| grid.world_from_voxel().transform_point3(p).to_array();
        model.step(0.0, &[Action::Bookmark("polyp".into()), Action::Bookmark("wall".into())]);
        model.bookmarks[0].wall_mm = Some(world(floor + DVec3::X * radius));
        model.bookmarks[1].wall_mm = Some(world(floor + DVec3::new(0.0, 0.0, 12.0)));
        // Twice, as an impatient reader does.
        model.step(0.0, &[Action::MeasureFinding(0), Action::MeasureFinding(0)]);
        let [measured] = &model.measurements[..] else { panic!("{:?}", model.measurements) };
        assert_eq!(measured.finding, Some(model.bookmarks[0].id));
        assert!((measured.value() - 2.0 * radius).abs() < 1.5, "{}", measured.value());
        model.step(0.0, &[Action::MeasureFinding(1), Action::MeasureFinding(7)]);
        assert_eq!(model.measurements.len(), 1);
        assert!(model.message.as_ref().unwrap().ends_with("by hand"), "{:?}", model.message);
    }

    #[test]
    fn a_measurement_is_named_and_its_points_are_moved() {
        let mut model = Model::new(20.0);
        let marks = [Action::Mark([0.0; 3]), Action::Mark([3.0, 4.0, 0.0])];
        model.step(0.0, &[Action::Measure(Some(Ruler::Length))]);
        model.step(0.0, &marks);
        model.notes_saved();
        model.step(0.0, &[Action::NameMeasurement(0, "polyp".into())]);
        assert!(model.has_unsaved_notes());
        let to = [0.0, 0.0, 12.0];
        model.step(0.0, &[Action::MoveMark { measurement: 0, point: 1, to }]);
        assert_eq!(model.measurements[0].label(), "polyp 12.0 mm");
        // Numbers of nothing, and places that are none, change nothing.
        let none = [f64::NAN, 0.0, 0.0];
        for (measurement, point, to) in [(1, 0, to), (0, 2, to), (0, 0, none)] {
            model.step(0.0, &[Action::MoveMark { measurement, point, to }]);
        }
        assert_eq!(model.measurements[0].label(), "polyp 12.0 mm");
        model.step(0.0, &[Action::RemoveMeasurement(0)]);
        assert!(model.measurements.is_empty());
    }
}
