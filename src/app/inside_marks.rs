//! Marks over the inside view: branches that can be taken, measurements, names of the faces
//! of a cube, the scale of colours.

use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke, Vec2, pos2, vec2};
use glam::DVec3;

use super::action::{Colouring, WallView};
use super::branch_panel::{BRANCH_KEYS, BranchMark, MARK_RADIUS, branch_marks};
use super::colouring::{LEVEL, NO_WALL, SHEET, scale_colour};
use super::inside_pane::{in_pane, ray_at, taken_parts};
use super::labels::Labels;
use super::model::Model;
use super::style::{ACCENT, CAMERA, MEASURE, MISSED, SHADOW, TEXT};
use crate::render::cube_areas;

/// Text with a shadow, so that it can be read on any wall.
pub(super) fn shadowed(
    painter: &Painter,
    at: Pos2,
    anchor: Align2,
    text: &str,
    size: f32,
    colour: Color32,
) {
    let font = FontId::proportional(size);
    let galley = painter.layout_no_wrap(text.to_owned(), font, colour);
    let rect = anchor.anchor_size(at, galley.size());
    painter.rect_filled(rect.expand(2.0), 2.0, SHADOW);
    painter.galley(rect.min, galley, colour);
}

/// Marks and scales that lie over the inside view.
pub(super) fn inside_marks(painter: &Painter, rect: Rect, model: &Model) {
    let mut labels = Labels::new(painter, rect);
    let taken = taken_parts(rect, model);
    taken.iter().for_each(|part| labels.reserve(*part));
    match model.view {
        WallView::Eye => {
            offered_branches(painter, &mut labels, &taken, model);
            crosshair_mark(painter, rect, model);
            missed_mark(painter, model, true, |p| in_pane(rect, p, model));
            measurements(painter, model, |p| in_pane(rect, p, model));
        }
        WallView::Cube => face_names(painter, rect),
        WallView::Panorama => {}
    }
    if model.colouring == Colouring::Radius {
        radius_scale(painter, rect, model);
    }
    if model.colouring == Colouring::Evidence {
        evidence_legend(painter, rect, model);
    }
    if model.colouring == Colouring::Behind {
        behind_legend(painter, rect, model);
    }
}

/// Says how many clicks a measurement waits for: of the pane alone, as no picture waits for any.
pub(super) fn ruler_prompt(painter: &Painter, rect: Rect, model: &Model) {
    let Some(ruler) = model.ruler else { return };
    let left = ruler.points() - model.marks_mm.len();
    let text = format!("click {left} more, here or in a slice");
    let mut labels = Labels::new(painter, rect);
    taken_parts(rect, model).into_iter().for_each(|part| labels.reserve(part));
    let [low, high] = [8.0, 96.0].map(|y| rect.center_bottom() - vec2(0.0, y));
    let anchor = Align2::CENTER_BOTTOM;
    labels.put(&text, 13.0, MEASURE, &[(low, anchor), (high, anchor)]);
}

/// Branches by their numbers on the keys, each where it begins, or joined with that place by a line.
fn offered_branches(painter: &Painter, labels: &mut Labels<'_>, taken: &[Rect], model: &Model) {
    let (rect, offered) = (labels.rect(), model.offered());
    let stroke = Stroke::new(2.0, ACCENT);
    for BranchMark { number, place, at, .. } in branch_marks(rect, taken, model) {
        if place.distance(at) > MARK_RADIUS {
            painter.line_segment([at + (place - at).normalized() * MARK_RADIUS, place], stroke);
        }
        painter.circle_filled(at, MARK_RADIUS, SHADOW);
        painter.circle_stroke(at, MARK_RADIUS, stroke);
        let (anchor, font) = (Align2::CENTER_CENTER, FontId::proportional(13.0));
        painter.text(at, anchor, number.to_string(), font, ACCENT);
        labels.reserve(Rect::from_center_size(at, Vec2::splat(2.0 * MARK_RADIUS)));
    }
    if !offered.is_empty() {
        let keys = match offered.len() {
            1 => "another branch: key 1".to_owned(),
            n => format!("other branches: keys 1 to {}", n.min(BRANCH_KEYS.len())),
        };
        let [high, low] = [8.0, 28.0].map(|y| rect.center_top() + vec2(0.0, y));
        let (anchor, left) = (Align2::CENTER_TOP, rect.left_top() + vec2(8.0, 28.0));
        let places = [(high, anchor), (low, anchor), (left, Align2::LEFT_TOP)];
        labels.put(&keys, 13.0, ACCENT, &places);
    }
}

