//! Wall that the flight does not show, as a list in the order of the path.

use egui::Ui;

use super::action::{Action, ActionQueue};
use super::figures::MISSED;
use super::model::Model;
use super::style::FAINT;

/// Lays out the missed patches: where they are, how large, and whether they have been shown since.
pub(super) fn missed_patches(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let Some(patches) = model.missed_in_order() else {
        let why = match model.path {
            Some(_) => "The coverage of the flight is being computed.",
            None => "There is no path yet.",
        };
        ui.add(egui::Label::new(egui::RichText::new(why).color(FAINT)).wrap());
        return;
    };
    let left = patches.iter().filter(|p| !p.is_shown).count();
    let of = format!("{left} of {} patches left", patches.len());
    ui.label(of).on_hover_text(MISSED);
    ui.horizontal(|ui| {
        let steps =
            [("Previous", Action::PreviousMissed, "Shift + U"), ("Next", Action::NextMissed, "U")];
        for (name, action, key) in steps {
            let button = ui.add_enabled(left > 0, egui::Button::new(name));
            let all_shown = "Every patch has been shown";
            if button.on_hover_text(key).on_disabled_hover_text(all_shown).clicked() {
                commands.act(action);
            }
        }
        if model.missed.is_some() && ui.button("Hide").on_hover_text("Its outline (Esc)").clicked()
        {
            commands.act(Action::HideMissed);
        }
    });
    for patch in &patches {
        let is_marked = model.missed.as_ref().is_some_and(|m| m.patch == patch.patch);
        let state = if patch.is_shown { ", seen" } else { "" };
        let text = format!("{:.0} mm: {:.0} mm²{state}", patch.arc_mm, patch.area_mm2);
        if ui.selectable_label(is_marked, text).clicked() {
            commands.act(Action::GoToMissed(patch.patch));
        }
    }
}
