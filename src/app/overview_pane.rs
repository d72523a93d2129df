//! The overview's input and marks: the organ is turned, drawn near and shifted; a click flies to
//! the nearest place of the path.

use egui::{Align2, Pos2, Rect, Response, Ui, Vec2, pos2, vec2};
use glam::{DVec2, DVec3};

use super::action::{Action, ActionQueue, Request};
use super::inside_marks::shadowed;
use super::model::Model;
use super::style::{FAINT, pinch, wheel_notches};
use crate::geometry::{Lens, Pose};

/// Enlargement by a notch of the wheel.
const ZOOM_A_NOTCH: f64 = 1.15;

/// Camera of the overview in a pane.
pub(super) struct OverviewCamera {
    rect: Rect,
    pose: Pose,
    lens: Lens,
    /// Distance from the camera to the plane through the organ's middle, mm.
    depth_mm: f64,
}

impl OverviewCamera {
    /// The camera; `None` until there is a wall.
    pub fn of(rect: Rect, model: &Model) -> Option<Self> {
        let (low, high) = model.wall_bounds()?;
        let (pose, lens) = model.framing.camera(low, high, rect.width() / rect.height().max(1.0));
        let depth = (0.5 * (low + high) - pose.position_mm).dot(pose.forward());
        Some(Self { rect, pose, lens, depth_mm: f64::from(depth) })
    }

    /// Direction from the camera through a point of the pane; one millimetre ahead.
    fn ray(&self, p: Pos2) -> DVec3 {
        let half = f64::from((0.5 * self.lens.fov_y_rad).tan());
        let at = (p - self.rect.center()) * 2.0 / self.rect.height().max(1.0);
        DVec3::new(f64::from(at.x) * half, -f64::from(at.y) * half, -1.0)
    }

    /// Millimetres of the plane through the organ's middle that a point of the screen covers.
    fn mm_per_point(&self) -> f64 {
        let half = f64::from((0.5 * self.lens.fov_y_rad).tan());
        2.0 * half * self.depth_mm / f64::from(self.rect.height().max(1.0))
    }

    /// Position of a place in the pane.
    pub fn in_pane(&self, place: DVec3) -> Option<Pos2> {
        let inverse = self.pose.rotation.as_dquat().conjugate();
        let c = inverse * (place - self.pose.position_mm.as_dvec3());
        let half = f64::from((0.5 * self.lens.fov_y_rad).tan());
        let at = DVec2::new(c.x, -c.y) / (-c.z * half) * f64::from(0.5 * self.rect.height());
        (c.z < 0.0).then(|| self.rect.center() + vec2(at.x as f32, at.y as f32))
    }

    /// Rotation of the camera.
    pub fn rotation(&self) -> glam::DQuat {
        self.pose.rotation.as_dquat()
    }

    /// Zoom by notches of the wheel and the pan that keeps what lies under the pointer there.
    fn zoomed(&self, model: &Model, p: Pos2, notches: f64) -> Action {
        let factor = ZOOM_A_NOTCH.powf(notches);
        let zoom = (f64::from(model.framing.zoom) * factor) as f32;
        let off = (p - self.rect.center()) * (self.mm_per_point() * (1.0 - 1.0 / factor)) as f32;
        let [x, y] = model.framing.pan_mm;
        Action::Frame { zoom, pan_mm: [x + off.x, y - off.y] }
    }
}

/// Takes turning, zoom, pan and clicks.
pub(super) fn overview_input(
    ui: &Ui,
    response: &Response,
    camera: &OverviewCamera,
    model: &Model,
    commands: &mut ActionQueue,
) {
    if response.clicked()
        && let Some(p) = response.interact_pointer_pos()
        && let Some(place) = path_under(camera, p, model)
    {
        commands.ask(Request::FlyThrough(place.to_array()));
    }
    let (drag, shift) = (response.drag_delta(), ui.input(|i| i.modifiers.shift));
    let primary = response.dragged_by(egui::PointerButton::Primary);
    if drag != Vec2::ZERO {
        if response.dragged_by(egui::PointerButton::Middle) || (primary && shift) {
            let by = drag * camera.mm_per_point() as f32;
            let [x, y] = model.framing.pan_mm;
            let pan_mm = [x - by.x, y + by.y];
            commands.act(Action::Frame { zoom: model.framing.zoom, pan_mm });
        } else if primary {
            // Half a turn across the pane.
            let per = std::f32::consts::PI / camera.rect.width().max(1.0);
            commands.act(Action::Orbit([per * drag.x, per * drag.y]));
        }
    }
    let notches = wheel_notches(ui) + pinch(ui).ln() / ZOOM_A_NOTCH.ln();
    if let Some(p) = response.hover_pos().filter(|_| notches != 0.0) {
        commands.act(camera.zoomed(model, p, notches));
    }
}

/// Writes how near the organ is, where that is not all of it.
pub(super) fn zoom_mark(painter: &egui::Painter, rect: Rect, model: &Model) {
    if model.framing.zoom != 1.0 {
        let text = format!("{:.1} x", model.framing.zoom);
        let at = pos2(rect.right() - 6.0, rect.top() + 4.0);
        shadowed(painter, at, Align2::RIGHT_TOP, &text, 11.0, FAINT);
    }
}

/// The place of the centerline that is nearest to what lies under a point.
fn path_under(camera: &OverviewCamera, p: Pos2, model: &Model) -> Option<DVec3> {
    let along = (camera.rotation() * camera.ray(p)).try_normalize()?;
    let eye = camera.pose.position_mm.as_dvec3();
    let line = &model.products.centerline.as_ref()?.line;
    let points = line.branches.iter().flat_map(|b| &b.points).map(|p| p.position_mm);
    let off = |p: &DVec3| (*p - eye).cross(along).length_squared();
    points.min_by(|a, b| off(a).total_cmp(&off(b)))
}

#[cfg(test)]
mod tests {
    use super::super::model::flown_model;
    use super::*;
    use crate::volume::phantom::Kind;

    #[test]
    fn the_wheel_enlarges_the_overview_about_the_place_under_the_pointer() {
        let (mut model, _session) = flown_model(Kind::Bend, |_| {});
        let rect = Rect::from_min_size(pos2(20.0, 10.0), vec2(300.0, 200.0));
        let camera = |model: &Model| OverviewCamera::of(rect, model).unwrap();
        // A place in the plane through the middle of the organ.
        let (p, first) = (pos2(80.0, 60.0), camera(&model));
        let eye = first.pose.position_mm.as_dvec3();
        let place = eye + first.rotation() * first.ray(p) * first.depth_mm;
        assert!(first.in_pane(place).unwrap().distance(p) < 0.01);
        for notches in [1.0, 3.0, -2.0] {
            let action = camera(&model).zoomed(&model, p, notches);
            model.step(0.0, &[action]);
            let at = camera(&model).in_pane(place).unwrap();
            assert!(at.distance(p) < 0.1, "{at:?} after {notches} notches");
        }
        assert!((f64::from(model.framing.zoom) - ZOOM_A_NOTCH.powi(2)).abs() < 1e-3);
        // Away from the organ it ends at all of it.
        model.step(0.0, &[camera(&model).zoomed(&model, p, -40.0)]);
        assert_eq!(model.framing, crate::render::Framing::default());
    }
}
