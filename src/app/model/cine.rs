//! The slices shown one after another, to and fro.

use glam::DVec3;

use super::super::action::Pane;
use super::super::slices::{nearest_inside, slice_step_mm};
use super::Model;

/// Slices a second.
const RATE: f64 = 12.0;

/// State of the loop.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Cine {
    /// Whether it runs back.
    is_back: bool,
    /// Part of a slice that is still to be passed.
    due: f64,
}

impl Model {
    /// Whether the slices run.
    pub fn runs_cine(&self) -> bool {
        self.cine.is_some()
    }

    /// Starts or stops the loop.
    pub(super) fn run_cine(&mut self, runs: bool) {
        let starts = runs && self.volume().is_some();
        self.cine = starts.then_some(Cine { is_back: false, due: 0.0 });
        if starts {
            (self.playing, self.goal_mm, self.gaze_mm) = (false, None, None);
        }
    }

    /// Moves the crosshair on by whole slices; the loop turns at the ends of the volume.
    pub(super) fn pass_cine(&mut self, dt: f64) {
        let (Some(mut cine), Some(volume)) = (self.cine, self.volume().cloned()) else { return };
        cine.due += RATE * dt;
        let count = cine.due.floor();
        cine.due -= count;
        let normal = self.cine_normal();
        let way = normal * slice_step_mm(&volume, normal) * count;
        let to = self.crosshair_mm + if cine.is_back { -way } else { way };
        let end = nearest_inside(&volume, to);
        // Beyond the end along the way itself: a crosshair beside the volume comes back into it.
        cine.is_back ^= (to - end).dot(normal).abs() > 1e-6;
        self.crosshair_mm = end;
        self.cine = Some(cine);
    }

    /// Unit direction from one slice of the large pane to the next.
    fn cine_normal(&self) -> DVec3 {
        match self.maximised.unwrap_or(self.large_slice) {
            Pane::Coronal => DVec3::Y,
            Pane::Sagittal => DVec3::X,
            Pane::Across => {
                self.across_pose().map_or(DVec3::Z, |pose| pose.forward().as_dvec3().normalize())
            }
            Pane::Axial | Pane::Inside | Pane::Overview => DVec3::Z,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::flown_model;
    use super::*;
    use crate::app::action::Action;
    use crate::volume::phantom::Kind;

    #[test]
    fn slices_run_to_the_end_of_the_volume_and_back_until_they_are_stopped() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        let length = model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::Seek(0.5 * length), Action::Cine(true)]);
        let begun = model.crosshair_mm;
        let mut places = Vec::new();
        for _ in 0..120 {
            model.step(1.0 / RATE, &[]);
            places.push(model.crosshair_mm.z);
            assert_eq!(model.crosshair_mm.truncate(), begun.truncate(), "axial slices");
        }
        let steps: Vec<f64> = places.windows(2).map(|w| w[1] - w[0]).collect();
        assert!(steps.iter().all(|s| s.abs() < 1.0 + 1e-9), "a slice at a time: {steps:?}");
        assert!(steps.iter().any(|s| *s > 0.5) && steps.iter().any(|s| *s < -0.5), "to and fro");
        assert!(model.wants_frame());
        model.step(1.0, &[Action::Cine(false)]);
        let rests = model.crosshair_mm;
        model.step(1.0, &[]);
        assert_eq!(model.crosshair_mm, rests);
        // A crosshair that was drawn out of the volume comes back.
        model.step(0.0, &[Action::Crosshair([0.0, 0.0, 9e3]), Action::Cine(true)]);
        model.step(1.0 / RATE, &[]);
        let volume = model.volume().unwrap().clone();
        assert_eq!(nearest_inside(&volume, model.crosshair_mm), model.crosshair_mm);
        let mut empty = super::super::Model::new(20.0);
        empty.step(0.1, &[Action::Cine(true)]);
        assert!(!empty.wants_frame(), "there is nothing to run through");
        model.step(0.0, &[Action::Cine(true), Action::TogglePlay]);
        assert!(model.playing && !model.runs_cine(), "the flight moves the slices now");
    }
}
