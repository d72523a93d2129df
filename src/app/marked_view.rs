//! The inside view as a picture to keep: as the pane shows it, with its marks, scales and axes, and with the
//! notice.

use egui::{Color32, Pos2, RawInput, Rect, TextureId, ViewportId, pos2, vec2};

use super::canvas::Canvas;
use super::error::AppError;
use super::inside_marks::inside_marks;
use super::model::Model;
use super::notice::notice_stamp;
use super::pane_view::orientation_marker;
use crate::vk::{Gpu, ImageId};

/// Texture of the inside view.
const PICTURE: TextureId = TextureId::User(0);

/// Texts and marks of pictures that are kept, apart from those of the window: the pane may be hidden, or
/// something may lie over it.
#[derive(Default)]
pub(super) struct MarkedView {
    context: egui::Context,
    canvas: Canvas,
}

impl MarkedView {
    /// Draws the inside view with its marks: RGB, rows from the top.
    ///
    /// * `picture`: the image of the inside view, and whether it has four pixels for each of the size.
    /// * `size`: columns and rows.
    /// * `scale`: pixels a point.
    ///
    /// # Errors
    /// The device's.
    pub fn draw(
        &mut self,
        gpu: &mut Gpu,
        model: &Model,
        picture: (ImageId, bool),
        (size, scale): ([u32; 2], f32),
    ) -> Result<Vec<u8>, AppError> {
        let stamp = notice_stamp(size);
        let [width, height] = size.map(|pixels| pixels as f32 / scale);
        let rect = Rect::from_min_size(Pos2::ZERO, vec2(width, height));
        // The notice stands in the corner of the axes.
        let above_notice = height - stamp.size[1] as f32 / scale;
        let of_axes = Rect::from_min_max(rect.min, pos2(width, above_notice));
        let mut input = RawInput { screen_rect: Some(rect), ..RawInput::default() };
        let viewport = input.viewports.entry(ViewportId::ROOT).or_default();
        viewport.native_pixels_per_point = Some(scale);
        let mut output = self.context.run_ui(input, |ui| {
            let painter = ui.painter_at(rect);
            let all = Rect::from_min_max(pos2(0.0, 0.0), pos2(1.0, 1.0));
            painter.image(PICTURE, rect, all, Color32::WHITE);
            inside_marks(&painter, rect, model);
            if let Some(pose) = model.pose {
                orientation_marker(&painter, of_axes, pose.rotation.as_dquat());
            }
        });
        self.canvas.collect(std::mem::take(&mut output.textures_delta));
        let primitives = self.context.tessellate(output.shapes, scale);
        let pane = |id| (id == PICTURE).then_some(picture);
        let mut rgb = self.canvas.picture(gpu, size, (primitives, scale), pane)?;
        stamp.mark(size, &mut rgb);
        Ok(rgb)
    }

    /// The device was lost: everything is made on the next one that draws.
    pub fn forget_device(&mut self) {
        self.canvas.forget_device();
    }
}
