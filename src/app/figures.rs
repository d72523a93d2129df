//! Figures of the panel: of the lumen, of the path, and of the place of the eye.

use egui::Ui;

use super::action::{Action, ActionQueue};
use super::model::Model;
use super::style::FAINT;
use crate::flight::NoSection;
use crate::organ::{ColonEnds, Organ};

/// A figure with its unit, and what it says where the pointer rests.
struct Figure {
    name: &'static str,
    value: String,
    about: &'static str,
}

/// Explanation of a missed patch.
pub(super) const MISSED: &str = "Connected parts of the wall that neither the flight there nor the \
    flight back shows: behind folds, and in branches that are not flown.";

/// Lays the figures out, a line each.
pub(super) fn figures(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    ui.strong("Figures");
    for Figure { name, value, about } in of_lumen(model).chain(of_eye(model)).chain(of_wall(model))
    {
        let line = ui.horizontal(|ui| {
            ui.label(egui::RichText::new(name).color(FAINT));
            ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| ui.label(value));
        });
        if !about.is_empty() {
            line.response.on_hover_text(about);
        }
    }
    ends(ui, model, commands);
}

/// Names of the ends of a colon's path, and how they are given by hand. Of a label map it is not
/// known whether it is a colon: it may be where its path is as long as a colon's.
fn ends(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let lumen = model.products.lumen.as_ref();
    let organ = lumen.and_then(|l| l.organ.as_ref()).map(|o| o.organ);
    let Some(path) = &model.path else { return };
    let may_be_colon = match organ {
        Some(organ) => organ == Organ::Colon,
        None => path.length_mm() >= ColonEnds::MIN_LENGTH_MM,
    };
    if !may_be_colon && model.ends.is_none() {
        return;
    }
    ui.horizontal(|ui| {
        ui.label(egui::RichText::new("Ends").color(FAINT));
        let (tip, text, at_start) = match model.ends {
            Some(ends) => ("The other way about", "Swap", !ends.starts_at_rectum),
            None => ("Of a colon: the path begins at the rectum", "Name", true),
        };
        ui.with_layout(egui::Layout::right_to_left(egui::Align::Center), |ui| {
            if ui.small_button(text).on_hover_text(tip).clicked() {
                commands.act(Action::RectumAtStart(at_start));
            }
            let names = model.ends.map(|ends| ends.names().join(" to "));
            ui.label(names.unwrap_or_else(|| "not named".into()));
        });
    });
}

fn figure(name: &'static str, value: String) -> Figure {
    Figure { name, value, about: "" }
}

fn of_lumen(model: &Model) -> impl Iterator<Item = Figure> {
    let lumen = model.products.lumen.as_ref();
    let organ = lumen.and_then(|l| l.organ.as_ref()).map(|organ| {
        figure("Organ", format!("{}, confidence {:.2}", organ.organ.name(), organ.confidence))
    });
    let volume = lumen.map(|l| {
        let ml = l.lumen.inside_voxels() as f64 * l.lumen.grid.voxel_mm3() / 1000.0;
        figure("Volume", format!("{ml:.1} ml"))
    });
    let path = model.path.as_ref().map(|p| figure("Path", format!("{:.0} mm", p.length_mm())));
    organ.into_iter().chain(volume).chain(path)
}

/// Figures of the place of the eye: those of the path where it is on it, else its own.
fn of_eye(model: &Model) -> impl Iterator<Item = Figure> {
    let mut out = Vec::new();
    if let Some(path) = &model.path {
        let speed = model.flown_mm_s().unwrap_or(0.0);
        out.push(Figure {
            name: "Speed",
            value: format!("{speed:.1} mm/s"),
            about: "Speed of the eye, measured. It is below the cruising speed where the lumen is \
                    narrow or the gaze turns.",
        });
        if model.on_path {
            out.push(figure("Position", format!("{:.0} mm", model.arc_mm)));
            let radius = path.radius_at(model.arc_mm);
            out.push(figure("Radius here", format!("{radius:.1} mm")));
        } else {
            out.push(figure("Position", "off the path".into()));
        }
    }
    if let Some(mm) = model.eye_to_wall_mm().filter(|_| !model.on_path) {
        out.push(figure("Eye to wall", format!("{mm:.1} mm")));
    }
    match model.section_figures() {
        Some(s) => {
            let decimals = if s.area_mm2 < 9.95 { 1 } else { 0 };
            out.push(figure("Section here", format!("{:.decimals$} mm²", s.area_mm2)));
            let diameters = format!("{:.1}, {:.1} mm", s.largest_mm, s.smallest_mm);
            out.push(figure("Diameters", diameters));
        }
        None if model.path.is_some() && model.products.wall.is_some() => {
            // As many lines as with a section: what is below does not move in a flight.
            let (why, about) = without_section(model.no_section);
            out.push(Figure { name: "Section here", value: why.into(), about });
            out.push(Figure { name: "Diameters", value: "none".into(), about });
        }
        None => {}
    }
    out.into_iter()
}

