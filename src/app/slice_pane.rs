//! A pane with a slice of the volume: its texture, marks and input.

use egui::{Align2, Color32, Pos2, Rect, Response, Stroke, Ui, pos2, vec2};
use glam::DVec3;

use super::action::{Action, ActionQueue, Pane, Request, SliceExtent};
use super::grey_window::{value_text, window_text};
use super::inside_marks::{mark_under, measurements, missed_mark};
use super::labels::Labels;
use super::model::Model;
use super::slices::{Slab, SlicePlane, nearest_inside, slice, slice_step_mm, value_at};
use super::style::{CAMERA, TEXT, pinch, pixels, wheel_notches, wheel_sideways};
use super::wall_outline::draw_wall_outline;
use crate::volume::Volume;

const CROSSHAIR: Color32 = Color32::from_rgba_premultiplied(120, 94, 28, 150);

/// Inputs of a slice but the volume.
#[derive(Clone, Copy, PartialEq)]
struct SliceInput {
    plane: SlicePlane,
    /// Columns and rows, pixels.
    size: [usize; 2],
    /// Centre and width of the grey values.
    window: [f64; 2],
    slab: Option<Slab>,
    /// Whether there is a lumen to be outlined, or a wall.
    has: [bool; 2],
}

/// A slice as a texture.
struct SliceTexture {
    texture: egui::TextureHandle,
    input: SliceInput,
    /// Frame in which it was sampled.
    frame: u64,
}

impl SliceTexture {
    /// Whether it is shown for a frame more although its plane has moved: it was sampled in the last
    /// frame, and this one samples others.
    fn waits(&self, index: usize, frame: u64, input: SliceInput) -> bool {
        let only_moved = SliceInput { plane: self.input.plane, ..input } == self.input;
        only_moved && frame <= self.frame + 1 && (frame + index as u64) % 2 == 1
    }
}

/// Offset and textures of the slices.
#[derive(Default)]
pub(super) struct SliceViews {
    textures: [Option<SliceTexture>; 4],
    /// Whether slices are sampled in turn while the eye flies.
    pub in_turn: bool,
    /// Number of times that the model had led the slices to a place.
    centred: u64,
    /// Offset from the crosshair to the middle of each slice, LPS mm.
    pan_mm: [DVec3; 4],
    /// Offset for slices in which the crosshair is dragged: they stay under the pointer.
    held_mm: [DVec3; 4],
    /// Place the crosshair was dragged to last.
    dragged_to_mm: Option<DVec3>,
    /// Measurement, and point of it, that is dragged.
    grabbed: Option<(usize, usize)>,
    /// Measurement, and point of it, that is dragged in the inside view.
    pub grabbed_inside: Option<(usize, usize)>,
}

impl SliceViews {
    /// * `in_turn`: while the eye flies, half of the slices are sampled in a frame.
    pub fn new(in_turn: bool) -> Self {
        Self { in_turn, ..Self::default() }
    }
}

