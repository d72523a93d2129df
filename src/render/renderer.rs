//! The renderer: what it holds on the device, and frames in flight.

use glam::{Vec2, Vec3};

use super::lines::Tubes;
use super::mesh;
use super::pages::Pages;
use super::picture::{Spares, without_alpha};
use super::pipelines::{DEPTH, GLASS, PICTURE, Pipelines};
use super::scene::{FrameStats, MeshHandle, PathHandle, Scene, Shot, View, Wall};
use super::{RenderError, host};
use crate::geometry::{Lens, Mesh, Pose, Vertex};
use crate::lod::Camera;
use crate::vk::{Area, BufferId, Draw, DrawPipelineId, Gpu, ImageId, ImageSpec, Pass, Take};

/// A frame that was submitted and not fetched yet.
#[derive(Debug)]
#[must_use = "a frame occupies a slot until it is fetched"]
pub struct Ticket {
    slot: usize,
    /// What it took to draw it.
    pub stats: FrameStats,
}

pub(super) struct Model {
    pub vertices: BufferId,
    pub indices: BufferId,
    pub count: u32,
    pub bounds: Option<(Vec3, Vec3)>,
    pub mean_radius_mm: f32,
}

/// Images of one size.
pub(super) struct Targets {
    pub picture: ImageId,
    /// Multisampled twin of the picture.
    pub picture_many: Option<ImageId>,
    pub glass: ImageId,
    pub glass_many: Option<ImageId>,
    pub depth: ImageId,
}

/// Frames that may be submitted and not fetched.
pub const IN_FLIGHT: usize = 3;

/// Draws frames of one size.
pub struct Renderer<'g> {
    pub(super) gpu: &'g mut Gpu,
    size: [u32; 2],
    pub(super) pipelines: Pipelines,
    pub(super) targets: Targets,
    pub(super) models: Vec<Option<Model>>,
    pub(super) paths: Vec<Option<Model>>,
    pub(super) pages: Vec<Option<Pages>>,
    pub(super) frustum: Model,
    pub(super) ball: Model,
    /// What the glass image shows at the moment.
    pub(super) glass_of: Option<super::overview::GlassKey>,
    slots: Vec<BufferId>,
    idle: Vec<usize>,
    spares: Spares,
}

