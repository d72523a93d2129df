//! Keys: single presses, those that move the eye as long as they are held, and their list.

use egui::{Align2, Key, Modifiers, Ui, Vec2};
use glam::DVec3;

use super::action::{Action, ActionQueue, Colouring, Export, Request, Ruler, WallView};
use super::branch_panel::branch_keys;
use super::model::Model;
use super::ui::PairState;

/// Keys, unless a text field has them.
///
/// * `is_escape_taken`: something was open that Escape closes by itself.
pub(super) fn keys(ui: &Ui, model: &Model, is_escape_taken: bool, commands: &mut ActionQueue) {
    // Behind a dialog nothing is moved, and nothing deleted.
    if ui.ctx().egui_wants_keyboard_input() || model.leaving.is_some() {
        return;
    }
    let pressed = |key| ui.input(|i| i.key_pressed(key) && !i.modifiers.command);
    // A key may be down and up again within one frame: what was held with it is its own.
    let with = |wanted: Key, fits: fn(&Modifiers) -> bool| {
        ui.input(|i| {
            i.events.iter().any(|e| match e {
                egui::Event::Key { key, pressed: true, repeat: false, modifiers, .. } => {
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
        (Key::Num0, Action::BackToPath),
        (Key::K, Action::Cine(!model.runs_cine())),
        (Key::Comma, Action::PreviousFinding),
        (Key::Period, Action::NextFinding),
        (Key::F1, Action::ToggleHelp),
        (Key::F4, Action::TogglePanel),
        (Key::Questionmark, Action::ToggleHelp),
    ] {
        if pressed(key) {
            commands.act(action);
        }
    }
    // In the middle of the keypad, unless a fifth branch has it.
    if !branch_keys(ui, model, commands) && pressed(Key::Num5) {
        commands.act(Action::BackToPath);
    }
    if pressed(Key::Enter)
        && !is_escape_taken
        && let Some(branch) = branch_in_view(model)
    {
        commands.ask(Request::Branch(branch));
    }
    let next_view = match model.view {
        WallView::Eye => WallView::Cube,
        WallView::Cube => WallView::Panorama,
        WallView::Panorama => WallView::Eye,
    };
    let next_colour = match model.colouring {
        Colouring::Tissue => Colouring::Missed,
        Colouring::Missed if model.products.centerline_distances.is_some() => Colouring::Radius,
        Colouring::Missed | Colouring::Radius if model.evidence().is_some() => Colouring::Evidence,
        Colouring::Missed | Colouring::Radius | Colouring::Evidence if model.may_look_behind() => {
            Colouring::Behind
        }
        _ => Colouring::Tissue,
    };
    let ruler = |wanted| Action::Measure((model.ruler != Some(wanted)).then_some(wanted));
    for (key, action) in [
        (Key::V, Action::View(next_view)),
        (Key::C, Action::Colour(next_colour)),
        (Key::M, ruler(Ruler::Length)),
        (Key::N, ruler(Ruler::Angle)),
    ] {
        if pressed(key) {
            commands.act(action);
        }
    }
    if let Some(i) = model.selected.filter(|_| pressed(Key::Delete) && !is_escape_taken) {
        commands.act(Action::RemoveBookmark(i));
    }
    if with(Key::E, |m| !m.shift && !m.command) {
        commands.ask(Request::Export(Export::View));
    }
    if with(Key::E, |m| m.shift && !m.command) {
        commands.ask(Request::Export(Export::Window));
    }
    for (fits, action) in [
        (Modifiers::is_none as fn(&Modifiers) -> bool, Action::NextMissed),
        (|m| m.shift && !m.command, Action::PreviousMissed),
    ] {
        if with(Key::U, fits) {
            commands.act(action);
        }
    }
    if with(Key::B, |m| !m.shift && !m.command) {
        commands.act(Action::Bookmark(String::new()));
    }
    if pressed(Key::Escape) && !is_escape_taken {
        commands.act(match (model.help, model.ruler, &model.missed) {
            (true, _, _) => Action::ToggleHelp,
            (false, Some(_), _) => Action::Measure(None),
            (false, None, Some(_)) => Action::HideMissed,
            (false, None, None) => Action::Maximise(None),
        });
    }
    if with(Key::Q, |m| m.command && !m.shift && !m.alt) {
        commands.ask(Request::Quit);
    }
    if with(Key::Z, |m| m.command && !m.shift) {
        commands.act(Action::Undo);
    }
    if with(Key::Z, |m| m.command && m.shift) || with(Key::Y, |m| m.command) {
        commands.act(Action::Redo);
    }
    held_keys(ui, commands);
}

/// Keys of two cases beside each other.
pub(super) fn pair_keys(ui: &Ui, model: &Model, pair: PairState, commands: &mut ActionQueue) {
    if ui.ctx().egui_wants_keyboard_input() || model.leaving.is_some() {
        return;
    }
    for (key, request) in [
        (Key::F6, Request::Activate(1 - pair.active)),
        (Key::F, Request::FindInOther),
        (Key::L, Request::Link(!pair.is_linked)),
    ] {
        if ui.input(|i| i.key_pressed(key) && !i.modifiers.command) {
            commands.ask(request);
        }
    }
}

/// Returns the branch that the eye looks at most nearly, of those that can be taken.
fn branch_in_view(model: &Model) -> Option<usize> {
    let pose = model.pose?;
    let forward = pose.forward().as_dvec3();
    let towards = |c: &super::junctions::BranchChoice| {
        (c.ahead_mm - pose.position_mm.as_dvec3()).normalize_or_zero().dot(forward)
    };
    let offered = model.offered();
    let most = offered.iter().max_by(|a, b| towards(a).total_cmp(&towards(b)))?;
    Some(most.branch)
}

/// Millimetres a second of hand-flown motion.
const HAND_MM_S: f64 = 25.0;

/// Radians a second of turns by keys.
const HAND_RAD_S: f32 = 0.8;

/// Keys that move as long as they are held.
fn held_keys(ui: &Ui, commands: &mut ActionQueue) {
    // Ctrl + S saves, and moves nobody back.
    if ui.input(|i| i.modifiers.command) {
        return;
    }
    let (dt, fast) = ui.input(|i| (f64::from(i.stable_dt).min(0.1), i.modifiers.shift));
    let by = HAND_MM_S * dt * if fast { 3.0 } else { 1.0 };
    // Down at the end of the frame, or pressed and let go within it.
    let down = |key| ui.input(|i| f64::from(u8::from(i.key_down(key) || i.key_pressed(key))));
    let along = down(Key::ArrowUp) - down(Key::ArrowDown);
    if along != 0.0 {
        commands.act(Action::Travel(along * by));
    }
    let right = down(Key::ArrowRight) - down(Key::ArrowLeft);
    if right != 0.0 {
        commands.act(Action::Turn([(right * dt) as f32 * HAND_RAD_S, 0.0, 0.0]));
    }
    let fly = DVec3::new(
        down(Key::D) - down(Key::A),
        down(Key::PageUp) - down(Key::PageDown),
        down(Key::W) - down(Key::S),
    );
    if fly != DVec3::ZERO {
        commands.act(Action::Fly((fly * by).to_array()));
    }
}

/// Whether a key is held that moves the eye.
pub fn moves(ctx: &egui::Context) -> bool {
    const MOVING: [Key; 10] = [
        Key::ArrowUp,
        Key::ArrowDown,
        Key::ArrowLeft,
        Key::ArrowRight,
        Key::W,
        Key::A,
        Key::S,
        Key::D,
        Key::PageUp,
        Key::PageDown,
    ];
    let is_down =
        |i: &egui::InputState| !i.modifiers.command && MOVING.iter().any(|k| i.key_down(*k));
    !ctx.egui_wants_keyboard_input() && ctx.input(is_down)
}

/// Height of the title, the frame and the margins of the list of keys, points.
const HELP_FRAME: f32 = 72.0;

/// The keys as a window over the panes.
pub(super) fn help(ui: &Ui, commands: &mut ActionQueue) {
    const KEYS: &[(&str, &str)] = &[
        ("Space", "play, pause"),
        ("R", "direction"),
        ("Up, Down, wheel", "along the path (Shift: three times as fast)"),
        ("Home, End", "ends of the path"),
        ("[ ]", "slower, faster"),
        ("Left, Right", "turn"),
        ("W S A D, Page Up, Page Down", "fly by hand; the wall is never passed"),
        ("drag", "look around; turn the overview"),
        ("Ctrl + drag", "roll"),
        ("right drag", "field of view; window of the slices"),
        ("Ctrl + wheel, pinch", "field of view; zoom of the slices"),
        ("0 or 5", "back to the path, level"),
        ("1 to 9, Enter, click on a number", "take a branch; Enter: the one looked at"),
        ("click on the wall", "show the place in the slices"),
        ("click in a slice, the overview", "fly there through the tree"),
        ("drag in a slice", "crosshair (Shift + move: without a button)"),
        ("middle drag, Shift + drag", "pan a slice, the overview"),
        ("wheel in the overview", "zoom"),
        ("V", "eye, cube, panorama"),
        ("C", "colour: tissue, not seen yet, radius, evidence"),
        ("M, N", "measure a length, an angle"),
        ("E, Shift + E", "save the inside view; the window as it is seen"),
        ("B", "add a finding of what the eye looks at"),
        (", .", "previous, next finding"),
        ("U, Shift + U", "next, previous missed patch"),
        ("double click", "a small slice large; one pane, all panes"),
        ("K", "run through the slices, to and fro"),
        ("Delete", "delete the selected finding"),
        ("Ctrl + O, Ctrl + S", "open; save the session"),
        ("Ctrl + Z, Ctrl + Shift + Z", "undo, redo: notes, measurements, grey window"),
        ("Escape", "close the dialog, text field, list of keys, ruler or single pane"),
        ("Ctrl + plus, minus, 0", "size of texts"),
        ("F4", "the panel on the right"),
        ("F6, F, L", "two cases: the other one, find there, move together"),
        ("F1 or ?", "these keys"),
        ("Ctrl + Q", "quit"),
    ];
    let mut open = true;
    egui::Window::new("Keys")
        .open(&mut open)
        .collapsible(false)
        .default_width(560.0)
        .resizable(false)
        .anchor(Align2::CENTER_CENTER, Vec2::ZERO)
        .show(ui, |ui| {
            // The list scrolls in a low window: its last keys were below the edge at 800x600.
            let height = (ui.ctx().content_rect().height() - HELP_FRAME).max(60.0);
            let list = egui::ScrollArea::vertical().max_height(height).min_scrolled_height(height);
            list.show(ui, |ui| {
                ui.horizontal(|ui| {
                    ui.label("Size of texts");
                    for (name, by) in [("smaller", 0.9), ("larger", 1.0 / 0.9)] {
                        if ui.button(name).clicked() {
                            let size = (ui.ctx().zoom_factor() * by).clamp(0.5, 3.0);
                            ui.ctx().set_zoom_factor(size);
                        }
                    }
                });
                egui::Grid::new("keys").num_columns(2).striped(true).show(ui, |ui| {
                    for (key, does) in KEYS {
                        ui.strong(*key);
                        ui.add(egui::Label::new(*does).extend());
                        ui.end_row();
                    }
                });
            });
        });
    if !open {
        commands.act(Action::ToggleHelp);
    }
}

#[cfg(test)]
mod tests {
    use super::super::action::Pane;
    use super::super::model::{MissedMark, flown_model};
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::volume::phantom::Kind;

    #[test]
    fn the_last_of_the_keys_can_be_scrolled_to_in_a_low_window() {
        let mut screen = TestScreen::sized(egui::vec2(640.0, 400.0));
        let mut shown = |events| screen.frame(events, |ui| help(ui, &mut ActionQueue::default()));
        let bottom = |texts: Vec<(String, egui::Rect)>| {
            texts.iter().find(|(text, _)| text == "quit").map(|(_, rect)| rect.bottom())
        };
        (0..3).for_each(|_| drop(shown(Vec::new())));
        assert!(bottom(shown(Vec::new())).is_none_or(|y| y > 400.0), "it is too low for all");
        let wheel = egui::Event::MouseWheel {
            unit: egui::MouseWheelUnit::Point,
            delta: egui::vec2(0.0, -9000.0),
            phase: egui::TouchPhase::Move,
            modifiers: Modifiers::NONE,
        };
        shown(vec![egui::Event::PointerMoved(egui::pos2(320.0, 200.0)), wheel]);
        (0..60).for_each(|_| drop(shown(Vec::new())));
        let last = bottom(shown(Vec::new()));
        assert!(last.is_some_and(|y| y < 400.0), "{last:?}");
    }

    /// The outline of a missed patch stayed in every pane for ever.
    #[test]
    fn escape_closes_the_keys_then_the_ruler_then_the_mark_then_the_single_pane() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        model.missed = Some(MissedMark {
            patch: 0,
            area_mm2: 10.0,
            center_mm: DVec3::ZERO,
            outline_mm: Vec::new(),
        });
        (model.help, model.ruler, model.maximised) = (true, Some(Ruler::Length), Some(Pane::Axial));
        let escape = egui::Event::Key {
            key: Key::Escape,
            physical_key: None,
            pressed: true,
            repeat: false,
            modifiers: Modifiers::NONE,
        };
        let mut closed = Vec::new();
        for _ in 0..4 {
            let mut commands = ActionQueue::default();
            let events = vec![escape.clone()];
            TestScreen::new().frame(events, |ui| keys(ui, &model, false, &mut commands));
            model.step(0.0, &commands.actions);
            let open = [model.help, model.ruler.is_some(), model.missed.is_some()];
            closed.push((open, model.maximised.is_some()));
        }
        let wanted = [
            ([false, true, true], true),
            ([false, false, true], true),
            ([false, false, false], true),
            ([false, false, false], false),
        ];
        assert_eq!(closed, wanted);
    }

    #[test]
    fn a_key_pressed_and_let_go_within_a_frame_moves_the_eye() {
        let model = Model::new(20.0);
        let context = egui::Context::default();
        let key = |pressed| egui::Event::Key {
            key: Key::ArrowUp,
            physical_key: None,
            pressed,
            repeat: false,
            modifiers: Modifiers::NONE,
        };
        let moved = |events| {
            let mut commands = ActionQueue::default();
            let input = egui::RawInput { events, ..Default::default() };
            let mut output = context.run_ui(input, |ui| keys(ui, &model, false, &mut commands));
            output.textures_delta.clear();
            matches!(commands.actions[..], [Action::Travel(mm)] if mm > 0.0)
        };
        assert!(moved(vec![key(true), key(false)]));
        assert!(!moved(Vec::new()), "not for ever");
        assert!(moved(vec![key(true)]) && moved(Vec::new()) && !moved(vec![key(false)]));
    }
}
