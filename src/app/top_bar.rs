//! Controls above the panes and under the inside view: the steps of a reading, the layouts, the flight,
//! and the work in progress.

use egui::Ui;

use super::action::{Action, ActionQueue, FOV_DEG, PaneLayout, Request, SPEED_MM_S};
use super::computation::WorkStatus;
use super::dialogs::{Dialogs, FILES, open_request};
use super::model::Model;
use super::side_panel::Tab;
use super::style::{FAINT, NO_PATH, NO_SCAN, WRONG};
use super::ui::{PairState, UiState};

/// Lays out the steps of a reading, the layouts, and the work in progress.
pub(super) fn top_bar(
    ui: &mut Ui,
    model: &Model,
    state: &mut UiState,
    status: Option<&WorkStatus>,
    commands: &mut ActionQueue,
) {
    // Too narrow for one line: buttons wrap, and the state has a line of its own.
    if ui.available_width() < ONE_LINE {
        ui.horizontal_wrapped(|ui| controls(ui, model, state, commands));
        ui.horizontal(|ui| what_is_at_work(ui, model, status, commands));
    } else {
        ui.horizontal(|ui| {
            controls(ui, model, state, commands);
            ui.separator();
            what_is_at_work(ui, model, status, commands);
        });
    }
}

/// Width of a window whose controls and state fit into one line.
const ONE_LINE: f32 = 1000.0;

fn controls(ui: &mut Ui, model: &Model, state: &mut UiState, commands: &mut ActionQueue) {
    // A click into the field for a path does not close it.
    let stays = egui::containers::menu::MenuConfig::new()
        .close_behavior(egui::PopupCloseBehavior::CloseOnClickOutside);
    egui::containers::menu::MenuButton::new("1 Open")
        .config(stays)
        .ui(ui, |ui| open_menu(ui, model, state, commands));
    for ReadingStep { name, tab, missing } in steps(model) {
        let is_here = missing.is_none() && state.panel.tab == tab;
        let button = ui.add_enabled(missing.is_none(), egui::Button::selectable(is_here, name));
        if button.on_disabled_hover_text(missing.unwrap_or_default()).clicked() {
            state.panel.tab = tab;
        }
    }
    ui.separator();
    // Two cases have one layout.
    for (layout, name) in PaneLayout::ALL.into_iter().filter(|_| !state.is_pair) {
        if ui.selectable_label(model.layout == layout, name).clicked() {
            commands.act(Action::Layout(layout));
        }
    }
    let panel = egui::Button::selectable(!model.hides_panel, "panel");
    if ui.add(panel).on_hover_text("The panel on the right (F4)").clicked() {
        commands.act(Action::TogglePanel);
    }
    if ui.button("Keys").on_hover_text("F1").clicked() {
        commands.act(Action::ToggleHelp);
    }
}

/// Ways to open a scan or a session: a path, a dialog, a case from before.
fn open_menu(ui: &mut Ui, model: &Model, state: &mut UiState, commands: &mut ActionQueue) {
    let dialogs = &mut state.dialogs;
    let typed = egui::TextEdit::singleline(&mut dialogs.typed).hint_text("path, then Enter");
    let field = ui.add(typed.desired_width(220.0)).on_hover_text("Of a file or a folder");
    if field.lost_focus() && ui.input(|i| i.key_pressed(egui::Key::Enter)) {
        let path = std::mem::take(&mut dialogs.typed);
        if !path.trim().is_empty() {
            commands.ask(open_request(path.trim().into()));
            ui.close();
        }
    }
    dialog_buttons(ui, dialogs, false);
    for case in &model.recent {
        if ui.button(&case.name).on_hover_text("Opened before").clicked() {
            commands.ask(Request::OpenKept(case.file.clone()));
            ui.close();
        }
    }
    ui.separator();
    let has_case = model.volume().is_some();
    let beside = ui.add_enabled_ui(has_case, |ui| open_beside(ui, model, dialogs, commands));
    beside.response.on_disabled_hover_text(NO_SCAN);
}

/// Buttons that open the dialog for a file or a folder.
fn dialog_buttons(ui: &mut Ui, dialogs: &mut Dialogs, is_beside: bool) {
    for (name, tip, is_folder) in [("File", FILES, false), ("Folder", "A DICOM series", true)] {
        if ui.button(name).on_hover_text(tip).clicked() {
            dialogs.is_beside = is_beside;
            match is_folder {
                true => dialogs.open.pick_directory(),
                false => dialogs.open.pick_file(),
            }
            ui.close();
        }
    }
}

