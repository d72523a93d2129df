//! Panels and panes. One function a part; each takes the model as it is and returns actions.

use egui::{Align2, Color32, FontId, Pos2, Rect, Response, Sense, Stroke, Ui, Vec2, pos2, vec2};
use glam::DVec3;

use super::action::{Action, ActionQueue, Command, Pane, PaneLayout, Request, WallView};
use super::branch_panel::branch_under;
use super::computation::WorkStatus;
use super::dialogs::{Dialogs, ask_to_save, opened};
use super::first_page::first_page;
use super::grey_window::slice_row;
use super::inside_marks::{inside_marks, mark_under, measurements, missed_mark, value_behind};
use super::inside_pane::{in_pane, ray_at};
use super::keys::{help, keys};
use super::labels::Labels;
use super::layout::places;
use super::lumen_panel::lumen_question;
use super::model::Model;
use super::overview_pane::{OverviewCamera, overview_input, zoom_mark};
use super::side_panel::{PanelState, side_panel};
use super::slice_pane::{SliceViews, show_slice};
use super::style::{FAINT, TEXT, WRONG, pixels, wheel_notches};
use super::timeline::timeline;
use super::top_bar::{top_bar, transport};
use crate::formats::NOTICE;

/// Textures of the two drawn panes.
pub const INSIDE: egui::TextureId = egui::TextureId::User(0);
pub const OVERVIEW: egui::TextureId = egui::TextureId::User(1);

/// Returns the next step for a user after a failure.
fn what_next(model: &Model) -> &'static str {
    match model.volume() {
        Some(_) => "Choose an organ or a range of values on the right.",
        None => "Open another volume.",
    }
}

/// State that the panels keep from frame to frame beside the model.
#[derive(Default)]
pub struct UiState {
    slices: SliceViews,
    pub(super) panel: PanelState,
    /// When a pane was clicked, s, and what that leads to.
    click: Option<(f64, Command)>,
    pub(super) dialogs: Dialogs,
    /// Whether the last frame showed something that Escape closes by itself: a text field takes
    /// the focus back before the keys of a frame are looked at.
    is_escape_taken: bool,
}

impl UiState {
    /// * `is_live`: while the eye flies, slices are sampled in turn, half of them a frame.
    pub fn new(is_live: bool) -> Self {
        Self { slices: SliceViews::new(is_live), ..Self::default() }
    }

    /// Forgets the slices and their zoom, for another volume.
    pub fn reset(&mut self) {
        self.slices = SliceViews::new(self.slices.in_turn);
        (self.panel.lumen, self.click) = (None, None);
    }

    /// Forgets what is of one lumen; a range that was typed stays, to be tried again.
    pub fn reset_lumen(&mut self) {
        self.click = None;
    }
}

/// Sizes of the drawn panes, pixels: columns and rows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct PaneSizes {
    /// The inside view, where it is shown.
    pub inside: Option<[u32; 2]>,
    /// The overview.
    pub overview: Option<[u32; 2]>,
}

/// Lays the window out.
///
/// * `status`: what is at work.
pub fn window(
    ui: &mut Ui,
    model: &Model,
    state: &mut UiState,
    status: Option<&WorkStatus>,
    commands: &mut ActionQueue,
) -> PaneSizes {
    keys(ui, model, state.is_escape_taken, commands);
    let shortcut = |key| {
        let keys = egui::KeyboardShortcut::new(egui::Modifiers::COMMAND, key);
        ui.input_mut(|i| i.consume_shortcut(&keys))
    };
    if shortcut(egui::Key::O) {
        state.dialogs.open.pick_file();
    }
    state.panel.saves_session |= shortcut(egui::Key::S) && model.products.identity.is_some();
    opened(ui, &mut state.dialogs, commands);
    egui::Panel::top("top").show(ui, |ui| top_bar(ui, model, state, status, commands));
    egui::Panel::bottom("timeline")
        .exact_size(timeline_height(ui))
        .show(ui, |ui| timeline(ui, model, commands));
    if !model.hides_panel {
        egui::Panel::right("notes")
            .default_size(PANEL)
            .size_range(PANEL..=2.0 * PANEL)
            .show(ui, |ui| side_panel(ui, model, &mut state.panel, commands));
    }
    if std::mem::take(&mut state.panel.saves_session) {
        state.dialogs.save.save_file();
    }
    let mut sizes = PaneSizes::default();
    let mut of_panes = ActionQueue::default();
    let is_computing = status.is_some_and(|s| s.is_computing);
    egui::CentralPanel::no_frame().show(ui, |ui| {
        let shown = places(ui.max_rect(), model.layout, model.large_slice, model.maximised);
        if let Some(rect) = shown.transport {
            row(ui, rect, |ui| transport(ui, model, commands));
        }
        if model.hides_panel {
            // The panel has it otherwise: pictures of the window bear it in any case.
            let at = ui.max_rect().center_top() + vec2(0.0, 4.0);
            let (font, top) = (FontId::proportional(10.0), egui::Order::Foreground);
            let layer = egui::LayerId::new(top, egui::Id::new("notice"));
            ui.ctx().layer_painter(layer).text(at, Align2::CENTER_TOP, NOTICE, font, FAINT);
        }
        if let Some(rect) = shown.presets {
            row(ui, rect, |ui| slice_row(ui, model, commands));
        }
        for (pane, rect) in shown.panes {
            let rect = on_pixels(ui, rect);
            let size = pixels(ui, rect);
            match pane {
                Pane::Inside => sizes.inside = Some(size),
                Pane::Overview => sizes.overview = Some(size),
                _ => {}
            }
            show_pane(ui, pane, rect, model, &mut state.slices, is_computing, &mut of_panes);
        }
    });
    delay_clicks(ui, &mut state.click, &mut of_panes);
    commands.actions.append(&mut of_panes.actions);
    commands.requests.append(&mut of_panes.requests);
    ask_to_save(ui, model, &mut state.dialogs, commands);
    if model.help {
        help(ui, commands);
    }
    state.is_escape_taken = ui.ctx().egui_wants_keyboard_input()
        || egui::Popup::is_any_open(ui.ctx())
        || state.dialogs.is_any_open()
        || model.leaving.is_some();
    sizes
}

