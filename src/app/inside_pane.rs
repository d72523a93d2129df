//! Places in the inside pane: rays through it, points on it, parts that are taken.

use egui::{Pos2, Rect, Vec2, vec2};
use glam::{DVec2, DVec3};

use super::action::Colouring;
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

/// Parts of the inside pane that are taken by its name, the patient's axes and a legend.
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
    [title, axes].into_iter().chain(colours).collect()
}