/// Samples the slice where it has changed, and takes crosshair, window and zoom from the mouse.
pub(super) fn show_slice(
    ui: &mut Ui,
    pane: Pane,
    rect: Rect,
    response: &Response,
    model: &Model,
    views: &mut SliceViews,
    commands: &mut ActionQueue,
) {
    let painter = ui.painter_at(rect);
    let Some(volume) = model.volume() else { return };
    let size = pixels(ui, rect).map(|s| s as usize);
    let extent = model.extent_mm(pane).map(|mm| mm / shorter_px(size));
    let mm_per_px = extent.unwrap_or_else(|| mm_to_fit(volume, pane, size));
    if views.centred != model.centred {
        views.centred = model.centred;
        (views.pan_mm, views.held_mm, views.dragged_to_mm) = Default::default();
    }
    let index = index_of(pane);
    if views.dragged_to_mm.is_some_and(|to| to != model.crosshair_mm) {
        // Moved by something else since: all slices follow it.
        (views.held_mm, views.dragged_to_mm) = Default::default();
    }
    let at = |place| SlicePlane::of(pane, place, mm_per_px, model.across_pose());
    let Some(mut plane) = at(model.crosshair_mm) else { return };
    let way = plane.way_into(volume, size);
    plane.centre_mm += way + views.pan_mm[index] + views.held_mm[index];
    // Until there is a wall, the edge of the voxels is shown.
    let wall = model.products.triangle_tree.as_deref();
    let lumen = model.products.lumen.as_ref().map(|l| &l.lumen).filter(|_| wall.is_none());
    let has = [lumen.is_some(), wall.is_some()];
    let is_moving = model.is_moving() || ui.input(|i| i.pointer.any_down());
    let most = Slab::PLANES[usize::from(is_moving)];
    let slab = model.slab.map(|mode| Slab { mode, thickness_mm: model.slab_mm, most });
    let input = SliceInput { plane, size, window: model.window, slab, has };
    let slot = &mut views.textures[index];
    let frame = ui.ctx().cumulative_frame_nr();
    let takes_turns = views.in_turn && model.playing;
    let is_stale = slot.as_ref().is_none_or(|s| s.input != input);
    let waits = |s: &&mut SliceTexture| takes_turns && s.waits(index, frame, input);
    if is_stale && let Some(s) = slot.as_mut().filter(waits) {
        // Marks lie on the shown plane.
        plane = s.input.plane;
        ui.ctx().request_repaint();
    } else if is_stale {
        let mut rgb = slice(volume, lumen, &plane, size, model.window, slab);
        wall.iter().for_each(|tree| draw_wall_outline(tree, &plane, size, &mut rgb));
        let pixels = rgb.into_iter().map(|[r, g, b]| Color32::from_rgb(r, g, b)).collect();
        let image = egui::ColorImage::new(size, pixels);
        let options = egui::TextureOptions::NEAREST;
        match slot {
            Some(s) => {
                s.texture.set(image, options);
                (s.input, s.frame) = (input, frame);
            }
            None => {
                let texture = ui.ctx().load_texture(pane.title(), image, options);
                *slot = Some(SliceTexture { texture, input, frame });
            }
        }
    }
    if let Some(s) = slot {
        let all = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
        painter.image(s.texture.id(), rect, all, Color32::WHITE);
    }
    let shown = ShownSlice { pane, rect, size, plane, scale: f64::from(ui.pixels_per_point()) };
    let under = response.hover_pos().map(|p| shown.place(p));
    slice_marks(&painter, &shown, model, under);
    pointer_input(ui, response, &shown, model, views, commands);
    wheel_input(ui, response, &shown, model, views, commands);
}

/// A slice where it is on the screen.
struct ShownSlice {
    pane: Pane,
    rect: Rect,
    /// Columns and rows, pixels.
    size: [usize; 2],
    plane: SlicePlane,
    /// Pixels a point of the screen.
    scale: f64,
}

impl ShownSlice {
    /// The place under a point of the screen, LPS mm.
    fn place(&self, p: Pos2) -> DVec3 {
        let px = [p.x - self.rect.min.x, p.y - self.rect.min.y];
        self.plane.at(px.map(|v| f64::from(v) * self.scale), self.size)
    }

    /// The point of the screen over a place, and how far that is from the plane, mm.
    fn point(&self, place: DVec3) -> (Pos2, f64) {
        let (px, off) = self.plane.px(place, self.size);
        let [x, y] = px.map(|v| (v / self.scale) as f32);
        (self.rect.min + vec2(x, y), off)
    }

    /// The point over a place that lies in the slice, or near enough to be marked in it.
    fn point_in(&self, place: DVec3) -> Option<Pos2> {
        let (at, off) = self.point(place);
        (off.abs() < 3.0 * self.plane.mm_per_px.max(1.0)).then_some(at)
    }

    fn index(&self) -> usize {
        index_of(self.pane)
    }
}

