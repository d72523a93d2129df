//! Bookmarks, measurements, and visits to missed patches.

use std::collections::BTreeMap;

use glam::{DVec3, Quat};

use super::super::action::FOV_DEG;
use super::super::finding::{FindingEdit, OWN_REACH_MM, wall_at};
use super::super::measure::Measurement;
use super::super::session_file::{AddedNotes, content_id};
use super::{Bookmark, Model};
use crate::flight::{Coverage, LISTED_FROM_MM2};
use crate::geometry::{Mesh, Pose};
use crate::organ::{ColonEnds, Organ};
use crate::session::FlightRoute;

/// A missed patch, where the path is nearest to it.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct MissedPlace {
    /// Its rank in area.
    pub patch: usize,
    /// Millimetres along the path.
    pub arc_mm: f64,
    /// Area that the flight misses, mm².
    pub area_mm2: f64,
    /// Area of it that no picture has shown since, mm².
    pub unseen_mm2: f64,
    /// Whether next to all of it has been shown since.
    pub is_shown: bool,
}

/// Missed patch that is marked in the panes.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedMark {
    /// Its rank in area.
    pub patch: usize,
    /// Area that no picture has shown, mm².
    pub area_mm2: f64,
    /// Middle of the patch, LPS mm.
    pub center_mm: DVec3,
    /// Edges of the wall about the patch, LPS mm.
    pub outline_mm: Vec<[DVec3; 2]>,
}

impl MissedMark {
    fn of(wall: &Mesh, coverage: &Coverage, patch: usize, area_mm2: f64) -> Self {
        // An edge of one face of the patch alone is one of its outline.
        let mut edges = BTreeMap::new();
        for (face, own) in wall.faces.iter().zip(&coverage.patch_of_face) {
            if own.is_some_and(|own| own.get() as usize == patch + 1) {
                for (a, b) in [(0, 1), (1, 2), (2, 0)].map(|(i, k)| (face[i], face[k])) {
                    *edges.entry((a.min(b), a.max(b))).or_insert(0u32) += 1;
                }
            }
        }
        let place = |v: u32| wall.positions[v as usize].as_dvec3();
        let outline = edges.into_iter().filter(|(_, faces)| *faces == 1);
        Self {
            patch,
            area_mm2,
            center_mm: coverage.patches[patch].center_mm,
            outline_mm: outline.map(|((a, b), _)| [place(a), place(b)]).collect(),
        }
    }
}

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
        }
        self.notes_changed();
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

    /// Returns the missed patches of [`LISTED_FROM_MM2`] or more in the order of the path; `None` before
    /// the coverage is known.
    pub fn missed_in_order(&self) -> Option<Vec<MissedPlace>> {
        let (coverage, path) = (self.products.coverage.as_ref()?, self.path.as_ref()?);
        let mut unseen_mm2 = vec![0.0; coverage.patches.len()];
        for (face, patch, area_mm2) in &self.missed_faces {
            if !self.seen.faces.get(*face as usize).copied().unwrap_or(false) {
                unseen_mm2[*patch as usize] += f64::from(*area_mm2);
            }
        }
        let of = |(patch, unseen): (usize, f64)| MissedPlace {
            patch,
            arc_mm: path.nearest_to(coverage.patches[patch].center_mm),
            area_mm2: coverage.patches[patch].area_mm2,
            unseen_mm2: unseen,
            is_shown: unseen < LISTED_FROM_MM2,
        };
        let mut places: Vec<_> = unseen_mm2.into_iter().enumerate().map(of).collect();
        places.retain(|p| p.area_mm2 >= LISTED_FROM_MM2);
        places.sort_by(|a, b| a.arc_mm.total_cmp(&b.arc_mm).then(a.patch.cmp(&b.patch)));
        Some(places)
    }

    /// Returns the faces of the missed patches, each with its patch and its area, mm².
    pub(super) fn faces_of_patches(&self) -> Vec<(u32, u32, f32)> {
        let (Some(coverage), Some(wall)) = (&self.products.coverage, &self.products.wall) else {
            return Vec::new();
        };
        let of = |(face, patch): (usize, &Option<std::num::NonZeroU32>)| {
            let patch = patch.as_ref()?.get() - 1;
            let area = 0.5 * wall.mesh.face_cross(wall.mesh.faces[face]).length();
            ((patch as usize) < coverage.patches.len()).then_some((face as u32, patch, area))
        };
        coverage.patch_of_face.iter().enumerate().filter_map(of).collect()
    }

    /// Moves the eye to the next patch along the path that was not shown since, or to the one before;
    /// the list goes round.
    pub(super) fn go_to_missed_beside(&mut self, by: isize) {
        let Some(places) = self.missed_in_order() else { return };
        // From the patch that is marked, else from the eye.
        let marked = self.missed.as_ref().map(|m| m.patch);
        let marked = places.iter().position(|p| Some(p.patch) == marked);
        let ahead = || places.partition_point(|p| p.arc_mm <= self.arc_mm) as isize;
        let count = places.len() as isize;
        let first = match (marked, by > 0) {
            (Some(i), _) => i as isize + by,
            (None, true) => ahead(),
            (None, false) => ahead() - 1,
        };
        let order = (0..count).map(|k| &places[(first + k * by).rem_euclid(count) as usize]);
        match order.clone().find(|p| !p.is_shown) {
            Some(place) => self.go_to_missed(place.patch),
            None => {
                self.message =
                    Some(format!("no missed patch of {LISTED_FROM_MM2} mm² or more is left"));
            }
        }
    }

    /// Moves the eye to a missed patch, looks at it and marks it.
    pub(super) fn go_to_missed(&mut self, patch: usize) {
        let (Some(coverage), Some(wall)) =
            (self.products.coverage.clone(), self.products.wall.clone())
        else {
            return;
        };
        let places = self.missed_in_order().unwrap_or_default();
        let Some(place) = places.iter().find(|p| p.patch == patch) else { return };
        self.playing = false;
        self.missed = Some(MissedMark::of(&wall.mesh, &coverage, patch, place.unseen_mm2));
        self.seek(place.arc_mm);
        self.turn_to(coverage.patches[patch].center_mm);
        let left = places.iter().filter(|p| !p.is_shown).count();
        let (area, all) = (place.unseen_mm2, places.len());
        self.message = Some(format!("missed patch of {area:.0} mm² ahead; {left} of {all} left"));
    }
}

