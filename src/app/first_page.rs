//! The window before there is a volume: what it is for, and the cases that were opened last.

use egui::{Rect, Ui, UiBuilder};

use super::action::{ActionQueue, Request};
use super::kept_notes::{RecentCase, ago};
use super::model::Model;
use super::style::{FAINT, TEXT};

/// Lays out the first page in the inside pane.
pub(super) fn first_page(ui: &mut Ui, rect: Rect, model: &Model, commands: &mut ActionQueue) {
    const LINE: f32 = 26.0;
    let height = 110.0 + LINE * model.recent.len() as f32;
    let size = egui::vec2((rect.width() - 16.0).min(460.0), height.min(rect.height()));
    let area = Rect::from_center_size(rect.center(), size);
    ui.scope_builder(UiBuilder::new().max_rect(area), |ui| {
        ui.vertical_centered(|ui| {
            ui.label(egui::RichText::new("intima").size(22.0).color(TEXT));
            ui.label("Flies through colon, airways and vessels of a CT or MR scan.");
            let hint = "Drop a volume or a DICOM folder here, or open one above.";
            ui.label(egui::RichText::new(hint).color(FAINT));
            if !model.recent.is_empty() {
                ui.add_space(10.0);
                ui.strong("Opened before");
            }
            for case in &model.recent {
                let button = egui::Button::new(line(case)).truncate();
                if ui.add_sized([size.x, LINE - 4.0], button).clicked() {
                    commands.ask(Request::OpenKept(case.file.clone()));
                }
            }
        });
    });
}

/// A case in one line.
fn line(case: &RecentCase) -> String {
    let notes = match case.notes {
        0 => String::new(),
        1 => ", 1 note".into(),
        n => format!(", {n} notes"),
    };
    format!("{}: {}{notes}", case.name, ago(case.days))
}

#[cfg(test)]
mod tests {
    use super::super::panel_tests::TestScreen;
    use super::*;

    #[test]
    fn a_case_that_was_opened_before_is_opened_by_a_click() {
        let mut model = Model::new(20.0);
        let case = |name: &str, notes, days| RecentCase {
            name: name.into(),
            file: name.into(),
            notes,
            days,
        };
        model.recent = vec![case("ct.nrrd", 3, 0), case("label.nii.gz", 0, 12)];
        let (mut screen, mut asked) = (TestScreen::new(), Vec::new());
        let rect = Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(400.0, 500.0));
        screen.click("label.nii.gz: 12 days ago", |ui| {
            let mut commands = ActionQueue::default();
            first_page(ui, rect, &model, &mut commands);
            asked.append(&mut commands.requests);
        });
        assert_eq!(asked, [Request::OpenKept("label.nii.gz".into())]);
        assert_eq!(line(&model.recent[0]), "ct.nrrd: today, 3 notes");
    }
}
