//! The panel on the right: findings, missed wall, branches, figures, looks, and the choice of the
//! lumen, a tab each.

use egui::Ui;
use egui::style::ScrollStyle;

use super::action::{Action, ActionQueue, Colouring, Request, WallView};
use super::branch_panel::{branch_list, way_to_target};
use super::doubts::{doubtful_ends, reasons};
use super::figures::figures;
use super::findings_panel::findings;
use super::grey_window::slice_controls;
use super::kept_notes::{KeptOffer, ago};
use super::lumen_panel::{EnteredRange, lumen_choice};
use super::missed_panel::missed_patches;
use super::model::Model;
use super::style::{ACCENT, FAINT};
use crate::formats::{InputInfo, NOTICE, SeriesInfo};

/// A group of controls of the panel.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) enum Tab {
    /// Noted places and measurements.
    #[default]
    Findings,
    /// Wall that no picture has shown.
    Missed,
    /// Branches that can be taken.
    Branches,
    /// Figures of lumen, path and eye.
    Numbers,
    /// Look of wall and slices.
    View,
    /// Choice of the lumen, and why it is this one.
    Lumen,
}

impl Tab {
    const ALL: [(Self, &str); 6] = [
        (Self::Findings, "Findings"),
        (Self::Missed, "Missed"),
        (Self::Branches, "Branches"),
        (Self::Numbers, "Numbers"),
        (Self::View, "View"),
        (Self::Lumen, "Lumen"),
    ];
}

/// Text and numbers that are being entered, and the group that is shown.
#[derive(Default)]
pub(super) struct PanelState {
    pub tab: Tab,
    /// Text of the next bookmark.
    pub note: String,
    /// Whether a file for the notes is to be chosen.
    pub saves_session: bool,
    /// Range of a lumen to be chosen.
    pub lumen: EnteredRange,
}

/// The groups as tabs, so that nothing lies below the edge of the window or moves for another group.
pub(super) fn side_panel(
    ui: &mut Ui,
    model: &Model,
    state: &mut PanelState,
    commands: &mut ActionQueue,
) {
    egui::Panel::bottom("notice").show_separator_line(false).show(ui, |ui| {
        // The offer comes late, with the hash of the volume. Above the list it would move every button.
        kept_notes(ui, model, commands);
        ui.add(egui::Label::new(egui::RichText::new(NOTICE).small().color(FAINT)).wrap());
    });
    ui.add_space(4.0);
    ui.horizontal_wrapped(|ui| {
        for (tab, name) in Tab::ALL {
            let is_asked = tab == Tab::Lumen && asks_in_lumen_tab(model);
            let text = egui::RichText::new(name);
            // As wide as without the line: no tab moves when the question comes.
            let text = if is_asked { text.color(ACCENT).underline() } else { text };
            if ui.selectable_label(state.tab == tab, text).clicked() {
                state.tab = tab;
            }
        }
    });
    ui.separator();
    // No wider than the panel, whatever a name or a note is; what does not fit below is scrolled to.
    // Its bar is always seen where there is more: it floats otherwise, and shows under the pointer.
    ui.spacing_mut().scroll = ScrollStyle { bar_width: 8.0, ..ScrollStyle::solid() };
    let list = egui::ScrollArea::vertical().id_salt(state.tab as usize).auto_shrink(false);
    list.show(ui, |ui| {
        ui.set_max_width(ui.available_width());
        match state.tab {
            Tab::Findings => findings(ui, model, state, commands),
            Tab::Missed => missed_patches(ui, model, commands),
            Tab::Branches => {
                way_to_target(ui, model, commands);
                ui.separator();
                branch_list(ui, model, commands);
            }
            Tab::Numbers => {
                figures(ui, model, commands);
                doubtful_ends(ui, model, commands);
            }
            Tab::View => {
                appearance(ui, model, commands);
                if model.volume().is_some() {
                    ui.separator();
                    slice_controls(ui, model, commands);
                }
            }
            Tab::Lumen => {
                if let Some((info, _)) = &model.contents {
                    contents(ui, info, commands);
                    ui.separator();
                }
                if model.volume().is_some() {
                    lumen_choice(ui, model, &mut state.lumen, commands);
                }
                reasons(ui, model);
            }
        }
    });
}

