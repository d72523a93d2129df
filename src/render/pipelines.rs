//! The pipelines of all passes, created together.

use super::host;
use crate::vk::{
    Area, Attribute, Blend, DepthUse, Draw, DrawPipelineId, DrawRange, DrawSpec, Format, Gpu,
    ImageId, Pass, Releaser, VkError,
};

/// Format of pictures, and of the glass that is laid over them.
pub(super) const PICTURE: Format = Format::Rgba8Srgb;
pub(super) const GLASS: Format = Format::Rgba16Float;
/// Format of statistics whose differences count.
pub(super) const STATISTICS: Format = Format::Rgba32Float;
pub(super) const DEPTH: Format = Format::Depth32;

pub(super) struct Pipelines {
    pub inside: DrawPipelineId,
    /// Inside view of walls whose back faces are left out.
    pub inside_fronts: DrawPipelineId,
    /// Inside view of walls whose patches stay on the device and morph, and that without back faces.
    pub patches: DrawPipelineId,
    pub patch_fronts: DrawPipelineId,
    /// Inside view of refined faces in slots, and that without back faces.
    pub faces: DrawPipelineId,
    pub face_fronts: DrawPipelineId,
    /// Inside view of a wall whose vertices have colours.
    pub inside_coloured: DrawPipelineId,
    pub lines: DrawPipelineId,
    /// Overview's glass: the nearest wall, and faint layers.
    pub glass: [DrawPipelineId; 2],
    /// Overview's glass of a wall whose vertices have colours.
    pub glass_coloured: [DrawPipelineId; 2],
    pub stack: DrawPipelineId,
    pub panorama: DrawPipelineId,
    /// Tissue behind the wall.
    pub behind: DrawPipelineId,
    /// Local contrast: statistics, their means, lines fitted to them, the picture with its contrast.
    pub contrast_gather: DrawPipelineId,
    pub contrast_blur: DrawPipelineId,
    pub contrast_fit: DrawPipelineId,
    pub contrast_lay: DrawPipelineId,
}

/// A pass that fills an area from other images. It keeps the pixels of the area, so that its draw can
/// blend with them.
pub(super) fn whole_pass(
    colour: ImageId,
    area: Area,
    pipeline: DrawPipelineId,
    push: &[u8],
    images: &[ImageId],
) -> Pass {
    let fill = Draw {
        pipeline,
        push: push.to_vec(),
        vertices: None,
        indices: None,
        range: DrawRange::Direct(0..3),
        images: images.to_vec(),
        buffers: Vec::new(),
        scissor: None,
    };
    Pass {
        colour,
        resolve: None,
        depth: None,
        kept_depth: None,
        encoded: false,
        clear: None,
        area,
        draws: vec![fill],
    }
}

