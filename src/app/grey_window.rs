//! Windows of the slices' grey values: what a scan begins with, presets, and values typed in.

use egui::Ui;

use super::action::{Action, ActionQueue, Pane, SLAB_MM, SlabMode, SliceExtent};
use super::model::Model;
use super::style::FAINT;

/// Window in which lesions beside gas are measured: centre and width, Hounsfield units.
pub(super) const LUNG: [f64; 2] = [-600.0, 1500.0];

/// Presets of a CT by what they show: centre and width, Hounsfield units.
pub(super) const CT_PRESETS: [(&str, [f64; 2]); 5] = [
    ("lung", LUNG),
    ("soft tissue", [40.0, 400.0]),
    // Wide enough for folds, polyps and tagged fluid beside gas.
    ("colon", [-200.0, 1500.0]),
    // Contrast medium below, calcium above the middle.
    ("vessel", [170.0, 600.0]),
    ("bone", [400.0, 2000.0]),
];

/// Whether values are Hounsfield units, as far as they show: no other scan has values of air so far
/// below zero.
pub(super) fn is_hounsfield((low, _): (f64, f64)) -> bool {
    low < -500.0
}

/// Window to begin with: gas, soft tissue and bone of a CT; what is there otherwise.
pub(super) fn default_window(range: (f64, f64)) -> [f64; 2] {
    let (low, high) = range;
    if is_hounsfield(range) {
        [-200.0, 1800.0]
    } else {
        [0.5 * (low + high), (high - low).max(1.0)]
    }
}

/// A value with its unit, where that is known.
pub(super) fn value_text(value: f64, range: (f64, f64)) -> String {
    let decimals = if range.1 - range.0 < 20.0 && value != value.round() { 2 } else { 0 };
    let unit = if is_hounsfield(range) { " HU" } else { "" };
    format!("{value:.decimals$}{unit}")
}

/// Lays out how much slices show, with presets and numbers of their window.
pub(super) fn slice_controls(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.horizontal(|ui| {
        ui.label(egui::RichText::new("Slices").color(FAINT));
        extents(ui, model, commands);
    });
    grey_window(ui, model, commands);
}

/// Controls of the slices in one row, under the large one.
///
/// * `names_planes`: no other slice is shown that could take its place.
pub(super) fn slice_row(
    ui: &mut Ui,
    model: &Model,
    names_planes: bool,
    commands: &mut ActionQueue,
) {
    if model.volume().is_some() {
        for pane in Pane::SLICES.into_iter().filter(|_| names_planes) {
            let name = pane.title().split(' ').next().unwrap_or_default();
            if ui.selectable_label(model.large_slice == pane, name).clicked() {
                commands.act(Action::LargeSlice(pane));
            }
        }
        presets(ui, model, commands);
        ui.separator();
        extents(ui, model, commands);
        let (runs, tip) = (model.runs_cine(), "Runs through the slices, to and fro (K)");
        if ui.selectable_label(runs, "cine").on_hover_text(tip).clicked() {
            commands.act(Action::Cine(!runs));
        }
        slabs(ui, model, commands);
    }
}

/// Thin or thick slices.
fn slabs(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    for (mode, name) in SlabMode::ALL {
        let is_on = model.slab == Some(mode);
        let tip = "Of the values in a thick slice; a second click shows a thin one";
        if ui.selectable_label(is_on, name).on_hover_text(tip).clicked() {
            commands.act(Action::Slab((!is_on).then_some(mode)));
        }
    }
    let mut mm = model.slab_mm;
    let field = egui::DragValue::new(&mut mm).range(SLAB_MM).speed(0.2).suffix(" mm");
    let field = ui.add_enabled(model.slab.is_some(), field);
    if field.on_disabled_hover_text("Of thick slices: choose one of the three.").changed() {
        commands.act(Action::SlabThickness(mm));
    }
}

fn grey_window(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.horizontal(|ui| {
        ui.label(egui::RichText::new("Window").color(FAINT));
        let [mut centre, mut width] = model.window;
        let speed = (width / 200.0).max(0.01);
        let number = |value, name: &str| {
            egui::DragValue::new(value).speed(speed).max_decimals(1).prefix(format!("{name} "))
        };
        let centre_field = ui.add(number(&mut centre, "C")).on_hover_text("Centre");
        let width_field = ui.add(number(&mut width, "W").range(1e-3..=1e9)).on_hover_text("Width");
        if centre_field.changed() || width_field.changed() {
            commands.act(Action::Window([centre, width]));
        }
    });
    ui.horizontal_wrapped(|ui| presets(ui, model, commands));
}

