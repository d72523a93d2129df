//! Places of a path as shares of its length, by which two cases of a patient are compared.

use super::Model;

impl Model {
    /// Share of the path's length that the eye has passed, 0 to 1.
    ///
    /// * `from_rectum`: counted from there; else from the start of the path.
    pub fn share_of_path(&self, from_rectum: bool) -> Option<f64> {
        let share = self.arc_mm / self.path.as_ref()?.length_mm().max(1e-9);
        Some(if from_rectum && self.begins_at_caecum() { 1.0 - share } else { share })
    }

    /// Sets out to a place on the path.
    pub fn fly_to_share(&mut self, share: f64, from_rectum: bool) {
        self.arc_of_share(share, from_rectum).into_iter().for_each(|arc| self.fly_to(arc));
    }

    /// Moves the eye to a place on the path, as another eye is moved.
    pub fn follow_to_share(&mut self, share: f64, from_rectum: bool) {
        let arc = self.arc_of_share(share, from_rectum);
        arc.into_iter().for_each(|arc| self.fly_along(arc, false));
    }

    fn arc_of_share(&self, share: f64, from_rectum: bool) -> Option<f64> {
        let length = self.path.as_ref()?.length_mm();
        let share = share.clamp(0.0, 1.0);
        Some(length * if from_rectum && self.begins_at_caecum() { 1.0 - share } else { share })
    }

    fn begins_at_caecum(&self) -> bool {
        self.ends.is_some_and(|ends| !ends.starts_at_rectum)
    }
}

#[cfg(test)]
mod tests {
    use super::super::flown_model;
    use crate::app::action::Action;
    use crate::organ::ColonEnds;
    use crate::volume::phantom::Kind;

    #[test]
    fn a_place_is_the_same_share_from_the_rectum_whichever_end_the_path_begins_at() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        let length = model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::Seek(0.25 * length)]);
        let near = |a: Option<f64>, b: f64| assert!((a.unwrap() - b).abs() < 1e-9, "{a:?}, {b}");
        near(model.share_of_path(false), 0.25);
        for (starts_at_rectum, share) in [(true, 0.25), (false, 0.75)] {
            model.ends = Some(ColonEnds { starts_at_rectum, is_sure: true });
            near(model.share_of_path(true), share);
            model.follow_to_share(0.1, true);
            near(model.share_of_path(true), 0.1);
            model.follow_to_share(share, true);
            near(Some(model.arc_mm / length), 0.25);
        }
        model.follow_to_share(7.0, false);
        near(Some(model.arc_mm), length);
    }
}
