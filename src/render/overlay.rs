//! Flat triangles with pictures: panels, text and panes over a window.
//!
//! Colours are premultiplied and stay encoded as sRGB, blending included; text is made for that.
//! Pictures drawn one to one on whole pixels keep their bytes.

use std::borrow::Cow;

use bytemuck::{Pod, Zeroable};

use super::host;
use crate::vk::{
    Area, Attribute, Blend, BufferId, DepthUse, Draw, DrawPipelineId, DrawRange, DrawSpec, Format,
    Gpu, ImageId, Pass, Releaser, VkError, Write,
};

/// A corner of a triangle.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct FlatVertex {
    /// Position, pixels from the top left of the target.
    pub at_px: [f32; 2],
    /// Texture coordinates in the picture, 0 to 1.
    pub uv: [f32; 2],
    /// Colour, premultiplied, encoded as sRGB.
    pub colour: [u8; 4],
}

/// Triangles with one picture.
#[derive(Clone, Debug, PartialEq)]
pub struct FlatMesh {
    /// Picture on the triangles, one sample a pixel.
    pub picture: ImageId,
    /// Whether colours are interpolated between texels; else the nearest texel is taken.
    pub filtered: bool,
    /// The part of the target that is drawn to.
    pub clip: Area,
    /// Corners of the triangles, three each.
    pub vertices: Vec<FlatVertex>,
}

/// Draws flat triangles to targets of one format.
pub struct Overlay {
    filtered: DrawPipelineId,
    nearest: DrawPipelineId,
    vertices: Option<BufferId>,
    /// Size of the vertex buffer, bytes.
    room: u64,
    releaser: Releaser,
}

/// Least size of the vertex buffer, bytes.
const MIN_ROOM: u64 = 1 << 18;

impl Overlay {
    /// Creates the pipelines.
    ///
    /// * `format`: format of the targets, which hold encoded colours: [`Format::Rgba8Stored`] or
    ///   [`Format::Bgra8Stored`].
    ///
    /// # Errors
    /// [`VkError::OutOfMemory`], or the failing call.
    pub fn new(gpu: &mut Gpu, format: Format) -> Result<Self, VkError> {
        let spec = |fragment| DrawSpec {
            shader: &host::ui::SHADER,
            entries: ["project", fragment],
            attributes: &[Attribute::F32x2, Attribute::F32x2, Attribute::Unorm8x4],
            colour: format,
            depth: None,
            depth_use: DepthUse::Ignore,
            samples: 1,
            blend: Blend::Over,
            cull_backs: false,
        };
        gpu.all_or_none(|gpu| {
            Ok(Self {
                filtered: gpu.draw_pipeline(&spec("filtered"))?,
                nearest: gpu.draw_pipeline(&spec("nearest"))?,
                vertices: None,
                room: 0,
                releaser: gpu.releaser(),
            })
        })
    }

    /// Returns the pass that clears a target and draws meshes over it in order, and the write of
    /// their vertices, which belongs to the same frame.
    ///
    /// # Errors
    /// [`VkError::OutOfMemory`], or the failing call.
    pub fn pass(
        &mut self,
        gpu: &mut Gpu,
        target: ImageId,
        background: [f32; 4],
        meshes: &[FlatMesh],
    ) -> Result<(Pass, Option<Write<'static>>), VkError> {
        let [width, height] = gpu.image_extent(target);
        let area = Area { x: 0, y: 0, width, height };
        let mut bytes: Vec<u8> = Vec::new();
        let mut draws = Vec::new();
        let push = host::ui::Params { size: [width as f32, height as f32] };
        let mut first = 0;
        for mesh in meshes {
            let Some(clip) = clipped(mesh.clip, area) else { continue };
            let count = mesh.vertices.len() as u32;
            bytes.extend_from_slice(bytemuck::cast_slice(&mesh.vertices));
            draws.push(Draw {
                pipeline: if mesh.filtered { self.filtered } else { self.nearest },
                push: bytemuck::bytes_of(&push).to_vec(),
                vertices: None,
                indices: None,
                range: DrawRange::Direct(first..first + count),
                images: vec![mesh.picture],
                buffers: Vec::new(),
                scissor: Some(clip),
            });
            first += count;
        }
        let write = self.room_for(gpu, bytes.len() as u64)?.map(|to| {
            draws.iter_mut().for_each(|d| d.vertices = Some(to));
            Write { to, offset: 0, bytes: Cow::Owned(bytes) }
        });
        let pass = Pass {
            colour: target,
            resolve: None,
            depth: None,
            kept_depth: None,
            encoded: false,
            clear: Some(background),
            area,
            draws,
        };
        Ok((pass, write))
    }

    /// Returns a buffer for so many bytes, made larger if need be; `None` for none.
    fn room_for(&mut self, gpu: &mut Gpu, bytes: u64) -> Result<Option<BufferId>, VkError> {
        if bytes == 0 {
            return Ok(None);
        }
        if bytes > self.room {
            let room = bytes.next_power_of_two().max(MIN_ROOM);
            let new = gpu.empty_vertices("flat vertices", room)?;
            self.vertices.replace(new).into_iter().for_each(|old| self.releaser.buffer(old));
            self.room = room;
        }
        Ok(self.vertices)
    }
}

