//! Motion of the eye: along the path, to a place on it, or by hand.

use glam::DVec3;

use super::super::junctions::BranchChoice;
use super::Model;
use crate::flight::{
    Clearance, CrossSection, NoSection, SectionFigures, WallDistance, collide_and_slide,
    cross_section,
};
use crate::geometry::{Lens, Pose};

/// Least speed at which the eye flies to a place that was clicked, mm/s.
const MIN_APPROACH_MM_S: f64 = 60.0;
/// A branch is offered from so far before the place where it leaves, mm, to so far behind.
const OFFERED_MM: std::ops::Range<f64> = -5.0..25.0;
/// Wished near plane, mm; nearer where the wall is.
pub(super) const NEAR_MM: f32 = 2.0;
/// Room that light is scaled by, in distances of the eye from the wall, where that is less than the
/// path's: an eye off the middle of a lumen sees it lit as from there.
const LIGHT_REACH: f64 = 1.5;
/// The near plane that the eye keeps room for while it is moved by hand, mm.
const HAND_NEAR_MM: f32 = 0.4;

impl Model {
    /// Flies towards the goal: a third of a second more takes it nearer by a factor of e, and it is
    /// never slower than [`MIN_APPROACH_MM_S`].
    pub(super) fn approach_goal(&mut self, dt: f64) {
        let (Some(goal), gaze) = (self.goal_mm, self.gaze_mm) else { return };
        let left = goal - self.arc_mm;
        let step = (3.0 * left.abs()).max(MIN_APPROACH_MM_S) * dt;
        // The speed of this motion is not shown: it depends on the distance to the goal.
        self.seek_while(self.arc_mm + left.clamp(-step, step), false);
        if left.abs() > step {
            // Seeking forgets them.
            (self.goal_mm, self.gaze_mm) = (Some(goal), gaze);
        } else if let Some(place) = gaze {
            self.turn_to(place);
        }
    }

    /// Sets out to the place on the path nearest to another one, to look at that.
    pub(super) fn look_at(&mut self, place: DVec3) {
        let Some(path) = &self.path else { return };
        self.fly_to(path.nearest_to(place));
        self.gaze_mm = Some(place);
    }

    /// Turns the eye to a place, which the slices show too.
    pub(super) fn turn_to(&mut self, place: DVec3) {
        let Some(pose) = self.pose else { return };
        let to = place.as_vec3() - pose.position_mm;
        if to.length() > 1e-3 {
            self.on_path = false;
            self.place(Pose::looking(pose.position_mm, to, pose.up()));
        }
        self.crosshair_mm = place;
    }

    /// Flies on along the path.
    pub(super) fn play(&mut self, dt: f64) {
        let Some(path) = &self.path else { return };
        let way = if self.reverse { -dt } else { dt };
        let to = path.after(self.arc_mm, way * self.speed_mm_s / self.planned_mm_s);
        let end = if self.reverse { 0.0 } else { path.length_mm() };
        let playing = (to - end).abs() >= 1e-9;
        self.fly_along(to, playing);
    }

    /// Flies along the path to a place on it, mm from its start. From off the path it is a jump.
    pub(super) fn fly_along(&mut self, arc_mm: f64, playing: bool) {
        let from = self.pose.filter(|_| self.on_path).map(|pose| (pose.position_mm, self.arc_mm));
        self.seek_while(arc_mm, playing);
        if let (Some((place, arc)), Some(pose)) = (from, self.pose) {
            // The eye cuts the path's corners; a jump between two pieces is not flown.
            let way = f64::from(place.distance(pose.position_mm));
            self.speedometer.fly(way.min((self.arc_mm - arc).abs()));
        }
    }

    /// Returns the speed at which the eye is flown, mm/s, measured over the last moments; `None`
    /// while it stands.
    pub fn flown_mm_s(&self) -> Option<f64> {
        self.speedometer.mm_per_s()
    }

