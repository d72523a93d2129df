//! The two drawn panes: the wall as the eye sees it, and the organ from outside. Each is drawn when
//! what it shows has changed, into an image of its own.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec3;

use super::action::{Colouring, WallView};
use super::colouring::{distance_colours, evidence_colours, missed_colours};
use super::model::Model;
use crate::geometry::Camera;
use crate::lod::{Tolerance, Worker};
use crate::render::{
    Culling, Framing, Look, MeshHandle, PagesHandle, PathHandle, RenderError, Renderer, Scene,
    SceneWall, Shot, View,
};
use crate::session::{Levels, Products, SessionError};
use crate::vk::{Frame, Gpu, ImageId};

/// Whether a picture waits for its level of detail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Shows what is there; later steps are drawn when they come.
    Live,
    /// Waits, so that the picture depends on its camera alone.
    Settled,
}

/// Inputs of a drawn picture.
#[derive(Clone, Copy, Debug, PartialEq)]
struct Drawn {
    shot: Shot,
    size: [u32; 2],
    scene: u64,
}

/// A renderer with its scene and what it shows now.
struct DrawnPane {
    renderer: Renderer,
    scene: Option<Scene>,
    version: u64,
    drawn: Option<Drawn>,
}

impl DrawnPane {
    fn new(gpu: &mut Gpu, samples: u32) -> Result<Self, RenderError> {
        let renderer = Renderer::new(gpu, 64, 64, samples)?;
        Ok(Self { renderer, scene: None, version: 0, drawn: None })
    }

    /// Whether the picture shows something else.
    fn is_stale(&self, shot: Shot, size: [u32; 2]) -> bool {
        self.scene.is_some() && self.drawn != Some(Drawn { shot, size, scene: self.version })
    }

    /// Draws a shot unless it is what the picture shows; whether it was drawn.
    fn draw(&mut self, gpu: &mut Gpu, shot: Shot, size: [u32; 2]) -> Result<bool, RenderError> {
        let Some(scene) = self.scene.filter(|_| self.is_stale(shot, size)) else {
            return Ok(false);
        };
        self.renderer.resize(gpu, size[0], size[1])?;
        self.renderer.draw_picture(gpu, &scene, &shot)?;
        self.is_drawn(shot, size);
        Ok(true)
    }

    fn is_drawn(&mut self, shot: Shot, size: [u32; 2]) {
        self.drawn = Some(Drawn { shot, size, scene: self.version });
    }

    fn change(&mut self, scene: Scene) {
        self.scene = Some(scene);
        self.version += 1;
    }
}

/// A wall whose vertices have colours, on the device.
struct Coloured {
    inside: MeshHandle,
    overview: MeshHandle,
    /// Quantity that the colours show, and the version of what was shown.
    of: (Colouring, u64),
    at: Instant,
}

/// The drawn panes of a window.
pub struct Panes {
    inside: DrawnPane,
    overview: DrawnPane,
    /// The whole mesh in the inside view, until there are levels.
    mesh: Option<MeshHandle>,
    /// Whether what a camera cannot see of that mesh is left out.
    is_culled: bool,
    glass: Option<MeshHandle>,
    /// Whether the wall is on the device for the inside view.
    has_wall: bool,
    /// Whether the wall of the overview is put on the device in the next frame.
    is_glass_next: bool,
    path: Option<PathHandle>,
    /// Mean radius of the organ, for the light, mm.
    radius_mm: f32,
    levels: Option<(Worker, PagesHandle, Arc<Levels>)>,
    /// Whether the pages hold a cut.
    has_cut: bool,
    /// The camera whose levels were asked for last.
    asked: Option<Camera>,
    /// Whether steps are still to come for it.
    is_settling: bool,
    coloured: Option<Coloured>,
    /// Whether colours are older than what was shown.
    is_paint_old: bool,
}

/// Colours of a wall that is being seen are brought up to date no more often.
const PAINT_EVERY: Duration = Duration::from_millis(200);

