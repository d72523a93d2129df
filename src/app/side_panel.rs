//! The panel on the right: figures, choices of lumen and view, measurements, files, bookmarks.

use egui::style::ScrollStyle;
use egui::{Key, Ui};
use glam::DVec3;

use super::action::{Action, ActionQueue, Colouring, Export, Request, Ruler, WallView};
use super::branch_panel::branch_list;
use super::doubts::{doubtful_ends, reasons};
use super::figures::figures;
use super::grey_window::slice_controls;
use super::kept_notes::{KeptOffer, ago};
use super::lumen_panel::{EnteredRange, lumen_choice};
use super::model::Model;
use super::style::FAINT;
use crate::formats::{InputInfo, NOTICE, SeriesInfo};

/// Text and numbers that are being entered.
#[derive(Default)]
pub(super) struct PanelState {
    /// Text of the next bookmark.
    note: String,
    /// Whether a file for the notes is to be chosen.
    pub saves_session: bool,
    /// Range of a lumen to be chosen.
    pub lumen: EnteredRange,
}

/// Figures, how the wall looks, measuring, export, bookmarks.
pub(super) fn side_panel(
    ui: &mut Ui,
    model: &Model,
    state: &mut PanelState,
    commands: &mut ActionQueue,
) {
    egui::Panel::bottom("notice").show_separator_line(false).show(ui, |ui| {
        ui.add(egui::Label::new(egui::RichText::new(NOTICE).small().color(FAINT)).wrap());
    });
    // No wider than the panel, whatever a name or a note is; what does not fit below is scrolled to.
    // Its bar is always seen where there is more: it floats otherwise, and shows under the pointer.
    ui.spacing_mut().scroll = ScrollStyle { bar_width: 8.0, ..ScrollStyle::solid() };
    egui::ScrollArea::vertical().auto_shrink(false).show(ui, |ui| {
        ui.set_max_width(ui.available_width());
        groups(ui, model, state, commands);
    });
}

fn groups(ui: &mut Ui, model: &Model, state: &mut PanelState, commands: &mut ActionQueue) {
    ui.add_space(4.0);
    kept_notes(ui, model, commands);
    figures(ui, model, commands);
    doubtful_ends(ui, model, commands);
    reasons(ui, model);
    ui.separator();
    if let Some((info, _)) = &model.contents {
        contents(ui, info, commands);
        ui.separator();
    }
    if model.volume().is_some() {
        lumen_choice(ui, model, &mut state.lumen, commands);
        ui.separator();
    }
    if !model.choices.is_empty() {
        branch_list(ui, model, commands);
        ui.separator();
    }
    appearance(ui, model, commands);
    ui.separator();
    if model.volume().is_some() {
        slice_controls(ui, model, commands);
        ui.separator();
    }
    measuring(ui, model, commands);
    ui.separator();
    exports(ui, model, commands);
    ui.separator();
    ui.horizontal(|ui| {
        ui.strong("Bookmarks");
        let save = egui::Button::new("Save session");
        let tip = "Bookmarks, measurements and the view, as a file that Open shows again";
        let button = ui.add_enabled(model.products.identity.is_some(), save);
        state.saves_session |= button.on_hover_text(tip).on_disabled_hover_text(tip).clicked();
    });
    ui.horizontal(|ui| {
        let text =
            egui::TextEdit::singleline(&mut state.note).hint_text("note").desired_width(120.0);
        let field = ui.add(text);
        let entered = field.lost_focus() && ui.input(|i| i.key_pressed(Key::Enter));
        let can = model.pose.is_some();
        if ui.add_enabled(can, egui::Button::new("Add")).clicked() || (entered && can) {
            commands.act(Action::Bookmark(std::mem::take(&mut state.note)));
        }
    });
    for (i, b) in model.bookmarks.iter().enumerate() {
        ui.horizontal(|ui| {
            if ui.small_button("x").on_hover_text("Forget").clicked() {
                commands.act(Action::RemoveBookmark(i));
            }
            let place = b.arc_mm.map_or("off the path".into(), |mm| format!("{mm:.0} mm"));
            let text = format!("{place}: {}", b.text);
            if short_button(ui, &text).clicked() {
                commands.act(Action::GoToBookmark(i));
            }
        });
    }
}

/// Offers notes of this volume from before.
fn kept_notes(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let Some(KeptOffer { counts: [bookmarks, measurements], days }) = model.kept_offer else {
        return;
    };
    let of = |n: usize, name: &str| format!("{n} {name}{}", if n == 1 { "" } else { "s" });
    let parts = [(bookmarks, "bookmark"), (measurements, "measurement")];
    let parts: Vec<_> = parts.iter().filter(|p| p.0 > 0).map(|(n, name)| of(*n, name)).collect();
    let what = format!("Notes of this scan, {}: {}", ago(days), parts.join(", "));
    ui.add(egui::Label::new(what).wrap());
    ui.horizontal(|ui| {
        if ui.button("Take them").clicked() {
            commands.ask(Request::TakeKept);
        }
        let leave = ui.button("Leave them");
        if leave.on_hover_text("Their file is set aside, not removed").clicked() {
            commands.ask(Request::LeaveKept);
        }
    });
    ui.separator();
}

