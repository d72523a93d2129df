//! Panels, panes and keys. One function a part; each takes the model as it is and returns actions.

use egui::{
    Align2, Color32, FontId, Key, Modifiers, Pos2, Rect, Response, Sense, Stroke, Ui, Vec2, pos2,
    vec2,
};
use glam::DVec3;

use super::model::{Action, FOV_DEG, Model, Pane, SPEED_MM_S};
use super::slices::{Plane, slice};
use crate::volume::Volume;

/// Textures of the two drawn panes.
pub const INSIDE: egui::TextureId = egui::TextureId::User(0);
pub const OVERVIEW: egui::TextureId = egui::TextureId::User(1);

const TEXT: Color32 = Color32::from_rgb(225, 228, 232);
const FAINT: Color32 = Color32::from_rgb(150, 156, 165);
const ACCENT: Color32 = Color32::from_rgb(90, 210, 140);
const CAMERA: Color32 = Color32::from_rgb(255, 200, 60);
const CROSSHAIR: Color32 = Color32::from_rgba_premultiplied(120, 94, 28, 150);

/// What a user has to accept.
pub const NOTICE: &str = "Research and education only. Not for diagnosis.";

/// A slice as a texture, and what it was made of.
struct SliceTexture {
    texture: egui::TextureHandle,
    made_of: (Plane, [usize; 2], [f64; 2], bool),
}

/// What the panels keep from frame to frame beside the model.
pub struct UiState {
    slices: [Option<SliceTexture>; 4],
    /// Text of the next bookmark.
    note: String,
    /// Of the slices: 1 shows all of the volume.
    zoom: f64,
}

impl Default for UiState {
    fn default() -> Self {
        Self { slices: Default::default(), note: String::new(), zoom: 1.0 }
    }
}

/// Where the drawn panes are, in pixels: columns and rows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Shown {
    /// The inside view, where it is shown.
    pub inside: Option<[u32; 2]>,
    /// The overview.
    pub overview: Option<[u32; 2]>,
}

/// Lays the window out.
///
/// * `stage`: what is being computed, and the share that is done.
pub fn window(
    ui: &mut Ui,
    model: &Model,
    state: &mut UiState,
    stage: Option<(&str, f32)>,
    actions: &mut Vec<Action>,
) -> Shown {
    keys(ui, model, actions);
    egui::Panel::top("top").show(ui, |ui| top_bar(ui, model, stage, actions));
    egui::Panel::bottom("timeline").exact_size(92.0).show(ui, |ui| timeline(ui, model, actions));
    egui::Panel::right("notes")
        .resizable(false)
        .exact_size(210.0)
        .show(ui, |ui| notes(ui, model, state, actions));
    let mut shown = Shown::default();
    egui::CentralPanel::no_frame().show(ui, |ui| {
        let whole = ui.max_rect();
        for (pane, rect) in layout(whole, model.maximised) {
            let rect = on_pixels(ui, rect);
            let size = pixels(ui, rect);
            match pane {
                Pane::Inside => shown.inside = Some(size),
                Pane::Overview => shown.overview = Some(size),
                _ => {}
            }
            show_pane(ui, pane, rect, model, state, actions);
        }
    });
    if model.help {
        help(ui, actions);
    }
    shown
}

/// The rectangles of the panes that are shown.
fn layout(whole: Rect, maximised: Option<Pane>) -> Vec<(Pane, Rect)> {
    if let Some(pane) = maximised {
        return vec![(pane, whole)];
    }
    const GAP: f32 = 2.0;
    let split = (0.56 * whole.width()).round();
    let left = Rect::from_min_max(whole.min, pos2(whole.min.x + split - GAP, whole.max.y));
    let right = Rect::from_min_max(pos2(whole.min.x + split, whole.min.y), whole.max);
    let part = |col: usize, row: usize, cols: usize, rows: usize| {
        let size = vec2(right.width() / cols as f32, right.height() / rows as f32);
        let min = right.min + vec2(col as f32 * size.x, row as f32 * size.y);
        Rect::from_min_size(min, (size - Vec2::splat(GAP)).max(Vec2::splat(1.0)))
    };
    // The overview takes the upper third of the right side, slices the rest.
    let third = right.height() / 3.0;
    let overview =
        Rect::from_min_size(part(0, 0, 2, 3).min, vec2(part(0, 0, 2, 3).width(), third - GAP));
    vec![
        (Pane::Inside, left),
        (Pane::Overview, overview),
        (Pane::Across, part(1, 0, 2, 3)),
        (Pane::Axial, part(0, 1, 2, 3)),
        (Pane::Coronal, part(1, 1, 2, 3)),
        (Pane::Sagittal, part(0, 2, 2, 3).union(part(1, 2, 2, 3))),
    ]
}