impl Drop for Overlay {
    fn drop(&mut self) {
        self.releaser.draw_pipeline(self.filtered);
        self.releaser.draw_pipeline(self.nearest);
        self.vertices.into_iter().for_each(|v| self.releaser.buffer(v));
    }
}

/// Returns the part of an area within another, if there is any.
fn clipped(a: Area, within: Area) -> Option<Area> {
    let span = |from: u32, n: u32, low: u32, side: u32| {
        let (from, end) = (from.max(low), (from.saturating_add(n)).min(low + side));
        (from < end).then(|| (from, end - from))
    };
    let (x, width) = span(a.x, a.width, within.x, within.width)?;
    let (y, height) = span(a.y, a.height, within.y, within.height)?;
    Some(Area { x, y, width, height })
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::vk::{Choice, Frame, ImageSpec, ImageWrite, OpenOptions, Validate};

    const SIDE: u32 = 16;

    fn image(format: Format) -> ImageSpec {
        ImageSpec { format, extent: [SIDE; 2], samples: 1 }
    }

    /// Two triangles that cover an area, with all of a picture.
    fn quad(a: Area, colour: [u8; 4]) -> Vec<FlatVertex> {
        let corner = |u: u32, v: u32| FlatVertex {
            at_px: [(a.x + u * a.width) as f32, (a.y + v * a.height) as f32],
            uv: [u as f32, v as f32],
            colour,
        };
        [(0, 0), (1, 0), (0, 1), (0, 1), (1, 0), (1, 1)].map(|(u, v)| corner(u, v)).to_vec()
    }

    #[test]
    fn a_picture_one_to_one_keeps_its_bytes_and_colours_blend_as_they_are_encoded() {
        let options =
            OpenOptions { validate: Validate::Sync, cache_dir: None, ..Default::default() };
        let mut gpu = match Gpu::open_with(Choice::Any, options) {
            Ok(gpu) => gpu,
            Err(e) if e.is_no_device() && std::env::var_os("INTIMA_REQUIRE_GPU").is_none() => {
                return;
            }
            Err(e) => panic!("{e}"),
        };
        let mut overlay = Overlay::new(&mut gpu, Format::Rgba8Stored).unwrap();
        let target = gpu.image("target", image(Format::Rgba8Stored)).unwrap();
        // Kept as sRGB, as the panes are; read as its bytes.
        let pane = gpu.image("pane", image(Format::Rgba8Srgb)).unwrap();
        let white = gpu.image("white", image(Format::Rgba8Stored)).unwrap();
        let back = gpu.readback_buffer("back", 4 * u64::from(SIDE * SIDE)).unwrap();
        let whole = Area { x: 0, y: 0, width: SIDE, height: SIDE };
        let pixels: Vec<u8> = (0..SIDE * SIDE)
            .flat_map(|i| [(i % 251) as u8, (i / 3) as u8, (7 * i % 256) as u8, 255])
            .collect();
        let all = [255; 4 * (SIDE * SIDE) as usize];
        let fill = |to, bytes| ImageWrite { to, area: whole, bytes: Cow::Borrowed(bytes) };
        let right = Area { x: 8, y: 4, width: 8, height: 4 };
        for filtered in [false, true] {
            let meshes = [
                FlatMesh { picture: pane, filtered, clip: whole, vertices: quad(whole, [255; 4]) },
                // Half of a grey of 100, over everything but clipped to a part.
                FlatMesh {
                    picture: white,
                    filtered,
                    clip: right,
                    vertices: quad(whole, [50, 50, 50, 128]),
                },
            ];
            let (pass, write) = overlay.pass(&mut gpu, target, [0.0; 4], &meshes).unwrap();
            let frame = Frame {
                writes: write.into_iter().collect(),
                image_writes: vec![fill(pane, &pixels), fill(white, &all)],
                passes: vec![pass],
                picture: Some((target, back)),
            };
            gpu.make_room(frame.staged_bytes()).unwrap();
            gpu.submit_draws(&frame).unwrap();
            let drawn = gpu.read(back).unwrap().to_vec();
            for (i, (got, put)) in drawn.chunks(4).zip(pixels.chunks(4)).enumerate() {
                let (x, y) = (i as u32 % SIDE, i as u32 / SIDE);
                if (8..16).contains(&x) && (4..8).contains(&y) {
                    for c in 0..3 {
                        let want = 50.0 + f64::from(put[c]) * 127.0 / 255.0;
                        assert!(
                            (f64::from(got[c]) - want).abs() <= 1.0,
                            "{x} {y}: {got:?} {put:?}"
                        );
                    }
                } else {
                    assert_eq!(got, put, "{x} {y}");
                }
            }
        }
        let said = gpu.validation_messages();
        assert!(said.is_empty(), "{said:?}");
    }

    #[test]
    fn a_clip_outside_the_target_draws_nothing() {
        let within = Area { x: 0, y: 0, width: 10, height: 10 };
        assert_eq!(clipped(Area { x: 10, y: 0, width: 5, height: 5 }, within), None);
        assert_eq!(clipped(Area { x: 3, y: 3, width: 0, height: 5 }, within), None);
        let all = clipped(Area { x: 4, y: 0, width: u32::MAX, height: 5 }, within);
        assert_eq!(all, Some(Area { x: 4, y: 0, width: 6, height: 5 }));
    }
}
