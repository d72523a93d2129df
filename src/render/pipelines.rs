//! The pipelines of all passes, created together.

use super::host;
use crate::vk::{
    Attribute, Blend, DepthUse, DrawPipelineId, DrawSpec, Format, Gpu, Releaser, VkError,
};

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

    pub fn release(&self, releaser: &Releaser) {
        let Self { inside, inside_fronts, lines, ghost, nearest, shell, stack } = *self;
        for p in [inside, inside_fronts, lines, ghost, nearest, shell, stack] {
            releaser.draw_pipeline(p);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;
    use crate::vk::{
        Area, Choice, Draw, Frame, ImageSpec, OpenOptions, Pass, Piece, Take, Validate,
    };

    #[test]
    fn draws_that_do_not_fit_their_buffers_are_refused_before_anything_is_recorded() {
        let options =
            OpenOptions { validate: Validate::Sync, cache_dir: None, ..Default::default() };
        let mut gpu = match Gpu::open_with(Choice::Any, options) {
            Ok(gpu) => gpu,
            Err(e) if e.is_no_device() && std::env::var_os("INTIMA_REQUIRE_GPU").is_none() => {
                return;
            }
            Err(e) => panic!("{e}"),
        };
        let inside = Pipelines::new(&mut gpu, 1).unwrap().inside;
        let image = |format| ImageSpec { format, extent: [16, 16], samples: 1 };
        let colour = gpu.image("picture", image(PICTURE)).unwrap();
        let depth = gpu.image("depth", image(DEPTH)).unwrap();
        // Four vertices of 20 bytes.
        let vertices = gpu.vertex_buffer("vertices", &[0; 80]).unwrap();
        let [within, beyond] = [3, 4].map(|most| {
            let indices = [0, 1, 2, 1, 2, most];
            gpu.index_buffer("indices", &indices).unwrap()
        });
        let fits = Draw {
            pipeline: inside,
            push: vec![0; host::surface::PUSH_BYTES as usize],
            vertices: Some(vertices),
            indices: Some(within),
            take: Take::Range(0..6),
            images: Vec::new(),
        };
        let mut refused = |draw: Draw| {
            let area = Area { x: 0, y: 0, width: 16, height: 16 };
            let (clear, draws) = (Some([0.0; 4]), vec![draw]);
            let (resolve, depth, encoded) = (None, Some(depth), true);
            let pass = Pass { colour, resolve, depth, encoded, clear, area, draws };
            let frame = Frame { passes: vec![pass], ..Frame::default() };
            catch_unwind(AssertUnwindSafe(|| gpu.submit_draws(&frame).unwrap())).is_err()
        };
        let piece = |first_index, indices, first_vertex| {
            Take::Pieces(vec![Piece { first_index, indices, first_vertex }])
        };
        let pieces = |take| Draw { take, ..fits.clone() };
        assert!(!refused(fits.clone()));
        assert!(!refused(pieces(piece(3, 3, 0))));
        assert!(!refused(Draw { indices: None, take: Take::Range(0..3), ..fits.clone() }));
        let wrong = [
            ("indices that are not there", pieces(Take::Range(3..9))),
            ("a vertex that is not there", Draw { indices: Some(beyond), ..fits.clone() }),
            ("no vertices", Draw { vertices: None, ..fits.clone() }),
            (
                "vertices past the end",
                Draw { indices: None, take: Take::Range(3..6), ..fits.clone() },
            ),
            ("vertices for indices", Draw { indices: Some(vertices), ..fits.clone() }),
            ("a piece past the indices", pieces(piece(6, 3, 0))),
            ("a piece past the vertices", pieces(piece(0, 3, 1))),
            ("a piece far past them", pieces(piece(0, 3, u32::MAX))),
            ("pieces of no indices", Draw { indices: None, ..pieces(piece(0, 3, 0)) }),
            ("a short immediate block", Draw { push: vec![0; 4], ..fits.clone() }),
            ("an image too many", Draw { images: vec![colour], ..fits.clone() }),
        ];
        for (what, draw) in wrong {
            assert!(refused(draw), "{what}");
        }
        assert!(!refused(fits));
        let said = gpu.validation_messages();
        assert!(said.is_empty(), "{said:?}");
    }
}