/// The rectangle on whole pixels, so that pictures are shown one to one.
fn on_pixels(ui: &Ui, rect: Rect) -> Rect {
    let scale = ui.pixels_per_point();
    let round = |p: Pos2| pos2((p.x * scale).round() / scale, (p.y * scale).round() / scale);
    Rect::from_min_max(round(rect.min), round(rect.max))
}

fn pixels(ui: &Ui, rect: Rect) -> [u32; 2] {
    let scale = ui.pixels_per_point();
    [rect.width(), rect.height()].map(|s| ((s * scale).round() as u32).max(2))
}

fn top_bar(ui: &mut Ui, model: &Model, stage: Option<(&str, f32)>, actions: &mut Vec<Action>) {
    ui.horizontal(|ui| {
        ui.strong("intima");
        ui.separator();
        let ready = model.path.is_some();
        let play = if model.playing { "Pause" } else { "Play" };
        if ui.add_enabled(ready, egui::Button::new(play)).clicked() {
            actions.push(Action::TogglePlay);
        }
        let way = if model.reverse { "Direction: back" } else { "Direction: forward" };
        if ui.add_enabled(ready, egui::Button::new(way)).clicked() {
            actions.push(Action::Reverse);
        }
        let mut speed = model.speed_mm_s;
        let slider = egui::DragValue::new(&mut speed).range(SPEED_MM_S).suffix(" mm/s").speed(0.5);
        if ui.add(slider).on_hover_text("Cruising speed").changed() {
            actions.push(Action::Speed(speed));
        }
        let mut fov = model.fov_deg;
        let slider = egui::DragValue::new(&mut fov).range(FOV_DEG).suffix("°").speed(0.5);
        if ui.add(slider).on_hover_text("Vertical field of view").changed() {
            actions.push(Action::FieldOfView(fov));
        }
        if ui.add_enabled(ready && !model.on_path, egui::Button::new("Back to path")).clicked() {
            actions.push(Action::BackToPath);
        }
        let missed = model.products.coverage.as_ref().is_some_and(|c| !c.patches.is_empty());
        if ui.add_enabled(missed, egui::Button::new("Next missed patch")).clicked() {
            actions.push(Action::NextMissed);
        }
        if ui.button("Keys").clicked() {
            actions.push(Action::ToggleHelp);
        }
        ui.separator();
        match (stage, &model.failure) {
            (_, Some(failure)) => {
                ui.colored_label(Color32::from_rgb(255, 120, 110), failure);
            }
            (Some((stage, share)), None) => {
                let bar = egui::ProgressBar::new(share).desired_width(90.0);
                ui.add(bar);
                ui.label(stage);
                if ui.small_button("Cancel").clicked() {
                    actions.push(Action::Cancel);
                }
            }
            (None, None) => {
                if let Some(message) = &model.message {
                    ui.label(message);
                }
            }
        }
    });
}

