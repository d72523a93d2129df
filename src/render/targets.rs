//! Images that frames are drawn to.

use super::RenderError;
use super::pipelines::{DEPTH, GLASS, PICTURE};
use crate::vk::{Gpu, ImageId, ImageSpec, Releaser};

/// Largest number of columns and rows, whatever the device can.
const MAX_SIDE: u32 = 16384;

/// Images of one size.
pub(super) struct Targets {
    pub extent: [u32; 2],
    pub picture: ImageId,
    /// Multisampled twin of the picture.
    pub picture_many: Option<ImageId>,
    /// Glass, once an overview was drawn.
    glass: Option<Glass>,
    glass_grid: u32,
    pub depth: ImageId,
    /// Depth of one sample a pixel, which a later pass may read.
    pub kept_depth: ImageId,
}

/// Images of the glass of an overview.
#[derive(Clone, Copy)]
pub(super) struct Glass {
    /// Glass, with `grid` by `grid` pixels for each of the picture.
    pub image: ImageId,
    pub depth: ImageId,
    pub grid: u32,
}

impl Targets {
    /// Creates all images but the glass, or none.
    ///
    /// * `is_antialiased`: whether glass is drawn with four pixels for each of the picture although a
    ///   pixel has one sample.
    pub fn new(
        gpu: &mut Gpu,
        extent: [u32; 2],
        samples: u32,
        is_antialiased: bool,
    ) -> Result<Self, RenderError> {
        let [width, height] = extent;
        let possible = matches!(samples, 1 | 4) && samples <= gpu.info().max_samples;
        let most = gpu.info().max_image_side.min(MAX_SIDE);
        if !possible || width < 2 || height < 1 || width > most || height > most {
            return Err(RenderError::BadSize { width, height, samples });
        }
        // A whole organ's triangles are smaller than a pixel: four samples of each cost more than
        // four pixels.
        let is_fine = (samples > 1 || is_antialiased) && 2 * width.max(height) <= most;
        let glass_grid = if is_fine { 2 } else { 1 };
        gpu.all_or_none(|gpu| {
            let mut image = |name, format, extent, samples| {
                gpu.image(name, ImageSpec { format, extent, samples })
            };
            let depth = image("depth", DEPTH, extent, samples)?;
            let (picture_many, kept_depth) = match samples {
                1 => (None, depth),
                _ => (
                    Some(image("picture", PICTURE, extent, samples)?),
                    image("depth of one sample", DEPTH, extent, 1)?,
                ),
            };
            Ok(Self {
                extent,
                picture: image("picture", PICTURE, extent, 1)?,
                picture_many,
                glass: None,
                glass_grid,
                depth,
                kept_depth,
            })
        })
    }

    /// Creates the images of the glass, if they are not there: in a panorama they would take gigabytes
    /// for nothing.
    pub fn make_glass(&mut self, gpu: &mut Gpu) -> Result<(), RenderError> {
        if self.glass.is_some() {
            return Ok(());
        }
        let (grid, is_shared) =
            (self.glass_grid, self.glass_grid == 1 && self.picture_many.is_none());
        let extent = self.extent.map(|side| grid * side);
        let depth = self.depth;
        let made = gpu.all_or_none(|gpu| {
            let mut image =
                |name, format| gpu.image(name, ImageSpec { format, extent, samples: 1 });
            let depth = if is_shared { depth } else { image("depth of the glass", DEPTH)? };
            Ok::<_, RenderError>(Glass { image: image("glass", GLASS)?, depth, grid })
        });
        self.glass = Some(made?);
        Ok(())
    }

    /// Returns the glass.
    ///
    /// # Panics
    /// If it was not made.
    pub fn glass(&self) -> Glass {
        self.glass.expect("the glass of an overview")
    }

    /// Returns the colour target and the image it is resolved to.
    pub fn drawn_and_resolved(&self) -> (ImageId, Option<ImageId>) {
        self.picture_many.map_or((self.picture, None), |many| (many, Some(self.picture)))
    }

    pub fn release(&self, releaser: &Releaser) {
        let Self { picture, picture_many, glass, depth, kept_depth, .. } = *self;
        let own = |image| (image != depth).then_some(image);
        let glass = glass.map(|glass| [Some(glass.image), own(glass.depth)]);
        let all = [Some(picture), picture_many, Some(depth), own(kept_depth)];
        let all = all.into_iter().chain(glass.into_iter().flatten());
        all.flatten().for_each(|image| releaser.image(image));
    }
}
