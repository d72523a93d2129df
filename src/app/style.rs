//! Colours of the panels and panes, and how their points and wheel are counted.

use egui::{Color32, Rect, Ui};

pub(super) const TEXT: Color32 = Color32::from_rgb(225, 228, 232);
pub(super) const FAINT: Color32 = Color32::from_rgb(150, 156, 165);
pub(super) const ACCENT: Color32 = Color32::from_rgb(77, 234, 172);
pub(super) const WRONG: Color32 = Color32::from_rgb(255, 120, 110);
pub(super) const CAMERA: Color32 = Color32::from_rgb(247, 238, 107);
/// Where the flight goes on in another part of the lumen.
pub(super) const CUT: Color32 = Color32::from_rgb(224, 83, 62);
/// Outline of wall that the flight misses.
pub(super) const MISSED: Color32 = Color32::from_rgb(58, 112, 244);
pub(super) const MEASURE: Color32 = Color32::from_rgb(253, 158, 236);
pub(super) const SHADOW: Color32 = Color32::from_black_alpha(150);

/// Reasons why a control is grey.
pub(super) const NO_SCAN: &str = "Open a scan first.";
pub(super) const NO_PATH: &str = "There is no path through an organ yet.";
pub(super) const NO_VIEW: &str = "There is no view of an organ yet.";

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

/// Points turned to the right in this frame, by a touchpad or a wheel that tilts.
pub(super) fn wheel_sideways(ui: &Ui) -> f32 {
    const POINTS_A_NOTCH: f32 = 50.0;
    ui.input(|i| {
        let of = |e: &egui::Event| match e {
            egui::Event::MouseWheel { unit: egui::MouseWheelUnit::Line, delta, .. } => {
                delta.x * POINTS_A_NOTCH
            }
            egui::Event::MouseWheel { delta, .. } => delta.x,
            _ => 0.0,
        };
        -i.raw.events.iter().map(of).sum::<f32>()
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::app::colouring::{LEVEL, NO_WALL, SHEET};
    use crate::app::slices::OUTLINE;

    /// Linear light to how eyes without one kind of cone see it (Machado, Oliveira & Fernandes 2009,
    /// IEEE Transactions on Visualization and Computer Graphics 15(6), 1291–1298): all cones, no long,
    /// no middle, no short ones.
    const EYES: [[[f64; 3]; 3]; 4] = [
        [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]],
        [
            [0.152286, 1.052583, -0.204868],
            [0.114503, 0.786281, 0.099216],
            [-0.003882, -0.048116, 1.051998],
        ],
        [
            [0.367322, 0.860646, -0.227968],
            [0.280085, 0.672501, 0.047413],
            [-0.01182, 0.04294, 0.968881],
        ],
        [
            [1.255528, -0.076749, -0.178779],
            [-0.078411, 0.930809, 0.147602],
            [0.004733, 0.691367, 0.3039],
        ],
    ];

    fn times(m: [[f64; 3]; 3], v: [f64; 3]) -> [f64; 3] {
        m.map(|row| row.iter().zip(v).map(|(a, b)| a * b).sum())
    }

    /// CIE 1976 L*a*b* of a colour in sRGB, as an eye sees it.
    fn seen(eye: [[f64; 3]; 3], rgb: [u8; 3]) -> [f64; 3] {
        let linear = rgb.map(|c| {
            let c = f64::from(c) / 255.0;
            if c <= 0.04045 { c / 12.92 } else { ((c + 0.055) / 1.055).powf(2.4) }
        });
        let light = times(eye, linear).map(|c| c.clamp(0.0, 1.0));
        let xyz = times(
            [
                [0.4124564, 0.3575761, 0.1804375],
                [0.2126729, 0.7151522, 0.072175],
                [0.0193339, 0.119192, 0.9503041],
            ],
            light,
        );
        let f = |t: f64| if t > 0.008856 { t.cbrt() } else { 7.787 * t + 16.0 / 116.0 };
        let [x, y, z] = [f(xyz[0] / 0.95047), f(xyz[1]), f(xyz[2] / 1.08883)];
        [116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)]
    }

    /// Least distance of two of these colours for any eye.
    fn least_distance(colours: &[[u8; 3]]) -> f64 {
        let mut least = f64::INFINITY;
        for (i, a) in colours.iter().enumerate() {
            for b in &colours[..i] {
                for eye in EYES {
                    let [p, q] = [seen(eye, *a), seen(eye, *b)];
                    let square: f64 = p.iter().zip(q).map(|(p, q)| (p - q).powi(2)).sum();
                    least = least.min(square.sqrt());
                }
            }
        }
        least
    }

    /// Missed wall and measurements were one blue; green outline and red cut one brown for eyes without
    /// middle cones.
    #[test]
    fn marks_are_told_apart_by_eyes_without_one_kind_of_cones() {
        let rgb = |c: Color32| [c.r(), c.g(), c.b()];
        let marks = [ACCENT, CAMERA, CUT, MISSED, MEASURE].map(rgb);
        let distance = least_distance(&marks);
        assert!(distance > 30.0, "{distance}");
        // The colours of evidence lie on the wall.
        let tissue = [205, 140, 120];
        let distance = least_distance(&[NO_WALL, SHEET, LEVEL, tissue]);
        assert!(distance > 30.0, "{distance}");
        assert_eq!(OUTLINE, rgb(ACCENT));
        // A difference that is known: red and green of equal lightness are one for these eyes.
        assert!(least_distance(&[[200, 60, 60], [110, 110, 30]]) < 25.0);
    }
}