/// Number of a pane among those of slices.
fn index_of(pane: Pane) -> usize {
    match pane {
        Pane::Axial => 0,
        Pane::Coronal => 1,
        Pane::Sagittal => 2,
        _ => 3,
    }
}

/// Takes clicks, the crosshair, points of measurements, pan and grey values from the pointer.
fn pointer_input(
    ui: &Ui,
    response: &Response,
    shown: &ShownSlice,
    model: &Model,
    views: &mut SliceViews,
    commands: &mut ActionQueue,
) {
    let Some(volume) = model.volume() else { return };
    let (index, plane) = (shown.index(), &shown.plane);
    let shift = ui.input(|i| i.modifiers.shift);
    let primary = response.dragged_by(egui::PointerButton::Primary);
    let mark_at = |p| mark_under(p, model, |place| shown.point_in(place));
    if response.drag_started_by(egui::PointerButton::Primary) {
        let pressed = ui.input(|i| i.pointer.press_origin());
        views.grabbed = pressed.filter(|_| !shift).and_then(mark_at);
    }
    if let Some((measurement, point)) = views.grabbed.filter(|_| primary) {
        let to = response.interact_pointer_pos().map(|p| shown.place(p).to_array());
        to.into_iter().for_each(|to| commands.act(Action::MoveMark { measurement, point, to }));
    } else if response.dragged_by(egui::PointerButton::Middle) || (primary && shift) {
        let d = response.drag_delta() * shown.scale as f32;
        let by = plane.right * f64::from(d.x) + plane.down * f64::from(d.y);
        views.pan_mm[index] -= by * plane.mm_per_px;
    } else if let Some(p) = response.interact_pointer_pos() {
        let place = shown.place(p);
        if primary {
            let to = nearest_inside(volume, place);
            // Plus the shift of the slice at an end of the volume.
            let middle = |at: DVec3| {
                at + SlicePlane { centre_mm: at, ..*plane }.way_into(volume, shown.size)
            };
            views.held_mm[index] += middle(model.crosshair_mm) - middle(to);
            views.dragged_to_mm = Some(to);
            commands.act(Action::Crosshair(to.to_array()));
        } else if response.clicked() {
            match model.ruler {
                Some(_) => commands.act(Action::MarkInSlice(place.to_array())),
                None if model.path.is_some() => {
                    commands.ask(Request::FlyThrough(place.to_array()));
                }
                None => commands.act(Action::Crosshair(place.to_array())),
            }
        }
    } else if let Some(p) = response.hover_pos().filter(|_| shift) {
        // The other slices follow the pointer.
        if ui.input(|i| i.pointer.delta()) != egui::Vec2::ZERO {
            let to = nearest_inside(volume, shown.place(p));
            commands.act(Action::Crosshair(to.to_array()));
        }
    } else if response.hover_pos().and_then(mark_at).is_some() {
        ui.set_cursor_icon(egui::CursorIcon::Grab);
    }
    if response.dragged_by(egui::PointerButton::Secondary) {
        let d = response.drag_delta();
        let [centre, width] = model.window;
        let step = (width / 300.0).max(0.01);
        let width = width + f64::from(d.x) * step;
        commands.act(Action::Window([centre + f64::from(d.y) * step, width]));
    }
}

/// Takes zoom, the next slice and a shift to the side from the wheel.
fn wheel_input(
    ui: &Ui,
    response: &Response,
    shown: &ShownSlice,
    model: &Model,
    views: &mut SliceViews,
    commands: &mut ActionQueue,
) {
    let Some(volume) = model.volume().filter(|_| response.hovered()) else { return };
    let sideways = f64::from(wheel_sideways(ui)) * shown.scale;
    views.pan_mm[shown.index()] += shown.plane.right * sideways * shown.plane.mm_per_px;
    let (notches, plane) = (wheel_notches(ui), &shown.plane);
    let is_zoom = ui.input(|i| i.modifiers.ctrl);
    let zoom = pinch(ui) * if is_zoom { 0.9f64.powf(-notches) } else { 1.0 };
    if zoom != 1.0 {
        let mm = plane.mm_per_px * shorter_px(shown.size) / zoom;
        commands.act(Action::Extent(SliceExtent::Mm(mm)));
    } else if notches != 0.0 {
        let normal = plane.right.cross(plane.down);
        let p = model.crosshair_mm + normal * slice_step_mm(volume, normal) * notches;
        commands.act(Action::Crosshair(p.to_array()));
    }
}