fn notes(ui: &mut Ui, model: &Model, state: &mut UiState, actions: &mut Vec<Action>) {
    ui.add_space(4.0);
    figures(ui, model);
    ui.separator();
    ui.strong("Bookmarks");
    ui.horizontal(|ui| {
        let text =
            egui::TextEdit::singleline(&mut state.note).hint_text("note").desired_width(120.0);
        let field = ui.add(text);
        let entered = field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
        let can = model.pose.is_some();
        if ui.add_enabled(can, egui::Button::new("Add")).clicked() || (entered && can) {
            actions.push(Action::Bookmark(std::mem::take(&mut state.note)));
        }
    });
    egui::ScrollArea::vertical().show(ui, |ui| {
        for (i, b) in model.bookmarks.iter().enumerate() {
            ui.horizontal(|ui| {
                if ui.small_button("x").on_hover_text("Forget").clicked() {
                    actions.push(Action::RemoveBookmark(i));
                }
                let place = b.arc_mm.map_or("off the path".into(), |mm| format!("{mm:.0} mm"));
                if ui.button(format!("{} ({place})", b.text)).clicked() {
                    actions.push(Action::GoToBookmark(i));
                }
            });
        }
    });
    ui.with_layout(egui::Layout::bottom_up(egui::Align::LEFT), |ui| {
        ui.add(egui::Label::new(egui::RichText::new(NOTICE).small().color(FAINT)).wrap());
    });
}

fn figures(ui: &mut Ui, model: &Model) {
    let line = |ui: &mut Ui, name: &str, value: String| {
        ui.horizontal(|ui| {
            ui.label(egui::RichText::new(name).color(FAINT));
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| ui.label(value));
        });
    };
    ui.strong("Figures");
    if let Some(lumen) = &model.products.lumen {
        let l = &lumen.lumen;
        let ml = l.inside_voxels() as f64 * l.grid.voxel_mm3() / 1000.0;
        line(ui, "Volume", format!("{ml:.1} ml"));
    }
    if let Some(path) = &model.path {
        line(ui, "Path", format!("{:.0} mm", path.length_mm()));
        line(ui, "Position", format!("{:.0} mm", model.arc_mm));
        line(ui, "Radius here", format!("{:.1} mm", path.radius_at(model.arc_mm)));
    }
    if let Some(c) = &model.products.coverage {
        line(ui, "Wall seen, one way", format!("{:.1} %", 100.0 * c.one_way_fraction));
        line(ui, "Both ways", format!("{:.1} %", 100.0 * c.both_ways_fraction));
        line(ui, "Missed patches", format!("{}", c.patches.len()));
    }
}

/// The scrub bar with the radius along the path.
fn timeline(ui: &mut Ui, model: &Model, actions: &mut Vec<Action>) {
    let size = ui.available_size().max(Vec2::splat(4.0));
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    let painter = ui.painter_at(rect);
    let bar = rect.shrink2(vec2(8.0, 6.0));
    painter.rect_filled(bar, 2.0, Color32::from_rgb(24, 26, 30));
    let Some(path) = &model.path else {
        let text = "the path is not known yet";
        painter.text(bar.center(), Align2::CENTER_CENTER, text, FontId::proportional(13.0), FAINT);
        return;
    };
    let length = path.length_mm().max(1e-6);
    let most = path.radius_mm.iter().copied().fold(1e-6, f64::max);
    let x = |arc: f64| bar.left() + (arc / length) as f32 * bar.width();
    let plot = Rect::from_min_max(bar.min, pos2(bar.max.x, bar.max.y - 14.0));
    // One bar a point of the screen: the least radius of its stretch.
    let columns = (plot.width() as usize).max(1);
    let mut least = vec![f64::INFINITY; columns];
    for (arc, radius) in path.arcs_mm().iter().zip(&path.radius_mm) {
        let i = ((arc / length) * columns as f64) as usize;
        let slot = &mut least[i.min(columns - 1)];
        *slot = slot.min(*radius);
    }
    let mut last = 0.0;
    for (i, radius) in least.iter().enumerate() {
        last = if radius.is_finite() { *radius } else { last };
        let px = plot.left() + i as f32 + 0.5;
        let h = (last / most) as f32 * plot.height();
        let flown = px <= x(model.arc_mm);
        let colour = if flown { ACCENT } else { Color32::from_rgb(70, 90, 84) };
        painter.line_segment(
            [pos2(px, plot.bottom() - h), pos2(px, plot.bottom())],
            Stroke::new(1.0, colour),
        );
    }
    for cut in path.cuts_mm() {
        let line = [pos2(x(cut), plot.top()), pos2(x(cut), plot.bottom())];
        painter.line_segment(line, Stroke::new(2.0, Color32::from_rgb(255, 120, 110)));
    }
    for b in model.bookmarks.iter().filter_map(|b| b.arc_mm) {
        painter.circle_filled(pos2(x(b), plot.top() + 4.0), 3.0, CAMERA);
    }
    let here = x(model.arc_mm);
    painter
        .line_segment([pos2(here, bar.top()), pos2(here, plot.bottom())], Stroke::new(2.0, CAMERA));
    let label = |at: Pos2, anchor, text: String| {
        painter.text(at, anchor, text, FontId::proportional(11.0), FAINT);
    };
    label(bar.left_bottom(), Align2::LEFT_BOTTOM, "0 mm".into());
    label(bar.right_bottom(), Align2::RIGHT_BOTTOM, format!("{length:.0} mm"));
    label(
        bar.center_bottom(),
        Align2::CENTER_BOTTOM,
        format!("radius to {most:.0} mm along the path"),
    );
    if (response.clicked() || response.dragged())
        && let Some(p) = response.interact_pointer_pos()
    {
        actions.push(Action::Seek(f64::from((p.x - bar.left()) / bar.width()) * length));
    }
}