/// Measurements, and the points of the one that is being made, where `place` puts them.
pub(super) fn measurements(
    painter: &Painter,
    model: &Model,
    place: impl Fn(DVec3) -> Option<Pos2>,
) {
    let stroke = Stroke::new(1.5, MEASURE);
    let line = |points: &[DVec3]| {
        for w in points.windows(2) {
            if let (Some(a), Some(b)) = (place(w[0]), place(w[1])) {
                painter.line_segment([a, b], stroke);
            }
        }
        for at in points.iter().filter_map(|p| place(*p)) {
            painter.circle_filled(at, 3.0, MEASURE);
        }
    };
    let mut labels = Labels::new(painter, painter.clip_rect());
    for m in &model.measurements {
        let points = m.points();
        line(&points);
        if let Some(at) = place(points[1]) {
            labels.put(&m.label(), 12.0, MEASURE, &places_beside(at));
        }
    }
    line(&model.marks_mm);
}

/// Places of a text beside a point, the best first.
fn places_beside(at: Pos2) -> Vec<(Pos2, Align2)> {
    let corners = [
        (vec2(6.0, -6.0), Align2::LEFT_BOTTOM),
        (vec2(6.0, 6.0), Align2::LEFT_TOP),
        (vec2(-6.0, -6.0), Align2::RIGHT_BOTTOM),
        (vec2(-6.0, 6.0), Align2::RIGHT_TOP),
    ];
    let rows = (0..3u8).map(|row| 18.0 * f32::from(row));
    let places = rows.flat_map(|row| {
        corners.map(|(by, anchor)| (at + by + vec2(0.0, row * by.y.signum()), anchor))
    });
    places.collect()
}

/// Four strokes about the place that the slices show, where the eye sees it.
fn crosshair_mark(painter: &Painter, rect: Rect, model: &Model) {
    let seen = model.crosshair_in_view().and_then(|place| in_pane(rect, place, model));
    for way in [vec2(1.0, 0.0), vec2(0.0, 1.0), vec2(-1.0, 0.0), vec2(0.0, -1.0)] {
        if let Some(at) = seen {
            painter.line_segment([at + 4.0 * way, at + 10.0 * way], Stroke::new(1.5, CAMERA));
        }
    }
}

/// The missed patch that was asked for last: its outline, also where wall lies before it. It is
/// named, with its area, where there is room.
pub(super) fn missed_mark(
    painter: &Painter,
    model: &Model,
    is_named: bool,
    place: impl Fn(DVec3) -> Option<Pos2>,
) {
    let Some(missed) = &model.missed else { return };
    let stroke = Stroke::new(1.5, MISSED);
    for edge in &missed.outline_mm {
        if let [Some(a), Some(b)] = edge.map(&place) {
            painter.line_segment([a, b], stroke);
        }
    }
    if let Some(at) = place(missed.center_mm) {
        painter.circle_stroke(at, 5.0, stroke);
        if is_named {
            let text = format!("missed, {:.0} mm²", missed.area_mm2);
            shadowed(painter, at + vec2(9.0, 0.0), Align2::LEFT_CENTER, &text, 12.0, TEXT);
        }
    }
}

/// Distance at which the pointer takes a point of a measurement, points of the screen.
const GRAB_POINTS: f32 = 8.0;

/// The measurement and its point that lie under the pointer, the nearest first.
pub(super) fn mark_under(
    p: Pos2,
    model: &Model,
    place: impl Fn(DVec3) -> Option<Pos2>,
) -> Option<(usize, usize)> {
    let mut nearest = None;
    for (i, m) in model.measurements.iter().enumerate() {
        for (k, point) in m.points().into_iter().enumerate() {
            let Some(away) = place(point).map(|at| at.distance(p)) else { continue };
            if away < GRAB_POINTS && nearest.is_none_or(|(least, _)| away < least) {
                nearest = Some((away, (i, k)));
            }
        }
    }
    nearest.map(|(_, mark)| mark)
}

fn face_names(painter: &Painter, rect: Rect) {
    // In whole thousandths of the pane.
    let size = [rect.width(), rect.height()].map(|s| s.round().max(1.0) as u32);
    let names = ["front", "right", "back", "left", "up", "down"];
    for (name, [x, y, ..]) in names.into_iter().zip(cube_areas(size)) {
        let at = rect.min + vec2(x as f32 + 5.0, y as f32 + 4.0);
        // The pane's own name is there.
        let at = if y == 0 { at + vec2(0.0, 2.0) } else { at };
        shadowed(painter, at, Align2::LEFT_TOP, name, 12.0, TEXT);
    }
}