/// Ways to open a second case beside the first: the other position of the patient, or another date.
fn open_beside(ui: &mut Ui, model: &Model, dialogs: &mut Dialogs, commands: &mut ActionQueue) {
    ui.menu_button("Beside this one", |ui| {
        dialog_buttons(ui, dialogs, true);
        for case in &model.recent {
            if ui.button(&case.name).on_hover_text("Opened before").clicked() {
                let opens = Request::OpenKept(case.file.clone());
                commands.ask(Request::Beside(Box::new(opens)));
                ui.close();
            }
        }
    });
}

/// Controls of two cases beside each other.
pub(super) fn pair_controls(ui: &mut Ui, pair: PairState, commands: &mut ActionQueue) {
    let find = ui.button("find there");
    if find
        .on_hover_text("Finds this place in the other case, by the share of its path (F)")
        .clicked()
    {
        commands.ask(Request::FindInOther);
    }
    let tip = "Both eyes move together along their paths (L)";
    if ui.selectable_label(pair.is_linked, "linked").on_hover_text(tip).clicked() {
        commands.ask(Request::Link(!pair.is_linked));
    }
    if ui.small_button("close").on_hover_text("Closes this case; the other stays").clicked() {
        commands.ask(Request::CloseCase);
    }
}

/// A step of a reading, and why it cannot be done yet.
struct ReadingStep {
    name: &'static str,
    tab: Tab,
    missing: Option<&'static str>,
}

/// The steps of a reading after the scan is open, each with the tab that serves it.
fn steps(model: &Model) -> [ReadingStep; 4] {
    let no_scan = model.volume().is_none().then_some(NO_SCAN);
    let no_path = model.path.is_none().then_some(NO_PATH);
    let no_coverage = model.coverage.is_none();
    let no_coverage = no_coverage.then_some("The coverage of the flight is not computed yet.");
    [
        ReadingStep { name: "2 Organ", tab: Tab::Lumen, missing: no_scan },
        ReadingStep { name: "3 Fly", tab: Tab::Branches, missing: no_scan.or(no_path) },
        ReadingStep {
            name: "4 Review",
            tab: Tab::Missed,
            missing: no_scan.or(no_path).or(no_coverage),
        },
        ReadingStep { name: "5 Report", tab: Tab::Findings, missing: no_scan },
    ]
}

/// Controls of the flight, under the picture that they move.
pub(super) fn transport(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let ready = model.path.is_some();
    let why_not = if ready { "The eye is on the path." } else { NO_PATH };
    let mut button = |ui: &mut Ui, text: &str, can: bool, tip: &str, action: Action| {
        let button = ui.add_enabled(can, egui::Button::new(text));
        if button.on_hover_text(tip).on_disabled_hover_text(why_not).clicked() {
            commands.act(action);
        }
    };
    button(ui, "⏮", ready, "To the start (Home)", Action::Seek(0.0));
    let play = if model.playing { "Pause" } else { "Play" };
    button(ui, play, ready, "Space", Action::TogglePlay);
    let way = if model.reverse { "Direction: back" } else { "Direction: forward" };
    button(ui, way, ready, "R", Action::Reverse);
    button(ui, "⏭", ready, "To the end (End)", Action::Seek(f64::MAX));
    button(ui, "Back to path", ready && !model.on_path, "0", Action::BackToPath);
    let mut speed = model.speed_mm_s;
    let slider = egui::DragValue::new(&mut speed).range(SPEED_MM_S).speed(0.5);
    // Else as many as a point of the screen has pixels for.
    let slider = slider.prefix("cruise ").suffix(" mm/s").fixed_decimals(1);
    let tip = "Cruising speed ([ ]); where it is narrow or winding the flight is slower";
    if ui.add(slider).on_hover_text(tip).changed() {
        commands.act(Action::Speed(speed));
    }
    let mut fov = model.fov_deg;
    let slider =
        egui::DragValue::new(&mut fov).range(FOV_DEG).suffix("°").speed(0.5).fixed_decimals(0);
    if ui.add(slider).on_hover_text("Vertical field of view").changed() {
        commands.act(Action::FieldOfView(fov));
    }
    if let Some(mm_s) = model.flown_mm_s() {
        ui.label(egui::RichText::new(format!("{mm_s:.1} mm/s")).color(FAINT));
    }
}

