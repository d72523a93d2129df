//! The panels' triangles and textures on the device, put onto an image with the drawn panes.

use std::borrow::Cow;
use std::collections::HashMap;

use egui::TextureId;
use egui::epaint::Primitive;

use super::error::AppError;
use crate::render::{FlatMesh, FlatVertex, Overlay};
use crate::vk::{Area, Format, Frame, Gpu, ImageId, ImageSpec, ImageWrite, VkError};

/// A part of a texture that has changed.
struct TextureChange {
    id: TextureId,
    area: Area,
    /// All of the texture: it may have another size than before.
    is_whole: bool,
    rgba: Vec<u8>,
}

/// A texture of the panels, with its texels for a device that is opened after another was lost.
struct Texture {
    image: Option<ImageId>,
    size: [u32; 2],
    rgba: Vec<u8>,
}

impl Texture {
    /// Takes a change in.
    fn write(&mut self, c: &TextureChange) {
        let Area { x, y, width, height } = c.area;
        if c.is_whole {
            (self.size, self.rgba) = ([width, height], c.rgba.clone());
            return;
        }
        let row = 4 * width as usize;
        for k in 0..height as usize {
            let to = 4 * ((y as usize + k) * self.size[0] as usize + x as usize);
            let from = k * row;
            if let Some(own) = self.rgba.get_mut(to..to + row) {
                own.copy_from_slice(&c.rgba[from..from + row]);
            }
        }
    }
}

/// Image that a frame is drawn to.
pub struct Target {
    pub image: ImageId,
    pub format: Format,
}

/// Textures and pipeline of the panels.
#[derive(Default)]
pub struct Canvas {
    overlay: Option<(Overlay, Format)>,
    textures: HashMap<TextureId, Texture>,
    /// Waiting for the next frame that is drawn.
    changes: Vec<TextureChange>,
    freed: Vec<TextureId>,
}

impl Canvas {
    /// Notes what has become of textures. To be called before anything can fail, so that a frame
    /// that is not drawn loses none of it.
    pub fn collect(&mut self, mut delta: egui::TexturesDelta) {
        let mut set: Vec<_> = delta.set.drain().collect();
        set.sort_by_key(|(id, _)| *id);
        for (id, deltas) in set {
            for delta in deltas {
                let egui::ImageData::Color(image) = &delta.image;
                let [width, height] = image.size.map(|s| s as u32);
                let [x, y] = delta.pos.unwrap_or([0, 0]).map(|s| s as u32);
                let rgba = image.pixels.iter().flat_map(|c| c.to_array()).collect();
                let (area, is_whole) = (Area { x, y, width, height }, delta.pos.is_none());
                if is_whole {
                    self.changes.retain(|c| c.id != id);
                }
                self.changes.push(TextureChange { id, area, is_whole, rgba });
            }
        }
        self.freed.extend(delta.free.drain());
    }