/// Whether a choice waits that can be made in the tab of the lumen.
fn asks_in_lumen_tab(model: &Model) -> bool {
    model.failure.is_some() || model.question.is_some() || model.contents.is_some()
}

/// Offers notes of this volume from before.
fn kept_notes(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let Some(KeptOffer { counts: [bookmarks, measurements], days }) = model.kept_offer else {
        return;
    };
    let of = |n: usize, name: &str| format!("{n} {name}{}", if n == 1 { "" } else { "s" });
    let parts = [(bookmarks, "finding"), (measurements, "measurement")];
    let parts: Vec<_> = parts.iter().filter(|p| p.0 > 0).map(|(n, name)| of(*n, name)).collect();
    let what = format!("Notes of this scan, {}: {}", ago(days), parts.join(", "));
    ui.separator();
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
pub(super) fn contents(ui: &mut Ui, info: &InputInfo, commands: &mut ActionQueue) {
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
    let mut raised = model.local_contrast;
    let tip = "Fine relief stands out; light is no measure of the wall's slope then";
    if ui.checkbox(&mut raised, "Local contrast").on_hover_text(tip).changed() {
        commands.act(Action::LocalContrast(raised));
    }
    ui.horizontal(|ui| {
        ui.label(egui::RichText::new("Overview").color(FAINT));
        let mut opacity = model.opacity;
        let slider = egui::Slider::new(&mut opacity, 0.0..=2.0).show_value(false);
        if ui.add(slider).on_hover_text("Wall of the overview: clear to solid").changed() {
            commands.act(Action::Opacity(opacity));
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
        let (mut screen, mut offered) = (TestScreen::new(), Vec::new());
        for (tab, text) in [(Tab::Findings, "Save session"), (Tab::Numbers, "Missed patches")] {
            let mut places = Vec::new();
            for i in 0..=40 {
                model.step(0.0, &[Action::Seek(f64::from(i) / 40.0 * length)]);
                let mut state = PanelState { tab, ..PanelState::default() };
                let mut commands = ActionQueue::default();
                let texts = screen
                    .frame(Vec::new(), |ui| side_panel(ui, &model, &mut state, &mut commands));
                let shown = texts.iter().find(|(shown, _)| shown == text).expect("its controls");
                places.push(shown.1.top());
                offered.push((model.offered().len(), model.section.is_some()));
            }
            assert!(places.iter().all(|y| *y == places[0]), "{places:?}");
        }
        let of = |what: fn(&(usize, bool)) -> bool| offered.iter().filter(|o| what(o)).count();
        assert!(of(|o| o.0 == 0) > 0 && of(|o| o.0 > 0) > 0, "branches come and go: {offered:?}");
        assert!(of(|o| o.1) > 0 && of(|o| !o.1) > 0, "so do sections: {offered:?}");
    }

    /// The tab sprang open when a question came. Clicks on buttons of the tab before chose an organ.
    #[test]
    fn nothing_in_the_panel_moves_when_a_question_comes() {
        let mut model = Model::new(20.0);
        let (mut screen, mut state) = (TestScreen::new(), PanelState::default());
        let mut shown = |model: &Model| {
            let mut commands = ActionQueue::default();
            let texts =
                screen.frame(Vec::new(), |ui| side_panel(ui, model, &mut state, &mut commands));
            // The line under a text is a little wider than its letters.
            let middle = |(text, rect): (String, egui::Rect)| {
                (text, rect.center().x.round() as i32, rect.top().round() as i32)
            };
            texts.into_iter().filter(|t| !t.0.is_empty()).map(middle).collect::<Vec<_>>()
        };
        shown(&model);
        let before = shown(&model);
        model.question = Some("which organ?");
        assert_eq!(shown(&model), before);
        (model.question, model.failure) = (None, Some("no vessel found".into()));
        assert_eq!(shown(&model), before);
        // Notes from before are offered below.
        model.kept_offer = Some(KeptOffer { counts: [2, 1], days: 3 });
        // A panel that grows is as high as its content one frame later.
        (0..2).for_each(|_| drop(shown(&model)));
        let after = shown(&model);
        assert!(after.iter().any(|text| text.0 == "Take them"), "{after:?}");
        let stays = |text: &&(String, i32, i32)| text.0 == NOTICE || after.contains(text);
        assert!(before.iter().all(|text| stays(&text)), "{after:?}");
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