/// Lays out the work in progress, the failure, or the last message.
fn what_is_at_work(
    ui: &mut Ui,
    model: &Model,
    status: Option<&WorkStatus>,
    commands: &mut ActionQueue,
) {
    let message = model.question.or(model.message.as_deref()).unwrap_or_default();
    // A failure or a long name of a stage leaves room for the last message.
    let own_width = if message.is_empty() { 1.0 } else { 0.5 } * ui.available_width();
    match (status, &model.failure) {
        (Some(status), failure) if failure.is_none() || !status.is_computing => {
            ui.add(egui::ProgressBar::new(status.share).desired_width(90.0));
            if ui.small_button("Cancel").clicked() {
                commands.ask(Request::Cancel);
            }
            let text = egui::Label::new(&status.text).truncate();
            ui.scope(|ui| {
                ui.set_max_width(own_width);
                ui.add(text);
            });
        }
        (_, Some(failure)) => {
            // The inside pane has all of it.
            let line = failure.lines().next().unwrap_or_default();
            let text = egui::RichText::new(line).color(WRONG);
            ui.scope(|ui| {
                ui.set_max_width(own_width);
                ui.add(egui::Label::new(text).truncate()).on_hover_text(failure);
            });
        }
        (_, None) => {
            if model.is_stopped && ui.small_button("Go on").clicked() {
                commands.ask(Request::Resume);
            }
        }
    }
    ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
        ui.label(egui::RichText::new(model.notes_are).color(FAINT));
        ui.add(egui::Label::new(message).truncate()).on_hover_text(message);
    });
}

#[cfg(test)]
mod tests {
    use super::super::model::flown_model;
    use super::super::panel_tests::TestScreen;
    use super::super::slice_pane::tests::{button, model_of_a_volume};
    use super::*;
    use crate::volume::phantom::Kind;

    /// Buttons were grey for two minutes with no reason said.
    #[test]
    fn a_grey_step_says_why_where_the_pointer_rests() {
        let texts_over = |model: &Model, name: &str| {
            let mut state = UiState::default();
            TestScreen::sized(egui::vec2(1280.0, 700.0)).hover(name, |ui| {
                top_bar(ui, model, &mut state, None, &mut ActionQueue::default());
            })
        };
        let of_scan = model_of_a_volume();
        let (mut flown, _session) = flown_model(Kind::Tube, |_| {});
        flown.coverage = None;
        for (model, step, reason) in [
            (&Model::new(20.0), "2 Organ", NO_SCAN),
            (&Model::new(20.0), "4 Review", NO_SCAN),
            (&of_scan, "3 Fly", NO_PATH),
            (&of_scan, "4 Review", NO_PATH),
            (&flown, "4 Review", "The coverage of the flight is not computed yet."),
        ] {
            let texts = texts_over(model, step);
            assert!(texts.iter().any(|text| text == reason), "{step}: {texts:?}");
        }
        let texts = texts_over(&flown, "3 Fly");
        assert!(!texts.iter().any(|text| text == NO_PATH), "{texts:?}");
    }

    /// A typed folder led to an empty list of the folder above.
    #[test]
    fn a_typed_path_of_a_folder_is_opened() {
        let (model, mut state) = (Model::new(20.0), UiState::default());
        let mut screen = TestScreen::sized(egui::vec2(1280.0, 700.0));
        let mut frame = |events| {
            let mut commands = ActionQueue::default();
            let texts =
                screen.frame(events, |ui| top_bar(ui, &model, &mut state, None, &mut commands));
            (texts, commands.requests)
        };
        frame(Vec::new());
        let texts = frame(Vec::new()).0;
        let mut click = |text: &str, texts: &[(String, egui::Rect)]| {
            let at = texts.iter().find(|(t, _)| t == text).expect(text).1.center();
            frame(vec![egui::Event::PointerMoved(at)]);
            frame(vec![button(at, true)]);
            frame(vec![button(at, false)]);
            frame(Vec::new()).0
        };
        let texts = click("1 Open", &texts);
        let texts = click("path, then Enter", &texts);
        assert!(texts.iter().any(|(t, _)| t == "Folder"), "the menu stays open: {texts:?}");
        frame(vec![egui::Event::Text("scans/chest ".into())]);
        let enter = egui::Event::Key {
            key: egui::Key::Enter,
            physical_key: None,
            pressed: true,
            repeat: false,
            modifiers: egui::Modifiers::NONE,
        };
        assert_eq!(frame(vec![enter]).1, [Request::Open("scans/chest".into())]);
    }
}
