//! Findings in the panel: the list, the fields of the selected finding, measurements, files.

use egui::{ComboBox, Key, TextEdit, Ui};
use glam::DVec3;

use super::action::{Action, ActionQueue, Export, Request, Ruler};
use super::finding::{
    Confidence, FindingEdit, LesionShape, category, distance_mm, mean_value, middle, sizes,
};
use super::measure::Measurement;
use super::model::{Bookmark, Model};
use super::side_panel::PanelState;
use super::style::{FAINT, NO_PATH, NO_SCAN, NO_VIEW};

/// Lays out the findings, the measurements that belong to none, and the files.
pub(super) fn findings(
    ui: &mut Ui,
    model: &Model,
    state: &mut PanelState,
    commands: &mut ActionQueue,
) {
    new_finding(ui, model, state, commands);
    for (i, finding) in model.bookmarks.iter().enumerate() {
        let is_selected = model.selected == Some(i);
        let text = line(model, i, finding);
        let button = ui.add(egui::Button::selectable(is_selected, &text).truncate());
        if button.on_hover_text(&text).clicked() {
            commands.act(Action::GoToBookmark(i));
        }
        if is_selected {
            ui.indent("finding", |ui| said(ui, model, i, finding, commands));
        }
    }
    if let Some(category) = category(model) {
        let tip =
            "C-RADS by the sizes noted; whether the examination is complete (C0) is yours to say";
        ui.add(egui::Label::new(format!("C-RADS {category}")).wrap()).on_hover_text(tip);
    }
    ui.separator();
    measuring(ui, model, commands);
    ui.separator();
    files(ui, model, state, commands);
}

fn new_finding(ui: &mut Ui, model: &Model, state: &mut PanelState, commands: &mut ActionQueue) {
    let has_eye = model.pose.is_some();
    ui.horizontal(|ui| {
        let text = TextEdit::singleline(&mut state.note).hint_text("name").desired_width(120.0);
        let field = ui.add(text);
        let entered = field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
        let add = ui.add_enabled(has_eye, egui::Button::new("Add finding"));
        let add = add.on_hover_text("At the wall in the middle of the view (B)");
        if add.on_disabled_hover_text(NO_VIEW).clicked() || (entered && has_eye) {
            commands.act(Action::Bookmark(std::mem::take(&mut state.note)));
        }
    });
    ui.horizontal(|ui| {
        let count = model.bookmarks.len();
        let steps = [
            ("Previous", Action::PreviousFinding, "Comma"),
            ("Next", Action::NextFinding, "Full stop"),
        ];
        for (name, action, key) in steps {
            let button = ui.add_enabled(count > 0, egui::Button::new(name));
            let none = "No finding is noted yet.";
            if button.on_hover_text(key).on_disabled_hover_text(none).clicked() {
                commands.act(action);
            }
        }
        let s = if count == 1 { "" } else { "s" };
        ui.label(egui::RichText::new(format!("{count} finding{s}")).color(FAINT));
    });
}

/// A finding in one line: number, name, place, size.
fn line(model: &Model, i: usize, finding: &Bookmark) -> String {
    let place = match model.arc_beside(finding) {
        Some(_) => distance_mm(model, finding).map(|mm| format!(", {mm:.0} mm")),
        None => Some(", not on this path".into()),
    };
    let size = sizes(model, finding).largest_mm().map(|mm| format!(", size {mm:.1} mm"));
    let (place, size) = (place.unwrap_or_default(), size.unwrap_or_default());
    format!("{}: {}{place}{size}", i + 1, finding.text)
}

