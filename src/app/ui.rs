//! Panels and panes. One function a part; each takes the model as it is and returns actions.

use super::action::{Action, ActionQueue, Command, Pane, Request};
use super::computation::WorkStatus;
use super::dialogs::{Dialogs, ask_to_save, open_request, opened};
use super::grey_window::slice_row;
use super::keys::{help, keys, pair_keys};
use super::layout::{Half, Places, halves, places};
use super::model::Model;
use super::pane_view::show_pane;
use super::side_panel::{PanelState, side_panel};
use super::slice_pane::SliceViews;
use super::style::{FAINT, pixels};
use super::timeline::timeline;
use super::top_bar::{pair_controls, top_bar, transport};
use crate::formats::NOTICE;
use egui::{Align2, FontId, Pos2, Rect, Ui, pos2, vec2};

/// Texture of a drawn pane: of each case the inside view, then the overview.
fn texture(case: usize, pane: Pane) -> egui::TextureId {
    egui::TextureId::User(2 * case as u64 + u64::from(pane == Pane::Overview))
}

/// State that the panels keep from frame to frame beside the model.
#[derive(Default)]
pub struct UiState {
    pub(super) slices: SliceViews,
    pub(super) panel: PanelState,
    /// When a pane was clicked, s, and what that leads to.
    click: Option<(f64, Command)>,
    pub(super) dialogs: Dialogs,
    /// Whether another case is shown beside this one.
    pub(super) is_pair: bool,
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
    /// Pixels a point; 0 where nothing is laid out yet.
    pub scale: f32,
}

/// A case as the window shows it.
pub struct CaseUi<'a> {
    pub model: &'a Model,
    pub state: &'a mut UiState,
    /// Work in progress.
    pub status: Option<WorkStatus>,
    /// Name of its file or folder.
    pub name: String,
    /// Commands of keys, panels and panes.
    pub commands: ActionQueue,
    /// Sizes that its drawn panes have now.
    pub sizes: PaneSizes,
}

/// Two cases beside each other, or one alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct PairState {
    /// The case that keys and panels are of.
    pub active: usize,
    /// Whether both eyes move together.
    pub is_linked: bool,
}