/// Draws the legend of the wall's evidence: each colour with its share of the wall.
fn evidence_legend(painter: &Painter, rect: Rect, model: &Model) {
    let Some(field) = model.products.lumen.as_ref().and_then(|l| l.wall.as_ref()) else { return };
    let percent = |share: f64| format!("{:.1} %", 100.0 * share);
    let levels = model.products.wall.as_ref().map_or(&[][..], |wall| &wall.levels);
    let area: f64 = levels.iter().map(|level| level.area_mm2).sum();
    let mut rows = vec![
        (NO_WALL, "no wall in the scan", percent(field.stats.closed_by_limit_share)),
        (SHEET, "thin sheet", percent(field.stats.sheet_share)),
    ];
    if !levels.is_empty() {
        rows.push((LEVEL, "level of fluid", format!("{area:.0} mm²")));
    }
    let mut at = rect.right_bottom() - vec2(8.0, 8.0);
    for ([r, g, b], name, share) in rows {
        let text = format!("{name} {share}");
        shadowed(painter, at - vec2(16.0, 0.0), Align2::RIGHT_BOTTOM, &text, 12.0, TEXT);
        let square = Rect::from_min_size(at - vec2(11.0, 13.0), vec2(11.0, 11.0));
        painter.rect_filled(square, 2.0, Color32::from_rgb(r, g, b));
        at.y -= 19.0;
    }
}

/// Colours of the tissue behind the wall.
fn behind_legend(painter: &Painter, rect: Rect, model: &Model) {
    let Some(behind) = &model.products.behind else { return };
    let mut at = rect.right_bottom() - vec2(8.0, 8.0);
    for (name, [r, g, b]) in behind.opacity.legend() {
        shadowed(painter, at - vec2(16.0, 0.0), Align2::RIGHT_BOTTOM, name, 12.0, TEXT);
        let square = Rect::from_min_size(at - vec2(11.0, 13.0), vec2(11.0, 11.0));
        painter.rect_filled(square, 2.0, Color32::from_rgb(r, g, b));
        at.y -= 19.0;
    }
}

/// What lies behind the wall under the pointer: its largest value.
pub(super) fn value_behind(painter: &Painter, rect: Rect, model: &Model, pointer: Pos2) {
    let is_looking = model.colouring == Colouring::Behind && model.view == WallView::Eye;
    let Some(behind) = model.products.behind.as_ref().filter(|_| is_looking) else { return };
    let ray = ray_at(rect, pointer, model);
    let (Some(place), Some(pose)) = (model.wall_behind(ray), model.pose) else { return };
    let way = (pose.rotation.as_dquat() * ray.normalize()).as_vec3();
    let Some(largest) = behind.seen(place, way).largest else { return };
    let text = format!(
        "largest value {largest:.0} HU within {} mm; a thing under {:.1} mm is not measured",
        behind.band.depth_mm,
        3.0 * behind.tissue.mean_side_mm()
    );
    let at = rect.center_bottom() - vec2(0.0, 8.0);
    shadowed(painter, at, Align2::CENTER_BOTTOM, &text, 12.0, TEXT);
}

fn radius_scale(painter: &Painter, rect: Rect, model: &Model) {
    let Some(radii) = &model.products.centerline_distances else { return };
    let bar =
        Rect::from_min_size(pos2(rect.right() - 24.0, rect.center().y - 70.0), vec2(12.0, 140.0));
    const STEPS: u8 = 64;
    for i in 0..STEPS {
        let share = f64::from(i) / f64::from(STEPS - 1);
        let [r, g, b] = scale_colour(share);
        let h = bar.height() / f32::from(STEPS);
        let y = bar.bottom() - f32::from(i + 1) * h;
        let part = Rect::from_min_size(pos2(bar.left(), y), vec2(bar.width(), h + 0.5));
        painter.rect_filled(part, 0.0, Color32::from_rgb(r, g, b));
    }
    let label = |at: Pos2, anchor, text: String| {
        shadowed(painter, at, anchor, &text, 11.0, CAMERA);
    };
    let widest = radii.widest_mm;
    label(bar.right_top() - vec2(0.0, 4.0), Align2::RIGHT_BOTTOM, format!("{widest:.1} mm"));
    label(bar.right_bottom() + vec2(0.0, 4.0), Align2::RIGHT_TOP, "0".into());
}

#[cfg(test)]
mod tests {
    use super::super::measure::Measurement;
    use super::super::panel_tests::TestScreen;
    use super::*;

    /// Beside each other they read "109.2°20.8 mm".
    #[test]
    fn texts_of_measurements_close_by_do_not_lie_over_each_other() {
        let mut model = Model::new(20.0);
        let length = |by: f64| [DVec3::ZERO, DVec3::new(60.0 + by, 40.0, 0.0)];
        let of = |by| Measurement::of(super::super::action::Ruler::Length, &length(by)).unwrap();
        model.measurements = [0.0, 2.0, 4.0, 30.0].map(of).to_vec();
        let texts = TestScreen::new().frame(Vec::new(), |ui| {
            let place = |p: DVec3| Some(pos2(300.0 + p.x as f32, 300.0 + p.y as f32));
            measurements(ui.painter(), &model, place);
        });
        assert_eq!(texts.len(), 4, "{texts:?}");
        for (i, (_, a)) in texts.iter().enumerate() {
            assert!(texts[..i].iter().all(|(_, b)| !a.intersects(*b)), "{texts:?}");
        }
    }
}