impl Pipelines {
    pub fn new(gpu: &mut Gpu, samples: u32) -> Result<Self, VkError> {
        // Where samples are averaged they have to be linear. Elsewhere the shader encodes for itself:
        // software devices encode every block of 16 pixels that a triangle touches, and decode it
        // before, which is a seventh of a frame.
        let (inside, inside_fronts, inside_coloured, stored) = match samples {
            1 => ("inside_encoded", "fronts_encoded", "coloured_encoded", Format::Rgba8Stored),
            _ => ("inside", "inside", "inside_coloured", PICTURE),
        };
        let surface = DrawSpec {
            shader: &host::surface::SHADER,
            entries: ["project", inside],
            attributes: &[Attribute::F32x3, Attribute::Snorm16x4],
            colour: stored,
            depth: Some(DEPTH),
            depth_use: DepthUse::Nearest,
            samples,
            blend: Blend::Opaque,
            cull_backs: false,
        };
        let fronts =
            DrawSpec { entries: ["project", inside_fronts], cull_backs: true, ..surface.clone() };
        let coloured = DrawSpec {
            entries: ["project_coloured", inside_coloured],
            attributes: &[Attribute::F32x3, Attribute::Snorm16x4, Attribute::Unorm8x4],
            ..surface.clone()
        };
        let morphing = |project: &'static str, wall: &DrawSpec| DrawSpec {
            entries: [project, wall.entries[1]],
            attributes: &[
                Attribute::F32x3,
                Attribute::Snorm16x4,
                Attribute::F32x3,
                Attribute::Snorm16x4,
                Attribute::U32,
            ],
            ..wall.clone()
        };
        let mut glass = |wall: &DrawSpec, shell: &'static str| {
            let mut layer = |fragment, depth_use, blend| {
                let entries = [wall.entries[0], fragment];
                gpu.draw_pipeline(&DrawSpec {
                    entries,
                    colour: GLASS,
                    depth_use,
                    samples: 1,
                    blend,
                    ..wall.clone()
                })
            };
            Ok::<_, VkError>([
                layer(shell, DepthUse::Nearest, Blend::Opaque)?,
                layer("ghost", DepthUse::Ignore, Blend::Under)?,
            ])
        };
        let plain_glass = glass(&surface, "shell")?;
        let glass_coloured = glass(&coloured, "shell_coloured")?;
        let lines = DrawSpec {
            shader: &host::lines::SHADER,
            entries: ["project", "shade"],
            colour: PICTURE,
            ..surface.clone()
        };
        let stack = DrawSpec {
            cull_backs: false,
            shader: &host::stack::SHADER,
            entries: ["whole", "lay"],
            colour: PICTURE,
            attributes: &[],
            depth: None,
            depth_use: DepthUse::Ignore,
            samples: 1,
            blend: Blend::Stack,
        };
        let fill = |shader, fragment, colour| DrawSpec {
            shader,
            entries: ["whole", fragment],
            colour,
            blend: Blend::Opaque,
            ..stack.clone()
        };
        Ok(Self {
            inside: gpu.draw_pipeline(&surface)?,
            inside_fronts: gpu.draw_pipeline(&fronts)?,
            patches: gpu.draw_pipeline(&morphing("project_patch", &surface))?,
            patch_fronts: gpu.draw_pipeline(&morphing("project_patch", &fronts))?,
            faces: gpu.draw_pipeline(&morphing("project_face", &surface))?,
            face_fronts: gpu.draw_pipeline(&morphing("project_face", &fronts))?,
            inside_coloured: gpu.draw_pipeline(&coloured)?,
            lines: gpu.draw_pipeline(&lines)?,
            glass: plain_glass,
            glass_coloured,
            stack: gpu.draw_pipeline(&stack)?,
            panorama: gpu.draw_pipeline(&DrawSpec {
                shader: &host::panorama::SHADER,
                entries: ["whole", "unroll"],
                blend: Blend::Opaque,
                ..stack.clone()
            })?,
            behind: gpu.draw_pipeline(&DrawSpec {
                shader: &host::behind::SHADER,
                entries: ["whole", "look"],
                blend: Blend::Over,
                ..stack.clone()
            })?,
            contrast_gather: gpu.draw_pipeline(&fill(
                &host::contrast_gather::SHADER,
                "gather",
                STATISTICS,
            ))?,
            contrast_blur: gpu.draw_pipeline(&fill(
                &host::contrast_blur::SHADER,
                "blur",
                STATISTICS,
            ))?,
            contrast_fit: gpu.draw_pipeline(&fill(
                &host::contrast_blur::SHADER,
                "fit",
                STATISTICS,
            ))?,
            contrast_lay: gpu.draw_pipeline(&fill(&host::contrast_lay::SHADER, "lay", PICTURE))?,
        })
    }

    pub fn release(&self, releaser: &Releaser) {
        let Self { inside, inside_fronts, inside_coloured, lines, stack, panorama, .. } = *self;
        let single = [inside, inside_fronts, inside_coloured, lines, stack, panorama];
        let morphing = [self.patches, self.patch_fronts, self.faces, self.face_fronts];
        let single = single.into_iter().chain(morphing).chain([self.behind]);
        let contrast =
            [self.contrast_gather, self.contrast_blur, self.contrast_fit, self.contrast_lay];
        let single = single.chain(contrast);
        for p in single.chain(self.glass).chain(self.glass_coloured) {
            releaser.draw_pipeline(p);
        }
    }
}

#[cfg(test)]
mod tests {
    use std::panic::{AssertUnwindSafe, catch_unwind};

    use super::*;
    use crate::vk::{
        Area, BufferId, Choice, Draw, DrawRange, Frame, ImageId, ImageSpec, IndexedRange,
        OpenOptions, Pass, Validate,
    };

    /// A device with what a small picture needs.
    struct Stage {
        gpu: Gpu,
        pipelines: Pipelines,
        colour: ImageId,
        depth: ImageId,
        vertices: BufferId,
    }

    fn stage() -> Option<Stage> {
        let options =
            OpenOptions { validate: Validate::Sync, cache_dir: None, ..Default::default() };
        let mut gpu = match Gpu::open_with(Choice::Any, options) {
            Ok(gpu) => gpu,
            Err(e) if e.is_no_device() && std::env::var_os("INTIMA_REQUIRE_GPU").is_none() => {
                return None;
            }
            Err(e) => panic!("{e}"),
        };
        let pipelines = Pipelines::new(&mut gpu, 1).unwrap();
        let colour = gpu.image("picture", image(PICTURE, 16, 1)).unwrap();
        let depth = gpu.image("depth", image(DEPTH, 16, 1)).unwrap();
        // Four vertices of 20 bytes.
        let vertices = gpu.vertex_buffer("vertices", &[0; 80]).unwrap();
        Some(Stage { gpu, pipelines, colour, depth, vertices })
    }