/// Lays the window out: panels of the active case about the panes of each.
pub fn window(ui: &mut Ui, cases: &mut [CaseUi<'_>], pair: PairState) {
    let is_pair = cases.len() > 1;
    cases.iter_mut().for_each(|case| case.state.is_pair = is_pair);
    open_dropped(ui, cases, pair);
    let CaseUi { model, state, status, commands, .. } = &mut cases[pair.active];
    keys(ui, model, state.is_escape_taken, commands);
    if is_pair && !state.dialogs.is_any_open() {
        pair_keys(ui, model, pair, commands);
    }
    let shortcut = |key| {
        let keys = egui::KeyboardShortcut::new(egui::Modifiers::COMMAND, key);
        ui.input_mut(|i| i.consume_shortcut(&keys))
    };
    if shortcut(egui::Key::O) {
        state.dialogs.is_beside = false;
        state.dialogs.open.pick_file();
    }
    state.panel.saves_session |= shortcut(egui::Key::S) && model.products.identity.is_some();
    opened(ui, &mut state.dialogs, commands);
    // Fields of one case are not those of the other.
    egui::Panel::top("top").show(ui, |ui| {
        ui.push_id(pair.active, |ui| top_bar(ui, model, state, status.as_ref(), commands))
    });
    if !is_pair {
        egui::Panel::bottom("timeline")
            .exact_size(timeline_height(ui))
            .show(ui, |ui| timeline(ui, model, commands));
    }
    if !model.hides_panel {
        egui::Panel::right("notes")
            .default_size(PANEL)
            .size_range(PANEL..=2.0 * PANEL)
            .show(ui, |ui| {
                ui.push_id(pair.active, |ui| side_panel(ui, model, &mut state.panel, commands))
            });
    }
    if std::mem::take(&mut state.panel.saves_session) {
        state.dialogs.save.save_file();
    }
    let hides_panel = model.hides_panel;
    egui::CentralPanel::no_frame().show(ui, |ui| {
        let mut whole = ui.max_rect();
        if hides_panel {
            // The panel has it otherwise: pictures of the window bear it in any case.
            let font = FontId::proportional(10.0);
            ui.painter().text(whole.center_bottom(), Align2::CENTER_BOTTOM, NOTICE, font, FAINT);
            whole.max.y -= NOTICE_ROW;
        }
        if is_pair {
            for (i, half) in halves(whole).into_iter().enumerate() {
                ui.push_id(i, |ui| half_of_pair(ui, half, cases, i, pair));
            }
        } else {
            let model = cases[0].model;
            let places = places(whole, model.layout, model.large_slice, model.maximised);
            show_places(ui, &places, &mut cases[0], 0);
        }
    });
    // Of all cases the active one first: one question at a time.
    let leaving = (0..cases.len()).filter(|i| cases[*i].model.leaving.is_some());
    if let Some(i) = leaving.min_by_key(|i| *i != pair.active) {
        let CaseUi { model, state, commands, .. } = &mut cases[i];
        ask_to_save(ui, model, &mut state.dialogs, commands);
    }
    let CaseUi { model, state, commands, .. } = &mut cases[pair.active];
    if model.help {
        help(ui, commands);
    }
    state.is_escape_taken = ui.ctx().egui_wants_keyboard_input()
        || egui::Popup::is_any_open(ui.ctx())
        || state.dialogs.is_any_open()
        || model.leaving.is_some();
}

/// Opens a file that was dropped, in the place of the case that it was dropped on.
fn open_dropped(ui: &Ui, cases: &mut [CaseUi<'_>], pair: PairState) {
    let (dropped, at) = ui.input(|i| {
        let file = i.raw.dropped_files.first().map(|file| file.path().to_owned());
        (file, i.pointer.latest_pos())
    });
    let is_in = |half: &Half| at.is_some_and(|at| half.whole.contains(at));
    let on = halves(ui.max_rect()).iter().position(is_in).filter(|_| cases.len() > 1);
    if let Some(path) = dropped {
        cases[on.unwrap_or(pair.active)].commands.ask(open_request(path));
    }
}

/// A name that leaves room beside it.
fn shortened(name: &str) -> String {
    const MAX_CHARS: usize = 24;
    match name.chars().count() > MAX_CHARS {
        true => name.chars().take(MAX_CHARS - 1).chain(['…']).collect(),
        false => name.to_owned(),
    }
}

/// One of two cases: its name, its panes and its scrub bar.
fn half_of_pair(ui: &mut Ui, half: Half, cases: &mut [CaseUi<'_>], i: usize, pair: PairState) {
    let is_active = i == pair.active;
    let name = shortened(&cases[i].name);
    row(ui, half.controls, |ui| {
        let commands = &mut cases[i].commands;
        if ui.selectable_label(is_active, name).on_hover_text("Keys and panels (F6)").clicked() {
            commands.ask(Request::Activate(i));
        }
        if is_active {
            pair_controls(ui, pair, commands);
        }
    });
    let places = half.places(cases[i].model.large_slice, cases[i].model.maximised);
    show_places(ui, &places, &mut cases[i], i);
    ui.scope_builder(egui::UiBuilder::new().max_rect(half.scrub), |ui| {
        timeline(ui, cases[i].model, &mut cases[i].commands);
    });
    // Whoever presses a button over a case works on it.
    let pressed = ui.input(|i| i.pointer.press_origin().filter(|_| i.pointer.any_pressed()));
    // Not through a dialog that lies over it.
    let is_here =
        |at: &Pos2| half.whole.contains(*at) && ui.ctx().layer_id_at(*at) == Some(ui.layer_id());
    if pressed.filter(is_here).is_some() && !is_active {
        cases[i].commands.ask(Request::Activate(i));
    }
}

/// The panes of a case, with what moves them.
fn show_places(ui: &mut Ui, places: &Places, case: &mut CaseUi<'_>, number: usize) {
    let CaseUi { model, state, status, commands, sizes, .. } = case;
    if let Some(rect) = places.transport {
        row(ui, rect, |ui| transport(ui, model, commands));
    }
    if let Some(rect) = places.presets {
        row(ui, rect, |ui| slice_row(ui, model, state.is_pair, commands));
    }
    let is_computing = status.as_ref().is_some_and(|s| s.is_computing);
    let mut of_panes = ActionQueue::default();
    sizes.scale = ui.pixels_per_point();
    for (pane, rect) in &places.panes {
        let rect = on_pixels(ui, *rect);
        let size = pixels(ui, rect);
        match pane {
            Pane::Inside => sizes.inside = Some(size),
            Pane::Overview => sizes.overview = Some(size),
            _ => {}
        }
        let pane = (*pane, texture(number, *pane));
        show_pane(ui, pane, rect, model, state, is_computing, &mut of_panes);
    }
    delay_clicks(ui, &mut state.click, &mut of_panes);
    commands.actions.append(&mut of_panes.actions);
    commands.requests.append(&mut of_panes.requests);
}

/// Width of the panel on the right, points; it can be drawn to twice as much.
const PANEL: f32 = 250.0;
/// Height of the notice below the panes where that panel is hidden, points.
const NOTICE_ROW: f32 = 14.0;

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

#[cfg(test)]
mod tests {
    use egui::Vec2;

    use super::super::model::{Bookmark, flown_model};
    use super::super::panel_tests::TestScreen;
    use super::super::slice_pane::tests::{button, model_of_a_volume};
    use super::*;
    use crate::volume::phantom::Kind;

    /// The window with one case; its commands are added.
    fn one_case(ui: &mut Ui, model: &Model, state: &mut UiState, commands: &mut ActionQueue) {
        let (status, sizes) = (None, PaneSizes::default());
        let (name, own) = (String::new(), std::mem::take(commands));
        let mut cases = [CaseUi { model, state, status, name, commands: own, sizes }];
        window(ui, &mut cases, PairState::default());
        let [case] = cases;
        *commands = case.commands;
    }

    /// A try that failed could not be corrected, only begun anew.
    #[test]
    fn the_range_that_was_typed_stays_for_another_lumen_and_goes_with_its_volume() {
        let mut state = UiState::default();
        let typed = Some(([100.0, 180.0], true));
        state.panel.lumen = typed;
        state.reset_lumen();
        assert_eq!(state.panel.lumen, typed);
        state.reset();
        assert_eq!(state.panel.lumen, None);
    }

    /// Keys went to the case that was active before: B at a polyp noted it in the other position.
    #[test]
    fn a_press_over_the_other_case_gives_it_keys_and_panels() {
        let models = [model_of_a_volume(), model_of_a_volume()];
        let mut states = [UiState::default(), UiState::default()];
        let mut screen = TestScreen::sized(vec2(1280.0, 800.0));
        let mut frame = |events: Vec<egui::Event>| {
            let mut asked = Vec::new();
            screen.frame(events, |ui| {
                let [first, second] = &mut states;
                let case = |(model, state)| CaseUi {
                    model,
                    state,
                    status: None,
                    name: "case".into(),
                    commands: ActionQueue::default(),
                    sizes: PaneSizes::default(),
                };
                let mut cases = [(&models[0], first), (&models[1], second)].map(case);
                window(ui, &mut cases, PairState::default());
                asked = cases.map(|case| case.commands.requests).to_vec();
            });
            asked
        };
        frame(Vec::new());
        // The slice and the scrub bar of the second case, and those of the first.
        for (at, wanted) in [
            (pos2(760.0, 560.0), Some(Request::Activate(1))),
            (pos2(760.0, 770.0), Some(Request::Activate(1))),
            (pos2(260.0, 560.0), None),
        ] {
            frame(vec![egui::Event::PointerMoved(at)]);
            let asked = frame(vec![button(at, true)]);
            assert_eq!((&asked[0][..], asked[1].first()), (&[][..], wanted.as_ref()), "{at}");
            frame(vec![button(at, false)]);
        }
    }

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
                one_case(ui, &model, &mut state, &mut all);
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
                one_case(ui, &model, &mut state, &mut commands);
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
                one_case(ui, &model, &mut state, &mut ActionQueue::default());
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
