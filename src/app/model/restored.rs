//! View of a window that a session file keeps and restores.

use glam::{DQuat, DVec3, Quat};
use serde::{Deserialize, Serialize};

use super::super::action::{Action, Colouring, Pane, PaneLayout, SliceExtent, WallView};
use super::Model;
use crate::geometry::Pose;
use crate::render::Framing;
use crate::session::FlightRoute;

/// Way in which a window showed the organ.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedView {
    /// The eye, where it was off the path.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub eye: Option<SavedEye>,
    /// Number of the branch that was flown; the planned path without one.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub branch: Option<usize>,
    /// Whether the flight went towards the start of the path.
    pub reverse: bool,
    /// Projection of the inside pane.
    pub projection: WallView,
    /// Quantity that coloured the wall.
    pub colouring: Colouring,
    /// Part of the volume that slices showed.
    pub extent: SliceExtent,
    /// Place where the slices crossed, LPS mm.
    pub crosshair_mm: [f64; 3],
    /// The pane that filled the window.
    #[serde(default, skip_serializing_if = "Option::is_none")]
    pub maximised: Option<Pane>,
    /// Arrangement of the panes.
    #[serde(default)]
    pub layout: PaneLayout,
    /// The slice that was shown large.
    #[serde(default)]
    pub large_slice: Pane,
    /// Whether the local contrast of the inside view was raised.
    #[serde(default, skip_serializing_if = "std::ops::Not::not")]
    pub local_contrast: bool,
    /// Opacity of the overview's wall.
    pub opacity: f32,
    /// Rotation of the overview, radians.
    pub orbit_rad: [f32; 2],
    /// Enlargement of the overview.
    pub zoom: f32,
    /// Shift of the overview's camera to its right and up, mm.
    pub pan_mm: [f32; 2],
}

/// Pose of an eye.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct SavedEye {
    /// Place of the eye, LPS mm.
    pub position_mm: [f64; 3],
    /// World from camera, unit quaternion x, y, z, w.
    pub rotation: [f64; 4],
}

impl SavedView {
    /// Whether all numbers are places, turns and sizes.
    pub(in super::super) fn is_valid(&self) -> bool {
        let is_eye = self.eye.is_none_or(|eye| {
            let rotation = DQuat::from_array(eye.rotation);
            let is_turn = rotation.is_finite() && (rotation.length() - 1.0).abs() < 1e-3;
            is_turn && DVec3::from(eye.position_mm).is_finite()
        });
        let [right, up] = self.pan_mm;
        let [about, tilt] = self.orbit_rad;
        let numbers = [self.opacity, about, tilt, self.zoom, right, up];
        is_eye
            && DVec3::from(self.crosshair_mm).is_finite()
            && numbers.iter().all(|n| n.is_finite())
    }
}

impl Model {
    /// Returns the view as it is, or as it is to be restored.
    pub(in super::super) fn saved_view(&self) -> SavedView {
        if let Some(view) = &self.restoring {
            return view.clone();
        }
        let eye = self.pose.filter(|_| self.path.is_some() && !self.on_path);
        SavedView {
            eye: eye.map(|pose| SavedEye {
                position_mm: pose.position_mm.as_dvec3().to_array(),
                rotation: pose.rotation.as_dquat().to_array(),
            }),
            branch: match self.route {
                FlightRoute::Leaf(branch) => Some(branch),
                FlightRoute::Trunk | FlightRoute::All => None,
            },
            reverse: self.reverse,
            projection: self.view,
            colouring: self.colouring,
            extent: self.extent,
            crosshair_mm: self.crosshair_mm.to_array(),
            maximised: self.maximised,
            layout: self.layout,
            large_slice: self.large_slice,
            local_contrast: self.local_contrast,
            opacity: self.opacity,
            orbit_rad: self.framing.orbit,
            zoom: self.framing.zoom,
            pan_mm: self.framing.pan_mm,
        }
    }