impl Panes {
    /// * `samples`: a pixel, 1 or 4.
    ///
    /// # Errors
    /// The renderer's.
    pub fn new(gpu: &mut Gpu, samples: u32) -> Result<Self, RenderError> {
        Ok(Self {
            inside: DrawnPane::new(gpu, samples)?,
            overview: DrawnPane::new(gpu, samples)?,
            mesh: None,
            is_culled: false,
            glass: None,
            has_wall: false,
            is_glass_next: false,
            path: None,
            radius_mm: 1.0,
            levels: None,
            has_cut: false,
            asked: None,
            is_settling: false,
            coloured: None,
            is_paint_old: false,
        })
    }

    /// Puts products on the device that came since the last time.
    ///
    /// # Errors
    /// The renderer's; the level-of-detail thread's.
    pub fn take(
        &mut self,
        gpu: &mut Gpu,
        products: &Products,
        tolerance: Tolerance,
    ) -> Result<(), SessionError> {
        if let (Some(wall), false) = (&products.prepared_wall, self.has_wall) {
            self.has_wall = true;
            let mesh = self.inside.renderer.upload_prepared_mesh(gpu, wall)?;
            self.radius_mm = self.inside.renderer.mean_radius_mm(mesh);
            self.mesh = Some(mesh);
        }
        // Only of a closed wall the tree is that of the mesh with its caps.
        let culling = products.culling.as_deref().and_then(Option::as_ref);
        if let (Some(culling), Some(mesh), Some(wall), false) =
            (culling, self.mesh, &products.prepared_wall, self.is_culled)
            && culling.closed.is_some()
        {
            self.inside.renderer.cull_mesh(gpu, mesh, wall, Culling::clone(culling))?;
            self.is_culled = true;
        }
        if let (Some(centered), None) = (&products.centerline, self.path) {
            let places = |b: &crate::geometry::Branch| -> Vec<Vec3> {
                b.points.iter().map(|p| p.position_mm.as_vec3()).collect()
            };
            let pieces: Vec<Vec<Vec3>> = centered.line.branches.iter().map(places).collect();
            let path = self.overview.renderer.upload_path(gpu, &pieces)?;
            self.path = Some(path);
        }
        if let (Some(levels), None) = (&products.levels, &self.levels) {
            let renderer = &mut self.inside.renderer;
            let pages = levels.open(renderer, gpu, self.radius_mm)?;
            let worker = levels.worker(tolerance)?;
            self.levels = Some((worker, pages, Arc::clone(levels)));
        }
        Ok(())
    }

    /// Puts the wall of the overview on the device, a frame after that of the inside view: both
    /// together take longer than a frame.
    fn upload_glass(
        &mut self,
        gpu: &mut Gpu,
        products: &Products,
        detail: Detail,
    ) -> Result<(), SessionError> {
        if let (Some(wall), true, None) = (&products.prepared_wall, self.has_wall, self.glass) {
            if self.is_glass_next || matches!(detail, Detail::Settled) {
                self.glass = Some(self.overview.renderer.upload_prepared_mesh(gpu, wall)?);
            }
            self.is_glass_next = self.glass.is_none();
        }
        Ok(())
    }

    /// Draws what changed.
    ///
    /// * `inside`, `overview`: columns and rows of each, where it is shown.
    ///
    /// # Errors
    /// The renderer's; the level-of-detail thread's.
    pub fn draw(
        &mut self,
        gpu: &mut Gpu,
        model: &Model,
        (inside, overview): (Option<[u32; 2]>, Option<[u32; 2]>),
        detail: Detail,
    ) -> Result<bool, SessionError> {
        self.upload_glass(gpu, &model.products, detail)?;
        self.colour(gpu, model, detail)?;
        let Some(pose) = model.pose else { return Ok(false) };
        let share = match &model.path {
            Some(path) => model.arc_mm / path.length_mm().max(1e-9),
            None => 0.0,
        };
        let view = match model.view {
            WallView::Eye => View::Inside,
            WallView::Cube => View::Cube,
            WallView::Panorama => View::Panorama,
        };
        // Where the eye is along the path does not show inside.
        let room_mm = model.light_room_mm().map(|mm| mm as f32);
        let shot = Shot { view, pose, lens: model.lens(), progress: 0.0, room_mm };
        if let Some(size) = inside {
            self.inside.renderer.resize(gpu, size[0], size[1])?;
            if !view.is_all_round() && self.coloured.is_none() {
                self.refine(&shot, detail)?;
            }
        }
        self.arrange(model);
        let mut any = false;
        if let Some(size) = inside {
            any |= match view.is_all_round() && self.draws_pages() {
                true => self.draw_all_round(gpu, shot, size)?,
                false => self.inside.draw(gpu, shot, size)?,
            };
        }
        if let Some(size) = overview {
            let lens = model.lens();
            let shot =
                Shot { view: View::Overview, pose, lens, progress: share as f32, room_mm: None };
            any |= self.overview.draw(gpu, shot, size)?;
        }
        Ok(any)
    }

