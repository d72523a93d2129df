//! The pipelines of all passes, created together.

use super::host;
use crate::vk::{Attribute, Blend, DepthUse, DrawPipelineId, DrawSpec, Format, Gpu, VkError};

/// Format of pictures, and of the glass that is laid over them.
pub(super) const PICTURE: Format = Format::Rgba8Srgb;
pub(super) const GLASS: Format = Format::Rgba16Float;
pub(super) const DEPTH: Format = Format::Depth32;

pub(super) struct Pipelines {
    pub inside: DrawPipelineId,
    /// The same for walls whose backs are hidden.
    pub inside_fronts: DrawPipelineId,
    pub lines: DrawPipelineId,
    pub ghost: DrawPipelineId,
    pub nearest: DrawPipelineId,
    pub shell: DrawPipelineId,
    pub stack: DrawPipelineId,
}

impl Pipelines {
    pub fn new(gpu: &mut Gpu, samples: u32) -> Result<Self, VkError> {
        // Where samples are averaged they have to be linear. Elsewhere the shader encodes for itself:
        // software devices encode every block of 16 pixels that a triangle touches, and decode it
        // before, which is a seventh of a frame.
        let (inside, inside_fronts, stored) = match samples {
            1 => ("inside_encoded", "fronts_encoded", Format::Rgba8Stored),
            _ => ("inside", "inside", PICTURE),
        };
        let surface = DrawSpec {
            spirv: host::surface::SPIRV,
            entries: ["project", inside],
            attributes: &[Attribute::F32x3, Attribute::Snorm16x4],
            colour: stored,
            depth: Some(DEPTH),
            depth_use: DepthUse::Nearest,
            samples,
            blend: Blend::Opaque,
            cull_backs: false,
            push_bytes: host::surface::PUSH_BYTES,
            images: 0,
        };
        let fronts =
            DrawSpec { entries: ["project", inside_fronts], cull_backs: true, ..surface.clone() };
        let glass = |fragment, depth_use, blend| DrawSpec {
            entries: ["project", fragment],
            colour: GLASS,
            depth_use,
            blend,
            ..surface.clone()
        };
        let lines = DrawSpec {
            spirv: host::lines::SPIRV,
            entries: ["project", "shade"],
            colour: PICTURE,
            push_bytes: host::lines::PUSH_BYTES,
            ..surface.clone()
        };
        let stack = DrawSpec {
            cull_backs: false,
            spirv: host::stack::SPIRV,
            entries: ["whole", "lay"],
            colour: PICTURE,
            attributes: &[],
            depth: None,
            depth_use: DepthUse::Ignore,
            samples: 1,
            blend: Blend::Stack,
            push_bytes: host::stack::PUSH_BYTES,
            images: 1,
        };
        Ok(Self {
            inside: gpu.draw_pipeline(&surface)?,
            inside_fronts: gpu.draw_pipeline(&fronts)?,
            lines: gpu.draw_pipeline(&lines)?,
            ghost: gpu.draw_pipeline(&glass("ghost", DepthUse::Ignore, Blend::Layer))?,
            nearest: gpu.draw_pipeline(&glass("nothing", DepthUse::Nearest, Blend::DepthOnly))?,
            shell: gpu.draw_pipeline(&glass("shell", DepthUse::Equal, Blend::Layer))?,
            stack: gpu.draw_pipeline(&stack)?,
        })
    }

    pub fn free(&self, gpu: &mut Gpu) {
        let Self { inside, inside_fronts, lines, ghost, nearest, shell, stack } = *self;
        for p in [inside, inside_fronts, lines, ghost, nearest, shell, stack] {
            gpu.free_draw_pipeline(p);
        }
    }
}
