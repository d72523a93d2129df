//! The notice as pixels, for pictures that leave the window.

use egui::{Color32, Context, FontId, RawInput};

use crate::formats::NOTICE;
use crate::session::Stamp;

/// Height of the text, as a share of the height of the picture, and in pixels at least.
const SHARE: f32 = 0.028;
const MIN_TEXT_PX: f32 = 11.0;

/// Returns the notice for pictures of a size, with the widest text that has room.
pub(super) fn notice_stamp([width, height]: [u32; 2]) -> Stamp {
    let wanted = (SHARE * height as f32).max(MIN_TEXT_PX);
    let stamp = text_stamp(NOTICE, wanted);
    match stamp.size[0] > width {
        true => text_stamp(NOTICE, wanted * width as f32 / stamp.size[0] as f32),
        false => stamp,
    }
}

/// Draws a line of text with the font of the window.
fn text_stamp(text: &str, text_px: f32) -> Stamp {
    let context = Context::default();
    // Fonts are there from the first frame on.
    context.run_ui(RawInput::default(), |_| {}).textures_delta.clear();
    let font = FontId::proportional(text_px);
    let (galley, atlas) = context.fonts_mut(|fonts| {
        let galley = fonts.layout_no_wrap(text.to_owned(), font, Color32::WHITE);
        (galley, fonts.image())
    });
    let margin = (0.4 * text_px).ceil();
    let size = [galley.size().x, galley.size().y].map(|v| (v + 2.0 * margin).ceil() as usize);
    let mut opacity = vec![0u8; size[0] * size[1]];
    for row in &galley.rows {
        for glyph in &row.glyphs {
            let uv = glyph.uv_rect;
            let at = row.pos + glyph.pos.to_vec2() + uv.offset;
            let [x, y] = [at.x, at.y].map(|v| (v + margin).round().max(0.0) as usize);
            for (v, texel_row) in (uv.min[1]..uv.max[1]).enumerate() {
                for (u, texel) in (uv.min[0]..uv.max[0]).enumerate() {
                    let value = atlas[(texel as usize, texel_row as usize)].a();
                    if x + u < size[0] && y + v < size[1] {
                        let pixel = &mut opacity[(y + v) * size[0] + x + u];
                        *pixel = (*pixel).max(value);
                    }
                }
            }
        }
    }
    Stamp { size: size.map(|v| v as u32), opacity }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_notice_has_letters_and_fits_the_picture() {
        for size in [[1280, 720], [640, 360], [200, 150]] {
            let stamp = notice_stamp(size);
            assert!(stamp.size[0] <= size[0] + 2, "{:?} in {size:?}", stamp.size);
            let inked = stamp.opacity.iter().filter(|a| **a > 128).count();
            let share = inked as f64 / stamp.opacity.len() as f64;
            assert!((0.03..0.4).contains(&share), "{share} of {:?} is text", stamp.size);
        }
    }
}