/// Pixels of the shorter side of a pane.
fn shorter_px(size: [usize; 2]) -> f64 {
    size[0].min(size[1]).max(1) as f64
}

/// Millimetres a pixel at which a slice through the middle shows all of the volume.
fn mm_to_fit(volume: &Volume, pane: Pane, [width, height]: [usize; 2]) -> f64 {
    let grid = &volume.grid;
    let sides = grid.dims.as_dvec3() * grid.spacing_mm;
    let column = |i: usize| grid.direction.col(i).abs() * sides[i];
    let box_mm = column(0) + column(1) + column(2);
    let (across, down) = match pane {
        Pane::Axial => (box_mm.x, box_mm.y),
        Pane::Coronal => (box_mm.x, box_mm.z),
        Pane::Sagittal => (box_mm.y, box_mm.z),
        // Of a slice that may lie any way about.
        _ => (box_mm.max_element(), box_mm.max_element()),
    };
    (across / width.max(1) as f64).max(down / height.max(1) as f64).max(1e-3)
}

/// Crosshair, eye, measurements and texts. `under`: the place under the pointer.
fn slice_marks(painter: &egui::Painter, shown: &ShownSlice, model: &Model, under: Option<DVec3>) {
    let (rect, plane, scale) = (shown.rect, &shown.plane, shown.scale);
    let (c, _) = shown.point(model.crosshair_mm);
    let thin = Stroke::new(1.0, CROSSHAIR);
    painter.line_segment([pos2(rect.left(), c.y), pos2(rect.right(), c.y)], thin);
    painter.line_segment([pos2(c.x, rect.top()), pos2(c.x, rect.bottom())], thin);
    if let Some(pose) = model.pose {
        let eye = pose.position_mm.as_dvec3();
        if let Some(at) = shown.point_in(eye).filter(|at| rect.contains(*at)) {
            let ahead = eye + 15.0 * plane.mm_per_px * pose.forward().as_dvec3();
            painter.circle_filled(at, 3.5, CAMERA);
            painter.line_segment([at, shown.point(ahead).0], Stroke::new(2.0, CAMERA));
        }
    }
    missed_mark(painter, model, false, |place| shown.point_in(place));
    measurements(painter, model, |place| shown.point_in(place));
    let mut labels = Labels::new(painter, rect);
    let along = (shown.pane == Pane::Across).then(|| model.plane_along_finding()).flatten();
    labels.title(if along.is_some() { "Along the finding" } else { shown.pane.title() });
    slice_labels(&mut labels, plane, model.window, scale);
    if let Some(place) = under {
        value_under(&mut labels, place, model);
    }
}

/// Sides of the patient, a bar of a centimetre, the window of grey values.
pub(super) fn slice_labels(
    labels: &mut Labels<'_>,
    plane: &SlicePlane,
    [centre, width]: [f64; 2],
    scale: f64,
) {
    let rect = labels.rect();
    let m = 8.0;
    let [left, right, up, down] = plane.sides();
    let (top, bottom) = (rect.center_top(), rect.center_bottom());
    let below = |y: f32| (top + vec2(0.0, y), Align2::CENTER_TOP);
    let above = |y: f32| (bottom - vec2(0.0, y), Align2::CENTER_BOTTOM);
    for (text, places) in [
        (up, [below(4.0), below(22.0)]),
        (down, [above(4.0), above(22.0)]),
        (left, [(rect.left_center() + vec2(m, 0.0), Align2::LEFT_CENTER); 2]),
        (right, [(rect.right_center() - vec2(m, 0.0), Align2::RIGHT_CENTER); 2]),
    ] {
        labels.put(&text, 13.0, TEXT, &places);
    }
    let end = rect.right_bottom() - vec2(m, 7.0);
    let text = end - vec2(0.0, 3.0);
    if labels.put("1 cm", 11.0, TEXT, &[(text, Align2::RIGHT_BOTTOM)]) {
        labels.bar(end, (10.0 / plane.mm_per_px / scale) as f32);
    }
    let text = window_text([centre, width]);
    let places = [4.0, 22.0, 40.0].map(|y| rect.left_bottom() + vec2(m, -y));
    labels.put(&text, 11.0, TEXT, &places.map(|at| (at, Align2::LEFT_BOTTOM)));
}