/// Lays out the fields of the selected finding.
fn said(ui: &mut Ui, model: &Model, i: usize, finding: &Bookmark, commands: &mut ActionQueue) {
    let mut edit = |edit| commands.act(Action::EditFinding(i, edit));
    let mut name = finding.text.clone();
    if ui.add(TextEdit::singleline(&mut name).desired_width(170.0)).changed() {
        edit(FindingEdit::Name(name));
    }
    let mut segment = finding.segment.clone().unwrap_or_default();
    let field = TextEdit::singleline(&mut segment).hint_text("segment, branch");
    if ui.add(field.desired_width(170.0)).changed() {
        edit(FindingEdit::Segment(segment));
    }
    ui.horizontal(|ui| {
        let mut shape = finding.shape;
        ComboBox::from_id_salt("shape")
            .width(90.0)
            .selected_text(shape.map_or("form", LesionShape::name))
            .show_ui(ui, |ui| {
                ui.selectable_value(&mut shape, None, "not said");
                for one in LesionShape::ALL {
                    ui.selectable_value(&mut shape, Some(one), one.name());
                }
            });
        let mut confidence = finding.confidence;
        let shown = confidence.map_or("confidence", Confidence::name);
        ComboBox::from_id_salt("confidence").width(84.0).selected_text(shown).show_ui(ui, |ui| {
            ui.selectable_value(&mut confidence, None, "not said");
            for one in Confidence::ALL {
                ui.selectable_value(&mut confidence, Some(one), one.name());
            }
        });
        if shape != finding.shape {
            edit(FindingEdit::Shape(shape));
        }
        if confidence != finding.confidence {
            edit(FindingEdit::Confidence(confidence));
        }
    });
    let mut looks = finding.in_flight;
    let tip = "The flight turns to it in passing, here and in the saved flight";
    if ui.checkbox(&mut looks, "Seen in the flight").on_hover_text(tip).changed() {
        edit(FindingEdit::InFlight(looks));
    }
    if let Some(mean) = mean_value(model, finding) {
        let tip = "Mean value of the tissue within 3 mm of the middle of the largest diameter, or of \
                   the wall looked at";
        ui.label(format!("Mean value {mean:.0}")).on_hover_text(tip);
    }
    for (k, m) in model.measurements.iter().enumerate() {
        if m.finding == Some(finding.id) {
            measured(ui, k, m, commands);
        }
    }
    ui.horizontal(|ui| {
        let on = model.ruler == Some(Ruler::Length);
        let measure = ui.selectable_label(on, "Measure");
        if measure.on_hover_text("Its diameter, on the wall or in a slice (M)").clicked() {
            commands.act(Action::Measure((!on).then_some(Ruler::Length)));
        }
        let find = ui.add_enabled(finding.wall_mm.is_some(), egui::Button::new("Find diameter"));
        let tip = "The largest diameter of what stands out of the wall in the middle of the view; its \
                   ends can be dragged";
        let no_wall = "No wall was seen in the middle of its view.";
        if find.on_hover_text(tip).on_disabled_hover_text(no_wall).clicked() {
            commands.act(Action::MeasureFinding(i));
        }
    });
    ui.horizontal(|ui| {
        let tip = "Its largest diameter in the large slice: in the plane of the length on the wall, with \
                   the window of lungs and the ruler ready";
        let can = middle(model, finding).is_some();
        let in_slice = ui.add_enabled(can, egui::Button::new("In a slice"));
        let no_place = "Neither a length nor a place on the wall belongs to it.";
        if in_slice.on_hover_text(tip).on_disabled_hover_text(no_place).clicked() {
            commands.act(Action::MeasureInSlice(i));
        }
        if ui.button("Delete").on_hover_text("Ctrl + Z brings it back").clicked() {
            commands.act(Action::RemoveBookmark(i));
        }
    });
}

/// A measurement: its name, its value, and how it is removed.
fn measured(ui: &mut Ui, i: usize, m: &Measurement, commands: &mut ActionQueue) {
    ui.horizontal(|ui| {
        if ui.small_button("x").on_hover_text("Delete; Ctrl + Z brings it back").clicked() {
            commands.act(Action::RemoveMeasurement(i));
        }
        let mut name = m.name.clone();
        let text = TextEdit::singleline(&mut name).hint_text("name").desired_width(84.0);
        if ui.add(text).changed() {
            commands.act(Action::NameMeasurement(i, name));
        }
        let middle = m.points().iter().sum::<DVec3>() / m.points_mm.len().max(1) as f64;
        let plane = if m.in_slice { "Measured in a slice" } else { "Measured on the wall" };
        let tip = format!("{plane}. Show in the slices");
        if ui.button(m.text()).on_hover_text(tip).clicked() {
            commands.act(Action::Crosshair(middle.to_array()));
        }
    });
}

