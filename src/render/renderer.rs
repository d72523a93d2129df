//! The renderer: its resources on the device, and frames in flight.

use std::sync::Arc;

use super::RenderError;
use super::behind::PlacedTissue;
use super::contrast::ContrastTargets;
use super::edges::EdgeSmoother;
use super::inside::DrawnParts;
use super::lines::Tubes;
use super::picture::{Spares, without_alpha};
use super::pipelines::Pipelines;
use super::placed_mesh::{PlacedMesh, upload_tubes};
use super::refined_faces::{FrameFaces, RefinedFaces};
use super::scene::{FrameStats, GlassKey, MeshHandle, Scene, Shot, UnfoldedFace, View};
use super::targets::Targets;
use crate::geometry::{Camera, Lens};
use crate::lod::{DrawnWall, VisibleWall};
use crate::vk::{Area, BufferId, Draw, DrawPipelineId, DrawRange, Frame, Gpu, ImageId, Releaser};

/// A frame that was submitted and not fetched yet.
#[derive(Debug)]
#[must_use = "a frame occupies a slot until it is fetched"]
pub struct Ticket {
    slot: usize,
    /// Statistics of drawing the frame.
    pub stats: FrameStats,
}

/// Read-back buffer of a frame; a frame in flight keeps its own size.
#[derive(Clone, Copy)]
struct ReadbackSlot {
    buffer: BufferId,
    extent: [u32; 2],
}

impl ReadbackSlot {
    fn new(gpu: &mut Gpu, extent: [u32; 2]) -> Result<Self, RenderError> {
        let bytes = u64::from(extent[0]) * u64::from(extent[1]) * 4;
        Ok(Self { buffer: gpu.readback_buffer("frame", bytes)?, extent })
    }
}

/// Number of frames that may be submitted and not fetched.
pub const IN_FLIGHT: usize = 3;
/// Draws frames of one size.
///
/// It holds handles to its resources on a [`Gpu`] and borrows no `Gpu`: each call that needs the
/// device is given the one the renderer was made on, and panics if it is another. When dropped, it
/// frees its resources at the device's next submission.
pub struct Renderer {
    pub(super) samples: u32,
    /// Smooths the edges of finished pictures, where asked to.
    edges: Option<EdgeSmoother>,
    pub(super) pipelines: Pipelines,
    pub(super) targets: Targets,
    /// Images that the six faces of a panorama are drawn to.
    pub(super) faces: Option<Targets>,
    /// Images of local contrast, once a shot has it.
    pub(super) contrast: Option<ContrastTargets>,
    /// The image that the last frame was finished in.
    finished: ImageId,
    pub(super) models: Vec<Option<PlacedMesh>>,
    pub(super) paths: Vec<Option<PlacedMesh>>,
    pub(super) tissues: Vec<Option<PlacedTissue>>,
    pub(super) frustum: PlacedMesh,
    pub(super) ball: PlacedMesh,
    /// Inputs of the glass image as it is now.
    pub(super) glass_of: Option<GlassKey>,
    slots: Vec<ReadbackSlot>,
    idle: Vec<usize>,
    spares: Spares,
    /// Largest number of refined faces of each level that are made for one frame.
    made: u32,
    pub(super) releaser: Releaser,
}

impl Renderer {
    /// Creates a renderer of frames of `width` by `height` pixels with 1 or 4 samples a pixel.
    ///
    /// # Errors
    /// [`RenderError::BadSize`]; [`RenderError::Vulkan`] when the device runs out of memory. After
    /// an error nothing stays on the device.
    pub fn new(gpu: &mut Gpu, width: u32, height: u32, samples: u32) -> Result<Self, RenderError> {
        Self::make(gpu, [width, height], samples, None)
    }

    /// Creates a renderer of frames with one sample a pixel, whose edges are smoothed as the frames are
    /// fetched: on software Vulkan, where four samples take as long again as the frame.
    ///
    /// # Errors
    /// As [`Renderer::new`].
    pub fn with_smooth_edges(gpu: &mut Gpu, width: u32, height: u32) -> Result<Self, RenderError> {
        Self::make(gpu, [width, height], 1, Some(EdgeSmoother::new()))
    }