/// Width of the panel on the right, points; it can be drawn to twice as much.
const PANEL: f32 = 250.0;

/// Lays out controls in a row of the window.
fn row(ui: &mut Ui, rect: Rect, controls: impl FnOnce(&mut Ui)) {
    let inner = egui::UiBuilder::new().max_rect(rect.shrink2(vec2(4.0, 2.0)));
    ui.scope_builder(inner, |ui| {
        ui.set_clip_rect(rect);
        ui.horizontal_wrapped(controls);
    });
}

/// Height of the scrub bar: less of a low window.
fn timeline_height(ui: &Ui) -> f32 {
    (0.15 * ui.available_height()).clamp(48.0, 92.0).round()
}

/// Holds what a click leads to back until it is known not to be the first of a double click.
fn delay_clicks(ui: &Ui, click: &mut Option<(f64, Command)>, commands: &mut ActionQueue) {
    let delay = ui.ctx().options(|o| o.input_options.max_double_click_delay);
    let now = ui.input(|i| i.time);
    let shows = |a: &mut Action| matches!(a, Action::ShowInSlices(_));
    if let Some(action) = commands.actions.extract_if(.., shows).last() {
        *click = Some((now, Command::Action(action)));
    }
    let flies = |r: &mut Request| matches!(r, Request::FlyThrough(_));
    if let Some(request) = commands.requests.extract_if(.., flies).last() {
        *click = Some((now, Command::Request(request)));
    }
    let is_double = |a: &Action| matches!(a, Action::Maximise(_) | Action::LargeSlice(_));
    if commands.actions.iter().any(is_double) {
        *click = None;
    }
    match click.take_if(|(at, _)| now - *at >= delay) {
        Some((_, Command::Action(action))) => commands.act(action),
        Some((_, Command::Request(request))) => commands.ask(request),
        None => {
            if let Some((at, _)) = click {
                let left = std::time::Duration::from_secs_f64(*at + delay - now);
                ui.ctx().request_repaint_after(left);
            }
        }
    }
}

/// The rectangle on whole pixels, so that pictures are shown one to one.
fn on_pixels(ui: &Ui, rect: Rect) -> Rect {
    let scale = ui.pixels_per_point();
    let round = |p: Pos2| pos2((p.x * scale).round() / scale, (p.y * scale).round() / scale);
    Rect::from_min_max(round(rect.min), round(rect.max))
}

/// Whether nothing is open, and nothing on its way.
fn is_empty(model: &Model, is_computing: bool) -> bool {
    model.volume().is_none() && model.failure.is_none() && model.question.is_none() && !is_computing
}

