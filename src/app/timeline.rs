//! The scrub bar.

use egui::{Align2, Color32, FontId, Pos2, Rect, Sense, Stroke, Ui, Vec2, pos2, vec2};

use super::action::{Action, ActionQueue};
use super::labels::Labels;
use super::model::Model;
use super::style::{ACCENT, CAMERA, CUT, FAINT, MISSED, wheel_notches, wheel_sideways};
use crate::flight::FlightPath;
use crate::organ::ColonEnds;

/// Share of the path, by length, whose sections the plot has room for. One that runs along a
/// neighbouring bend leaves it at the top.
const PLOTTED: f64 = 0.98;

/// Radius of a circle as large as the widest section of the path, but for the last few per cent, mm.
/// By length: an eye is slow where it is narrow, so that most poses are of narrow places.
fn widest_section_mm(path: &FlightPath) -> f64 {
    let lengths = path.arcs_mm().windows(2).map(|pair| pair[1] - pair[0]).chain([0.0]);
    let sections = path.sections.iter().zip(lengths);
    let mut areas: Vec<(f64, f64)> =
        sections.filter_map(|(s, length)| Some((s.as_ref()?.area_mm2, length))).collect();
    areas.sort_by(|a, b| a.0.total_cmp(&b.0));
    let room = PLOTTED * areas.iter().map(|a| a.1).sum::<f64>();
    let mut passed = 0.0;
    let widest = areas.iter().find(|(_, length)| {
        passed += length;
        passed >= room
    });
    widest.map_or(0.0, |(area, _)| (area / std::f64::consts::PI).sqrt())
}

/// Says what the bar shows.
fn about(path: &FlightPath) -> String {
    let cuts = match path.cuts_mm().next() {
        Some(_) => " Red: the flight goes on in another part of the lumen.",
        None => "",
    };
    format!(
        "Bars: least distance of the path to the wall. Line: radius of a circle as large as the \
         cross-section; none where the plane runs along the lumen. Dots: findings, with a \
         ring where the flight looks at them. Diamonds: missed wall. Triangles: branches.{cuts}"
    )
}

/// A mark of a missed patch.
fn diamond(painter: &egui::Painter, at: Pos2, colour: Color32) {
    let corners = [vec2(0.0, -3.5), vec2(3.5, 0.0), vec2(0.0, 3.5), vec2(-3.5, 0.0)];
    let corners = corners.map(|by| at + by).to_vec();
    painter.add(egui::Shape::convex_polygon(corners, colour, Stroke::NONE));
}

/// A mark of a branch, that stands on a place.
fn triangle(painter: &egui::Painter, at: Pos2, colour: Color32) {
    let corners = [vec2(0.0, -6.0), vec2(3.5, 0.0), vec2(-3.5, 0.0)];
    let corners = corners.map(|by| at + by).to_vec();
    painter.add(egui::Shape::convex_polygon(corners, colour, Stroke::NONE));
}