    fn image(format: Format, side: u32, samples: u32) -> ImageSpec {
        ImageSpec { format, extent: [side, side], samples }
    }

    impl Stage {
        fn draw(&self) -> Draw {
            Draw {
                pipeline: self.pipelines.inside,
                push: vec![0; host::surface::SHADER.push_bytes() as usize],
                vertices: Some(self.vertices),
                indices: None,
                range: DrawRange::Direct(0..3),
                images: Vec::new(),
                buffers: Vec::new(),
                scissor: None,
            }
        }

        fn pass(&self, draws: Vec<Draw>) -> Pass {
            Pass {
                colour: self.colour,
                resolve: None,
                depth: Some(self.depth),
                kept_depth: None,
                encoded: true,
                clear: Some([0.0; 4]),
                area: Area { x: 0, y: 0, width: 16, height: 16 },
                draws,
            }
        }

        fn refused(&mut self, frame: &Frame<'_>) -> bool {
            catch_unwind(AssertUnwindSafe(|| self.gpu.submit_draws(frame).unwrap())).is_err()
        }

        fn pass_refused(&mut self, pass: Pass) -> bool {
            self.refused(&Frame { passes: vec![pass], ..Frame::default() })
        }

        fn assert_silent(&self) {
            let said = self.gpu.validation_messages();
            assert!(said.is_empty(), "{said:?}");
        }
    }

    #[test]
    fn draws_that_do_not_fit_their_buffers_are_refused_before_anything_is_recorded() {
        let Some(mut s) = stage() else { return };
        let [within, beyond] = [3, 4].map(|most| {
            let indices = [0, 1, 2, 1, 2, most];
            s.gpu.index_buffer("indices", &indices).unwrap()
        });
        let never_written = s.gpu.empty_indices("no indices", 6).unwrap();
        let (plain, colour, vertices) = (s.draw(), s.colour, s.vertices);
        let fits = Draw { indices: Some(within), range: DrawRange::Direct(0..6), ..plain.clone() };
        let indirect = |first_index, indices, first_vertex| {
            let range = IndexedRange { first_index, indices, first_vertex, instance: 0 };
            Draw { range: DrawRange::Indirect(vec![range]), ..fits.clone() }
        };
        let mut refused = |draw: Draw| {
            let pass = s.pass(vec![draw]);
            s.pass_refused(pass)
        };
        assert!(!refused(fits.clone()));
        assert!(!refused(indirect(3, 3, 0)));
        assert!(!refused(plain.clone()));
        let wrong = [
            ("indices that are not there", Draw { range: DrawRange::Direct(3..9), ..fits.clone() }),
            ("indices that nobody wrote", Draw { indices: Some(never_written), ..fits.clone() }),
            ("a vertex that is not there", Draw { indices: Some(beyond), ..fits.clone() }),
            ("no vertices", Draw { vertices: None, ..fits.clone() }),
            ("vertices past the end", Draw { range: DrawRange::Direct(3..6), ..plain }),
            ("vertices for indices", Draw { indices: Some(vertices), ..fits.clone() }),
            ("indices for vertices", Draw { vertices: Some(within), ..fits.clone() }),
            ("an indirect range past the indices", indirect(6, 3, 0)),
            ("an indirect range past the vertices", indirect(0, 3, 1)),
            ("an indirect range far past them", indirect(0, 3, u32::MAX)),
            ("indirect ranges of no indices", Draw { indices: None, ..indirect(0, 3, 0) }),
            ("a short immediate block", Draw { push: vec![0; 4], ..fits.clone() }),
            ("an image too many", Draw { images: vec![colour], ..fits.clone() }),
            ("a buffer too many", Draw { buffers: vec![vertices], ..fits.clone() }),
        ];
        for (what, draw) in wrong {
            assert!(refused(draw), "{what}");
        }
        assert!(!refused(fits));
        s.assert_silent();
    }