    fn make(
        gpu: &mut Gpu,
        extent: [u32; 2],
        samples: u32,
        edges: Option<EdgeSmoother>,
    ) -> Result<Self, RenderError> {
        gpu.all_or_none(|gpu| {
            let targets = Targets::new(gpu, extent, samples, edges.is_some())?;
            let slots =
                (0..IN_FLIGHT).map(|_| ReadbackSlot::new(gpu, extent)).collect::<Result<_, _>>()?;
            Ok(Self {
                samples,
                edges,
                pipelines: Pipelines::new(gpu, samples)?,
                frustum: upload_tubes(gpu, &Tubes::frustum())?,
                ball: upload_tubes(gpu, &Tubes::ball())?,
                finished: targets.picture,
                targets,
                faces: None,
                contrast: None,
                models: Vec::new(),
                paths: Vec::new(),
                tissues: Vec::new(),
                glass_of: None,
                slots,
                idle: (0..IN_FLIGHT).collect(),
                spares: Spares::default(),
                made: u32::MAX,
                releaser: gpu.releaser(),
            })
        })
    }

    /// Sets the size of later frames to `width` by `height` pixels. Frames in flight keep their
    /// size and may still be fetched.
    ///
    /// # Errors
    /// As [`Renderer::new`]; then the size is what it was.
    pub fn resize(&mut self, gpu: &mut Gpu, width: u32, height: u32) -> Result<(), RenderError> {
        self.check_device(gpu);
        if self.size() == [width, height] {
            return Ok(());
        }
        let targets = Targets::new(gpu, [width, height], self.samples, self.edges.is_some())?;
        self.finished = targets.picture;
        std::mem::replace(&mut self.targets, targets).release(&self.releaser);
        self.contrast.take().iter().for_each(|c| c.release(&self.releaser));
        self.glass_of = None;
        Ok(())
    }

    /// Whether the renderer was made on this device, and can draw on it.
    pub fn is_on(&self, gpu: &Gpu) -> bool {
        gpu.owns(&self.releaser)
    }

    pub(super) fn check_device(&self, gpu: &Gpu) {
        assert!(self.is_on(gpu), "a renderer draws on the device it was made on");
    }

    /// Columns and rows of a frame.
    pub fn size(&self) -> [u32; 2] {
        self.targets.extent
    }

    /// Makes at most so many refined faces of each level for each later frame: the frames of a window
    /// do not wait, and [`FrameStats::waiting`] counts the faces that are flat until then. Without
    /// this call a frame waits for all of them.
    pub fn make_at_most(&mut self, faces: u32) {
        self.made = faces;
    }