/// One pane with what lies over it. `stage`: something is being computed.
fn show_pane(
    ui: &mut Ui,
    pane: Pane,
    rect: Rect,
    model: &Model,
    slices: &mut SliceViews,
    stage: bool,
    commands: &mut ActionQueue,
) {
    let response = ui.allocate_rect(rect, Sense::click_and_drag());
    response.widget_info(|| egui::WidgetInfo::labeled(egui::WidgetType::Image, true, pane.title()));
    let all = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
    let painter = ui.painter_at(rect);
    painter.rect_filled(rect, 0.0, Color32::from_rgb(12, 12, 14));
    match pane {
        Pane::Inside if model.pose.is_some() && model.products.wall.is_some() => {
            painter.image(INSIDE, rect, all, Color32::WHITE);
            inside_marks(&painter, rect, model);
            let pointer = response.hover_pos();
            pointer.into_iter().for_each(|at| value_behind(&painter, rect, model, at));
            inside_input(ui, &response, rect, model, &mut slices.grabbed_inside, commands);
        }
        Pane::Overview if model.pose.is_some() && model.products.wall.is_some() => {
            painter.image(OVERVIEW, rect, all, Color32::WHITE);
            if let Some(camera) = OverviewCamera::of(rect, model) {
                overview_input(ui, &response, &camera, model, commands);
                missed_mark(&painter, model, false, |place| camera.in_pane(place));
                measurements(&painter, model, |place| camera.in_pane(place));
                orientation_marker(&painter, rect, camera.rotation());
                zoom_mark(&painter, rect, model);
            }
        }
        Pane::Inside if model.asks_for_lumen() => lumen_question(ui, rect, model, commands),
        Pane::Inside if is_empty(model, stage) => first_page(ui, rect, model, commands),
        Pane::Inside | Pane::Overview => {
            let question = model.question.unwrap_or_default();
            let (text, colour) = match (&model.failure, stage) {
                _ if pane == Pane::Overview => (String::new(), FAINT),
                (Some(failure), _) => (format!("{failure}\n\n{}", what_next(model)), WRONG),
                (None, _) if model.question.is_some() => (question.into(), TEXT),
                (None, true) => ("the wall is being made".into(), FAINT),
                (None, false) => (String::new(), FAINT),
            };
            let font = FontId::proportional(14.0);
            let text = painter.layout(text, font, colour, (rect.width() - 16.0).max(80.0));
            painter.galley(rect.center() - 0.5 * text.size(), text, colour);
        }
        _ => show_slice(ui, pane, rect, &response, model, slices, commands),
    }
    if matches!(pane, Pane::Inside | Pane::Overview) || model.volume().is_none() {
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
        let notches = wheel_notches(ui);
        if notches != 0.0 {
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

/// The patient's axes as the eye sees them.
fn orientation_marker(painter: &egui::Painter, rect: Rect, rotation: glam::DQuat) {
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

#[cfg(test)]
mod tests {
    use super::super::model::{Bookmark, flown_model};
    use super::super::panel_tests::TestScreen;
    use super::super::slice_pane::tests::{button, model_of_a_volume};
    use super::*;
    use crate::volume::phantom::Kind;

    /// Commands within a second of clicks in the middle of the axial slice, at these frames.
    fn after_clicks(at: &[usize]) -> ActionQueue {
        let (mut model, _session) = flown_model(Kind::Bend, |_| {});
        model.maximised = Some(Pane::Axial);
        let (context, mut state) = (egui::Context::default(), UiState::default());
        let place = pos2(250.0, 250.0);
        let mut all = ActionQueue::default();
        for i in 0..30 {
            let is_click = at.contains(&i);
            let mut events = vec![egui::Event::PointerMoved(place)];
            events.extend(
                is_click.then(|| [button(place, true), button(place, false)]).into_iter().flatten(),
            );
            let screen = Rect::from_min_size(Pos2::ZERO, vec2(800.0, 600.0));
            let time = Some(i as f64 / 30.0);
            let input =
                egui::RawInput { screen_rect: Some(screen), time, events, ..Default::default() };
            let mut output = context.run_ui(input, |ui| {
                window(ui, &model, &mut state, None, &mut all);
            });
            output.textures_delta.clear();
        }
        all
    }

    #[test]
    fn a_double_click_maximises_a_pane_and_flies_nowhere() {
        let double = after_clicks(&[2, 6]);
        assert_eq!(
            (&double.actions[..], &double.requests[..]),
            (&[Action::Maximise(None)][..], &[][..])
        );
        let flies = |clicks: &[usize]| {
            let done = after_clicks(clicks);
            assert!(done.actions.is_empty(), "{done:?}");
            matches!(done.requests[..], [Request::FlyThrough(_)])
        };
        assert!(flies(&[2]));
        assert!(flies(&[2, 22]), "the second flies later");
    }

    #[test]
    fn escape_leaves_an_open_text_field_before_a_maximised_pane() {
        let mut model = model_of_a_volume();
        model.maximised = Some(Pane::Axial);
        let mut state = UiState::default();
        let mut screen = TestScreen::sized(vec2(1280.0, 1200.0));
        let mut frame = |events| {
            let mut commands = ActionQueue::default();
            let texts = screen.frame(events, |ui| {
                window(ui, &model, &mut state, None, &mut commands);
            });
            (texts, commands.actions)
        };
        let escape = || egui::Event::Key {
            key: egui::Key::Escape,
            physical_key: None,
            pressed: true,
            repeat: false,
            modifiers: egui::Modifiers::NONE,
        };
        frame(Vec::new());
        let (texts, _) = frame(Vec::new());
        let note = texts.iter().find(|(t, _)| t == "name").expect("a field for a name").1.center();
        frame(vec![egui::Event::PointerMoved(note)]);
        frame(vec![button(note, true)]);
        frame(vec![button(note, false)]);
        frame(Vec::new());
        assert_eq!(frame(vec![escape()]).1, [], "it leaves the text field");
        frame(Vec::new());
        assert_eq!(frame(vec![escape()]).1, [Action::Maximise(None)], "then the pane");
        // A menu closes by itself too.
        let open = texts.iter().find(|(t, _)| t == "1 Open").unwrap().1.center();
        frame(vec![egui::Event::PointerMoved(open)]);
        frame(vec![button(open, true)]);
        frame(vec![button(open, false)]);
        assert!(frame(Vec::new()).0.iter().any(|(t, _)| t == "Folder"), "the menu is open");
        assert_eq!(frame(vec![escape()]).1, [], "it closes the menu");
    }

    #[test]
    fn the_speed_has_the_same_decimals_at_every_scale() {
        for scale in [1.0, 1.5, 2.0] {
            let shown = texts(vec2(1280.0, 800.0), scale, None);
            assert!(shown.iter().any(|(t, _)| t == "20.0"), "{scale}: {shown:?}");
            assert!(shown.iter().any(|(t, _)| t == "90"), "{scale}: {shown:?}");
        }
    }

    /// Texts of the window at a size, with their places, after turning the wheel over a point.
    fn texts(size: Vec2, scale: f32, wheel: Option<Pos2>) -> Vec<(String, Rect)> {
        let mut model = model_of_a_volume();
        model.message = Some("wrote 1800 frames to a folder with a long name".repeat(4));
        let json = r#"{"text": "note", "position_mm": [0, 0, 0], "rotation": [0, 0, 0, 1],
            "fov_deg": 90}"#;
        let note: Bookmark = serde_json::from_str(json).unwrap();
        model.bookmarks = vec![note; 20];
        model.bookmarks[19].text = "last".into();
        let (context, mut state) = (egui::Context::default(), UiState::default());
        let mut found = Vec::new();
        for i in 0..40 {
            let screen = Rect::from_min_size(Pos2::ZERO, size);
            let mut input = egui::RawInput { screen_rect: Some(screen), ..Default::default() };
            input.time = Some(f64::from(i) / 30.0);
            let viewport = input.viewports.entry(egui::ViewportId::ROOT).or_default();
            viewport.native_pixels_per_point = Some(scale);
            if let Some(place) = wheel.filter(|_| i < 10) {
                input.events.push(egui::Event::PointerMoved(place));
                input.events.push(egui::Event::MouseWheel {
                    unit: egui::MouseWheelUnit::Line,
                    delta: vec2(0.0, -5.0),
                    phase: egui::TouchPhase::Move,
                    modifiers: egui::Modifiers::NONE,
                });
            }
            let mut output = context.run_ui(input, |ui| {
                window(ui, &model, &mut state, None, &mut ActionQueue::default());
            });
            output.textures_delta.clear();
            found = output.shapes.iter().flat_map(|s| text_of(&s.shape, s.clip_rect)).collect();
        }
        found
    }

    /// A text with the part of its place that is seen.
    fn text_of(shape: &egui::Shape, clip: Rect) -> Vec<(String, Rect)> {
        match shape {
            egui::Shape::Vec(all) => all.iter().flat_map(|s| text_of(s, clip)).collect(),
            egui::Shape::Text(t) => {
                let seen = t.visual_bounding_rect().intersect(clip);
                let is_seen = seen.is_positive();
                is_seen
                    .then(|| (t.galley.text().to_owned(), t.visual_bounding_rect()))
                    .into_iter()
                    .collect()
            }
            _ => Vec::new(),
        }
    }

    #[test]
    fn no_control_falls_off_a_small_window_and_its_panel_can_be_scrolled() {
        for (size, scale) in
            [(vec2(640.0, 480.0), 1.0), (vec2(640.0, 400.0), 2.0), (vec2(480.0, 360.0), 1.0)]
        {
            let shown = texts(size, scale, None);
            for name in ["1 Open", "Play", "Back to path", "4 Review", "Keys"] {
                let (_, place) = shown.iter().find(|(t, _)| t == name).expect(name);
                assert!(place.max.x <= size.x, "{name} at {place:?} of {size}");
            }
            let over_panel = pos2(size.x - 120.0, 0.5 * size.y);
            let last =
                |texts: Vec<(String, Rect)>| texts.iter().any(|(t, _)| t.starts_with("20: last"));
            assert!(!last(shown), "{size} has room for all of the panel");
            assert!(last(texts(size, scale, Some(over_panel))), "{size} cannot be scrolled");
        }
    }
}