/// One pane with what lies over it.
fn show_pane(
    ui: &mut Ui,
    pane: Pane,
    rect: Rect,
    model: &Model,
    state: &mut UiState,
    actions: &mut Vec<Action>,
) {
    let response = ui.allocate_rect(rect, Sense::click_and_drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Image, true, pane.title()));
    let all = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 0.0, Color32::from_rgb(12, 12, 14));
    match pane {
        Pane::Inside if model.pose.is_some() && model.products.wall.is_some() => {
            painter.image(INSIDE, rect, all, Color32::WHITE);
            inside_input(ui, &response, rect, model, actions);
        }
        Pane::Overview if model.pose.is_some() && model.products.wall.is_some() => {
            painter.image(OVERVIEW, rect, all, Color32::WHITE);
            let drag = response.drag_delta();
            if response.dragged_by(egui::PointerButton::Primary) && drag != Vec2::ZERO {
                // Half a turn across the pane.
                let per = std::f32::consts::PI / rect.width().max(1.0);
                actions.push(Action::Orbit([per * drag.x, per * drag.y]));
            }
        }
        Pane::Inside | Pane::Overview => {
            let text = if model.failure.is_some() { "" } else { "the wall is being made" };
            painter.text(
                rect.center(),
                Align2::CENTER_CENTER,
                text,
                FontId::proportional(14.0),
                FAINT,
            );
        }
        _ => show_slice(ui, pane, rect, &response, model, state, actions),
    }
    painter.text(
        rect.left_top() + vec2(6.0, 4.0),
        Align2::LEFT_TOP,
        pane.title(),
        FontId::proportional(12.0),
        TEXT,
    );
    if pane == Pane::Inside
        && let Some(pose) = model.pose
    {
        orientation_marker(&painter, rect, pose.rotation.as_dquat());
    }
    if response.double_clicked() {
        actions.push(Action::Maximise((model.maximised != Some(pane)).then_some(pane)));
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
    actions: &mut Vec<Action>,
) {
    let drag = response.drag_delta();
    let per = turn_per_point(rect, model);
    if response.dragged_by(egui::PointerButton::Primary) && drag != Vec2::ZERO {
        let ctrl = ui.input(|i| i.modifiers.ctrl);
        // As if the wall were held and drawn along.
        let turn = if ctrl { [0.0, 0.0, per * drag.x] } else { [-per * drag.x, per * drag.y, 0.0] };
        actions.push(Action::Turn(turn));
    }
    if response.dragged_by(egui::PointerButton::Secondary) && drag.y != 0.0 {
        actions.push(Action::FieldOfView(model.fov_deg + 0.2 * drag.y));
    }
    if response.hovered() {
        let notches = wheel_notches(ui);
        if notches != 0.0 {
            let ctrl = ui.input(|i| i.modifiers.ctrl);
            actions.push(match ctrl {
                true => Action::FieldOfView(model.fov_deg - 4.0 * notches as f32),
                false => Action::Travel(WHEEL_MM * notches),
            });
        }
    }
}

/// A notch of the wheel along the path, mm.
const WHEEL_MM: f64 = 5.0;

