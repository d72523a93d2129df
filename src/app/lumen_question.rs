//! The inside pane before there is a wall: a question and its answers, a failure and the ways on from it, or
//! the stage that is computed.

use egui::{Rect, RichText, Ui, UiBuilder, vec2};

use super::action::{Action, ActionQueue, LumenChoice, Request};
use super::finding::range_around;
use super::model::Model;
use super::side_panel::{Tab, contents};
use super::style::{FAINT, TEXT, WRONG};
use crate::organ::Organ;

/// Height that most questions take, points: they stand in the middle of the pane.
const HEIGHT: f32 = 150.0;

/// Lays out a question, a failure or the stage.
///
/// * `tab`: tab of the panel. One of the answers changes it. A question does not: a panel that changes
///   under the pointer receives a click meant for another button.
pub(super) fn before_the_wall(
    ui: &mut Ui,
    rect: Rect,
    model: &Model,
    is_computing: bool,
    tab: &mut Tab,
    commands: &mut ActionQueue,
) {
    let area = rect.shrink2(vec2(8.0, 24.0));
    let is_asked = model.contents.is_some() && model.question.is_some();
    ui.scope_builder(UiBuilder::new().max_rect(area), |ui| {
        egui::ScrollArea::vertical().id_salt("before the wall").show(ui, |ui| {
            ui.vertical_centered(|ui| {
                ui.add_space((0.5 * (area.height() - HEIGHT)).max(0.0));
                if model.asks_for_lumen() {
                    which_organ(ui, model, tab, commands);
                } else if let Some((info, _)) = model.contents.as_ref().filter(|_| is_asked) {
                    contents(ui, info, commands);
                } else if let Some(failure) = &model.failure {
                    failed(ui, failure, model, tab, commands);
                } else if is_computing {
                    ui.label(RichText::new(stage(model)).size(14.0).color(FAINT));
                }
            });
        });
    });
}

/// The stage before the wall, by the products that are there.
fn stage(model: &Model) -> &'static str {
    match (model.volume(), &model.products.lumen) {
        (None, _) => "the scan is being read",
        (Some(_), None) => "the lumen is being looked for",
        (Some(_), Some(_)) => "the wall is being made",
    }
}

/// Asks for the lumen, with the organs that the volume seems to show.
fn which_organ(ui: &mut Ui, model: &Model, tab: &mut Tab, commands: &mut ActionQueue) {
    let glance = model.glance.clone().unwrap_or_default();
    let shows = glance.shows.map(|what| format!("This looks like {what}."));
    let text = shows.unwrap_or_else(|| "Which organ is to be flown through?".into());
    ui.label(RichText::new(text).size(15.0).color(TEXT));
    ui.add_space(8.0);
    for organ in &glance.organs {
        let name = match organ {
            Organ::Airway => "Airway",
            Organ::Colon => "Colon",
            Organ::Vessel => "Vessel",
        };
        let button = egui::Button::new(RichText::new(name).size(16.0));
        let button = button.min_size(vec2(120.0, 28.0));
        if ui.add(button).on_hover_text("Find it").clicked() {
            commands.ask(Request::Organ(*organ));
        }
    }
    open_lumen_tab(ui, model, tab, commands);
}

/// Says why there is no lumen, and offers the lumen at the crosshair: one click into the organ, and no
/// number to type.
fn failed(ui: &mut Ui, failure: &str, model: &Model, tab: &mut Tab, commands: &mut ActionQueue) {
    ui.label(RichText::new(failure).size(14.0).color(WRONG));
    ui.add_space(8.0);
    let Some(volume) = model.volume() else {
        ui.label(RichText::new("Open another volume.").color(FAINT));
        return;
    };
    ui.label(RichText::new("Click into the organ in a slice, then:").color(TEXT));
    let range = range_around(volume, model.crosshair_mm);
    let button = egui::Button::new("Find it by the values at the crosshair");
    let tip = "Mean and three standard deviations within 3 mm of the crosshair";
    let place = "The crosshair is outside the volume: click into a slice";
    let button = ui.add_enabled(range.is_some(), button).on_hover_text(tip);
    if let Some(range) = range.filter(|_| button.on_disabled_hover_text(place).clicked()) {
        let seed_mm = Some(model.crosshair_mm.to_array());
        commands.ask(Request::Lumen(LumenChoice { range, seed_mm }));
    }
    open_lumen_tab(ui, model, tab, commands);
}

