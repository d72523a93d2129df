//! Bookmarks, measurements, and visits to missed patches.

use glam::{DVec3, Quat};

use super::super::action::FOV_DEG;
use super::super::measure::Measurement;
use super::{Bookmark, Model};
use crate::flight::LISTED_FROM_MM2;
use crate::geometry::Pose;

impl Model {
    pub(super) fn mark(&mut self, p: DVec3) {
        let Some(ruler) = self.ruler else { return };
        self.marks_mm.push(p);
        if let Some(done) = Measurement::of(ruler, &self.marks_mm) {
            self.measurements.push(done);
            self.marks_mm.clear();
            self.unsaved = true;
        }
    }

    pub(super) fn bookmark(&mut self, text: &str) {
        let Some(pose) = self.pose else { return };
        let text = match text.trim() {
            "" => format!("Place {}", self.bookmarks.len() + 1),
            text => text.to_owned(),
        };
        self.unsaved = true;
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
            let Some(area) = patch.and_then(|p| unseen_mm2.get_mut(p as usize)) else { continue };
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
        let centre = coverage.patches[*next].center_mm;
        if let Some(path) = &self.path {
            self.seek(path.nearest_to(centre));
        }
        self.turn_to(centre);
        let area = unseen_mm2[*next];
        self.message = Some(format!("missed patch of {area:.0} mm² ahead"));
    }
}