/// The scrub bar with the radius along the path.
pub(super) fn timeline(ui: &mut Ui, model: &Model, commands: &mut ActionQueue) {
    let size = ui.available_size().max(Vec2::splat(4.0));
    let (rect, response) = ui.allocate_exact_size(size, Sense::click_and_drag());
    let painter = ui.painter_at(rect);
    let bar = rect.shrink2(vec2(8.0, 6.0));
    painter.rect_filled(bar, 2.0, Color32::from_rgb(24, 26, 30));
    let Some(path) = &model.path else {
        let text = "the path is not known yet";
        painter.text(bar.center(), Align2::CENTER_CENTER, text, FontId::proportional(13.0), FAINT);
        return;
    };
    let length = path.length_mm().max(1e-6);
    // The radius of the circle that is as large as a cross-section.
    let round = |area: f64| (area / std::f64::consts::PI).sqrt();
    let most = path.radius_mm.iter().copied().fold(1e-6, f64::max).max(widest_section_mm(path));
    let x = |arc: f64| bar.left() + (arc / length) as f32 * bar.width();
    let plot = Rect::from_min_max(bar.min, pos2(bar.max.x, bar.max.y - 14.0));
    // One bar a point of the screen: the least radius of its stretch.
    let columns = (plot.width() as usize).max(1);
    let mut least = vec![f64::INFINITY; columns];
    for (arc, radius) in path.arcs_mm().iter().zip(&path.radius_mm) {
        let i = ((arc / length) * columns as f64) as usize;
        let slot = &mut least[i.min(columns - 1)];
        *slot = slot.min(*radius);
    }
    let (mut last, mut bars) = (0.0, egui::Mesh::default());
    for (i, radius) in least.iter().enumerate() {
        last = if radius.is_finite() { *radius } else { last };
        let left = plot.left() + i as f32;
        let h = (last / most) as f32 * plot.height();
        let flown = left + 0.5 <= x(model.arc_mm);
        let colour = if flown { ACCENT.gamma_multiply(0.6) } else { Color32::from_rgb(70, 90, 84) };
        // Bars that meet in a corner leave no stripe at any scale of the screen.
        let top = pos2(left, plot.bottom() - h);
        bars.colored_vertex(top, colour);
        bars.colored_vertex(pos2(left + 1.0, top.y), colour);
        bars.colored_vertex(pos2(left, plot.bottom()), colour);
        bars.colored_vertex(pos2(left + 1.0, plot.bottom()), colour);
        let first = 4 * i as u32;
        bars.add_triangle(first, first + 1, first + 2);
        bars.add_triangle(first + 1, first + 2, first + 3);
    }
    painter.add(bars);
    let mut outline: Vec<Pos2> = Vec::new();
    for (arc, section) in path.arcs_mm().iter().zip(&path.sections) {
        if let Some(section) = section {
            let h = (round(section.area_mm2) / most).min(1.0) as f32 * plot.height();
            outline.push(pos2(x(*arc), plot.bottom() - h));
        } else {
            // No line over places without a section.
            let stretch = std::mem::take(&mut outline);
            painter.add(egui::Shape::line(stretch, Stroke::new(1.0, FAINT)));
        }
    }
    painter.add(egui::Shape::line(outline, Stroke::new(1.0, FAINT)));
    for cut in path.cuts_mm() {
        let line = [pos2(x(cut), plot.top()), pos2(x(cut), plot.bottom())];
        painter.line_segment(line, Stroke::new(2.0, CUT));
    }
    for choice in &model.choices {
        triangle(&painter, pos2(x(choice.arc_mm), plot.bottom()), FAINT);
    }
    for patch in model.missed_in_order().into_iter().flatten().filter(|p| !p.is_shown) {
        diamond(&painter, pos2(x(patch.arc_mm), plot.top() + 14.0), MISSED);
    }
    for finding in &model.bookmarks {
        let Some(arc) = model.arc_beside(finding) else { continue };
        let at = pos2(x(arc), plot.top() + 4.0);
        painter.circle_filled(at, 3.0, CAMERA);
        if finding.in_flight {
            painter.circle_stroke(at, 5.0, Stroke::new(1.0, CAMERA));
        }
    }
    let here = x(model.arc_mm);
    painter
        .line_segment([pos2(here, bar.top()), pos2(here, plot.bottom())], Stroke::new(2.0, CAMERA));
    let mut labels = Labels::new(&painter, rect);
    let [start, end] = model.ends.map_or(["", ""], ColonEnds::names);
    let start = format!("{start} 0 mm");
    let (left, right) = (bar.left_bottom(), bar.right_bottom());
    labels.put(start.trim(), 11.0, FAINT, &[(left, Align2::LEFT_BOTTOM)]);
    let end = format!("{end} {length:.0} mm");
    labels.put(end.trim(), 11.0, FAINT, &[(right, Align2::RIGHT_BOTTOM)]);
    // What it shows, as long as there is room.
    let long = format!("least radius (bars) and that of the section (line), to {most:.0} mm");
    for text in [long, format!("radius, to {most:.0} mm")] {
        let place = (bar.center_bottom(), Align2::CENTER_BOTTOM);
        if labels.put(&text, 11.0, FAINT, &[place]) {
            break;
        }
    }
    let turned = wheel_notches(ui) as f32 * 50.0 - wheel_sideways(ui);
    if response.hovered() && turned != 0.0 {
        let way = f64::from(-turned / bar.width()) * length;
        commands.act(Action::Travel(way));
    }
    let response = response.on_hover_text(about(path));
    if let Some(p) = response.interact_pointer_pos() {
        let arc = f64::from((p.x - bar.left()) / bar.width()) * length;
        // Where it is let go counts too.
        if response.dragged() || response.drag_stopped() {
            commands.act(Action::Seek(arc));
        } else if response.clicked() {
            commands.act(Action::FlyTo(arc));
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::junctions::tests::{path, tree};
    use super::super::model::flown_model;
    use super::*;
    use crate::volume::phantom::Kind;

    #[test]
    fn wide_places_stay_in_the_plot_where_most_poses_are_of_narrow_ones() {
        let (mut model, session) = flown_model(Kind::Colon, |_| {});
        let flight = session.flight().unwrap();
        let sections = session.sections().unwrap();
        model.take_branch(flight.as_ref().clone(), &sections, model.route);
        let path = model.path.as_ref().unwrap();
        let radii = path.sections.iter().flatten();
        let radii: Vec<f64> = radii.map(|s| (s.area_mm2 / std::f64::consts::PI).sqrt()).collect();
        let widest = radii.iter().copied().fold(0.0, f64::max);
        let plotted = widest_section_mm(path);
        assert!(plotted <= widest && plotted > 0.95 * widest, "{plotted} of {widest} mm");
    }

    /// At larger texts the bars became stripes: gaps between them fell on pixels.
    #[test]
    fn bars_of_the_scrub_bar_meet_at_every_size_of_texts() {
        let mut model = Model::new(20.0);
        model.path = Some(path(&tree(), 0));
        for scale in [1.0, 1.1, 1.25, 1.331, 2.0] {
            let context = egui::Context::default();
            context.set_pixels_per_point(scale);
            let screen = Rect::from_min_size(Pos2::ZERO, vec2(601.0, 92.0));
            let mut bars = Vec::new();
            // A scale takes effect with the next frame.
            for _ in 0..2 {
                let input = egui::RawInput { screen_rect: Some(screen), ..Default::default() };
                let mut commands = ActionQueue::default();
                let mut output = context.run_ui(input, |ui| timeline(ui, &model, &mut commands));
                output.textures_delta.clear();
                bars = output
                    .shapes
                    .into_iter()
                    .filter_map(|clipped| match clipped.shape {
                        egui::Shape::Mesh(mesh) => Some(mesh.vertices.clone()),
                        _ => None,
                    })
                    .collect();
            }
            let [bars] = &bars[..] else { panic!("{} meshes", bars.len()) };
            let of_bar: Vec<_> = bars.chunks_exact(4).collect();
            assert!(of_bar.len() > 100);
            for pair in of_bar.windows(2) {
                assert_eq!(pair[0][3].pos, pair[1][2].pos, "scale {scale}");
            }
        }
    }

    #[test]
    fn a_scrub_ends_where_the_pointer_was_let_go() {
        let mut model = Model::new(20.0);
        model.path = Some(path(&tree(), 0));
        let context = egui::Context::default();
        let at = |x: f32| pos2(x, 40.0);
        let button = |x: f32, pressed| egui::Event::PointerButton {
            pos: at(x),
            button: egui::PointerButton::Primary,
            pressed,
            modifiers: egui::Modifiers::NONE,
        };
        let frames = [
            vec![egui::Event::PointerMoved(at(100.0))],
            vec![button(100.0, true)],
            vec![egui::Event::PointerMoved(at(200.0))],
            vec![egui::Event::PointerMoved(at(400.0)), button(400.0, false)],
        ];
        let mut last = None;
        for (i, events) in frames.into_iter().enumerate() {
            let screen = Rect::from_min_size(Pos2::ZERO, vec2(600.0, 92.0));
            let time = Some(i as f64 / 30.0);
            let input =
                egui::RawInput { screen_rect: Some(screen), time, events, ..Default::default() };
            let mut commands = ActionQueue::default();
            let mut output = context.run_ui(input, |ui| timeline(ui, &model, &mut commands));
            output.textures_delta.clear();
            last = commands.actions.pop().or(last);
        }
        let Some(Action::Seek(arc)) = last else { panic!("{last:?}") };
        let share = arc / model.path.unwrap().length_mm();
        assert!((share - 400.0 / 600.0).abs() < 0.02, "{share}");
    }
}