    /// Whether the inside view shows a cut of the levels.
    fn draws_pages(&self) -> bool {
        matches!(self.inside.scene, Some(Scene { wall: SceneWall::Pages { .. }, .. }))
    }

    /// Sets the scene of each pane as the model wants it.
    fn arrange(&mut self, model: &Model) {
        let pages = self.levels.as_ref().filter(|_| self.has_cut).map(|l| l.1);
        let wall = match (&self.coloured, pages, self.mesh) {
            (Some(c), ..) => Some(SceneWall::Mesh(c.inside)),
            (None, Some(pages), _) => Some(SceneWall::Pages { pages, backs: false }),
            (None, None, mesh) => mesh.map(SceneWall::Mesh),
        };
        if let Some(wall) = wall.filter(|w| self.inside.scene.is_none_or(|s| s.wall != *w)) {
            let look = Look::default();
            let scene = Scene {
                wall,
                overview: None,
                path: None,
                camera: true,
                framing: Framing::default(),
                look,
            };
            self.inside.change(scene);
        }
        // Nothing shows the whole mesh any more.
        if self.has_cut
            && let Some(mesh) = self.mesh.take()
        {
            self.inside.renderer.remove_mesh(mesh);
        }
        let Some(glass) = self.coloured.as_ref().map(|c| c.overview).or(self.glass) else { return };
        let look = Look { opacity: model.opacity, ..Look::default() };
        let plain = Scene::of(glass);
        let scene = Scene { path: self.path, framing: model.framing, look, ..plain };
        let shows = |s: &Scene| (s.wall, s.path, s.framing, s.look);
        if self.overview.scene.as_ref().map(shows) != Some(shows(&scene)) {
            self.overview.change(scene);
        }
    }

    /// Brings the wall's colours up to date.
    fn colour(&mut self, gpu: &mut Gpu, model: &Model, detail: Detail) -> Result<(), RenderError> {
        let p = &model.products;
        let wanted = match model.colouring {
            Colouring::Tissue => None,
            Colouring::Missed => Some(model.seen_version),
            Colouring::Radius => p.centerline_distances.as_ref().map(|_| 0),
            Colouring::Evidence => model.evidence().map(|_| 0),
        };
        self.is_paint_old = false;
        let (Some(version), Some(wall), Some(drawn)) = (wanted, &p.wall, &p.prepared_wall) else {
            if let Some(c) = self.coloured.take() {
                self.inside.renderer.remove_mesh(c.inside);
                self.overview.renderer.remove_mesh(c.overview);
                // Handles are not used twice, so the scenes are seen to be others.
            }
            return Ok(());
        };
        let of = (model.colouring, version);
        if let Some(c) = &self.coloured {
            let again = c.of.0 == of.0 && detail == Detail::Live && c.at.elapsed() < PAINT_EVERY;
            self.is_paint_old = c.of != of && again;
            if c.of == of || again {
                return Ok(());
            }
        }
        let colours = match (model.colouring, &p.centerline_distances, model.evidence()) {
            (Colouring::Radius, Some(radii), _) => distance_colours(radii),
            (Colouring::Evidence, _, Some(evidence)) => evidence_colours(evidence),
            _ => {
                let none = vec![false; wall.mesh.faces.len()];
                let seen = &model.seen.faces;
                let known = if seen.len() == none.len() { seen } else { &none };
                missed_colours(&wall.mesh, known)
            }
        };
        let at = Instant::now();
        let (inside, overview) = match &self.coloured {
            Some(c) => {
                self.inside.renderer.recolour(gpu, c.inside, &colours)?;
                self.overview.renderer.recolour(gpu, c.overview, &colours)?;
                self.inside.version += 1;
                self.overview.version += 1;
                (c.inside, c.overview)
            }
            None => (
                self.inside.renderer.upload_coloured_mesh(gpu, drawn, &colours)?,
                self.overview.renderer.upload_coloured_mesh(gpu, drawn, &colours)?,
            ),
        };
        self.coloured = Some(Coloured { inside, overview, of, at });
        Ok(())
    }