    /// Draws one frame and waits for it: RGB, eight bits each, rows from the top.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    pub fn render(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shot: &Shot,
    ) -> Result<Vec<u8>, RenderError> {
        let ticket = self.begin_frame(gpu, scene, shot)?;
        self.fetch(gpu, ticket)
    }

    /// Submits a frame and returns at once. At most three may wait to be fetched.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    ///
    /// # Panics
    /// If three frames are waiting already.
    pub fn begin_frame(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shot: &Shot,
    ) -> Result<Ticket, RenderError> {
        self.begin_seen_frame(gpu, scene, shot, None)
    }

    /// Submits a frame as [`Renderer::begin_frame`].
    ///
    /// * `seen`: what each of the shot's cameras sees of the wall, if it is known.
    pub(super) fn begin_seen_frame(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shot: &Shot,
        seen: Option<&[VisibleWall]>,
    ) -> Result<Ticket, RenderError> {
        self.check_device(gpu);
        let slot = self.idle.pop().expect("at most three frames in flight");
        let begun = self.submit_frame(gpu, scene, shot, seen, slot);
        if begun.is_err() {
            self.idle.push(slot);
            self.glass_of = None;
        }
        begun.map(|stats| Ticket { slot, stats })
    }

    fn submit_frame(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shot: &Shot,
        seen: Option<&[VisibleWall]>,
        slot: usize,
    ) -> Result<FrameStats, RenderError> {
        if self.slots[slot].extent != self.size() {
            let new = ReadbackSlot::new(gpu, self.size())?;
            self.releaser.buffer(std::mem::replace(&mut self.slots[slot], new).buffer);
        }
        let to = self.slots[slot].buffer;
        self.submit_eyes(gpu, scene, shot, seen, Some(to))
    }

    /// Draws one frame to [`Renderer::picture`] and does not read it back. Waits for no picture unless
    /// so many are under way that there is no room to stage another; later submissions see the picture.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    pub fn draw_picture(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shot: &Shot,
    ) -> Result<FrameStats, RenderError> {
        self.check_device(gpu);
        let drawn = self.submit_eyes(gpu, scene, shot, None, None);
        if drawn.is_err() {
            self.glass_of = None;
        }
        drawn
    }

    /// Returns the image that the last frame was finished in: sRGB, one sample a pixel. Another after a
    /// resize, and where local contrast is raised.
    pub fn picture(&self) -> ImageId {
        self.finished
    }

    fn submit_eyes(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shot: &Shot,
        seen: Option<&[VisibleWall]>,
        read_to: Option<BufferId>,
    ) -> Result<FrameStats, RenderError> {
        self.room_for_faces(gpu, shot.view)?;
        self.room_for_contrast(gpu, scene, shot.view)?;
        if self.areas(shot.view).1.is_some() {
            self.targets.make_glass(gpu)?;
        }
        let eyes = self.eyes(shot);

        // 1. What each eye sees of the wall, and the vertices that are not there yet.
        let found: Vec<VisibleWall>;
        let seen = match (&self.model(scene.wall).drawn, seen) {
            (Some(drawn), None) => {
                found = eyes.iter().map(|eye| drawn.visible(&eye.camera)).collect();
                Some(&found[..])
            }
            (_, seen) => seen,
        };
        let mut stats = FrameStats::default();
        let mut placed: Option<FrameFaces> = None;
        let model = self.models[scene.wall.0].as_mut().expect("a mesh that was not removed");
        if let (Some(refined), Some(seen)) = (&mut model.refined, seen) {
            let faces = refined.place(gpu, seen, self.made)?;
            stats.waiting = faces.waiting as u32;
            placed = Some(faces);
        }

        // 2. Passes.
        let mut passes = Vec::new();
        if shot.view.is_all_round() {
            passes.push(self.clear_pass(scene.look.background));
        }
        for (i, eye) in eyes.iter().enumerate() {
            let visible = match (&placed, seen) {
                (Some(placed), _) => Some(DrawnParts {
                    ranges: &placed.eyes[i].flat.ranges,
                    refined: placed.range(i),
                    triangles: placed.eyes[i].triangles,
                }),
                (None, Some(seen)) => Some(DrawnParts {
                    ranges: &seen[i].ranges,
                    refined: None,
                    triangles: seen[i].triangles(),
                }),
                (None, None) => None,
            };
            passes.push(self.inside_pass(scene, shot, eye, visible, &mut stats));
            passes.extend(self.behind_pass(scene, shot, eye));
        }
        if let Some(area) = self.areas(shot.view).1 {
            self.overview_passes(scene, shot, area, &mut passes);
        }
        if shot.view == View::Panorama {
            passes.extend(self.panorama_pass());
        }
        self.finished = self.targets.picture;
        if let (Some(area), Some(contrast)) = (self.areas(shot.view).0, &self.contrast)
            && Self::raises_contrast(scene, shot.view)
        {
            self.finished = contrast.lit;
            passes.extend(self.contrast_passes(contrast, scene.look.local_contrast, area));
        }
        let picture = read_to.map(|to| (self.finished, to));
        let refined = self.model(scene.wall).refined.as_ref();
        let writes = refined.zip(placed.as_ref()).map(|(to, faces)| to.writes(faces));
        let writes = writes.unwrap_or_default();
        let frame = Frame { writes, passes, picture, ..Frame::default() };
        // Any number of pictures may be under way.
        let sent = gpu.make_room(frame.staged_bytes()).and_then(|()| gpu.submit_draws(&frame));
        if sent.is_err() {
            // Nothing was written.
            let refined = self.models[scene.wall.0].as_mut().and_then(|m| m.refined.as_mut());
            refined.into_iter().for_each(RefinedFaces::forget);
        }
        sent?;
        Ok(stats)
    }

    /// Returns the parts of a frame that the inside view and the overview fill.
    fn areas(&self, view: View) -> (Option<Area>, Option<Area>) {
        let [width, height] = self.size();
        let whole = Area { x: 0, y: 0, width, height };
        let left = Area { width: width / 2, ..whole };
        let right = Area { x: width / 2, width: width - width / 2, ..whole };
        match view {
            View::Inside | View::Translucent => (Some(whole), None),
            View::Overview => (None, Some(whole)),
            View::Split => (Some(left), Some(right)),
            View::Cube | View::Panorama => (None, None),
        }
    }

    /// Returns the inside views of a shot, each with its part of an image.
    fn eyes(&self, shot: &Shot) -> Vec<UnfoldedFace> {
        match self.areas(shot.view).0 {
            Some(area) => vec![UnfoldedFace { camera: camera_of(shot, area), area }],
            None => self.faces(shot),
        }
    }

    /// Returns the cameras of a shot's inside views: one camera of an inside view, six cameras of a
    /// view of everything about the eye, no camera of an overview.
    pub fn cameras(&self, shot: &Shot) -> Vec<Camera> {
        self.eyes(shot).into_iter().map(|eye| eye.camera).collect()
    }

    /// Returns what a scene's wall shows of itself; `None` of a mesh that is drawn whole.
    pub(super) fn drawn_wall(&self, scene: &Scene) -> Option<Arc<dyn DrawnWall>> {
        self.model(scene.wall).drawn.clone()
    }

    /// Waits for a frame and takes it: RGB, eight bits each, rows from the top.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    pub fn fetch(&mut self, gpu: &mut Gpu, ticket: Ticket) -> Result<Vec<u8>, RenderError> {
        self.check_device(gpu);
        self.idle.push(ticket.slot);
        let ReadbackSlot { buffer, extent: [width, height] } = self.slots[ticket.slot];
        let pixels = width as usize * height as usize;
        let rgba = &gpu.read(buffer)?[..4 * pixels];
        let mut rgb = self.spares.take(3 * pixels);
        without_alpha(rgba, &mut rgb);
        if let Some(edges) = &mut self.edges {
            edges.smooth(&mut rgb, [width, height]);
        }
        Ok(rgb)
    }

    /// Returns the store that takes pictures back once they are not needed any more, from any
    /// thread.
    pub fn spares(&self) -> Spares {
        self.spares.clone()
    }

    pub(super) fn model(&self, mesh: MeshHandle) -> &PlacedMesh {
        self.models[mesh.0].as_ref().expect("a mesh that was not removed")
    }
}