    /// Sets the view as it was saved; the eye once there is the path that it flew.
    pub(in super::super) fn restore_view(&mut self, view: &SavedView) {
        self.framing = Framing::default();
        self.reverse = view.reverse;
        self.step(
            0.0,
            &[
                Action::View(view.projection),
                Action::Colour(view.colouring),
                Action::Extent(view.extent),
                Action::Layout(view.layout),
                Action::LargeSlice(view.large_slice),
                Action::Maximise(view.maximised),
                Action::LocalContrast(view.local_contrast),
                Action::Opacity(view.opacity),
                Action::Orbit(view.orbit_rad),
                Action::Frame { zoom: view.zoom, pan_mm: view.pan_mm },
            ],
        );
        self.restoring = Some(view.clone());
        self.restore_eye();
    }

    /// Returns the branch that the saved eye flew, if it has to be planned first.
    pub(in super::super) fn branch_to_restore(&self) -> Option<usize> {
        let branch = self.restoring.as_ref()?.branch?;
        let is_other = self.path.is_some() && self.route != FlightRoute::Leaf(branch);
        is_other.then_some(branch)
    }

    /// Leaves the eye where it is, where the branch that it flew is none of this lumen's.
    pub(in super::super) fn give_up_branch(&mut self) {
        if let Some(view) = &mut self.restoring {
            view.branch = None;
        }
        self.restore_eye();
    }

    /// Moves the eye to where it was saved, once there is the path that it flew.
    pub(super) fn restore_eye(&mut self) {
        if self.path.is_none() || self.branch_to_restore().is_some() {
            return;
        }
        let Some(view) = self.restoring.take() else { return };
        self.seek_while(self.start_mm, false);
        if let Some(eye) = view.eye {
            // A unit quaternion stays as it was saved: the picture is then the same to the pixel.
            let saved = Quat::from_array(eye.rotation.map(|v| v as f32));
            let rotation = if saved.is_normalized() { saved } else { saved.normalize() };
            self.on_path = false;
            self.place(Pose { position_mm: DVec3::from(eye.position_mm).as_vec3(), rotation });
        }
        self.crosshair_mm = DVec3::from(view.crosshair_mm);
    }
}

#[cfg(test)]
mod tests {
    use super::super::flown_model;
    use super::*;
    use crate::volume::phantom::Kind;

    #[test]
    fn a_saved_view_is_restored_also_off_the_path_and_on_another_branch() {
        let (mut model, session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let take = |model: &mut Model, branch| {
            let route = FlightRoute::Leaf(branch);
            let flight = session.flight_along(route).unwrap();
            let sections = session.sections_along(&flight).unwrap();
            model.take_branch(flight, &sections, route);
        };
        let branch = model.choices.last().expect("a Y has another branch").branch;
        take(&mut model, branch);
        let arc = 0.9 * model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::Seek(arc), Action::Colour(Colouring::Radius), Action::Reverse]);
        model.step(0.0, &[Action::Orbit([0.5, -0.25]), Action::Opacity(1.5)]);
        model.step(0.0, &[Action::Turn([0.4, 0.1, 0.0]), Action::Crosshair([1.0, 2.0, 3.0])]);
        let (saved, pose) = (model.saved_view(), model.pose);
        assert!(saved.is_valid() && saved.eye.is_some() && saved.branch == Some(branch));

        let (mut opened, _session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        opened.start_at(arc);
        opened.restore_view(&saved);
        assert_eq!(opened.branch_to_restore(), Some(branch), "it is planned first");
        assert_eq!(opened.saved_view(), saved, "closed meanwhile, nothing is lost");
        take(&mut opened, branch);
        assert_eq!((opened.saved_view(), opened.arc_mm), (saved.clone(), model.arc_mm));
        let moved = opened.pose.unwrap().position_mm.distance(pose.unwrap().position_mm);
        assert!(moved < 1e-4 && !opened.on_path, "{moved} mm away");

        // Where the branch is gone, everything else is restored.
        let (mut other, _session) = flown_model(Kind::Tube, |_| {});
        other.restore_view(&SavedView { branch: Some(99), ..saved });
        other.give_up_branch();
        assert_eq!((other.branch_to_restore(), other.colouring), (None, Colouring::Radius));
        assert!(other.saved_view().branch.is_none());
    }
}
