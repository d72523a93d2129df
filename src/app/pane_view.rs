//! One pane: its picture, the marks over it, and what the pointer does there.

use egui::{Align2, Color32, FontId, Rect, Response, Sense, Stroke, Ui, Vec2, pos2, vec2};
use glam::DVec3;

use super::action::{Action, ActionQueue, Pane, PaneLayout, Request, WallView};
use super::branch_panel::branch_under;
use super::first_page::first_page;
use super::inside_marks::{
    inside_marks, mark_under, measurements, missed_mark, ruler_prompt, value_behind,
};
use super::inside_pane::{in_pane, ray_at};
use super::labels::Labels;
use super::lumen_question::before_the_wall;
use super::model::Model;
use super::overview_pane::{OverviewCamera, overview_input, zoom_mark};
use super::slice_pane::show_slice;
use super::style::{pinch, wheel_notches, wheel_sideways};
use super::ui::UiState;

/// Whether nothing is open, and nothing on its way.
fn is_empty(model: &Model, is_computing: bool) -> bool {
    model.volume().is_none() && model.failure.is_none() && model.question.is_none() && !is_computing
}

/// One pane, which is drawn to a texture, with the marks that lie over it.
pub(super) fn show_pane(
    ui: &mut Ui,
    (pane, drawn): (Pane, egui::TextureId),
    rect: Rect,
    model: &Model,
    state: &mut UiState,
    is_computing: bool,
    commands: &mut ActionQueue,
) {
    let response = ui.allocate_rect(rect, Sense::click_and_drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Image, true, pane.title()));
    let all = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 0.0, Color32::from_rgb(12, 12, 14));
    let has_wall = model.pose.is_some() && model.products.wall.is_some();
    match pane {
        Pane::Inside if has_wall => {
            painter.image(drawn, rect, all, Color32::WHITE);
            inside_marks(&painter, rect, model);
            ruler_prompt(&painter, rect, model);
            let pointer = response.hover_pos();
            pointer.into_iter().for_each(|at| value_behind(&painter, rect, model, at));
            inside_input(ui, &response, rect, model, &mut state.slices.grabbed_inside, commands);
        }
        Pane::Overview if has_wall => {
            painter.image(drawn, rect, all, Color32::WHITE);
            if let Some(camera) = OverviewCamera::of(rect, model) {
                overview_input(ui, &response, &camera, model, commands);
                missed_mark(&painter, model, false, |place| camera.in_pane(place));
                measurements(&painter, model, |place| camera.in_pane(place));
                // It would hide a small organ.
                if rect.size().min_elem() >= MARKED_INSET {
                    orientation_marker(&painter, rect, camera.rotation());
                }
                zoom_mark(&painter, rect, model);
            }
        }
        Pane::Inside if is_empty(model, is_computing) => first_page(ui, rect, model, commands),
        Pane::Inside => {
            before_the_wall(ui, rect, model, is_computing, &mut state.panel.tab, commands);
        }
        Pane::Overview => {}
        _ => show_slice(ui, pane, rect, &response, model, &mut state.slices, commands),
    }
    let is_named = match pane {
        // An empty corner of the inside view has no name.
        Pane::Overview => has_wall || model.layout == PaneLayout::All,
        Pane::Inside => true,
        _ => model.volume().is_none(),
    };
    if is_named {
        Labels::new(&painter, rect).title(pane.title());
    }
    if pane == Pane::Inside
        && let Some(pose) = model.pose
    {
        orientation_marker(&painter, rect, pose.rotation.as_dquat());
    }
    if response.double_clicked() {
        let is_small = model.layout != PaneLayout::All && model.large_slice != pane;
        commands.act(match Pane::SLICES.contains(&pane) && is_small && model.maximised.is_none() {
            true => Action::LargeSlice(pane),
            false => Action::Maximise((model.maximised != Some(pane)).then_some(pane)),
        });
    }
}

/// Radians a point of dragging turns the eye, for a pane one field of view high.
fn turn_per_point(rect: Rect, model: &Model) -> f32 {
    model.fov_deg.to_radians() / rect.height().max(1.0)
}