fn measuring(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.horizontal(|ui| {
        ui.strong("Measure");
        for (ruler, name, key) in [(Ruler::Length, "length", "M"), (Ruler::Angle, "angle", "N")] {
            let on = model.ruler == Some(ruler);
            if ui.selectable_label(on, name).on_hover_text(key).clicked() {
                commands.act(Action::Measure((!on).then_some(ruler)));
            }
        }
    });
    let of_none = |m: &Measurement| !model.bookmarks.iter().any(|b| m.finding == Some(b.id));
    for (i, m) in model.measurements.iter().enumerate().filter(|(_, m)| of_none(m)) {
        measured(ui, i, m, commands);
    }
}

fn files(ui: &mut Ui, model: &Model, state: &mut PanelState, commands: &mut ActionQueue) {
    ui.strong("Save");
    let (has_path, has_findings) = (model.path.is_some(), !model.bookmarks.is_empty());
    let (no_scan, no_path) = (model.volume().is_none(), !has_path);
    let no_scan = no_scan.then_some(NO_SCAN);
    let no_view = model.pose.is_none().then_some(NO_VIEW);
    let is_at_work = (!model.is_complete).then_some("Not everything is computed yet.");
    let no_flight = no_path.then_some(NO_PATH).or(is_at_work);
    let no_finding = (!has_findings).then_some("No finding is noted yet.");
    let exports = [
        (Export::View, "view", no_view, "The inside view as it is seen (E)"),
        (Export::Window, "window", no_scan, "The window as it is seen (Shift + E)"),
        (Export::Flight, "flight", no_flight, "The flight as pictures and a film"),
        (Export::Report, "report", no_scan, "Findings and figures as a page"),
        (Export::Findings, "table", no_finding, "The findings as CSV"),
    ];
    ui.horizontal_wrapped(|ui| {
        for (what, name, missing, tip) in exports {
            let button = ui.add_enabled(missing.is_none(), egui::Button::new(name));
            let why_not = missing.unwrap_or_default();
            if button.on_hover_text(tip).on_disabled_hover_text(why_not).clicked() {
                commands.ask(Request::Export(what));
            }
        }
    });
    let tip = "Findings, measurements and the view, as a file that Open shows again (Ctrl + S)";
    let save = egui::Button::new("Save session");
    let button = ui.add_enabled(model.products.identity.is_some(), save).on_hover_text(tip);
    state.saves_session |= button.on_disabled_hover_text(NO_SCAN).clicked();
}

#[cfg(test)]
mod tests {
    use super::super::model::flown_model;
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::volume::phantom::Kind;

    #[test]
    fn grey_buttons_of_files_and_findings_say_why() {
        let model = Model::new(20.0);
        for (button, reason) in [
            ("Next", "No finding is noted yet."),
            ("Add finding", NO_VIEW),
            ("view", NO_VIEW),
            ("flight", NO_PATH),
            ("report", NO_SCAN),
            ("table", "No finding is noted yet."),
            ("Save session", NO_SCAN),
        ] {
            let mut state = PanelState::default();
            let texts = TestScreen::new().hover(button, |ui| {
                findings(ui, &model, &mut state, &mut ActionQueue::default());
            });
            assert!(texts.iter().any(|text| text == reason), "{button}: {texts:?}");
        }
    }

    #[test]
    fn the_selected_finding_is_edited_measured_and_deleted_in_the_list() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        model.step(0.0, &[Action::Bookmark("fold".into()), Action::Bookmark("polyp".into())]);
        let (mut screen, mut state) = (TestScreen::new(), PanelState::default());
        let mut click = |model: &mut Model, text: &str| {
            let mut commands = ActionQueue::default();
            screen.click(text, |ui| findings(ui, model, &mut state, &mut commands));
            model.step(0.0, &commands.actions);
        };
        click(&mut model, "1: fold, 0 mm");
        assert_eq!(model.selected, Some(0));
        click(&mut model, "Next");
        assert_eq!(model.selected, Some(1));
        click(&mut model, "Measure");
        assert_eq!(model.ruler, Some(Ruler::Length));
        let at = DVec3::from(model.bookmarks[1].wall_mm.unwrap());
        let marks = [at, at + 6.5 * DVec3::Y].map(|p| Action::Mark(p.to_array()));
        model.step(0.0, &marks);
        assert_eq!(line(&model, 1, &model.bookmarks[1]), "2: polyp, 0 mm, size 6.5 mm");
        click(&mut model, "Delete");
        assert_eq!((model.bookmarks.len(), model.measurements.len()), (1, 0));
    }
}
