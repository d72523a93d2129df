//! Panels in tests: laid out without a window, their texts read and clicked.

use egui::{Event, Pos2, Rect, Ui, vec2};

use super::slice_pane::tests::button;

/// A screen on which panels are laid out, a thirtieth of a second a frame.
pub(super) struct TestScreen {
    context: egui::Context,
    size: egui::Vec2,
    frames: u32,
}

impl TestScreen {
    /// A screen of 800 by 600 points.
    pub fn new() -> Self {
        Self::sized(vec2(800.0, 600.0))
    }

    pub fn sized(size: egui::Vec2) -> Self {
        Self { context: egui::Context::default(), size, frames: 0 }
    }

    /// Lays out one frame; the texts that it shows, with their places.
    pub fn frame(&mut self, events: Vec<Event>, ui: impl FnMut(&mut Ui)) -> Vec<(String, Rect)> {
        let screen = Rect::from_min_size(Pos2::ZERO, self.size);
        let time = Some(f64::from(self.frames) / 30.0);
        self.frames += 1;
        let input =
            egui::RawInput { screen_rect: Some(screen), time, events, ..Default::default() };
        let mut output = self.context.run_ui(input, ui);
        output.textures_delta.clear();
        let mut texts = Vec::new();
        for clipped in &output.shapes {
            collect_texts(&clipped.shape, &mut texts);
        }
        texts
    }

    /// Rests the pointer on the first text that reads so; the texts that are shown then.
    pub fn hover(&mut self, text: &str, mut ui: impl FnMut(&mut Ui)) -> Vec<String> {
        self.frame(Vec::new(), &mut ui);
        let texts = self.frame(Vec::new(), &mut ui);
        let at = texts.iter().find(|(shown, _)| shown == text).map(|(_, rect)| rect.center());
        let at = at.unwrap_or_else(|| panic!("{text:?} is not among {texts:?}"));
        self.frame(vec![Event::PointerMoved(at)], &mut ui);
        // Longer than the delay of hints.
        (0..40).for_each(|_| drop(self.frame(Vec::new(), &mut ui)));
        self.frame(Vec::new(), &mut ui).into_iter().map(|(shown, _)| shown).collect()
    }

    /// Clicks the first text that reads so.
    pub fn click(&mut self, text: &str, mut ui: impl FnMut(&mut Ui)) {
        let texts = self.frame(Vec::new(), &mut ui);
        let at = texts.iter().find(|(shown, _)| shown == text).map(|(_, rect)| rect.center());
        let at = at.unwrap_or_else(|| panic!("{text:?} is not among {texts:?}"));
        self.frame(vec![Event::PointerMoved(at)], &mut ui);
        self.frame(vec![button(at, true)], &mut ui);
        self.frame(vec![button(at, false)], &mut ui);
    }
}

fn collect_texts(shape: &egui::Shape, into: &mut Vec<(String, Rect)>) {
    match shape {
        egui::Shape::Vec(all) => all.iter().for_each(|s| collect_texts(s, into)),
        egui::Shape::Text(text) => {
            let rect = text.visual_bounding_rect();
            into.push((text.galley.text().to_owned(), rect));
        }
        _ => {}
    }
}