/// Leads to the other organs and to ranges of values.
fn open_lumen_tab(ui: &mut Ui, model: &Model, tab: &mut Tab, commands: &mut ActionQueue) {
    ui.add_space(4.0);
    if ui.button("Other organs, ranges of values").clicked() {
        *tab = Tab::Lumen;
        if model.hides_panel {
            commands.act(Action::TogglePanel);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::panel_tests::TestScreen;
    use super::super::slice_pane::tests::model_of_a_volume;
    use super::*;
    use crate::organ::Glance;
    use crate::session::SessionError;

    const PANE: Rect = Rect { min: egui::pos2(50.0, 50.0), max: egui::pos2(550.0, 450.0) };

    fn not_chosen(organ: Option<Organ>) -> SessionError {
        SessionError::LumenNotChosen { name: "ct.nrrd".into(), organ }
    }

    /// Clicks a text of the pane; the commands, and the tab that is shown then.
    fn clicked(model: &Model, text: &str) -> (ActionQueue, Tab) {
        let (mut screen, mut tab) = (TestScreen::new(), Tab::default());
        let mut commands = ActionQueue::default();
        let mut lay_out =
            |ui: &mut Ui| before_the_wall(ui, PANE, model, false, &mut tab, &mut commands);
        screen.frame(Vec::new(), &mut lay_out);
        screen.click(text, lay_out);
        (commands, tab)
    }

    #[test]
    fn a_lumen_not_chosen_is_a_question_and_no_error_and_its_organ_is_one_click() {
        let mut model = model_of_a_volume();
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
        let (mut screen, mut tab) = (TestScreen::new(), Tab::default());
        let mut commands = ActionQueue::default();
        let texts = screen.frame(Vec::new(), |ui| {
            before_the_wall(ui, PANE, &model, true, &mut tab, &mut commands);
        });
        assert!(texts.iter().any(|(text, _)| text == "This looks like a chest."), "{texts:?}");
        assert_eq!(clicked(&model, "Airway").0.requests, [Request::Organ(Organ::Airway)]);
        let (commands, tab) = clicked(&model, "Other organs, ranges of values");
        assert!(commands.is_empty());
        assert_eq!(tab, Tab::Lumen);
        model.hides_panel = true;
        let (commands, _) = clicked(&model, "Other organs, ranges of values");
        assert_eq!(commands.actions, [Action::TogglePanel]);
    }

    /// A trunk angiogram was offered as a vessel, refused as too large, and led nowhere.
    #[test]
    fn where_an_organ_is_not_found_a_click_into_a_slice_leads_to_it() {
        let mut model = model_of_a_volume();
        model.failure = Some("no vessel found: vessels in ml 1987, at most 500".into());
        let (commands, _) = clicked(&model, "Find it by the values at the crosshair");
        let [Request::Lumen(LumenChoice { range, seed_mm })] = &commands.requests[..] else {
            panic!("{:?}", commands.requests)
        };
        let value = super::super::slices::value_at(model.volume().unwrap(), model.crosshair_mm);
        let value = value.unwrap();
        assert!(range[0] <= value && value <= range[1], "{value} in {range:?}");
        assert_eq!(*seed_mm, Some(model.crosshair_mm.to_array()));
        assert_eq!(clicked(&model, "Other organs, ranges of values").1, Tab::Lumen);
    }

    /// The pane said that the wall was being made while the scan was read and nothing was asked for.
    #[test]
    fn the_pane_names_the_stage_that_is_computed() {
        let said = |model: &Model| {
            let (mut tab, mut commands) = (Tab::default(), ActionQueue::default());
            let texts = TestScreen::new().frame(Vec::new(), |ui| {
                before_the_wall(ui, PANE, model, true, &mut tab, &mut commands);
            });
            texts.into_iter().map(|t| t.0).collect::<Vec<_>>()
        };
        assert_eq!(said(&Model::new(20.0)), ["the scan is being read"]);
        assert_eq!(said(&model_of_a_volume()), ["the lumen is being looked for"]);
    }
}
