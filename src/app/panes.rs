//! The two drawn panes: the wall as the eye sees it, and the organ from outside. Each is drawn when
//! what it shows has changed, into an image of its own.

use std::sync::Arc;
use std::time::{Duration, Instant};

use glam::Vec3;

use super::action::{Colouring, WallView};
use super::colouring::{distance_colours, evidence_colours, missed_colours};
use super::model::Model;
use crate::render::{
    Look, MeshHandle, PathHandle, PreparedMesh, RenderError, Renderer, Scene, Shot, TissueHandle,
    View,
};
use crate::session::{Products, SessionError, WallForm};
use crate::vk::{Frame, Gpu, ImageId};

/// Whether a picture waits for all of its parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Detail {
    /// Shows the parts that are there; later parts are drawn when they come.
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
    /// Pixels of the picture along each side of one of the pane.
    fineness: u32,
    /// Since when the picture shows the same.
    still_since: Instant,
    /// Whether the picture has faces that are not yet as fine as it asks.
    is_coarse: bool,
}

impl DrawnPane {
    fn new(gpu: &mut Gpu, samples: u32) -> Result<Self, RenderError> {
        let renderer = Renderer::new(gpu, 64, 64, samples)?;
        let still_since = Instant::now();
        let (scene, drawn) = (None, None);
        Ok(Self { renderer, scene, version: 0, drawn, fineness: 1, still_since, is_coarse: false })
    }

    /// Whether the picture shows something else.
    fn is_stale(&self, shot: Shot, size: [u32; 2]) -> bool {
        let now = Drawn { shot, size, scene: self.version };
        self.scene.is_some() && (self.is_coarse || self.drawn != Some(now))
    }

    /// Whether the picture shows the same scene from elsewhere.
    fn has_only_moved(&self, shot: Shot, size: [u32; 2]) -> bool {
        let moved = |d: Drawn| d == Drawn { shot: d.shot, size, scene: self.version };
        !self.is_coarse && self.drawn.is_some_and(|d| d.shot != shot && moved(d))
    }

    /// Draws a shot unless it is what the picture shows; whether it was drawn.
    fn draw(&mut self, gpu: &mut Gpu, shot: Shot, size: [u32; 2]) -> Result<bool, RenderError> {
        let Some(scene) = self.scene.filter(|_| self.is_stale(shot, size)) else {
            return Ok(false);
        };
        self.still_since = Instant::now();
        self.draw_as_fine(gpu, scene, shot, size, 1)
    }

    /// Draws the picture again with four pixels for each of the pane, once it has rested.
    fn draw_at_rest(
        &mut self,
        gpu: &mut Gpu,
        shot: Shot,
        size: [u32; 2],
    ) -> Result<(), RenderError> {
        let Some(scene) = self.scene.filter(|_| !self.is_stale(shot, size)) else { return Ok(()) };
        if self.fineness == 1 && self.still_since.elapsed() >= REST {
            self.draw_as_fine(gpu, scene, shot, size, 2)?;
            // Faces that this picture asks for and that are not made yet do not show in it.
            self.is_coarse = false;
        }
        Ok(())
    }