/// Writes the value under the pointer, above the window of the grey values.
fn value_under(labels: &mut Labels<'_>, place: DVec3, model: &Model) {
    let Some(value) = model.volume().and_then(|volume| value_at(volume, place)) else { return };
    let corner = labels.rect().left_bottom();
    let places = [20.0, 38.0, 56.0].map(|y| (corner + vec2(8.0, -y), Align2::LEFT_BOTTOM));
    labels.put(&value_text(value, model.value_range()), 12.0, TEXT, &places);
}

#[cfg(test)]
pub(super) mod tests {
    use std::sync::Arc;

    use super::*;
    use crate::app::action::Ruler;
    use crate::session::{Product, Session, Settings, Source, VolumeSource};
    use crate::volume::phantom::{Kind, Phantom};

    /// A model of a label map of 64 mm.
    pub fn model_of_a_volume() -> Model {
        model_of(Phantom::new(Kind::Tube, 64, [1.0; 3]).unwrap().mask())
    }

    /// A model of a volume of which nothing more is known.
    pub fn model_of(volume: Volume) -> Model {
        let source = Source::Image(VolumeSource::Memory(Arc::new(volume)));
        let mut session = Session::new(source, Settings::default()).unwrap();
        session.keep_volume();
        let wanted = [Product::Volume, Product::ValueRange];
        session.prepare(&wanted).unwrap();
        let mut model = Model::new(20.0);
        model.update(session.products(&wanted));
        model
    }

    /// Feeds a pane of 200 points with events, a list a frame.
    fn shown(frames: &[Vec<egui::Event>], each: impl FnMut(&Model, &ActionQueue)) {
        shown_of(model_of_a_volume(), frames, each);
    }

    fn shown_of(
        mut model: Model,
        frames: &[Vec<egui::Event>],
        mut each: impl FnMut(&Model, &ActionQueue),
    ) {
        let (context, mut views) = (egui::Context::default(), SliceViews::default());
        let rect = Rect::from_min_size(Pos2::ZERO, vec2(200.0, 200.0));
        for (i, events) in frames.iter().enumerate() {
            let mut commands = ActionQueue::default();
            let input = egui::RawInput {
                screen_rect: Some(rect),
                time: Some(i as f64 / 30.0),
                events: events.clone(),
                ..Default::default()
            };
            let mut output = context.run_ui(input, |ui| {
                let response = ui.allocate_rect(rect, egui::Sense::click_and_drag());
                show_slice(ui, Pane::Axial, rect, &response, &model, &mut views, &mut commands);
            });
            output.textures_delta.clear();
            model.step(0.0, &commands.actions);
            each(&model, &commands);
        }
    }

