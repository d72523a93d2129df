//! The two drawn panes: the wall as the eye sees it, and the organ from outside. Each is drawn when
//! what it shows has changed, into an image of its own.

use std::sync::Arc;

use glam::Vec3;

use super::model::{Model, Products};
use crate::geometry::Camera;
use crate::lod::{Tolerance, Worker};
use crate::render::{
    IN_FLIGHT, MeshHandle, PagesHandle, PathHandle, RenderError, Renderer, Scene, Shot, View, Wall,
};
use crate::session::levels::UPLOAD_BYTES;
use crate::session::{Levels, SessionError};
use crate::vk::{Gpu, ImageId};

/// Whether a picture waits for its level of detail.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Shows what is there; later steps are drawn when they come.
    Live,
    /// Waits, so that the picture depends on its camera alone.
    Settled,
}

/// What a picture was drawn of.
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

    /// Draws a shot unless it is what the picture shows; whether it was drawn.
    fn draw(&mut self, gpu: &mut Gpu, shot: Shot, size: [u32; 2]) -> Result<bool, RenderError> {
        let Some(scene) = self.scene else { return Ok(false) };
        let wanted = Drawn { shot, size, scene: self.version };
        if self.drawn == Some(wanted) {
            return Ok(false);
        }
        self.renderer.resize(gpu, size[0], size[1])?;
        self.renderer.draw_picture(gpu, &scene, &shot)?;
        self.drawn = Some(wanted);
        Ok(true)
    }

    fn change(&mut self, scene: Scene) {
        self.scene = Some(scene);
        self.version += 1;
    }
}

/// The drawn panes of a window.
pub struct Panes {
    inside: DrawnPane,
    overview: DrawnPane,
    /// The whole mesh in the inside view, until there are levels.
    mesh: Option<MeshHandle>,
    glass: Option<MeshHandle>,
    path: Option<PathHandle>,
    levels: Option<(Worker, PagesHandle, Arc<Levels>)>,
    /// The camera whose levels were asked for last.
    asked: Option<Camera>,
    /// Steps are still to come for it.
    is_settling: bool,
}

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
            glass: None,
            path: None,
            levels: None,
            asked: None,
            is_settling: false,
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
        if let (Some(wall), None) = (&products.wall, self.glass) {
            let glass = self.overview.renderer.upload_mesh(gpu, &wall.mesh, false)?;
            let mesh = self.inside.renderer.upload_mesh(gpu, &wall.mesh, false)?;
            (self.glass, self.mesh) = (Some(glass), Some(mesh));
            self.overview.change(Scene::of(glass));
            self.inside.change(Scene::of(mesh));
        }
        if let (Some(centered), None) = (&products.centerline, self.path) {
            let places = |b: &crate::geometry::Branch| -> Vec<Vec3> {
                b.points.iter().map(|p| p.position_mm.as_vec3()).collect()
            };
            let pieces: Vec<Vec<Vec3>> = centered.line.branches.iter().map(places).collect();
            let path = self.overview.renderer.upload_path(gpu, &pieces)?;
            self.path = Some(path);
            if let Some(scene) = self.overview.scene {
                self.overview.change(Scene { path: Some(path), ..scene });
            }
        }
        if let (Some(levels), None) = (&products.levels, &self.levels) {
            let renderer = &mut self.inside.renderer;
            let radius =
                renderer.mean_radius_mm(self.mesh.expect("a wall comes before its levels"));
            let pages = renderer.open_pages(gpu, levels.pages, radius)?;
            if let Some(occlusion) = &levels.occlusion {
                renderer.hide(pages, Arc::clone(occlusion));
            }
            let in_flight = IN_FLIGHT as u32;
            let worker = Worker::spawn(
                levels.hierarchy(),
                tolerance,
                levels.pages,
                UPLOAD_BYTES,
                in_flight,
            )?;
            self.levels = Some((worker, pages, Arc::clone(levels)));
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
        let Some(pose) = model.pose else { return Ok(false) };
        let share = match &model.path {
            Some(path) => model.arc_mm / path.length_mm().max(1e-9),
            None => 0.0,
        };
        let shot = |view| Shot { view, pose, lens: model.lens(), progress: share as f32 };
        let mut any = false;
        if let Some(size) = inside {
            let shot = shot(View::Inside);
            self.inside.renderer.resize(gpu, size[0], size[1])?;
            self.refine(&shot, detail)?;
            // Where the eye is along the path does not show.
            let shot = Shot { progress: 0.0, ..shot };
            any |= self.inside.draw(gpu, shot, size)?;
        }
        if let Some(scene) = self.overview.scene.filter(|s| s.orbit != model.orbit) {
            self.overview.change(Scene { orbit: model.orbit, ..scene });
        }
        if let Some(size) = overview {
            any |= self.overview.draw(gpu, shot(View::Overview), size)?;
        }
        Ok(any)
    }

    /// Asks for the levels of a camera and takes in what has come.
    fn refine(&mut self, shot: &Shot, detail: Detail) -> Result<(), SessionError> {
        let Some((worker, pages, _)) = &mut self.levels else { return Ok(()) };
        let Some(camera) = self.inside.renderer.camera(shot) else { return Ok(()) };
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
            let wall = Wall::Pages { pages: *pages, backs: false };
            let scene = self.inside.scene.unwrap_or_else(|| Scene::paged(*pages, None));
            self.inside.change(Scene { wall, ..scene });
            if let Some(mesh) = self.mesh.take() {
                self.inside.renderer.remove_mesh(mesh);
            }
        }
        Ok(())
    }

    /// Whether finer levels of what is shown are still to come.
    pub fn is_settling(&self) -> bool {
        self.is_settling
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