    /// Draws everything about the eye, each face from its own settled cut.
    fn draw_all_round(
        &mut self,
        gpu: &mut Gpu,
        shot: Shot,
        size: [u32; 2],
    ) -> Result<bool, SessionError> {
        let Some(scene) = self.inside.scene.filter(|_| self.inside.is_stale(shot, size)) else {
            return Ok(false);
        };
        for (eye, camera) in self.inside.renderer.cameras(&shot).into_iter().enumerate() {
            if let Some((worker, pages, _)) = &mut self.levels {
                let step = worker.converge(camera)?;
                self.inside.renderer.apply(*pages, step)?;
            }
            self.inside.renderer.draw_eye(gpu, &scene, &shot, eye)?;
        }
        // The pages are those of the last face.
        self.asked = None;
        self.inside.is_drawn(shot, size);
        Ok(true)
    }

    /// Asks for the levels of a camera and takes in what has come.
    fn refine(&mut self, shot: &Shot, detail: Detail) -> Result<(), SessionError> {
        let Some((worker, pages, _)) = &mut self.levels else { return Ok(()) };
        let Some(camera) = self.inside.renderer.cameras(shot).first().copied() else {
            return Ok(());
        };
        let is_new = self.asked != Some(camera);
        let mut steps = Vec::new();
        match detail {
            Detail::Settled if is_new => steps.push(worker.converge(camera)?),
            Detail::Settled => {}
            Detail::Live => {
                if is_new {
                    worker.set_camera(&camera);
                    self.is_settling = true;
                }
                while let Some(step) = worker.try_recv()? {
                    self.is_settling = !step.settled;
                    steps.push(step);
                }
            }
        }
        self.asked = Some(camera);
        for step in steps {
            self.inside.renderer.apply(*pages, step)?;
            self.has_cut = true;
            self.inside.version += 1;
        }
        Ok(())
    }

    /// Whether finer levels of what is shown are still to come.
    pub fn is_settling(&self) -> bool {
        self.is_settling || self.is_paint_old || self.is_glass_next
    }

    /// The inside view as it was drawn last: columns, rows, RGB. Waits for the device.
    ///
    /// # Errors
    /// [`RenderError::Vulkan`].
    pub fn inside_picture(&self, gpu: &mut Gpu) -> Result<([u32; 2], Vec<u8>), RenderError> {
        let [width, height] = self.inside.renderer.size();
        let pixels = width as usize * height as usize;
        let buffer = gpu.readback_buffer("picture", 4 * pixels as u64)?;
        let picture = Some((self.inside.renderer.picture(), buffer));
        let read = gpu.submit_draws(&Frame { picture, ..Frame::default() }).and_then(|()| {
            let rgba = &gpu.read(buffer)?[..4 * pixels];
            Ok(rgba.chunks_exact(4).flat_map(|p| [p[0], p[1], p[2]]).collect())
        });
        gpu.free_buffer(buffer);
        Ok(([width, height], read?))
    }

    /// The image of the inside view.
    pub fn inside(&self) -> ImageId {
        self.inside.renderer.picture()
    }

    /// The image of the overview.
    pub fn overview(&self) -> ImageId {
        self.overview.renderer.picture()
    }

    /// Whether the pictures show anything yet.
    pub fn has_pictures(&self) -> bool {
        self.inside.drawn.is_some()
    }
}
