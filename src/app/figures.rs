//! Figures of the panel: of the lumen, of the path, and of the place of the eye.

use egui::Ui;

use super::action::{Action, ActionQueue};
use super::model::Model;
use super::style::FAINT;
use crate::organ::Organ;

/// A figure with its unit, and what it says where the pointer rests.
struct Figure {
    name: &'static str,
    value: String,
    about: &'static str,
}

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
/// known whether it is a colon.
fn ends(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let lumen = model.products.lumen.as_ref();
    let organ = lumen.and_then(|l| l.organ.as_ref()).map(|o| o.organ);
    if model.path.is_none() || organ.is_some_and(|organ| organ != Organ::Colon) {
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
            out.push(figure("Section here", format!("{:.0} mm²", s.area_mm2)));
            let diameters = format!("{:.1}, {:.1} mm", s.largest_mm, s.smallest_mm);
            out.push(figure("Diameters", diameters));
        }
        None if model.path.is_some() && model.products.wall.is_some() => {
            // As many lines as with a section: what is below does not move in a flight.
            out.extend(["Section here", "Diameters"].map(|name| Figure {
                name,
                value: "none".into(),
                about: "The plane across the path runs along the lumen here: its area is no \
                        cross-section.",
            }));
        }
        None => {}
    }
    out.into_iter()
}

fn of_wall(model: &Model) -> impl Iterator<Item = Figure> {
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let mut out = Vec::new();
    if !model.seen.faces.is_empty() {
        out.push(figure("Wall seen so far", percent(model.seen.fraction)));
    }
    if let Some(c) = &model.products.coverage {
        out.push(figure("Flight sees, one way", percent(c.one_way_fraction)));
        out.push(figure("Both ways", percent(c.both_ways_fraction)));
        out.push(figure("Missed patches", c.patches.len().to_string()));
    }
    out.into_iter()
}