/// A button no wider than the panel; the whole text where the pointer rests.
fn short_button(ui: &mut Ui, text: &str) -> egui::Response {
    ui.add(egui::Button::new(text).truncate()).on_hover_text(text)
}

/// Name of a series and what tells it from others: thickness, kernel, number and size of slices.
fn series_texts(s: &SeriesInfo) -> [String; 2] {
    let name = match &s.description.0[..] {
        "" => format!("Series {}, {}", s.index + 1, s.modality),
        description => description.to_owned(),
    };
    let [x, y, _] = s.dims;
    let parts = [
        Some(s.modality.clone()),
        s.slice_mm().map(|mm| format!("{mm} mm")),
        Some(s.kernel.0.clone()).filter(|kernel| !kernel.is_empty()),
        Some(format!("{} slices", s.slices)),
        Some(format!("{x} x {y}")),
    ];
    [name, parts.into_iter().flatten().collect::<Vec<_>>().join(", ")]
}

/// The series or segments of an input, to choose one.
fn contents(ui: &mut Ui, info: &InputInfo, commands: &mut ActionQueue) {
    ui.strong(if info.segments.is_empty() { "Series" } else { "Segments" });
    egui::ScrollArea::vertical().id_salt("contents").max_height(200.0).show(ui, |ui| {
        for s in info.series.iter().filter(|_| info.segments.is_empty()) {
            let [name, details] = series_texts(s);
            if short_button(ui, &name).clicked() {
                commands.ask(Request::Series(s.index));
            }
            ui.label(egui::RichText::new(details).small().color(FAINT));
        }
        for s in &info.segments {
            if short_button(ui, &s.name).clicked() {
                commands.ask(Request::Segment(s.name.clone()));
            }
        }
    });
}

/// Lays out the controls of the wall's appearance.
fn appearance(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let views =
        [(WallView::Eye, "eye"), (WallView::Cube, "cube"), (WallView::Panorama, "panorama")];
    ui.horizontal(|ui| {
        ui.label(egui::RichText::new("View").color(FAINT));
        for (view, name) in views {
            if ui.selectable_label(model.view == view, name).clicked() {
                commands.act(Action::View(view));
            }
        }
    });
    let p = &model.products;
    let colours = [
        (Colouring::Tissue, "tissue", true, "No colours"),
        (Colouring::Missed, "not seen", p.wall.is_some(), "Wall that no picture has shown yet"),
        (
            Colouring::Radius,
            "radius",
            p.centerline_distances.is_some(),
            "Distance from the centerline",
        ),
        (
            Colouring::Evidence,
            "evidence",
            model.evidence().is_some(),
            "Where the scan shows no wall, or only a thin sheet; of grey values, not of label maps",
        ),
        (
            Colouring::Behind,
            "behind",
            model.may_look_behind(),
            "Tissue behind the wall, by its CT numbers; of grey values, not of label maps",
        ),
    ];
    ui.horizontal_wrapped(|ui| {
        ui.label(egui::RichText::new("Colour").color(FAINT));
        for (colouring, name, can, tip) in colours {
            let label = egui::Button::selectable(model.colouring == colouring, name);
            let button = ui.add_enabled(can, label).on_hover_text(tip).on_disabled_hover_text(tip);
            if button.clicked() {
                commands.act(Action::Colour(colouring));
            }
        }
    });
    ui.horizontal(|ui| {
        ui.label(egui::RichText::new("Overview").color(FAINT));
        let mut opacity = model.opacity;
        let slider = egui::Slider::new(&mut opacity, 0.0..=2.0).show_value(false);
        if ui.add(slider).on_hover_text("Wall of the overview: clear to solid").changed() {
            commands.act(Action::Opacity(opacity));
        }
    });
}

fn measuring(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.horizontal(|ui| {
        ui.strong("Measure");
        for (ruler, name) in [(Ruler::Length, "length"), (Ruler::Angle, "angle")] {
            let on = model.ruler == Some(ruler);
            if ui.selectable_label(on, name).clicked() {
                commands.act(Action::Measure((!on).then_some(ruler)));
            }
        }
    });
    for (i, m) in model.measurements.iter().enumerate() {
        ui.horizontal(|ui| {
            if ui.small_button("x").on_hover_text("Forget").clicked() {
                commands.act(Action::RemoveMeasurement(i));
            }
            let mut name = m.name.clone();
            let text = egui::TextEdit::singleline(&mut name).hint_text("name").desired_width(96.0);
            if ui.add(text).changed() {
                commands.act(Action::NameMeasurement(i, name));
            }
            let middle = m.points().iter().sum::<DVec3>() / m.points_mm.len().max(1) as f64;
            if ui.button(m.text()).on_hover_text("Show in the slices").clicked() {
                commands.act(Action::Crosshair(middle.to_array()));
            }
        });
    }
}

