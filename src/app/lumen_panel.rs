//! Choice of the lumen: organs that the volume may show, or a range of values.

use egui::Ui;

use super::action::{ActionQueue, LumenChoice, Request};
use super::finding::range_around;
use super::model::Model;
use super::style::FAINT;
use crate::organ::Organ;

/// Range of a lumen that is entered, and whether it begins at the crosshair.
pub(super) type EnteredRange = Option<([f64; 2], bool)>;

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
        let find = ui.add_enabled(range[0] <= range[1], egui::Button::new("Find"));
        if find.on_disabled_hover_text("The first value is the larger one.").clicked() {
            let seed_mm = at_crosshair.then(|| model.crosshair_mm.to_array());
            commands.ask(Request::Lumen(LumenChoice { range: *range, seed_mm }));
        }
    });
}
