//! Colours of the panels and panes, and how their points and wheel are counted.

use egui::{Color32, Rect, Ui};

pub(super) const TEXT: Color32 = Color32::from_rgb(225, 228, 232);
pub(super) const FAINT: Color32 = Color32::from_rgb(150, 156, 165);
pub(super) const ACCENT: Color32 = Color32::from_rgb(90, 210, 140);
pub(super) const WRONG: Color32 = Color32::from_rgb(255, 120, 110);
pub(super) const CAMERA: Color32 = Color32::from_rgb(255, 200, 60);
pub(super) const SHADOW: Color32 = Color32::from_black_alpha(150);

/// Columns and rows of a rectangle of the screen, at least 2.
pub(super) fn pixels(ui: &Ui, rect: Rect) -> [u32; 2] {
    let scale = ui.pixels_per_point();
    [rect.width(), rect.height()].map(|s| ((s * scale).round() as u32).max(2))
}

/// Notches turned in this frame, as the wheel gave them: the smoothed value would go on for thirty
/// frames.
pub(super) fn wheel_notches(ui: &Ui) -> f64 {
    ui.input(|i| {
        i.raw
            .events
            .iter()
            .map(|e| match e {
                egui::Event::MouseWheel { unit: egui::MouseWheelUnit::Line, delta, .. } => {
                    f64::from(delta.y)
                }
                egui::Event::MouseWheel { delta, .. } => f64::from(delta.y) / 50.0,
                _ => 0.0,
            })
            .sum()
    })
}

/// Factor by which two fingers spread in this frame, on a screen or, where the system tells, on a
/// touchpad; 1 without any.
pub(super) fn pinch(ui: &Ui) -> f64 {
    ui.input(|i| {
        let factor = |e: &egui::Event| match e {
            egui::Event::Zoom(factor) if factor.is_finite() && *factor > 0.0 => f64::from(*factor),
            _ => 1.0,
        };
        let on_screen = i.multi_touch().map_or(1.0, |touch| f64::from(touch.zoom_delta));
        i.raw.events.iter().map(factor).product::<f64>() * on_screen
    })
}
