//! Places in the inside pane: rays through it, points on it, parts that are taken.

use egui::{Pos2, Rect, Vec2, vec2};
use glam::{DVec2, DVec3};

use super::action::{Colouring, PaneLayout};
use super::layout::inset;
use super::model::Model;

/// Room of the pane's name.
const TITLE: Vec2 = vec2(60.0, 20.0);
/// Corner of the room that the patient's axes take, from the pane's lower left one.
const MARKER: Vec2 = vec2(92.0, -92.0);
/// Room of the scale of colours and of the legend, from the pane's right side and its corner.
const SCALE: Vec2 = vec2(64.0, 184.0);
const LEGEND: Vec2 = vec2(190.0, 86.0);

/// The direction that a point of the inside pane looks in, in the camera's own axes.
pub(super) fn ray_at(rect: Rect, p: Pos2, model: &Model) -> DVec3 {
    let half = f64::from((0.5 * model.fov_deg.to_radians()).tan());
    let at = (p - rect.center()) * 2.0 / rect.height().max(1.0);
    DVec3::new(f64::from(at.x) * half, -f64::from(at.y) * half, -1.0)
}

/// Returns the position of a place in the inside pane, if it is in front of the eye.
pub(super) fn in_pane(rect: Rect, place: DVec3, model: &Model) -> Option<Pos2> {
    let pose = model.pose?;
    let inverse = pose.rotation.as_dquat().conjugate();
    let c = inverse * (place - pose.position_mm.as_dvec3());
    let depth = -c.z;
    let half = f64::from((0.5 * model.fov_deg.to_radians()).tan());
    let at = DVec2::new(c.x, -c.y) / (depth * half) * f64::from(0.5 * rect.height());
    (depth > 0.05).then(|| rect.center() + vec2(at.x as f32, at.y as f32))
}

/// Parts of the inside pane that are taken by its name, the patient's axes, a legend and the overview.
pub(super) fn taken_parts(rect: Rect, model: &Model) -> Vec<Rect> {
    let title = Rect::from_min_size(rect.min, TITLE);
    let axes = Rect::from_min_max(rect.left_bottom() + MARKER, rect.left_bottom());
    let scale = Rect::from_min_size(rect.right_center() - vec2(SCALE.x, 0.5 * SCALE.y), SCALE);
    let legend = Rect::from_min_size(rect.right_bottom() - LEGEND, LEGEND);
    let colours = match model.colouring {
        Colouring::Radius => Some(scale),
        Colouring::Evidence | Colouring::Behind => Some(legend),
        _ => None,
    };
    let has_inset = model.maximised.is_none() && model.layout != PaneLayout::All;
    let overview = has_inset.then(|| inset(rect));
    [title, axes].into_iter().chain(colours).chain(overview).collect()
}

#[cfg(test)]
mod tests {
    use super::super::action::{Action, Pane};
    use super::super::branch_panel::branch_marks;
    use super::super::layout::places;
    use super::super::model::flown_model;
    use super::*;
    use crate::volume::phantom::Kind;

    /// Names of keys and numbers of branches were written under the overview.
    #[test]
    fn no_number_of_a_branch_lies_under_the_overview() {
        let (mut model, _session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let whole = Rect::from_min_size(Pos2::ZERO, vec2(900.0, 480.0));
        let shown = places(whole, PaneLayout::Reading, Pane::Axial, None).panes;
        let rect_of = |pane: Pane| shown.iter().find(|(p, _)| *p == pane).unwrap().1;
        let (inside, overview) = (rect_of(Pane::Inside), rect_of(Pane::Overview));
        let length_mm = model.path.as_ref().unwrap().length_mm();
        let mut marks = 0;
        for step in 0..60 {
            model.step(0.0, &[Action::Seek(length_mm * f64::from(step) / 60.0)]);
            let taken = taken_parts(inside, &model);
            assert!(taken.contains(&overview));
            for mark in branch_marks(inside, &taken, &model) {
                assert!(!overview.contains(mark.at), "{:?}", mark.at);
                marks += 1;
            }
        }
        assert!(marks > 0, "a Y offers a branch");
        model.maximised = Some(Pane::Inside);
        assert!(!taken_parts(inside, &model).contains(&overview));
    }
}