/// Notches turned in this frame, as the wheel gave them: the smoothed value would go on for thirty
/// frames.
fn wheel_notches(ui: &Ui) -> f64 {
    ui.input(|i| {
        i.raw
            .events
            .iter()
            .map(|e| match e {
                egui::Event::MouseWheel { unit: egui::MouseWheelUnit::Line, delta, .. } => {
                    f64::from(delta.y)
                }
                egui::Event::MouseWheel { delta, .. } => f64::from(delta.y) / 50.0,
                _ => 0.0,
            })
            .sum()
    })
}

fn show_slice(
    ui: &mut Ui,
    pane: Pane,
    rect: Rect,
    response: &Response,
    model: &Model,
    state: &mut UiState,
    actions: &mut Vec<Action>,
) {
    let painter = ui.painter_at(rect);
    let Some(volume) = &model.products.volume else { return };
    let size = pixels(ui, rect).map(|s| s as usize);
    let mm_per_px = state.zoom * mm_to_fit(volume, pane, size);
    let Some(plane) = Plane::of(pane, model.crosshair_mm, mm_per_px, model.pose) else {
        return;
    };
    let lumen = model.products.lumen.as_ref().map(|l| &l.lumen);
    let made_of = (plane, size, model.window, lumen.is_some());
    let slot = match pane {
        Pane::Axial => 0,
        Pane::Coronal => 1,
        Pane::Sagittal => 2,
        _ => 3,
    };
    let slot = &mut state.slices[slot];
    if slot.as_ref().is_none_or(|s| s.made_of != made_of) {
        let rgb = slice(volume, lumen, &plane, size, model.window);
        let pixels = rgb.into_iter().map(|[r, g, b]| Color32::from_rgb(r, g, b)).collect();
        let image = egui::ColorImage::new(size, pixels);
        let options = egui::TextureOptions::NEAREST;
        match slot {
            Some(s) => {
                s.texture.set(image, options);
                s.made_of = made_of;
            }
            None => {
                let texture = ui.ctx().load_texture(pane.title(), image, options);
                *slot = Some(SliceTexture { texture, made_of });
            }
        }
    }
    if let Some(s) = slot {
        let all = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        painter.image(s.texture.id(), rect, all, Color32::WHITE);
    }
    let scale = ui.pixels_per_point();
    slice_marks(&painter, rect, &plane, model, f64::from(scale));
    let place = |p: Pos2| {
        let px = [(p.x - rect.min.x) * scale, (p.y - rect.min.y) * scale].map(f64::from);
        plane.at(px, size).to_array()
    };
    if response.dragged_by(egui::PointerButton::Primary)
        && let Some(p) = response.interact_pointer_pos()
    {
        actions.push(Action::Crosshair(place(p)));
    } else if response.clicked()
        && let Some(p) = response.interact_pointer_pos()
    {
        actions.push(Action::GoNear(place(p)));
    }
    if response.dragged_by(egui::PointerButton::Secondary) {
        let d = response.drag_delta();
        let [centre, width] = model.window;
        let step = (width / 300.0).max(0.01);
        let width = width + f64::from(d.x) * step;
        actions.push(Action::Window([centre + f64::from(d.y) * step, width]));
    }
    let notches = wheel_notches(ui);
    if response.hovered() && notches != 0.0 {
        if ui.input(|i| i.modifiers.ctrl) {
            state.zoom = (state.zoom * 0.9f64.powf(notches)).clamp(0.01, 4.0);
        } else {
            let normal = plane.right.cross(plane.down);
            let along = normal.abs().dot(volume.grid.spacing_mm).max(0.1);
            let p = model.crosshair_mm + normal * along * notches;
            actions.push(Action::Crosshair(p.to_array()));
        }
    }
}

