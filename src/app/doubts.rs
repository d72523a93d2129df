//! Reasons for the lumen and the ends of its path, with the ends that may be others.

use egui::{CollapsingHeader, RichText, ScrollArea, Ui};

use super::action::{Action, ActionQueue, Request};
use super::model::Model;
use super::style::{CAMERA, FAINT};
use crate::centerline::ChosenEnd;

/// Height of the reasons of an organ, points.
const REASONS_HEIGHT: f32 = 180.0;

/// Asks about each end of the path that another place is as good for.
pub(super) fn doubtful_ends(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    if let Some(ends) = model.products.centerline.as_ref().and_then(|c| c.ends.as_ref()) {
        ask_about(ui, ends, commands);
    }
}

fn ask_about(ui: &mut Ui, ends: &[ChosenEnd; 2], commands: &mut ActionQueue) {
    let requests = [Request::StartAt as fn([f64; 3]) -> Request, Request::EndAt];
    let ends = ends.iter().zip(["start", "end"]).zip(requests);
    for ((end, name), request) in ends.filter(|((end, _), _)| end.is_doubtful()) {
        let Some(other) = end.runner_up_mm else { continue };
        ui.label(RichText::new(format!("The {name} of the path may be another.")).color(CAMERA))
            .on_hover_text(format!(
                "Taken: {}. The other place is as good within {:.0} %.",
                end.rule.words(),
                100.0 * end.margin.unwrap_or(0.0)
            ));
        ui.horizontal(|ui| {
            if ui.small_button("Show it").on_hover_text("The other place in the slices").clicked() {
                commands.act(Action::ShowInSlices(other));
            }
            if ui.small_button("Take it").on_hover_text("Plan the path again").clicked() {
                commands.ask(request(other));
            }
        });
    }
}

/// Lists why the organ was found, what was left out, and why the path has its ends.
pub(super) fn reasons(ui: &mut Ui, model: &Model) {
    let lumen = model.products.lumen.as_ref();
    let organ = lumen.and_then(|lumen| lumen.organ.as_ref());
    let ends = model.products.centerline.iter().flat_map(|centered| centered.ends.iter().flatten());
    let ends =
        ends.zip(["Start", "End"]).map(|(end, name)| format!("{name}: {}", end.rule.words()));
    let found = organ.into_iter().flat_map(|organ| organ.reasons.iter().cloned());
    let lines: Vec<String> = ends.chain(found).collect();
    if lines.is_empty() {
        return;
    }
    CollapsingHeader::new("Why").show(ui, |ui| {
        ScrollArea::vertical().id_salt("reasons").max_height(REASONS_HEIGHT).show(ui, |ui| {
            for line in &lines {
                ui.label(RichText::new(line).color(FAINT));
            }
        });
    });
}

#[cfg(test)]
mod tests {
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::centerline::EndRule;

    #[test]
    fn an_end_in_doubt_is_asked_about_and_taken_by_a_click() {
        let other = [1.0, 2.0, 3.0];
        let end = |margin| ChosenEnd {
            rule: EndRule::WiderEnd,
            at_mm: [0.0; 3],
            margin: Some(margin),
            runner_up_mm: Some(other),
        };
        let ends = [end(0.5), end(0.02)];
        let mut screen = TestScreen::new();
        let mut commands = ActionQueue::default();
        let mut lay_out = |ui: &mut Ui| ask_about(ui, &ends, &mut commands);
        let texts = screen.frame(Vec::new(), &mut lay_out);
        let asked = texts.iter().filter(|(text, _)| text.contains("may be another")).count();
        assert_eq!(asked, 1, "{texts:?}");
        screen.click("Show it", &mut lay_out);
        screen.click("Take it", &mut lay_out);
        assert_eq!(commands.actions, [Action::ShowInSlices(other)]);
        assert_eq!(commands.requests, [Request::EndAt(other)]);
    }
}