fn inside_input(
    ui: &Ui,
    response: &Response,
    rect: Rect,
    model: &Model,
    grabbed: &mut Option<(usize, usize)>,
    commands: &mut ActionQueue,
) {
    let drag = response.drag_delta();
    let per = turn_per_point(rect, model);
    let is_eye = model.view == WallView::Eye;
    let primary = response.dragged_by(egui::PointerButton::Primary);
    let mark_at = |p| mark_under(p, model, |place| in_pane(rect, place, model));
    if response.drag_started_by(egui::PointerButton::Primary) {
        let pressed = ui.input(|i| i.pointer.press_origin());
        *grabbed = pressed.filter(|_| is_eye).and_then(mark_at);
    }
    if let Some((measurement, point)) = grabbed.filter(|_| primary) {
        let at = response.interact_pointer_pos();
        let wall = at.and_then(|p| model.wall_behind(ray_at(rect, p, model)));
        if let Some(to) = wall.map(|place| place.to_array()) {
            commands.act(Action::MoveMark { measurement, point, to });
        }
    } else if primary && drag != Vec2::ZERO {
        let ctrl = ui.input(|i| i.modifiers.ctrl);
        // As if the wall were held and drawn along.
        let turn = if ctrl { [0.0, 0.0, per * drag.x] } else { [-per * drag.x, per * drag.y, 0.0] };
        commands.act(Action::Turn(turn));
    }
    let branch = response.interact_pointer_pos().and_then(|p| branch_under(rect, p, model));
    if let Some(branch) = branch.filter(|_| response.clicked() && is_eye) {
        commands.ask(Request::Branch(branch));
    } else if response.clicked()
        && is_eye
        && let Some(p) = response.interact_pointer_pos()
        && let Some(place) = model.wall_behind(ray_at(rect, p, model))
    {
        let place = place.to_array();
        commands.act(match model.ruler {
            Some(_) => Action::Mark(place),
            None => Action::ShowInSlices(place),
        });
    }
    if response.dragged_by(egui::PointerButton::Secondary) && drag.y != 0.0 {
        commands.act(Action::FieldOfView(model.fov_deg + 0.2 * drag.y));
    }
    if response.hovered() {
        let (notches, pinch) = (wheel_notches(ui), pinch(ui));
        let sideways = wheel_sideways(ui);
        if sideways != 0.0 {
            // As a drag does.
            let half = (0.5 * model.fov_deg.to_radians()).tan();
            let angle = sideways * 2.0 * half / rect.height().max(1.0);
            commands.act(Action::Turn([angle, 0.0, 0.0]));
        }
        if pinch != 1.0 {
            commands.act(Action::FieldOfView(model.fov_deg / pinch as f32));
        } else if notches != 0.0 {
            let ctrl = ui.input(|i| i.modifiers.ctrl);
            commands.act(match ctrl {
                true => Action::FieldOfView(model.fov_deg - 4.0 * notches as f32),
                false => Action::Travel(WHEEL_MM * notches),
            });
        }
    }
}

/// A notch of the wheel along the path, mm.
const WHEEL_MM: f64 = 5.0;

/// Shorter side of a pane from which on the patient's axes have their full size, points.
const MARKED_PANE: f32 = 330.0;

/// Shorter side of an overview from which on the axes are shown in it, points.
const MARKED_INSET: f32 = 150.0;

/// The patient's axes as the eye sees them.
pub(super) fn orientation_marker(painter: &egui::Painter, rect: Rect, rotation: glam::DQuat) {
    // Less of a small pane, whose picture it would hide.
    let scale = (rect.size().min_elem() / MARKED_PANE).clamp(0.6, 1.0);
    let centre = rect.left_bottom() + vec2(44.0, -44.0) * scale;
    // Grey letters are to be read on a light wall too.
    painter.circle_filled(centre, 42.0 * scale, Color32::from_black_alpha(110));
    let inverse = rotation.conjugate();
    let mut axes: Vec<(DVec3, &str)> = vec![
        (DVec3::X, "L"),
        (DVec3::NEG_X, "R"),
        (DVec3::Y, "P"),
        (DVec3::NEG_Y, "A"),
        (DVec3::Z, "H"),
        (DVec3::NEG_Z, "F"),
    ];
    // Farther ones first.
    axes.sort_by(|a, b| (inverse * a.0).z.total_cmp(&(inverse * b.0).z));
    for (axis, letter) in axes {
        let v = inverse * axis;
        let to = centre + vec2(v.x as f32, -v.y as f32) * 26.0 * scale;
        let near = (0.5 + 0.5 * v.z) as f32;
        let grey = (90.0 + 150.0 * near) as u8;
        let colour = Color32::from_gray(grey);
        painter.line_segment([centre, to], Stroke::new(1.5, colour));
        let at = centre + vec2(v.x as f32, -v.y as f32) * 35.0 * scale;
        let font = FontId::proportional((12.0 * scale).max(9.0));
        painter.text(at, Align2::CENTER_CENTER, letter, font, colour);
    }
}