/// Says why there is no section: in the panel, and where the pointer rests.
fn without_section(why: Option<NoSection>) -> (&'static str, &'static str) {
    match why {
        Some(NoSection::AlongBranch) => (
            "crosses a branch",
            "The plane across the path cuts a branch lengthwise here: its area is no \
             cross-section of either.",
        ),
        Some(NoSection::AlongLumen) => (
            "runs along the lumen",
            "The lumen bends so sharply here that the plane across the path runs along it: its \
             area is no cross-section.",
        ),
        Some(NoSection::NoOutline) => (
            "wall is open",
            "No outline of the wall closes about the eye in the plane across the path.",
        ),
        None => ("none", "The section is not known yet."),
    }
}

fn of_wall(model: &Model) -> impl Iterator<Item = Figure> {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let mut out = Vec::new();
    if !model.seen.faces.is_empty() {
        out.push(Figure {
            name: "Wall seen so far",
            value: percent(model.seen.fraction),
            about: "Share of the wall's area that the inside view has shown since it was opened.",
        });
    }
    if let Some(c) = &model.coverage {
        out.push(Figure {
            name: "Flight sees, one way",
            value: percent(c.one_way_fraction),
            about: "Share of the wall's area that the flight along the path shows.",
        });
        out.push(Figure {
            name: "Both ways",
            value: percent(c.both_ways_fraction),
            about: "Share of the wall's area that the flight shows there and back.",
        });
        out.push(Figure {
            name: "Missed patches",
            value: c.patches.len().to_string(),
            about: MISSED,
        });
    }
    out.into_iter()
}

#[cfg(test)]
mod tests {
    use super::super::junctions::tests::{path, tree};
    use super::super::model::flown_model;
    use super::super::panel_tests::TestScreen;
    use super::*;
    use crate::volume::phantom::Kind;

    fn shown(model: &Model) -> Vec<String> {
        let mut screen = TestScreen::new();
        let texts = screen.frame(Vec::new(), |ui| figures(ui, model, &mut ActionQueue::default()));
        texts.into_iter().map(|t| t.0).collect()
    }

    #[test]
    fn ends_are_asked_for_only_where_the_path_may_be_a_colons() {
        let mut model = Model::new(20.0);
        model.path = Some(path(&tree(), 0));
        assert!(!shown(&model).iter().any(|t| t == "Ends"), "60 mm are no colon");
        let mut long = tree();
        for p in long.branches.iter_mut().flat_map(|b| &mut b.points) {
            p.position_mm *= 20.0;
        }
        model.path = Some(path(&long, 0));
        assert!(shown(&model).iter().any(|t| t == "Ends"), "1,200 mm may be one");
    }

    #[test]
    fn beside_a_branch_a_missing_section_is_said_to_cross_it() {
        let (mut model, _session) = flown_model(Kind::Y, |s| s.centerline.tree = true);
        let branches: Vec<f64> = model.choices.iter().map(|c| c.arc_mm).collect();
        let length = model.path.as_ref().unwrap().length_mm();
        let mut crossing = Vec::new();
        for i in 0..=200 {
            model.step(0.0, &[Action::Seek(length * f64::from(i) / 200.0)]);
            assert_eq!(model.section.is_none(), model.no_section.is_some());
            let is_crossing = model.no_section == Some(NoSection::AlongBranch);
            crossing.extend(is_crossing.then_some(model.arc_mm));
        }
        assert!(!crossing.is_empty(), "the branches leave at {branches:?} mm");
        let is_near = |arc: &f64| branches.iter().any(|b| (b - arc).abs() < 15.0);
        assert!(crossing.iter().all(is_near), "{crossing:?} beside {branches:?}");
    }

    #[test]
    fn where_there_is_no_section_the_panel_says_why() {
        let (mut model, _session) = flown_model(Kind::Tube, |_| {});
        assert!(model.section.is_some() && model.no_section.is_none());
        for (why, text) in [
            (NoSection::AlongBranch, "crosses a branch"),
            (NoSection::AlongLumen, "runs along the lumen"),
            (NoSection::NoOutline, "wall is open"),
        ] {
            (model.section, model.no_section) = (None, Some(why));
            let texts = shown(&model);
            assert!(texts.iter().any(|t| t == text), "{texts:?}");
        }
    }
}
