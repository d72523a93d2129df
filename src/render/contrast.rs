//! Local contrast of inside views, an option: light departs farther from smooth light, so that fine
//! relief shows. Smooth light is a function of the depth, fitted about each place, and does not cross
//! the edge of a fold.
//!
//! The guided filter (He, Sun & Tang 2013, doi:10.1109/TPAMI.2012.213) of the logarithm of light, guided
//! by that of depth, on means of squares of pixels (fast guided filter, He & Sun 2015, arXiv:1505.00996).

use super::pipelines::{PICTURE, STATISTICS, whole_pass};
use super::renderer::Renderer;
use super::scene::{Scene, View};
use super::{RenderError, host};
use crate::vk::{Area, Gpu, ImageId, ImageSpec, Pass, Releaser};

/// Largest share by which light may depart farther from smooth light.
pub const MAX_LOCAL_CONTRAST: f32 = 2.0;
/// Pixels along a square whose mean is taken.
const GRID: u32 = 4;
/// Radius of a window, as a share of the columns of the view.
const RADIUS: f32 = 1.0 / 27.0;
/// Variance of the logarithm of depth below which smooth light is even.
const MIN_VARIANCE: f32 = 0.02;
/// Largest change of the logarithm of light.
const MAX_CHANGE: f32 = 0.5;

/// Images that local contrast needs, for pictures of one size.
pub(super) struct ContrastTargets {
    extent: [u32; 2],
    /// Statistics of squares of pixels.
    squares: [ImageId; 2],
    /// The picture with its contrast.
    pub lit: ImageId,
}

impl ContrastTargets {
    fn new(gpu: &mut Gpu, extent: [u32; 2]) -> Result<Self, RenderError> {
        let coarse = ImageSpec {
            format: STATISTICS,
            extent: extent.map(|side| side.div_ceil(GRID)),
            samples: 1,
        };
        gpu.all_or_none(|gpu| {
            Ok(Self {
                extent,
                squares: [gpu.image("squares", coarse)?, gpu.image("squares", coarse)?],
                lit: gpu.image("contrast", ImageSpec { format: PICTURE, extent, samples: 1 })?,
            })
        })
    }

    pub fn release(&self, releaser: &Releaser) {
        self.squares.into_iter().chain([self.lit]).for_each(|image| releaser.image(image));
    }
}

impl Renderer {
    /// Whether local contrast is raised in a shot: cubes and panoramas would show seams.
    pub(super) fn raises_contrast(scene: &Scene, view: View) -> bool {
        scene.look.local_contrast > 0.0
            && matches!(view, View::Inside | View::Translucent | View::Split)
    }

    /// Makes room for local contrast, where a shot has it.
    pub(super) fn room_for_contrast(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        view: View,
    ) -> Result<(), RenderError> {
        let fits = self.contrast.as_ref().is_some_and(|c| c.extent == self.targets.extent);
        if fits || !Self::raises_contrast(scene, view) {
            return Ok(());
        }
        let new = ContrastTargets::new(gpu, self.targets.extent)?;
        if let Some(old) = self.contrast.replace(new) {
            old.release(&self.releaser);
        }
        Ok(())
    }

    /// Returns the passes that raise the contrast of a finished picture, and lay it into
    /// [`ContrastTargets::lit`].
    ///
    /// * `raise`: of [`Look::local_contrast`](super::Look::local_contrast).
    /// * `inside`: the inside view's part of the picture, from the first pixel.
    pub(super) fn contrast_passes(
        &self,
        images: &ContrastTargets,
        raise: f32,
        inside: Area,
    ) -> Vec<Pass> {
        let targets = &self.targets;
        let [first, second] = images.squares;
        let (picture, depth, p) = (targets.picture, targets.kept_depth, &self.pipelines);
        let size = [inside.width, inside.height].map(|side| side as i32);
        let squares = [inside.width, inside.height].map(|side| side.div_ceil(GRID));
        let coarse = Area { x: 0, y: 0, width: squares[0], height: squares[1] };
        let [width, height] = targets.extent;
        let whole = Area { x: 0, y: 0, width, height };

        let gather = host::contrast_gather::Params {
            size,
            grid: GRID as i32,
            ..bytemuck::Zeroable::zeroed()
        };
        let blur = |along: [i32; 2]| host::contrast_blur::Params {
            size: squares.map(|side| side as i32),
            along,
            radius: ((RADIUS * inside.width as f32 / GRID as f32).round() as i32).max(1),
            least: MIN_VARIANCE,
        };
        let lay = host::contrast_lay::Params {
            size,
            grid: GRID as i32,
            raise,
            most: MAX_CHANGE,
            ..bytemuck::Zeroable::zeroed()
        };
        let (along, down) = (blur([1, 0]), blur([0, 1]));
        let bytes = bytemuck::bytes_of::<host::contrast_blur::Params>;
        let passes = [
            whole_pass(
                first,
                coarse,
                p.contrast_gather,
                bytemuck::bytes_of(&gather),
                &[picture, depth],
            ),
            whole_pass(second, coarse, p.contrast_blur, bytes(&along), &[first]),
            whole_pass(first, coarse, p.contrast_fit, bytes(&down), &[second]),
            whole_pass(second, coarse, p.contrast_blur, bytes(&along), &[first]),
            whole_pass(first, coarse, p.contrast_blur, bytes(&down), &[second]),
            whole_pass(
                images.lit,
                whole,
                p.contrast_lay,
                bytemuck::bytes_of(&lay),
                &[picture, depth, first],
            ),
        ];
        passes.map(|pass| Pass { clear: Some([0.0; 4]), ..pass }).into()
    }
}