/// Millimetres a pixel at which a slice through the middle shows all of the volume.
fn mm_to_fit(volume: &Volume, pane: Pane, [width, height]: [usize; 2]) -> f64 {
    let grid = &volume.grid;
    let sides = grid.dims.as_dvec3() * grid.spacing_mm;
    let column = |i: usize| grid.direction.col(i).abs() * sides[i];
    let box_mm = column(0) + column(1) + column(2);
    let (across, down) = match pane {
        Pane::Axial => (box_mm.x, box_mm.y),
        Pane::Coronal => (box_mm.x, box_mm.z),
        Pane::Sagittal => (box_mm.y, box_mm.z),
        // Of a slice that may lie any way about.
        _ => (box_mm.max_element(), box_mm.max_element()),
    };
    (across / width.max(1) as f64).max(down / height.max(1) as f64).max(1e-3)
}

/// Crosshair, eye, sides of the patient, a bar of a centimetre.
fn slice_marks(painter: &egui::Painter, rect: Rect, plane: &Plane, model: &Model, scale: f64) {
    let size = [rect.width(), rect.height()].map(|s| f64::from(s) * scale);
    let size = size.map(|s| s.round() as usize);
    let point = |p: DVec3| {
        let (px, off) = plane.px(p, size);
        (rect.min + vec2((px[0] / scale) as f32, (px[1] / scale) as f32), off)
    };
    let (c, _) = point(model.crosshair_mm);
    let thin = Stroke::new(1.0, CROSSHAIR);
    painter.line_segment([pos2(rect.left(), c.y), pos2(rect.right(), c.y)], thin);
    painter.line_segment([pos2(c.x, rect.top()), pos2(c.x, rect.bottom())], thin);
    if let Some(pose) = model.pose {
        let (at, off) = point(pose.position_mm.as_dvec3());
        if off.abs() < 3.0 * plane.mm_per_px.max(1.0) && rect.contains(at) {
            let ahead =
                pose.position_mm.as_dvec3() + 15.0 * plane.mm_per_px * pose.forward().as_dvec3();
            let (to, _) = point(ahead);
            painter.circle_filled(at, 3.5, CAMERA);
            painter.line_segment([at, to], Stroke::new(2.0, CAMERA));
        }
    }
    let [left, right, up, down] = plane.sides();
    let m = 8.0;
    let letter = |at: Pos2, anchor, text: String| {
        painter.text(at, anchor, text, FontId::proportional(13.0), TEXT);
    };
    letter(rect.left_center() + vec2(m, 0.0), Align2::LEFT_CENTER, left);
    letter(rect.right_center() - vec2(m, 0.0), Align2::RIGHT_CENTER, right);
    letter(rect.center_top() + vec2(0.0, 4.0), Align2::CENTER_TOP, up);
    letter(rect.center_bottom() - vec2(0.0, 4.0), Align2::CENTER_BOTTOM, down);
    let centimetre = (10.0 / plane.mm_per_px / scale) as f32;
    let right = rect.right_bottom() - vec2(m, 10.0);
    painter.line_segment([right - vec2(centimetre, 0.0), right], Stroke::new(2.0, TEXT));
    let above = right - vec2(0.0, 3.0);
    painter.text(above, Align2::RIGHT_BOTTOM, "1 cm", FontId::proportional(11.0), TEXT);
}

/// The patient's axes as the eye sees them.
fn orientation_marker(painter: &egui::Painter, rect: Rect, rotation: glam::DQuat) {
    let centre = rect.left_bottom() + vec2(44.0, -44.0);
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
        let to = centre + vec2(v.x as f32, -v.y as f32) * 26.0;
        let near = (0.5 + 0.5 * v.z) as f32;
        let grey = (90.0 + 150.0 * near) as u8;
        let colour = Color32::from_gray(grey);
        painter.line_segment([centre, to], Stroke::new(1.5, colour));
        let at = centre + vec2(v.x as f32, -v.y as f32) * 35.0;
        painter.text(at, Align2::CENTER_CENTER, letter, FontId::proportional(12.0), colour);
    }
}