    fn draw_as_fine(
        &mut self,
        gpu: &mut Gpu,
        scene: Scene,
        shot: Shot,
        size: [u32; 2],
        fineness: u32,
    ) -> Result<bool, RenderError> {
        self.renderer.resize(gpu, fineness * size[0], fineness * size[1])?;
        self.fineness = fineness;
        let stats = self.renderer.draw_picture(gpu, &scene, &shot)?;
        self.is_coarse = stats.waiting > 0;
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
    /// The wall of the inside view: the whole mesh, until it is culled or subdivided.
    mesh: Option<MeshHandle>,
    /// Whether that wall has its last form.
    has_form: bool,
    glass: Option<MeshHandle>,
    /// Whether the wall is on the device for the inside view.
    has_wall: bool,
    /// Whether the wall of the overview is put on the device in the next frame.
    is_glass_next: bool,
    path: Option<PathHandle>,
    /// Mean radius of the organ, for the light, mm.
    radius_mm: f32,
    coloured: Option<Coloured>,
    /// Tissue behind the wall.
    tissue: Option<TissueHandle>,
    /// Whether colours are older than what was shown.
    is_paint_old: bool,
    /// Whether the inside view has one sample a pixel, and more where it rests.
    refines_at_rest: bool,
    /// Whether the inside view was shown in the last frame.
    shows_inside: bool,
    /// Whether the overview is a frame behind the eye.
    is_overview_behind: bool,
}

/// Time that a view rests before it is drawn with more samples, where the device draws slowly.
const REST: Duration = Duration::from_millis(250);

/// Colours of a wall that is being seen are brought up to date no more often.
const PAINT_EVERY: Duration = Duration::from_millis(200);

/// Local contrast of the inside view where it is raised.
const LOCAL_CONTRAST: f32 = 0.5;

/// Largest number of refined faces of each level that are made for one frame.
const MADE_PER_FRAME: u32 = 200;

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
            has_form: false,
            glass: None,
            has_wall: false,
            is_glass_next: false,
            path: None,
            radius_mm: 1.0,
            coloured: None,
            tissue: None,
            is_paint_old: false,
            refines_at_rest: samples == 1,
            shows_inside: false,
            is_overview_behind: false,
        })
    }

    /// Puts products on the device that came since the last time.
    ///
    /// # Errors
    /// The renderer's.
    pub fn take(&mut self, gpu: &mut Gpu, products: &Products) -> Result<(), SessionError> {
        let renderer = &mut self.inside.renderer;
        if let (Some(wall), false) = (&products.prepared_wall, self.has_wall) {
            self.has_wall = true;
            let mesh = renderer.upload_prepared_mesh(gpu, wall)?;
            self.radius_mm = renderer.mean_radius_mm(mesh);
            self.mesh = Some(mesh);
        }
        if let (Some(levels), Some(mesh), Some(whole), false) =
            (&products.levels, self.mesh, &products.prepared_wall, self.has_form)
        {
            self.has_form = true;
            match &levels.form {
                // The mesh has its caps; the octree has the caps only if the wall is closed.
                WallForm::Culled(wall) if wall.closed.is_some() => {
                    renderer.cull_mesh(gpu, mesh, whole, Arc::clone(wall))?;
                }
                WallForm::Culled(_) | WallForm::Whole => {}
                WallForm::Refined(wall) => {
                    let wall = PreparedMesh::refined(Arc::clone(wall));
                    self.mesh = Some(renderer.upload_prepared_mesh(gpu, &wall)?);
                    renderer.remove_mesh(mesh);
                }
                WallForm::Subdivided(wall) => {
                    let wall = PreparedMesh::subdivided(Arc::clone(wall), self.radius_mm);
                    self.mesh = Some(renderer.upload_prepared_mesh(gpu, &wall)?);
                    renderer.remove_mesh(mesh);
                }
            }
            self.inside.version += 1;
        }
        if let (Some(behind), None) = (&products.behind, self.tissue) {
            self.tissue = Some(self.inside.renderer.upload_tissue(gpu, behind)?);
        }
        if let (Some(centered), None) = (&products.centerline, self.path) {
            let places = |b: &crate::geometry::Branch| -> Vec<Vec3> {
                b.points.iter().map(|p| p.position_mm.as_vec3()).collect()
            };
            let pieces: Vec<Vec<Vec3>> = centered.line.branches.iter().map(places).collect();
            let path = self.overview.renderer.upload_path(gpu, &pieces)?;
            self.path = Some(path);
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
    /// The renderer's.
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
        self.arrange(model);
        let mut any = false;
        self.shows_inside = inside.is_some();
        if let Some(size) = inside {
            let made = if detail == Detail::Settled { u32::MAX } else { MADE_PER_FRAME };
            self.inside.renderer.make_at_most(made);
            any |= self.inside.draw(gpu, shot, size)?;
            if self.refines_at_rest && detail == Detail::Live && !any {
                self.inside.draw_at_rest(gpu, shot, size)?;
            }
        }
        if let Some(size) = overview {
            let lens = model.lens();
            let shot =
                Shot { view: View::Overview, pose, lens, progress: share as f32, room_mm: None };
            // Its wall is drawn whole: where the device draws slowly, in every other frame of a motion.
            let may_wait = self.refines_at_rest && detail == Detail::Live;
            let moved = may_wait && self.overview.has_only_moved(shot, size);
            self.is_overview_behind = moved && !self.is_overview_behind;
            if !self.is_overview_behind {
                any |= self.overview.draw(gpu, shot, size)?;
            }
        }
        Ok(any)
    }

    /// Sets the scene of each pane as the model wants it.
    fn arrange(&mut self, model: &Model) {
        let wall = self.coloured.as_ref().map(|c| c.inside).or(self.mesh);
        let behind = self.tissue.filter(|_| model.colouring == Colouring::Behind);
        let local_contrast = if model.local_contrast { LOCAL_CONTRAST } else { 0.0 };
        let look = Look { local_contrast, ..Look::default() };
        let shown = self.inside.scene.map(|scene| (scene.wall, scene.behind, scene.look));
        if let Some(wall) = wall.filter(|wall| shown != Some((*wall, behind, look))) {
            self.inside.change(Scene { behind, look, ..Scene::with(wall, None) });
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
            Colouring::Tissue | Colouring::Behind => None,
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

    /// Whether a pane waits for a part of its picture: new colours, the wall of the overview or the eye
    /// in it, or faces as fine as the camera asks.
    pub fn is_settling(&self) -> bool {
        let is_drawn = self.shows_inside && self.inside.drawn.is_some();
        let rests = self.refines_at_rest && is_drawn && self.inside.fineness == 1;
        let is_behind = self.is_glass_next || self.is_overview_behind;
        self.is_paint_old || is_behind || self.inside.is_coarse || rests
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
            Ok(rgba.chunks_exact(4).map(|p| [p[0], p[1], p[2]]).collect::<Vec<_>>())
        });
        gpu.free_buffer(buffer);
        let (pixels, size) = (read?, self.inside_size());
        match self.inside.fineness {
            1 => Ok((size, pixels.into_flattened())),
            _ => Ok((size, halved(&pixels, width as usize))),
        }
    }

    /// Columns and rows of the inside pane.
    pub fn inside_size(&self) -> [u32; 2] {
        self.inside.renderer.size().map(|pixels| pixels / self.inside.fineness)
    }

    /// Whether the image of the inside view has four pixels for each of the pane.
    pub fn is_inside_fine(&self) -> bool {
        self.inside.fineness > 1
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

/// A picture of half the columns and rows: means of four pixels.
fn halved(pixels: &[[u8; 3]], width: usize) -> Vec<u8> {
    let pairs = pixels.chunks_exact(2 * width);
    let mean = |rows: &[[u8; 3]], x: usize| {
        let four = [rows[2 * x], rows[2 * x + 1], rows[width + 2 * x], rows[width + 2 * x + 1]];
        [0, 1, 2].map(|c| (four.iter().map(|p| u16::from(p[c])).sum::<u16>().div_ceil(4)) as u8)
    };
    pairs.flat_map(|rows| (0..width / 2).flat_map(move |x| mean(rows, x))).collect()
}

#[cfg(test)]
mod tests {
    use super::super::action::Action;
    use super::super::model::flown_model;
    use super::*;
    use crate::vk::Choice;
    use crate::volume::phantom::Kind;

    #[test]
    fn a_view_that_rests_is_drawn_with_four_samples_and_one_that_moves_with_one() {
        let Ok(mut gpu) = Gpu::open(Choice::Any) else {
            assert!(std::env::var_os("INTIMA_REQUIRE_GPU").is_none(), "a device");
            return;
        };
        let (mut model, session) = flown_model(Kind::Bend, |_| {});
        model.products.prepared_wall = Some(session.prepared_wall().unwrap());
        let mut panes = Panes::new(&mut gpu, 1).unwrap();
        panes.take(&mut gpu, &model.products).unwrap();
        let size = [64, 48];
        let mut draw = |panes: &mut Panes, model: &Model| {
            panes.draw(&mut gpu, model, (Some(size), None), Detail::Live).unwrap();
            (panes.is_inside_fine(), panes.inside_picture(&mut gpu).unwrap())
        };
        let (is_fine, moving) = draw(&mut panes, &model);
        assert!(!is_fine && panes.is_settling());
        std::thread::sleep(REST);
        let (is_fine, rested) = draw(&mut panes, &model);
        assert!(is_fine && !panes.is_settling());
        assert!(rested.0 == size && rested != moving, "the same place with more samples");
        // Nothing is drawn again while it rests.
        std::thread::sleep(REST);
        assert_eq!(draw(&mut panes, &model), (true, rested));
        model.step(0.0, &[Action::Turn([0.2, 0.0, 0.0])]);
        assert!(!draw(&mut panes, &model).0, "one that moves is not waited for");
    }

    /// The whole wall of the overview was drawn in each frame of a flight.
    #[test]
    fn the_overview_follows_a_moving_eye_in_every_other_frame_and_catches_up_where_it_stops() {
        let Ok(mut gpu) = Gpu::open(Choice::Any) else {
            assert!(std::env::var_os("INTIMA_REQUIRE_GPU").is_none(), "a device");
            return;
        };
        let (mut model, session) = flown_model(Kind::Bend, |_| {});
        model.products.prepared_wall = Some(session.prepared_wall().unwrap());
        for (samples, detail, behind) in [
            (1, Detail::Live, [true, false, true, false]),
            (1, Detail::Settled, [false; 4]),
            (4, Detail::Live, [false; 4]),
        ] {
            let mut panes = Panes::new(&mut gpu, samples).unwrap();
            panes.take(&mut gpu, &model.products).unwrap();
            let mut is_behind = |panes: &mut Panes, model: &Model| {
                panes.draw(&mut gpu, model, (Some([64, 48]), Some([32, 24])), detail).unwrap();
                let is_old = panes.overview.drawn.map(|d| Some(d.shot.pose) != model.pose);
                assert!(is_old.is_none_or(|is_old| is_old == panes.is_overview_behind));
                panes.is_overview_behind
            };
            // The overview gets its wall one frame after the inside view.
            while is_behind(&mut panes, &model) || panes.is_glass_next {}
            for expected in behind {
                model.step(0.0, &[Action::Turn([0.1, 0.0, 0.0])]);
                let now = is_behind(&mut panes, &model);
                assert_eq!(now, expected, "{samples} samples, {detail:?}");
            }
            model.step(0.0, &[Action::Turn([0.1, 0.0, 0.0])]);
            is_behind(&mut panes, &model);
            assert!(!is_behind(&mut panes, &model), "an eye that stopped");
        }
    }

    /// Two cases in one window draw four pictures a frame: "no room to stage 877264 bytes".
    #[test]
    fn pictures_that_are_asked_for_faster_than_they_are_drawn_are_waited_for() {
        let Ok(mut gpu) = Gpu::open(Choice::Any) else {
            assert!(std::env::var_os("INTIMA_REQUIRE_GPU").is_none(), "a device");
            return;
        };
        let (mut model, session) = flown_model(Kind::Colon, |_| {});
        model.products.prepared_wall = Some(session.prepared_wall().unwrap());
        model.products.levels = Some(session.levels().unwrap());
        let mut panes = Panes::new(&mut gpu, 4).unwrap();
        panes.take(&mut gpu, &model.products).unwrap();
        let length = model.path.as_ref().unwrap().length_mm();
        for i in 0..90 {
            model.step(0.0, &[Action::Seek(length * f64::from(i * 7 % 90) / 90.0)]);
            let sizes = (Some([1280, 960]), None);
            panes.draw(&mut gpu, &model, sizes, Detail::Live).unwrap();
        }
        panes.inside_picture(&mut gpu).unwrap();
    }

    #[test]
    fn a_halved_picture_has_the_means_of_four_pixels() {
        let grey = |v: u8| [v, v, 0];
        let rows = [grey(0), grey(4), grey(9), grey(9), grey(8), grey(4), grey(9), grey(9)];
        assert_eq!(halved(&rows, 4), [4, 4, 0, 9, 9, 0]);
    }
}
