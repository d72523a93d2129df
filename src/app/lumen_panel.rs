//! Choice of the lumen: organs that the volume may show, or a range of values.

use egui::{Rect, Ui, UiBuilder};

use super::action::{ActionQueue, LumenChoice, Request};
use super::finding::range_around;
use super::model::Model;
use super::style::{FAINT, TEXT};
use crate::organ::Organ;

/// Range of a lumen that is entered, and whether it begins at the crosshair.
pub(super) type EnteredRange = Option<([f64; 2], bool)>;

/// The organ's name as a button has it.
fn label(organ: Organ) -> &'static str {
    match organ {
        Organ::Airway => "Airway",
        Organ::Colon => "Colon",
        Organ::Vessel => "Vessel",
    }
}

/// Asks in the inside pane for the lumen, with the organs that the volume seems to show.
pub(super) fn lumen_question(ui: &mut Ui, rect: Rect, model: &Model, commands: &mut ActionQueue) {
    let glance = model.glance.clone().unwrap_or_default();
    let area = Rect::from_center_size(rect.center(), egui::vec2(rect.width() - 16.0, 150.0));
    ui.scope_builder(UiBuilder::new().max_rect(area), |ui| {
        ui.vertical_centered(|ui| {
            let shows = glance.shows.map(|what| format!("This looks like {what}."));
            let text = shows.unwrap_or_else(|| "Which organ is to be flown through?".into());
            ui.label(egui::RichText::new(text).size(15.0).color(TEXT));
            ui.add_space(8.0);
            for organ in &glance.organs {
                let text = egui::RichText::new(label(*organ)).size(16.0);
                let button = egui::Button::new(text).min_size(egui::vec2(120.0, 28.0));
                if ui.add(button).on_hover_text("Find it").clicked() {
                    commands.ask(Request::Organ(*organ));
                }
            }
            let hint = match glance.organs.is_empty() {
                true => "Choose an organ or a range of values on the right.",
                false => "Other organs and ranges of values are on the right.",
            };
            ui.label(egui::RichText::new(hint).color(FAINT));
        });
    });
}

/// The organ or the range of values that is the lumen. The range begins as gas in a CT, else as what
/// is bright.
pub(super) fn lumen_choice(
    ui: &mut Ui,
    model: &Model,
    entered: &mut EnteredRange,
    commands: &mut ActionQueue,
) {
    let (low, high) = model.value_range();
    let begin = || match low < -500.0 {
        true => ([low, -500.0], false),
        false => ([0.5 * (low + high), high], false),
    };
    let (range, at_crosshair) = entered.get_or_insert_with(begin);
    ui.horizontal(|ui| {
        for organ in Organ::ALL {
            if ui.button(organ.name()).on_hover_text("Find it").clicked() {
                commands.ask(Request::Organ(organ));
            }
        }
    });
    let tip = "Contrast-tagged fluid counts as lumen, as if it were gas";
    if ui.button("colon with tagged fluid").on_hover_text(tip).clicked() {
        commands.ask(Request::TaggedColon);
    }
    ui.add_space(6.0);
    ui.label(egui::RichText::new("Or a range of values").color(FAINT));
    let around = ui.button("around the value at the crosshair");
    let tip = "Mean and three standard deviations within 3 mm of the crosshair";
    if around.on_hover_text(tip).clicked()
        && let Some(found) = model.volume().and_then(|v| range_around(v, model.crosshair_mm))
    {
        (*range, *at_crosshair) = (found, true);
    }
    ui.horizontal(|ui| {
        let step = ((high - low) / 500.0).max(1e-3);
        ui.add(egui::DragValue::new(&mut range[0]).speed(step));
        ui.label("to");
        ui.add(egui::DragValue::new(&mut range[1]).speed(step));
    });
    ui.horizontal(|ui| {
        ui.checkbox(at_crosshair, "at the crosshair");
        if ui.add_enabled(range[0] <= range[1], egui::Button::new("Find")).clicked() {
            let seed_mm = at_crosshair.then(|| model.crosshair_mm.to_array());
            commands.ask(Request::Lumen(LumenChoice { range: *range, seed_mm }));
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::organ::Glance;
    use crate::session::SessionError;

    fn not_chosen(organ: Option<Organ>) -> SessionError {
        SessionError::LumenNotChosen { name: "ct.nrrd".into(), organ }
    }

    #[test]
    fn a_lumen_not_chosen_is_a_question_and_no_error_and_its_organ_is_one_click() {
        let mut model = Model::new(20.0);
        model.glance =
            Some(Glance { shows: Some("a chest"), organs: vec![Organ::Colon, Organ::Airway] });
        model.finish(Err(not_chosen(Some(Organ::Airway))), None);
        assert_eq!(model.failure, None);
        assert!(model.question.is_some());
        // Also where the look at the volume ends later.
        model.set_glance(model.glance.clone().unwrap());
        assert_eq!(
            model.glance.as_ref().unwrap().organs,
            [Organ::Airway, Organ::Colon],
            "the one that was found comes first"
        );
        let rect = Rect::from_min_size(egui::pos2(50.0, 50.0), egui::vec2(500.0, 400.0));
        let (mut screen, mut commands) = (TestScreen::new(), ActionQueue::default());
        let texts = screen.frame(Vec::new(), |ui| lumen_question(ui, rect, &model, &mut commands));
        assert!(texts.iter().any(|(text, _)| text == "This looks like a chest."), "{texts:?}");
        screen.click("Airway", |ui| lumen_question(ui, rect, &model, &mut commands));
        assert_eq!(commands.requests, [Request::Organ(Organ::Airway)]);
    }
}