/// Keys, unless a text field has them.
fn keys(ui: &Ui, model: &Model, actions: &mut Vec<Action>) {
    if ui.ctx().egui_wants_keyboard_input() {
        return;
    }
    let pressed = |key| ui.input(|i| i.key_pressed(key));
    // A key may be down and up again within one frame: what was held with it is its own.
    let with = |wanted: Key, fits: fn(&Modifiers) -> bool| {
        ui.input(|i| {
            i.events.iter().any(|e| match e {
                egui::Event::Key { key, pressed: true, modifiers, .. } => {
                    *key == wanted && fits(modifiers)
                }
                _ => false,
            })
        })
    };
    for (key, action) in [
        (Key::Space, Action::TogglePlay),
        (Key::R, Action::Reverse),
        (Key::Home, Action::Seek(0.0)),
        (Key::End, Action::Seek(f64::MAX)),
        (Key::OpenBracket, Action::Speed(model.speed_mm_s / 1.25)),
        (Key::CloseBracket, Action::Speed(model.speed_mm_s * 1.25)),
        (Key::Num5, Action::BackToPath),
        (Key::U, Action::NextMissed),
        (Key::F1, Action::ToggleHelp),
        (Key::Questionmark, Action::ToggleHelp),
    ] {
        if pressed(key) {
            actions.push(action);
        }
    }
    if with(Key::B, |m| !m.shift) {
        actions.push(Action::Bookmark(String::new()));
    }
    if pressed(Key::Escape) {
        actions.push(if model.help { Action::ToggleHelp } else { Action::Maximise(None) });
    }
    if with(Key::Q, |m| m.ctrl && !m.shift && !m.alt) {
        actions.push(Action::Quit);
    }
    held_keys(ui, actions);
}

/// Millimetres a second of hand-flown motion.
const HAND_MM_S: f64 = 25.0;

/// Keys that move as long as they are held.
fn held_keys(ui: &Ui, actions: &mut Vec<Action>) {
    let (dt, fast) = ui.input(|i| (f64::from(i.stable_dt).min(0.1), i.modifiers.shift));
    let by = HAND_MM_S * dt * if fast { 3.0 } else { 1.0 };
    let down = |key| ui.input(|i| f64::from(u8::from(i.key_down(key))));
    let along = down(Key::ArrowUp) - down(Key::ArrowDown);
    if along != 0.0 {
        actions.push(Action::Travel(along * by));
    }
    let fly = DVec3::new(
        down(Key::D) - down(Key::A),
        down(Key::PageUp) - down(Key::PageDown),
        down(Key::W) - down(Key::S),
    );
    if fly != DVec3::ZERO {
        actions.push(Action::Fly((fly * by).to_array()));
    }
}

/// Whether a key is held that moves the eye.
pub fn moves(ctx: &egui::Context) -> bool {
    const MOVING: [Key; 8] =
        [Key::ArrowUp, Key::ArrowDown, Key::W, Key::A, Key::S, Key::D, Key::PageUp, Key::PageDown];
    !ctx.egui_wants_keyboard_input() && ctx.input(|i| MOVING.iter().any(|k| i.key_down(*k)))
}

fn help(ui: &Ui, actions: &mut Vec<Action>) {
    const KEYS: &[(&str, &str)] = &[
        ("Space", "play, pause"),
        ("R", "direction"),
        ("Up, Down, wheel", "along the path (Shift: three times as fast)"),
        ("Home, End", "ends of the path"),
        ("[ ]", "slower, faster"),
        ("W S A D, Page Up, Page Down", "fly by hand; the wall is never passed"),
        ("drag", "look around; turn the overview"),
        ("Ctrl + drag", "roll"),
        ("right drag, Ctrl + wheel", "field of view; window of the slices"),
        ("5", "back to the path, level"),
        ("click in a slice", "to the nearest place of the path"),
        ("drag in a slice", "crosshair"),
        ("B", "bookmark"),
        ("U", "next missed patch"),
        ("double click", "one pane, all panes"),
        ("F1 or ?", "these keys"),
        ("Ctrl + Q", "quit"),
    ];
    let mut open = true;
    egui::Window::new("Keys")
        .open(&mut open)
        .collapsible(false)
        .resizable(false)
        .anchor(Align2::CENTER_CENTER, Vec2::ZERO)
        .show(ui, |ui| {
            egui::Grid::new("keys").num_columns(2).striped(true).show(ui, |ui| {
                for (key, does) in KEYS {
                    ui.strong(*key);
                    ui.label(*does);
                    ui.end_row();
                }
            });
        });
    if !open {
        actions.push(Action::ToggleHelp);
    }
}