    #[test]
    fn while_the_eye_flies_slices_are_sampled_in_turn() {
        let (mut model, context) = (model_of_a_volume(), egui::Context::default());
        let mut views = SliceViews::new(true);
        let rect = Rect::from_min_size(Pos2::ZERO, vec2(200.0, 200.0));
        let mut sampled = Vec::new();
        for i in 0..8 {
            model.playing = i < 6;
            model.crosshair_mm += DVec3::splat(0.01);
            let input = egui::RawInput { screen_rect: Some(rect), ..Default::default() };
            let mut output = context.run_ui(input, |ui| {
                for pane in [Pane::Axial, Pane::Coronal] {
                    let id = ui.id().with(pane.title());
                    let response = ui.interact(rect, id, egui::Sense::click_and_drag());
                    let mut commands = ActionQueue::default();
                    show_slice(ui, pane, rect, &response, &model, &mut views, &mut commands);
                }
            });
            output.textures_delta.clear();
            let now = context.cumulative_frame_nr() - 1;
            let frame = |index: usize| views.textures[index].as_ref().unwrap().frame;
            sampled.push([0, 1].map(|index| frame(index) == now));
        }
        assert_eq!([sampled[0], sampled[6], sampled[7]], [[true; 2]; 3]);
        for pair in sampled[1..6].windows(2) {
            assert!(pair[0][0] != pair[0][1] && pair[0] != pair[1], "{sampled:?}");
        }
    }

    pub fn button(pos: Pos2, pressed: bool) -> egui::Event {
        let button = egui::PointerButton::Primary;
        egui::Event::PointerButton { pos, button, pressed, modifiers: egui::Modifiers::NONE }
    }

    /// A click did nothing, only a drag.
    #[test]
    fn a_click_before_there_is_a_path_moves_the_crosshair_and_another_lumen_leaves_it_there() {
        let (mut model, at) = (model_of_a_volume(), pos2(150.0, 100.0));
        let before = model.crosshair_mm;
        model.step(0.0, &[Action::Window([10.0, 50.0])]);
        let frames = [
            vec![egui::Event::PointerMoved(at)],
            vec![button(at, true)],
            vec![button(at, false)],
            vec![],
        ];
        let mut moved = Vec::new();
        shown_of(model, &frames, |model, _| {
            let anew = model.reset_lumen();
            assert_eq!((anew.crosshair_mm, anew.window), (model.crosshair_mm, model.window));
            assert_eq!(anew.window, [10.0, 50.0]);
            moved.push(model.crosshair_mm - before);
        });
        // A quarter of the pane is a quarter of the 64 mm that it shows.
        let last = moved.last().unwrap();
        assert!((last.x.abs() - 16.0).abs() < 0.5 && last.y.abs() < 0.5, "{moved:?}");
    }

    #[test]
    fn a_dragged_crosshair_stays_under_the_pointer_and_in_the_volume() {
        let at = |x: f32| pos2(x, 100.0);
        let mut frames = vec![vec![egui::Event::PointerMoved(at(100.0))]];
        frames.push(vec![button(at(100.0), true)]);
        frames
            .extend((1..=10).map(|i| vec![egui::Event::PointerMoved(at(100.0 + 5.0 * i as f32))]));
        // The pointer rests, then leaves the volume.
        frames.extend([vec![], vec![], vec![], vec![egui::Event::PointerMoved(at(199.0))]]);
        frames.extend([vec![], vec![], vec![button(at(199.0), false)]]);
        let mut places = Vec::new();
        shown(&frames, |model, _| places.push(model.crosshair_mm.x));
        // A quarter of the pane is a quarter of the 64 mm that it shows.
        let moved = places[11] - places[0];
        assert!((moved - 16.0).abs() < 0.5, "{moved} mm for 50 of 200 points: {places:?}");
        assert_eq!(places[11..=14], [places[11]; 4], "it rests with the pointer");
        let last = places[places.len() - 1] - places[0];
        assert!((31.0..=32.0).contains(&last), "it ends at the side of the volume: {last} mm");
    }