fn presets(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let range = model.value_range();
    let none: &[(&str, [f64; 2])] = &[];
    let presets = if is_hounsfield(range) { &CT_PRESETS[..] } else { none };
    let reset = ("reset", default_window(range));
    for (name, window) in presets.iter().chain([&reset]) {
        let tip = window_text(*window);
        let button = ui.selectable_label(model.window == *window, *name).on_hover_text(tip);
        if button.clicked() {
            commands.act(Action::Window(*window));
        }
    }
}

/// How much of the volume the slices show.
fn extents(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    for (extent, name, tip) in [
        (SliceExtent::Lumen, "lumen", "As much as the lumen is long"),
        (SliceExtent::Volume, "all", "All of the volume"),
    ] {
        let button = ui.selectable_label(model.extent == extent, name).on_hover_text(tip);
        if button.clicked() {
            commands.act(Action::Extent(extent));
        }
    }
    if ui.button("near").on_hover_text("Near to the crosshair").clicked() {
        commands.act(Action::ShowInSlices(model.crosshair_mm.to_array()));
    }
}

/// Centre and width of a window as the slices show them: with a decimal where it is narrow, as that
/// of a label map is.
pub(super) fn window_text([centre, width]: [f64; 2]) -> String {
    let digits = usize::from(width < 10.0);
    format!("C {centre:.digits$}  W {width:.digits$}")
}

#[cfg(test)]
mod tests {
    use super::super::panel_tests::TestScreen;
    use super::super::slice_pane::tests::{model_of, model_of_a_volume};
    use super::*;
    use crate::volume::phantom::{Kind, Phantom};

    #[test]
    fn the_window_of_a_label_map_is_not_shown_as_zero() {
        assert_eq!(window_text([0.5, 1.0]), "C 0.5  W 1.0");
        assert_eq!(window_text([-200.0, 1800.0]), "C -200  W 1800");
    }

    #[test]
    fn values_have_their_unit_where_it_is_known() {
        let (ct, mr) = ((-1024.0, 3071.0), (0.0, 1200.0));
        assert_eq!(value_text(-843.0, ct), "-843 HU");
        assert_eq!(value_text(611.4, mr), "611");
        assert_eq!(value_text(0.25, (0.0, 1.0)), "0.25");
        assert_eq!(value_text(1.0, (0.0, 1.0)), "1");
    }

    #[test]
    fn a_window_begins_with_all_of_a_ct_or_with_what_is_there() {
        assert_eq!(default_window((-1024.0, 3071.0)), [-200.0, 1800.0]);
        assert_eq!(default_window((100.0, 300.0)), [200.0, 200.0]);
        assert_eq!(default_window((7.0, 7.0)), [7.0, 1.0]);
    }

    #[test]
    fn a_preset_sets_the_window_and_reset_takes_it_back() {
        let tube = Phantom::new(Kind::Tube, 64, [1.0; 3]).unwrap();
        let (mut model, mut screen) = (model_of(tube.grey(None, 0)), TestScreen::new());
        let begun = model.window;
        let mut click = |model: &mut Model, text: &str| {
            let mut commands = ActionQueue::default();
            screen.click(text, |ui| grey_window(ui, model, &mut commands));
            model.step(0.0, &commands.actions);
            model.window
        };
        assert_eq!(click(&mut model, "lung"), [-600.0, 1500.0]);
        assert_eq!(click(&mut model, "soft tissue"), [40.0, 400.0]);
        assert_eq!(click(&mut model, "reset"), begun);
    }

    #[test]
    fn a_scan_without_hounsfield_units_is_offered_none_of_their_presets() {
        let model = model_of_a_volume();
        let grey = |ui: &mut Ui| grey_window(ui, &model, &mut ActionQueue::default());
        let texts = TestScreen::new().frame(Vec::new(), grey);
        let shows = |text: &str| texts.iter().any(|(shown, _)| shown == text);
        assert!(shows("reset") && !shows("lung"), "{texts:?}");
    }
}