#[cfg(test)]
mod tests {
    use std::num::NonZeroU32;
    use std::sync::Arc;

    use super::super::flown_model;
    use super::*;
    use crate::app::action::{Action, Ruler};
    use crate::flight::MissedPatch;
    use crate::volume::phantom::Kind;

    #[test]
    fn a_missed_patch_is_marked_with_its_outline_where_the_eye_is_led() {
        let (mut model, _session) = flown_model(Kind::Y, |_| {});
        let wall = model.products.wall.clone().unwrap();
        // Half of the wall, as if the flight had missed it.
        let centre = model.pose.unwrap().position_mm;
        let is_missed = |face: &[u32; 3]| wall.mesh.positions[face[0] as usize].x > centre.x;
        let faces = &wall.mesh.faces;
        let mut coverage = Coverage::clone(model.products.coverage.as_ref().unwrap());
        coverage.patch_of_face =
            faces.iter().map(|f| is_missed(f).then_some(NonZeroU32::MIN)).collect();
        let area_mm2 = 1000.0;
        let center_mm = centre.as_dvec3() + DVec3::X;
        coverage.patches = vec![MissedPatch { area_mm2, center_mm, arc_mm: 0.0, faces: 1 }];
        model.products.coverage = Some(Arc::new(coverage));
        model.missed_faces = model.faces_of_patches();
        model.step(0.0, &[Action::NextMissed]);
        let missed = model.missed.clone().expect("a patch of half the wall");
        let mut ends = BTreeMap::new();
        for p in missed.outline_mm.iter().flatten() {
            *ends.entry(p.to_array().map(f64::to_bits)).or_insert(0u32) += 1;
        }
        assert!(!ends.is_empty() && ends.values().all(|n| n % 2 == 0), "closed lines");
        assert_eq!((missed.center_mm, model.crosshair_mm), (center_mm, center_mm));
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