fn exports(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.horizontal(|ui| {
        ui.strong("Save");
        let ready = model.path.is_some();
        for (what, name, can) in [
            (Export::View, "view", model.pose.is_some()),
            (Export::Flight, "flight", ready && model.is_complete),
            (Export::Report, "report", model.volume().is_some()),
        ] {
            if ui.add_enabled(can, egui::Button::new(name)).clicked() {
                commands.ask(Request::Export(what));
            }
        }
    });
}

#[cfg(test)]
mod tests {
    use super::super::model::flown_model;
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::app::model::Bookmark;
    use crate::formats::ScreenText;
    use crate::volume::phantom::Kind;

    #[test]
    fn series_are_listed_by_description_thickness_and_kernel_and_not_by_uid() {
        let mut series = SeriesInfo {
            index: 2,
            uid: "1.2.840.99".into(),
            modality: "CT".into(),
            dims: [512, 512, 275],
            spacing_mm: Some([0.7, 0.7, 0.8]),
            slices: 275,
            description: ScreenText("Thorax lung".into()),
            kernel: ScreenText("B70f".into()),
            thickness_mm: Some(1.0),
            plane: "axial",
        };
        let details = "CT, 1 mm, B70f, 275 slices, 512 x 512";
        assert_eq!(series_texts(&series), ["Thorax lung", details]);
        (series.description, series.kernel) = Default::default();
        series.thickness_mm = None;
        let details = "CT, 0.8 mm, 275 slices, 512 x 512";
        assert_eq!(series_texts(&series), ["Series 3, CT", details]);
    }

    #[test]
    fn a_session_can_be_saved_without_closing_the_window() {
        let mut model = Model::new(20.0);
        let (mut screen, mut state) = (TestScreen::new(), PanelState::default());
        let mut click = |model: &Model, state: &mut PanelState| {
            let mut commands = ActionQueue::default();
            screen.click("Save session", |ui| side_panel(ui, model, state, &mut commands));
        };
        click(&model, &mut state);
        assert!(!state.saves_session, "there is no volume that it is of");
        model.products.identity = Some(std::sync::Arc::new("ab".into()));
        click(&model, &mut state);
        assert!(state.saves_session);
    }

    #[test]
    fn controls_of_the_panel_do_not_move_under_the_pointer_in_a_flight() {
        let (mut model, _session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let length = model.path.as_ref().unwrap().length_mm();
        let (mut screen, mut state) = (TestScreen::new(), PanelState::default());
        let (mut places, mut offered) = (Vec::new(), Vec::new());
        for i in 0..=40 {
            model.step(0.0, &[Action::Seek(f64::from(i) / 40.0 * length)]);
            let mut commands = ActionQueue::default();
            let texts =
                screen.frame(Vec::new(), |ui| side_panel(ui, &model, &mut state, &mut commands));
            let view = texts.iter().find(|(text, _)| text == "View").expect("its controls");
            places.push(view.1.top());
            offered.push((model.offered().len(), model.section.is_some()));
        }
        let of = |what: fn(&(usize, bool)) -> bool| offered.iter().filter(|o| what(o)).count();
        assert!(of(|o| o.0 == 0) > 0 && of(|o| o.0 > 0) > 0, "branches come and go: {offered:?}");
        assert!(of(|o| o.1) > 0 && of(|o| !o.1) > 0, "so do sections: {offered:?}");
        assert!(places.iter().all(|y| *y == places[0]), "{places:?}");
    }

    #[test]
    fn a_long_note_does_not_push_the_panel_over_the_panes() {
        let mut model = Model::new(20.0);
        let text = "a finding with a long description ".repeat(12);
        let json =
            r#"{"text": "", "position_mm": [0, 0, 0], "rotation": [0, 0, 0, 1], "fov_deg": 90}"#;
        let bookmark: Bookmark = serde_json::from_str(json).unwrap();
        model.bookmarks = vec![Bookmark { text, ..bookmark }; 40];
        let context = egui::Context::default();
        let mut widths = Vec::new();
        for _ in 0..3 {
            let screen = egui::Rect::from_min_size(egui::Pos2::ZERO, egui::vec2(800.0, 600.0));
            let input = egui::RawInput { screen_rect: Some(screen), ..Default::default() };
            let mut output = context.run_ui(input, |ui| {
                let mut state = PanelState::default();
                let panel = egui::Panel::right("notes").resizable(false).exact_size(236.0);
                let shown = panel.show(ui, |ui| {
                    side_panel(ui, &model, &mut state, &mut ActionQueue::default());
                    ui.min_rect().width()
                });
                widths.push((shown.inner, shown.response.rect.width()));
            });
            output.textures_delta.clear();
        }
        for (inner, panel) in widths {
            assert!(inner <= 236.0 && panel <= 237.0, "{inner} and {panel} points");
        }
    }
}
