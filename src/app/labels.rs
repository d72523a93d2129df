//! Texts over a pane: each on a dark ground, so that it can be read on any picture, and none over
//! another.

use egui::{Align2, Color32, FontId, Painter, Pos2, Rect, Stroke, pos2, vec2};

use super::style::SHADOW;
use super::style::TEXT;

/// Texts of one pane.
pub(super) struct Labels<'a> {
    painter: &'a Painter,
    rect: Rect,
    taken: Vec<Rect>,
}

impl<'a> Labels<'a> {
    /// No texts yet.
    ///
    /// * `rect`: the pane.
    pub fn new(painter: &'a Painter, rect: Rect) -> Self {
        Self { painter, rect, taken: Vec::new() }
    }

    /// Returns the pane.
    pub fn rect(&self) -> Rect {
        self.rect
    }

    /// Draws a bar so long to the left of a point, cut at the pane's edge.
    pub fn bar(&mut self, end: Pos2, length: f32) {
        let start = pos2((end.x - length).max(self.rect.left()), end.y);
        self.painter.line_segment([start, end], Stroke::new(4.0, SHADOW));
        self.painter.line_segment([start, end], Stroke::new(2.0, TEXT));
    }

    /// Keeps a part of the pane free.
    pub fn reserve(&mut self, part: Rect) {
        self.taken.push(part);
    }

    /// Writes a text at the first of some places where it lies within the pane and over nothing;
    /// whether there was one.
    pub fn put(
        &mut self,
        text: &str,
        size: f32,
        colour: Color32,
        places: &[(Pos2, Align2)],
    ) -> bool {
        let galley =
            self.painter.layout_no_wrap(text.to_owned(), FontId::proportional(size), colour);
        let ground = |(at, anchor): &(Pos2, Align2)| {
            anchor.anchor_size(*at, galley.size()).expand2(vec2(2.0, 0.0))
        };
        let is_free =
            |r: &Rect| self.rect.contains_rect(*r) && self.taken.iter().all(|t| !t.intersects(*r));
        let Some(ground) = places.iter().map(ground).find(is_free) else { return false };
        self.painter.rect_filled(ground, 2.0, SHADOW);
        self.painter.galley(ground.min + vec2(2.0, 0.0), galley, colour);
        self.taken.push(ground);
        true
    }

    /// Writes the name of the pane into its corner, or its first word where there is no more room.
    pub fn title(&mut self, text: &str) {
        let place = (self.rect.left_top() + vec2(6.0, 4.0), Align2::LEFT_TOP);
        if !self.put(text, 12.0, TEXT, &[place]) {
            let first = text.split(' ').next().unwrap_or_default();
            self.put(first, 12.0, TEXT, &[place]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::action::Pane;
    use super::super::slice_pane::slice_labels;
    use super::super::slices::SlicePlane;
    use super::*;

    /// Grounds of the texts of a slice in a pane of this size.
    fn grounds(width: f32, height: f32, scale: f32) -> Vec<Rect> {
        let context = egui::Context::default();
        let mut found = Vec::new();
        let screen = Rect::from_min_size(Pos2::ZERO, vec2(width, height));
        let mut input = egui::RawInput { screen_rect: Some(screen), ..Default::default() };
        let viewport = input.viewports.entry(egui::ViewportId::ROOT).or_default();
        viewport.native_pixels_per_point = Some(scale);
        let mut output = context.run_ui(input, |ui| {
            let painter = ui.painter_at(screen);
            let (y, x) = 0.7f64.sin_cos();
            // Oblique: two letters a side.
            let plane = SlicePlane {
                centre_mm: glam::DVec3::ZERO,
                right: glam::DVec3::new(x, y, 0.0),
                down: glam::DVec3::new(-y, x, 0.0),
                mm_per_px: 0.7,
            };
            let mut labels = Labels::new(&painter, screen);
            labels.title(Pane::Across.title());
            slice_labels(&mut labels, &plane, [-200.0, 1800.0], f64::from(scale));
            found = labels.taken;
        });
        output.textures_delta.clear();
        found
    }

    #[test]
    fn letters_of_a_slice_do_not_collide_at_small_sizes_and_at_scale_2() {
        for scale in [1.0, 2.0] {
            for (width, height) in
                [(400.0, 300.0), (120.0, 160.0), (90.0, 120.0), (120.0, 60.0), (40.0, 30.0)]
            {
                let all = grounds(width, height, scale);
                for (i, a) in all.iter().enumerate() {
                    assert!(
                        a.min.x >= 0.0 && a.min.y >= 0.0 && a.max.x <= width && a.max.y <= height,
                        "{a:?} leaves a pane of {width} x {height}"
                    );
                    for b in &all[i + 1..] {
                        assert!(!a.intersects(*b), "{a:?} over {b:?} in {width} x {height}");
                    }
                }
                let is_small = width < 100.0 || height < 100.0;
                assert!(is_small || all.len() == 7, "{} texts in {width} x {height}", all.len());
            }
        }
    }
}