impl Drop for Renderer {
    fn drop(&mut self) {
        let releaser = &self.releaser;
        let models = self.models.iter().chain(&self.paths).flatten();
        models.chain([&self.frustum, &self.ball]).for_each(|m| m.release(releaser));
        self.tissues.iter().flatten().for_each(|tissue| tissue.release(releaser));
        self.pipelines.release(releaser);
        self.slots.iter().for_each(|s| releaser.buffer(s.buffer));
        self.targets.release(releaser);
        self.faces.iter().for_each(|f| f.release(releaser));
        self.contrast.iter().for_each(|c| c.release(releaser));
    }
}

fn camera_of(shot: &Shot, area: Area) -> Camera {
    let lens = Lens { aspect: area.width as f32 / area.height as f32, ..shot.lens };
    Camera { pose: shot.pose, lens, height_px: area.height }
}

/// Returns a draw of all of a model, or nothing if it is empty.
pub(super) fn draw(
    pipeline: DrawPipelineId,
    model: &PlacedMesh,
    push: &[u8],
    images: Vec<ImageId>,
) -> Option<Draw> {
    (model.count > 0).then(|| Draw {
        pipeline,
        push: push.to_vec(),
        vertices: Some(model.vertices),
        indices: Some(model.indices),
        range: DrawRange::Direct(0..model.count),
        images,
        buffers: Vec::new(),
        scissor: None,
    })
}