    pub(super) fn toggle_play(&mut self) {
        let Some(path) = &self.path else { return };
        self.playing = !self.playing;
        if self.playing {
            self.cine = None;
            // From the end it begins anew.
            let length = path.length_mm();
            let start = match (self.reverse, self.arc_mm) {
                (false, at) if at >= length - 1e-6 => 0.0,
                (true, at) if at <= 1e-6 => length,
                (_, at) => at,
            };
            self.seek_while(start, true);
        }
    }

    /// Moves the eye to a place on the path, mm from its start.
    pub fn seek(&mut self, arc_mm: f64) {
        self.seek_while(arc_mm, self.playing);
    }

    pub(super) fn seek_while(&mut self, arc_mm: f64, playing: bool) {
        let Some(path) = self.path.as_ref().filter(|_| arc_mm.is_finite()) else { return };
        self.arc_mm = arc_mm.clamp(0.0, path.length_mm());
        let pose = self.pose_on_path(path, self.arc_mm);
        (self.on_path, self.playing, self.goal_mm, self.gaze_mm) = (true, playing, None, None);
        self.place(pose);
    }

    /// Sets out to a place on the path, from where it was left.
    pub(super) fn fly_to(&mut self, arc_mm: f64) {
        let Some(path) = self.path.as_ref().filter(|_| arc_mm.is_finite()) else { return };
        let goal = arc_mm.clamp(0.0, path.length_mm());
        self.seek_while(self.arc_mm, false);
        self.goal_mm = Some(goal);
    }

    /// Whether the eye moves by itself.
    pub fn is_moving(&self) -> bool {
        self.playing || self.goal_mm.is_some()
    }

    /// Whether another frame is to be drawn although nothing is asked for: the eye moves by itself,
    /// or the panels show a speed of it that is over.
    pub(in super::super) fn wants_frame(&self) -> bool {
        let flies = self.is_moving() || self.flown_mm_s().is_some() || self.showed_speed;
        flies || self.runs_cine()
    }

    /// Branches that can be taken here, those ahead of the eye first to come.
    pub fn offered(&self) -> Vec<BranchChoice> {
        let way = if self.reverse { -1.0 } else { 1.0 };
        let near = |c: &&BranchChoice| OFFERED_MM.contains(&(way * (c.arc_mm - self.arc_mm)));
        let mut offered: Vec<BranchChoice> = self.choices.iter().filter(near).copied().collect();
        if self.reverse {
            offered.reverse();
        }
        offered
    }

    /// The next branch along the flight that can be taken, farther than those offered here.
    pub fn next_branch(&self) -> Option<BranchChoice> {
        let ahead = |c: &&BranchChoice| match self.reverse {
            false => c.arc_mm > self.arc_mm + OFFERED_MM.end,
            true => c.arc_mm < self.arc_mm - OFFERED_MM.end,
        };
        match self.reverse {
            false => self.choices.iter().find(ahead).copied(),
            true => self.choices.iter().rev().find(ahead).copied(),
        }
    }

    /// Returns the distance of the eye to the wall, mm.
    pub fn eye_to_wall_mm(&self) -> Option<f64> {
        let (tree, pose) = (self.products.triangle_tree.as_ref()?, self.pose?);
        tree.closest(pose.position_mm.as_dvec3()).map(|near| near.distance_mm)
    }

    /// The place on the wall that the eye sees in a direction of its own, LPS mm.
    pub fn wall_behind(&self, ray: DVec3) -> Option<DVec3> {
        let (tree, pose) = (self.products.triangle_tree.as_ref()?, self.pose?);
        const FAR_MM: f64 = 10_000.0;
        let along = pose.rotation.as_dquat() * ray.try_normalize()? * FAR_MM;
        tree.first_hit(pose.position_mm.as_dvec3(), along)
    }