impl<'g> Renderer<'g> {
    /// A renderer of frames of `width` by `height` with 1 or 4 samples a pixel.
    ///
    /// # Errors
    /// [`RenderError::BadSize`]; [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn new(
        gpu: &'g mut Gpu,
        width: u32,
        height: u32,
        samples: u32,
    ) -> Result<Self, RenderError> {
        let possible = matches!(samples, 1 | 4) && samples <= gpu.info().max_samples;
        if !possible || width < 2 || height < 1 || width > 16384 || height > 16384 {
            return Err(RenderError::BadSize { width, height, samples });
        }
        let extent = [width, height];
        let image = |gpu: &mut Gpu, name, format, samples| {
            gpu.image(name, ImageSpec { format, extent, samples })
        };
        let many = samples > 1;
        let mut twin = |name, format| {
            if many { image(gpu, name, format, samples).map(Some) } else { Ok(None) }
        };
        let (picture_many, glass_many) = (twin("picture", PICTURE)?, twin("glass", GLASS)?);
        let targets = Targets {
            picture: image(gpu, "picture", PICTURE, 1)?,
            picture_many,
            glass: image(gpu, "glass", GLASS, 1)?,
            glass_many,
            depth: image(gpu, "depth", DEPTH, samples)?,
        };
        let bytes = u64::from(width) * u64::from(height) * 4;
        let slots = (0..IN_FLIGHT)
            .map(|_| gpu.readback_buffer("frame", bytes))
            .collect::<Result<Vec<_>, _>>()?;
        Ok(Self {
            pipelines: Pipelines::new(gpu, samples)?,
            frustum: upload_tubes(gpu, &Tubes::frustum())?,
            ball: upload_tubes(gpu, &Tubes::ball())?,
            gpu,
            size: extent,
            targets,
            models: Vec::new(),
            paths: Vec::new(),
            pages: Vec::new(),
            glass_of: None,
            idle: (0..slots.len()).collect(),
            slots,
            spares: Spares::default(),
        })
    }

    /// The device this draws on.
    pub fn gpu(&mut self) -> &mut Gpu {
        self.gpu
    }

    /// Columns and rows of a frame.
    pub fn size(&self) -> [u32; 2] {
        self.size
    }

    /// Puts a mesh on the device; faces tagged as caps are left out on request.
    ///
    /// # Errors
    /// [`RenderError::BadFace`]; [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn upload_mesh(&mut self, mesh: &Mesh, skip_caps: bool) -> Result<MeshHandle, RenderError> {
        let p = mesh::prepare(mesh, skip_caps)?;
        let model = upload(self.gpu, &p.vertices, &p.indices, p.bounds, p.mean_radius_mm)?;
        self.models.push(Some(model));
        Ok(MeshHandle(self.models.len() - 1))
    }

    /// Frees a mesh once no frame in flight uses it.
    pub fn remove_mesh(&mut self, mesh: MeshHandle) {
        if let Some(m) = self.models[mesh.0].take() {
            self.gpu.free_buffer(m.vertices);
            self.gpu.free_buffer(m.indices);
            self.glass_of = None;
        }
    }

    /// Puts a path on the device, LPS mm from start to end.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`] when the device runs out of memory.
    pub fn upload_path(&mut self, points: &[Vec3]) -> Result<PathHandle, RenderError> {
        let model = upload_tubes(self.gpu, &Tubes::along(points))?;
        self.paths.push(Some(model));
        Ok(PathHandle(self.paths.len() - 1))
    }

    /// Draws one frame and waits for it: RGB, eight bits each, rows from the top.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    pub fn render(&mut self, scene: &Scene, shot: &Shot) -> Result<Vec<u8>, RenderError> {
        let ticket = self.begin_frame(scene, shot)?;
        self.fetch(ticket)
    }

    /// Submits a frame and returns at once. At most three may wait to be fetched.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    ///
    /// # Panics
    /// If three frames are waiting already.
    pub fn begin_frame(&mut self, scene: &Scene, shot: &Shot) -> Result<Ticket, RenderError> {
        let slot = self.idle.pop().expect("at most three frames in flight");
        let (inside, outside) = self.areas(shot.view);
        let mut passes = Vec::new();
        let mut stats = FrameStats::default();
        if let Some(area) = inside {
            passes.push(self.inside_pass(scene, shot, area, &mut stats));
        }
        if let Some(area) = outside {
            self.overview_passes(scene, shot, area, &mut passes);
        }
        let picture = (self.targets.picture, self.slots[slot]);
        if let Err(e) = self.submit_with_changes(scene.pages(), passes, picture, &mut stats) {
            self.idle.push(slot);
            self.glass_of = None;
            return Err(e);
        }
        Ok(Ticket { slot, stats })
    }

    /// The parts of a frame that the inside view and the overview fill.
    fn areas(&self, view: View) -> (Option<Area>, Option<Area>) {
        let [width, height] = self.size;
        let whole = Area { x: 0, y: 0, width, height };
        let left = Area { width: width / 2, ..whole };
        let right = Area { x: width / 2, width: width - width / 2, ..whole };
        match view {
            View::Inside => (Some(whole), None),
            View::Overview => (None, Some(whole)),
            View::Split => (Some(left), Some(right)),
        }
    }

    /// The camera of a shot's inside view, as the wall's level of detail has to know it; `None`
    /// where the shot has no such view.
    pub fn camera(&self, shot: &Shot) -> Option<Camera> {
        self.areas(shot.view).0.map(|area| camera_of(shot, area))
    }

    /// Waits for a frame and takes it: RGB, eight bits each, rows from the top.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    pub fn fetch(&mut self, ticket: Ticket) -> Result<Vec<u8>, RenderError> {
        self.idle.push(ticket.slot);
        let [width, height] = self.size;
        let pixels = width as usize * height as usize;
        let rgba = &self.gpu.read(self.slots[ticket.slot])?[..4 * pixels];
        let mut rgb = self.spares.take(3 * pixels);
        without_alpha(rgba, &mut rgb);
        Ok(rgb)
    }

    /// Where pictures may be given back once they are not needed any more, from any thread.
    pub fn spares(&self) -> Spares {
        self.spares.clone()
    }

    pub(super) fn model(&self, mesh: MeshHandle) -> &Model {
        self.models[mesh.0].as_ref().expect("a mesh that was not removed")
    }

    fn inside_pass(&self, scene: &Scene, shot: &Shot, area: Area, stats: &mut FrameStats) -> Pass {
        let camera = camera_of(shot, area);
        let radius = match scene.wall {
            Wall::Mesh(mesh) => self.model(mesh).mean_radius_mm,
            Wall::Pages { pages, .. } => self.wall_pages(pages).mean_radius_mm,
        };
        let falloff = scene.look.falloff_mm.unwrap_or(super::look::FALLOFF_RADII * radius);
        // The light sits beside the lens, as on an endoscope: relief needs a shadow side.
        let beside = super::look::LIGHT_RADII * radius.min(shot.lens.near_mm * 4.0);
        let light = shot.pose.position_mm + beside * shot.pose.up();
        let push = surface_push(&shot.pose, &camera.lens, area, light, falloff);
        let push = bytemuck::bytes_of(&push);
        let draws = match scene.wall {
            Wall::Mesh(mesh) => draw(self.pipelines.inside, self.model(mesh), push, Vec::new()),
            Wall::Pages { pages, backs } => {
                let own = self.wall_pages(pages);
                let (pieces, triangles) = own.pieces(&camera, backs);
                stats.draws = pieces.len() as u32;
                stats.triangles = triangles;
                let p = &self.pipelines;
                (triangles > 0).then(|| Draw {
                    pipeline: if backs { p.inside } else { p.inside_fronts },
                    push: push.to_vec(),
                    vertices: Some(own.vertices),
                    indices: Some(own.indices),
                    take: Take::Pieces(pieces),
                    images: Vec::new(),
                })
            }
        };
        if let (Wall::Mesh(mesh), true) = (scene.wall, draws.is_some()) {
            stats.draws = 1;
            stats.triangles = u64::from(self.model(mesh).count / 3);
        }
        let (colour, resolve) = self.picture_targets();
        let encoded = resolve.is_none();
        let background = scene.look.background;
        let [r, g, b] = if encoded { super::look::srgb(background) } else { background };
        Pass {
            colour,
            resolve,
            depth: Some(self.targets.depth),
            encoded,
            clear: Some([r, g, b, 1.0]),
            area,
            draws: draws.into_iter().collect(),
        }
    }

    /// Colour target and what it is resolved to.
    pub(super) fn picture_targets(&self) -> (ImageId, Option<ImageId>) {
        let t = &self.targets;
        t.picture_many.map_or((t.picture, None), |many| (many, Some(t.picture)))
    }
}