    #[test]
    fn draws_whose_pipeline_was_made_for_other_targets_are_refused() {
        let Some(mut s) = stage() else { return };
        let many = Pipelines::new(&mut s.gpu, 4).unwrap();
        let mut make = |spec| s.gpu.image("another", spec).unwrap();
        let small = make(image(DEPTH, 8, 1));
        let [colour_many, depth_many] = [PICTURE, DEPTH].map(|f| make(image(f, 16, 4)));
        let glass = make(image(GLASS, 16, 1));
        let draw = s.draw();
        let (inside, lines, ghost) = (s.pipelines.inside, s.pipelines.lines, s.pipelines.glass[1]);
        let lay = Draw {
            pipeline: s.pipelines.stack,
            push: vec![0; host::stack::SHADER.push_bytes() as usize],
            vertices: None,
            images: vec![glass],
            ..draw.clone()
        };
        let with = |pipeline| vec![Draw { pipeline, ..draw.clone() }];
        let fits = s.pass(with(inside));
        let averaged = Pass {
            colour: colour_many,
            resolve: Some(s.colour),
            depth: Some(depth_many),
            kept_depth: None,
            encoded: false,
            draws: with(many.inside),
            ..fits.clone()
        };
        let laid = Pass { depth: None, encoded: false, draws: vec![lay.clone()], ..fits.clone() };
        for (what, pass) in [
            ("one sample", fits.clone()),
            ("four samples", averaged.clone()),
            ("an image that is read", laid.clone()),
        ] {
            assert!(!s.pass_refused(pass), "{what}");
        }
        let lines_push = vec![0; host::lines::SHADER.push_bytes() as usize];
        let area = fits.area;
        let wrong = [
            ("encoded colours without a pass for them", Pass { encoded: false, ..fits.clone() }),
            (
                "linear colours in a pass for encoded ones",
                s.pass(vec![Draw { pipeline: lines, push: lines_push, ..draw.clone() }]),
            ),
            ("a colour format of another target", s.pass(with(ghost))),
            ("a pipeline without depth in a pass with it", {
                Pass { depth: Some(s.depth), ..laid.clone() }
            }),
            ("no depth", Pass { depth: None, ..fits.clone() }),
            ("a colour image for depth", Pass { depth: Some(glass), ..fits.clone() }),
            ("four samples in a pass of one", s.pass(with(many.inside))),
            ("one sample in a pass of four", Pass { draws: with(inside), ..averaged.clone() }),
            ("depth of one sample beside colour of four", {
                Pass { depth: Some(s.depth), ..averaged.clone() }
            }),
            ("a resolve of one sample", Pass { resolve: Some(s.colour), ..fits.clone() }),
            ("a resolve to another format", Pass { resolve: Some(glass), ..averaged.clone() }),
            ("depth smaller than the area", Pass { depth: Some(small), ..fits.clone() }),
            (
                "an area past the right edge",
                Pass { area: Area { x: u32::MAX, ..area }, ..fits.clone() },
            ),
            ("an empty area", Pass { area: Area { width: 0, ..area }, ..fits.clone() }),
            ("a target that is read", {
                Pass { draws: vec![Draw { images: vec![s.colour], ..lay.clone() }], ..laid.clone() }
            }),
            ("a vertex buffer that fragments read", {
                let look = Draw {
                    pipeline: s.pipelines.behind,
                    push: vec![0; host::behind::SHADER.push_bytes() as usize],
                    images: vec![s.depth],
                    buffers: vec![s.vertices; 3],
                    ..lay.clone()
                };
                Pass { draws: vec![look], ..laid.clone() }
            }),
            ("one depth that becomes one", Pass { kept_depth: Some(small), ..fits.clone() }),
            ("an image of four samples that is read", {
                Pass { draws: vec![Draw { images: vec![colour_many], ..lay }], ..laid.clone() }
            }),
        ];
        for (what, pass) in wrong {
            assert!(s.pass_refused(pass), "{what}");
        }
        assert!(!s.pass_refused(fits));
        s.assert_silent();
    }

    #[test]
    fn pictures_of_eight_bytes_a_pixel_need_as_much_room() {
        let Some(mut s) = stage() else { return };
        let glass = s.gpu.image("glass", image(GLASS, 16, 1)).unwrap();
        let [small, large] = [4, 8].map(|n| s.gpu.readback_buffer("picture", n * 256).unwrap());
        let (colour, depth, vertices) = (s.colour, s.depth, s.vertices);
        let mut refused =
            |from, to| s.refused(&Frame { picture: Some((from, to)), ..Frame::default() });
        assert!(!refused(colour, small) && !refused(glass, large));
        assert!(refused(glass, small), "a copy past the end of its buffer");
        assert!(refused(depth, small), "a depth image");
        assert!(refused(colour, vertices), "a vertex buffer");
        s.gpu.make_room(0).unwrap();
        s.assert_silent();
    }
}