    /// Moves the eye by hand.
    pub(super) fn fly(&mut self, by: DVec3) {
        let Some(pose) = self.pose.filter(|_| by.is_finite()) else { return };
        (self.playing, self.on_path, self.goal_mm, self.gaze_mm) = (false, false, None, None);
        let delta = pose.rotation.as_dquat() * DVec3::new(by.x, by.y, -by.z);
        // Where it is narrower than a hand's room already, that much is kept.
        let near_mm = self.near_mm.min(HAND_NEAR_MM);
        let lens = Lens { near_mm, ..self.lens() };
        let from = pose.position_mm.as_dvec3();
        let to = self.with_clearance(|wall| collide_and_slide(from, delta, wall, lens));
        if let Some(to) = to {
            self.speedometer.fly(from.distance(to));
            self.place(Pose { position_mm: to.as_vec3(), ..pose });
        }
    }

    /// The lens, its near plane as proven at the eye.
    pub fn lens(&self) -> Lens {
        let fov_y_rad = self.fov_deg.to_radians();
        Lens { fov_y_rad, aspect: self.aspect, near_mm: self.near_mm }
    }

    /// Sets the aspect ratio of the inside view and proves the near plane again.
    pub fn set_aspect(&mut self, aspect: f32) {
        if aspect.is_finite() && aspect > 0.0 && aspect != self.aspect {
            self.aspect = aspect;
            self.pose.into_iter().for_each(|p| self.place(p));
        }
    }

    /// Puts the eye somewhere, if a near plane can be proven there; else it stays where it is.
    pub(super) fn place(&mut self, pose: Pose) {
        let wish = Lens { near_mm: NEAR_MM, ..self.lens() };
        let at = pose.position_mm.as_dvec3();
        let Some(Ok((near, _))) = self.with_clearance(|wall| wall.near_mm(at, wish)) else {
            return;
        };
        (self.pose, self.near_mm) = (Some(pose), near);
        self.crosshair_mm = at;
        let section = self.section_at(at, pose);
        self.no_section = section.as_ref().and_then(|s| s.as_ref().err().copied());
        self.section = section.and_then(Result::ok);
    }

    /// Cuts the wall at the eye; `None` before there is a wall.
    fn section_at(&self, at: DVec3, pose: Pose) -> Option<Result<CrossSection, NoSection>> {
        let (wall, tree) = (self.products.wall.as_ref()?, self.products.triangle_tree.as_ref()?);
        let Some(path) = &self.path else {
            let section = cross_section(&wall.mesh, tree, at, pose.forward().as_dvec3());
            return Some(section.ok_or(NoSection::NoOutline));
        };
        let across = match self.on_path {
            true => path.across_at(self.arc_mm),
            false => path.direction_near(at)?,
        };
        Some(path.section_at(&wall.mesh, tree, at, across))
    }

    fn with_clearance<T>(&self, ask: impl FnOnce(&Clearance<'_>) -> T) -> Option<T> {
        let p = &self.products;
        let (lumen, fields) = (p.lumen.as_ref()?, p.fields.as_ref()?);
        let mesh = p.triangle_tree.as_deref().map(|tree| tree as &dyn WallDistance);
        let drawn = p.levels.as_ref().and_then(|levels| levels.drawn_distance());
        let wall = drawn.or(mesh);
        Some(ask(&Clearance::new(&lumen.lumen, &fields.distance, wall)))
    }

    /// Room about the eye by which light is scaled, mm: that of the path, but beside the wall what
    /// there is, for there the lamp would be behind the wall and leave it a plain surface.
    pub fn light_room_mm(&self) -> Option<f64> {
        let (path, pose) = (self.path.as_ref()?, self.pose?);
        let room = path.room_at(pose, self.arc_mm);
        let tree = self.products.triangle_tree.as_ref().filter(|_| !self.on_path);
        let eye = pose.position_mm.as_dvec3();
        Some(tree.map_or(room, |tree| room.min(LIGHT_REACH * tree.distance(eye, room))))
    }

    /// Figures of the cross-section at the eye.
    pub fn section_figures(&self) -> Option<SectionFigures> {
        self.section.as_ref().map(SectionFigures::of)
    }
}

#[cfg(test)]
mod tests {
    use super::super::flown_model;
    use super::*;
    use crate::app::action::Action;
    use crate::app::finding::FindingEdit;
    use crate::volume::phantom::Kind;