    #[test]
    fn at_an_end_of_the_volume_no_half_of_a_slice_is_empty() {
        let model = model_of_a_volume();
        let volume = model.volume().unwrap();
        let [first, last] =
            [0.0, 63.0].map(|v| volume.grid.world_from_voxel().transform_point3(DVec3::splat(v)));
        let (size, turn) = ([100, 60], glam::DQuat::from_rotation_z(0.5));
        let pose =
            crate::geometry::Pose { position_mm: glam::Vec3::ZERO, rotation: turn.as_quat() };
        for at in [first, last, DVec3::new(first.x, last.y, first.z)] {
            for pane in [Pane::Axial, Pane::Coronal, Pane::Sagittal, Pane::Across] {
                for mm_per_px in [0.3, 1.5] {
                    let mut plane = SlicePlane::of(pane, at, mm_per_px, Some(pose)).unwrap();
                    let way = plane.way_into(volume, size);
                    assert!(way.dot(plane.right.cross(plane.down)).abs() < 1e-9, "another slice");
                    plane.centre_mm += way;
                    let seen = (0..6000).filter(|i| {
                        let px = [i % 100, i / 100].map(|v| f64::from(v) + 0.5);
                        value_at(volume, plane.at(px, size)).is_some()
                    });
                    // As much as there is of the volume and room for it; a corner of a slice
                    // askew is a triangle.
                    let all = (64.0 / mm_per_px).min(100.0) * (64.0 / mm_per_px).min(60.0);
                    let least = if pane == Pane::Across { 0.0 } else { 0.95 * all };
                    let seen = seen.count() as f64;
                    assert!(seen >= least, "{pane:?} {mm_per_px} {at}: {seen} of {all} pixels");
                }
            }
        }
        // In the middle nothing is shifted.
        let middle = model.crosshair_mm;
        let plane = SlicePlane::of(Pane::Axial, middle, 0.3, None).unwrap();
        assert!(plane.way_into(volume, size).length() < 1e-9);
    }

    #[test]
    fn a_crosshair_dragged_to_an_end_of_the_volume_stays_under_the_pointer() {
        let mut model = model_of_a_volume();
        // Half of the volume is shown: near its side the slice stays while the crosshair goes on.
        let begin = model.crosshair_mm + 20.0 * DVec3::X;
        model.step(0.0, &[Action::Crosshair(begin.to_array())]);
        model.step(0.0, &[Action::Extent(SliceExtent::Mm(32.0))]);
        let at = |x: f32| pos2(x, 100.0);
        // The slice ends 31.5 mm from the middle, so that 15.5 are in view of the 16 to its centre.
        let from = 100.0 + (20.0 - 15.5) / 32.0 * 200.0;
        let mut frames = vec![vec![egui::Event::PointerMoved(at(from))]];
        frames.push(vec![button(at(from), true)]);
        frames.extend((1..=10).map(|i| vec![egui::Event::PointerMoved(at(from - 6.0 * i as f32))]));
        frames.push(vec![button(at(from - 60.0), false)]);
        let mut last = begin;
        shown_of(model, &frames, |model, _| last = model.crosshair_mm);
        let moved = begin.x - last.x;
        assert!((moved - 60.0 / 200.0 * 32.0).abs() < 0.3, "{moved} mm for 60 of 200 points");
    }

    #[test]
    fn a_dragged_point_of_a_measurement_moves_and_the_crosshair_stays() {
        let at = |x: f32| pos2(x, 100.0);
        let mut model = model_of_a_volume();
        // Its first point lies under the middle of the pane, its second 16 mm to the right.
        let begin = model.crosshair_mm;
        let end = begin + 16.0 * DVec3::X;
        model.step(0.0, &[Action::Measure(Some(Ruler::Length))]);
        model.step(0.0, &[Action::Mark(begin.to_array()), Action::Mark(end.to_array())]);
        model.step(0.0, &[Action::Measure(None)]);
        let mut frames = vec![vec![egui::Event::PointerMoved(at(150.0))]];
        frames.push(vec![button(at(150.0), true)]);
        frames
            .extend((1..=10).map(|i| vec![egui::Event::PointerMoved(at(150.0 - 2.5 * i as f32))]));
        frames.push(vec![button(at(125.0), false)]);
        let mut last = (0.0, begin);
        shown_of(model, &frames, |model, _| {
            last = (model.measurements[0].value(), model.crosshair_mm);
        });
        assert!((last.0 - 8.0).abs() < 0.5, "{} mm after half the way back", last.0);
        assert_eq!(last.1, begin);
    }
}