    /// Draws triangles of the panels.
    ///
    /// * `scale`: pixels a point.
    /// * `pane`: the image of a texture that is a drawn pane, and whether it has more pixels than that.
    /// * `send`: submits the frame.
    ///
    /// # Errors
    /// The device's.
    pub fn draw(
        &mut self,
        gpu: &mut Gpu,
        target: &Target,
        (primitives, scale): (Vec<egui::ClippedPrimitive>, f32),
        pane: impl Fn(TextureId) -> Option<(ImageId, bool)>,
        send: impl FnOnce(&mut Gpu, &Frame<'_>) -> Result<(), VkError>,
    ) -> Result<(), AppError> {
        let changes = std::mem::take(&mut self.changes);
        self.make_textures(gpu, &changes)?;
        if self.overlay.as_ref().is_none_or(|o| o.1 != target.format) {
            self.overlay = Some((Overlay::new(gpu, target.format)?, target.format));
        }
        let of = |p| flat_mesh(p, scale, &pane, &self.textures);
        let meshes: Vec<FlatMesh> = primitives.into_iter().filter_map(of).collect();
        let Some((overlay, _)) = &mut self.overlay else { return Ok(()) };
        let (pass, write) = overlay.pass(gpu, target.image, [0.05, 0.05, 0.06, 1.0], &meshes)?;
        let image_writes = changes.iter().filter_map(|c| {
            let to = self.textures.get(&c.id)?.image?;
            Some(ImageWrite { to, area: c.area, bytes: Cow::Borrowed(&c.rgba[..]) })
        });
        let frame = Frame {
            writes: write.into_iter().collect(),
            image_writes: image_writes.collect(),
            passes: vec![pass],
            picture: None,
        };
        send(gpu, &frame)?;
        for id in std::mem::take(&mut self.freed) {
            if let Some(image) = self.textures.remove(&id).and_then(|t| t.image) {
                gpu.free_image(image);
            }
        }
        Ok(())
    }

    /// Draws triangles of the panels into an image of their own and reads that back: RGB, rows from
    /// the top.
    ///
    /// # Errors
    /// The device's.
    pub fn picture(
        &mut self,
        gpu: &mut Gpu,
        extent: [u32; 2],
        primitives: (Vec<egui::ClippedPrimitive>, f32),
        pane: impl Fn(TextureId) -> Option<(ImageId, bool)>,
    ) -> Result<Vec<u8>, AppError> {
        let format = Format::Rgba8Stored;
        let image = gpu.image("window", ImageSpec { format, extent, samples: 1 })?;
        let bytes = extent.map(u64::from).iter().product::<u64>() * 4;
        let back = gpu.readback_buffer("window", bytes)?;
        let target = Target { image, format };
        self.draw(gpu, &target, primitives, pane, |gpu, frame| {
            let frame = Frame { picture: Some((image, back)), ..frame.clone() };
            gpu.make_room(frame.staged_bytes())?;
            gpu.submit_draws(&frame)
        })?;
        let rgba = gpu.read(back)?[..bytes as usize].to_vec();
        gpu.free_image(image);
        gpu.free_buffer(back);
        Ok(rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect())
    }

    /// Images for textures that are written whole and have none of that size.
    fn make_textures(&mut self, gpu: &mut Gpu, changes: &[TextureChange]) -> Result<(), AppError> {
        for c in changes {
            let empty = || Texture { image: None, size: [0; 2], rgba: Vec::new() };
            self.textures.entry(c.id).or_insert_with(empty).write(c);
        }
        for c in changes {
            let Some(texture) = self.textures.get_mut(&c.id) else { continue };
            let extent = [c.area.width, c.area.height];
            let fits = texture.image.is_some_and(|i| gpu.image_extent(i) == extent);
            if !c.is_whole || fits {
                continue;
            }
            let spec = ImageSpec { format: Format::Rgba8Stored, extent, samples: 1 };
            if let Some(old) = texture.image.replace(gpu.image("texture", spec)?) {
                gpu.free_image(old);
            }
        }
        Ok(())
    }

    /// The device was lost: everything is made on the next one that draws.
    pub fn forget_device(&mut self) {
        self.overlay = None;
        self.freed.clear();
        // What is there goes first, then what was not drawn yet.
        let late = std::mem::take(&mut self.changes);
        let mut ids: Vec<TextureId> = self.textures.keys().copied().collect();
        ids.sort();
        for id in ids {
            let Some(t) = self.textures.get_mut(&id) else { continue };
            t.image = None;
            let area = Area { x: 0, y: 0, width: t.size[0], height: t.size[1] };
            let rgba = t.rgba.clone();
            self.changes.push(TextureChange { id, area, is_whole: true, rgba });
        }
        self.changes.extend(late);
    }
}

/// Triangles in pixels, with the image of their texture.
fn flat_mesh(
    p: egui::ClippedPrimitive,
    scale: f32,
    pane: impl Fn(TextureId) -> Option<(ImageId, bool)>,
    textures: &HashMap<TextureId, Texture>,
) -> Option<FlatMesh> {
    let Primitive::Mesh(mesh) = p.primitive else { return None };
    let (picture, filtered) = match pane(mesh.texture_id) {
        Some(pane) => pane,
        None => (textures.get(&mesh.texture_id)?.image?, true),
    };
    let size = |v: f32| (v * scale).round().max(0.0) as u32;
    let (min, max) = (p.clip_rect.min, p.clip_rect.max);
    let (x, y) = (size(min.x), size(min.y));
    let (right, lower) = (size(max.x), size(max.y));
    let clip = Area { x, y, width: right.saturating_sub(x), height: lower.saturating_sub(y) };
    let corner = |i: &u32| {
        let v = &mesh.vertices[*i as usize];
        FlatVertex {
            at_px: [v.pos.x * scale, v.pos.y * scale],
            uv: [v.uv.x, v.uv.y],
            colour: v.color.to_array(),
        }
    };
    let vertices = mesh.indices.iter().map(corner).collect();
    Some(FlatMesh { picture, filtered, clip, vertices })
}