    #[test]
    fn the_way_to_a_clicked_place_has_no_speed_and_ends_at_rest() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        let goal = 0.5 * model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::FlyTo(goal)]);
        let mut frames = 0;
        // As the window does: panels first, then the step; no frame where none is wanted.
        while model.wants_frame() {
            assert_eq!(model.flown_mm_s(), None, "3,503 mm/s were shown after a click");
            model.step(1.0 / 30.0, &[]);
            frames += 1;
            assert!(frames < 1000, "it never rests");
        }
        assert!(frames > 3 && (model.arc_mm - goal).abs() < 1e-6, "{frames} frames");
    }

    #[test]
    fn beside_the_wall_the_light_is_near_and_on_the_path_it_is_the_flights() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        let half = 0.5 * model.path.as_ref().unwrap().length_mm();
        model.step(0.0, &[Action::Seek(half)]);
        let on_path = model.light_room_mm().unwrap();
        let room = |m: &Model| m.path.as_ref().unwrap().room_at(m.pose.unwrap(), m.arc_mm);
        assert_eq!(on_path, room(&model));
        // To look round changes no light; to fly to the wall does.
        model.step(0.0, &[Action::Turn([1.5, 0.0, 0.0])]);
        assert_eq!(model.light_room_mm(), Some(on_path));
        (0..200).for_each(|_| model.step(0.0, &[Action::Fly([0.0, 0.0, 0.5])]));
        let eye = model.pose.unwrap().position_mm.as_dvec3();
        let away = model.products.triangle_tree.as_ref().unwrap().distance(eye, 100.0);
        let beside = model.light_room_mm().unwrap();
        assert!(away < 0.3 * on_path, "it is beside the wall: {away} of {on_path} mm");
        assert!((beside - LIGHT_REACH * away).abs() < 1e-9, "{beside} mm");
    }

    #[test]
    fn the_flight_looks_at_a_finding_in_passing_and_is_saved_so() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        let length = model.path.as_ref().unwrap().length_mm();
        let (here, end) = (0.5 * length, length);
        model.step(0.0, &[Action::Seek(here), Action::Turn([1.2, 0.0, 0.0])]);
        model.step(0.0, &[Action::Bookmark("fold".into())]);
        let wall = DVec3::from(model.bookmarks[0].wall_mm.unwrap());
        // A turned eye is beside its place of the path still: the list said "off the path".
        assert!((model.arc_beside(&model.bookmarks[0]).unwrap() - here).abs() < 0.5);
        let forward_at = |model: &mut Model, arc: f64| {
            model.step(0.0, &[Action::Seek(arc)]);
            model.pose.unwrap().forward()
        };
        let [ahead, last] = [here, end].map(|arc| forward_at(&mut model, arc));
        let plain = model.flown_flight().unwrap().1;
        model.step(0.0, &[Action::EditFinding(0, FindingEdit::InFlight(true))]);
        let looks = forward_at(&mut model, here);
        let to = (wall - model.pose.unwrap().position_mm.as_dvec3()).normalize().as_vec3();
        assert!(looks.dot(to) > 0.999 && looks.dot(ahead) < 0.6, "{looks} beside {to}");
        assert!(forward_at(&mut model, end).distance(last) < 1e-5);
        // The saved flight is the one that is seen.
        let (_, saved) = model.flown_flight().unwrap();
        let near = (0..saved.poses.len())
            .min_by(|a, b| {
                (saved.arc_mm[*a] - here).abs().total_cmp(&(saved.arc_mm[*b] - here).abs())
            })
            .unwrap();
        assert!(saved.poses[near].forward().dot(to) > 0.99);
        assert_eq!(saved.arc_mm, plain.arc_mm);
        model.step(0.0, &[Action::Undo]);
        assert_eq!(model.flown_flight().unwrap().1, plain);
    }
}
