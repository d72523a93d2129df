//! Bookmarks, measurements, and visits to missed patches.

use std::collections::BTreeMap;

use glam::{DVec3, Quat};

use super::super::action::FOV_DEG;
use super::super::measure::Measurement;
use super::super::session_file::AddedNotes;
use super::{Bookmark, Model};
use crate::flight::{Coverage, LISTED_FROM_MM2};
use crate::geometry::{Mesh, Pose};
use crate::organ::{ColonEnds, Organ};
use crate::session::FlightRoute;

/// Missed patch that is marked in the panes.
#[derive(Clone, Debug, PartialEq)]
pub struct MissedMark {
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
        self.bookmarks.extend_from_slice(&added.bookmarks);
        self.measurements.extend_from_slice(&added.measurements);
        self.notes_changed();
    }

    pub(super) fn mark(&mut self, p: DVec3) {
        let Some(ruler) = self.ruler else { return };
        self.marks_mm.push(p);
        if let Some(done) = Measurement::of(ruler, &self.marks_mm) {
            self.measurements.push(done);
            self.marks_mm.clear();
            self.notes_changed();
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
        self.message = Some(format!("bookmark {}: {text}", self.bookmarks.len() + 1));
        self.bookmarks.push(Bookmark {
            text,
            position_mm: pose.position_mm.as_dvec3().to_array(),
            rotation: pose.rotation.as_dquat().to_array(),
            fov_deg: self.fov_deg,
            arc_mm: self.on_path.then_some(self.arc_mm),
            picture: None,
            png: None,
        });
    }

    pub(super) fn go_to_bookmark(&mut self, i: usize) {
        let Some(b) = self.bookmarks.get(i).cloned() else { return };
        let rotation = Quat::from_array(b.rotation.map(|v| v as f32));
        let position_mm = DVec3::from(b.position_mm).as_vec3();
        self.fov_deg = b.fov_deg.clamp(*FOV_DEG.start(), *FOV_DEG.end());
        self.playing = false;
        match b.arc_mm {
            Some(arc) => self.seek(arc),
            None => {
                self.on_path = false;
                self.place(Pose { position_mm, rotation: rotation.normalize() });
            }
        }
    }

    /// Moves the eye to the largest patch that the flight misses, not visited yet nor shown since.
    pub(super) fn next_missed(&mut self) {
        let (Some(coverage), Some(wall)) =
            (self.products.coverage.clone(), self.products.wall.clone())
        else {
            return;
        };
        let mut unseen_mm2 = vec![0.0; coverage.patches.len()];
        for (face, patch) in coverage.patch_of_face.iter().enumerate() {
            let Some(area) = patch.and_then(|p| unseen_mm2.get_mut(p.get() as usize - 1)) else {
                continue;
            };
            if !self.seen.faces.get(face).copied().unwrap_or(false) {
                *area += 0.5 * f64::from(wall.mesh.face_cross(wall.mesh.faces[face]).length());
            }
        }
        let open = |i: &usize| unseen_mm2[*i] >= LISTED_FROM_MM2;
        let left: Vec<usize> = (0..unseen_mm2.len()).filter(open).collect();
        if left.iter().all(|i| self.visited.contains(i)) {
            self.visited.clear();
        }
        let Some(next) = left.iter().find(|i| !self.visited.contains(i)) else {
            self.message = Some("no missed patch of 300 mm² or more is left".into());
            return;
        };
        self.visited.push(*next);
        self.playing = false;
        self.missed = Some(MissedMark::of(&wall.mesh, &coverage, *next, unseen_mm2[*next]));
        let centre = coverage.patches[*next].center_mm;
        if let Some(path) = &self.path {
            self.seek(path.nearest_to(centre));
        }
        self.turn_to(centre);
        let area = unseen_mm2[*next];
        self.message = Some(format!("missed patch of {area:.0} mm² ahead"));
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