impl Drop for Renderer<'_> {
    fn drop(&mut self) {
        self.pages.drain(..).flatten().for_each(|p| p.free(self.gpu));
        let models = self.models.drain(..).chain(self.paths.drain(..)).flatten();
        for m in models {
            self.gpu.free_buffer(m.vertices);
            self.gpu.free_buffer(m.indices);
        }
        for m in [&self.frustum, &self.ball] {
            self.gpu.free_buffer(m.vertices);
            self.gpu.free_buffer(m.indices);
        }
        self.pipelines.free(self.gpu);
        self.slots.iter().for_each(|b| self.gpu.free_buffer(*b));
        let t = &self.targets;
        for image in [Some(t.picture), t.picture_many, Some(t.glass), t.glass_many, Some(t.depth)] {
            image.into_iter().for_each(|i| self.gpu.free_image(i));
        }
    }
}

fn camera_of(shot: &Shot, area: Area) -> Camera {
    let lens = Lens { aspect: area.width as f32 / area.height as f32, ..shot.lens };
    Camera { pose: shot.pose, lens, height_px: area.height }
}

/// A draw of all of a model, or nothing if it is empty.
pub(super) fn draw(
    pipeline: DrawPipelineId,
    model: &Model,
    push: &[u8],
    images: Vec<ImageId>,
) -> Option<Draw> {
    (model.count > 0).then(|| Draw {
        pipeline,
        push: push.to_vec(),
        vertices: Some(model.vertices),
        indices: Some(model.indices),
        take: Take::Range(0..model.count),
        images,
    })
}

/// Within these, mm, squares of distances in falloffs are numbers.
const FALLOFFS_MM: (f32, f32) = (1e-3, 1e6);

/// What the surface shader has to know; `light` in LPS mm, halved at `falloff` mm. Pixels are
/// square: the lens has the area's aspect.
pub(super) fn surface_push(
    pose: &Pose,
    lens: &Lens,
    area: Area,
    light: Vec3,
    falloff: f32,
) -> host::surface::Params {
    let focal = super::camera::focal(lens);
    let size = Vec2::new(area.width as f32, area.height as f32);
    let middle = Vec2::new(area.x as f32, area.y as f32) + 0.5 * size;
    let depth = -0.5 * size.y * focal.y;
    let falloff = falloff.clamp(FALLOFFS_MM.0, FALLOFFS_MM.1);
    let scale = (depth * falloff).recip();
    let turn = pose.rotation.conjugate();
    host::surface::Params {
        turn: turn.to_array(),
        eye: pose.position_mm.to_array(),
        near: lens.near_mm * scale,
        light: ((turn * (light - pose.position_mm)) / falloff).to_array(),
        scale,
        focal: focal.to_array(),
        middle: middle.to_array(),
        depth,
        ..bytemuck::Zeroable::zeroed()
    }
}

fn upload_tubes(gpu: &mut Gpu, tubes: &Tubes) -> Result<Model, RenderError> {
    let bounds = tubes.vertices.iter().fold(None, |b: Option<(Vec3, Vec3)>, v| {
        let p = v.position();
        Some(b.map_or((p, p), |(lo, hi)| (lo.min(p), hi.max(p))))
    });
    upload(gpu, &tubes.vertices, &tubes.indices, bounds, 0.0)
}

fn upload(
    gpu: &mut Gpu,
    vertices: &[Vertex],
    indices: &[u32],
    bounds: Option<(Vec3, Vec3)>,
    mean_radius_mm: f32,
) -> Result<Model, RenderError> {
    let vertices = gpu.vertex_buffer("vertices", bytemuck::cast_slice(vertices))?;
    let count = indices.len() as u32;
    match gpu.index_buffer("indices", indices) {
        Ok(indices) => Ok(Model { vertices, indices, count, bounds, mean_radius_mm }),
        Err(e) => {
            gpu.free_buffer(vertices);
            Err(e.into())
        }
    }
}
