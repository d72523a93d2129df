//! One frame: panels are laid out, actions carried out, panes drawn, all of it put on an image.

use std::borrow::Cow;
use std::collections::HashMap;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use egui::epaint::Primitive;
use egui::{TextureId, ViewportId};

use super::action::{Commands, Export, Request, WallView};
use super::error::AppError;
use super::export;
use super::keys;
use super::model::Model;
use super::painter::Painter;
use super::panes::{Detail, Panes};
use super::study::News;
use super::study::{Change, Study};
use super::ui::{self, INSIDE, OVERVIEW, UiState};
use crate::formats::{encode_png, shown};
use crate::geometry::cube_faces;
use crate::lod::Tolerance;
use crate::render::{FlatMesh, FlatVertex, Overlay};
use crate::session::FlightRoute;
use crate::vk::{Area, Format, Frame, Gpu, ImageId, ImageSpec, ImageWrite, VkError};

/// A part of a texture that has changed.
struct TextureChange {
    id: TextureId,
    area: Area,
    /// All of the texture: it may have another size than before.
    is_whole: bool,
    rgba: Vec<u8>,
}

/// A texture of the panels, with its texels for a device that is opened anew.
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

/// Everything of a window but the window.
pub struct Stage {
    pub model: Model,
    pub context: egui::Context,
    state: UiState,
    panes: Panes,
    overlay: Option<(Overlay, Format)>,
    textures: HashMap<TextureId, Texture>,
    /// Waiting for the next frame that is drawn.
    changes: Vec<TextureChange>,
    freed: Vec<TextureId>,
    tolerance: Tolerance,
    samples: u32,
    painter: Option<Painter>,
    wake: Arc<dyn Fn() + Send + Sync>,
    files: Files,
}

/// Where files go.
#[derive(Clone, Debug, Default)]
pub struct Files {
    /// Bookmarks; their pictures are beside it.
    pub session: Option<PathBuf>,
    /// Folder of what is exported.
    pub export: PathBuf,
}

impl Files {
    /// Folder and stem of the pictures of bookmarks.
    fn beside_session(&self) -> Option<(&Path, &str)> {
        let session = self.session.as_deref()?;
        Some((session.parent()?, session.file_stem()?.to_str()?))
    }
}

/// What a frame wants to have done after it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct After {
    /// Closes the window.
    pub quit: bool,
    /// Stops the study.
    pub cancel: bool,
    /// Plan a flight along this.
    pub route: Option<FlightRoute>,
    /// Draw the flight into this folder.
    pub export_flight: Option<PathBuf>,
    /// Compute this instead.
    pub change: Option<Change>,
    /// Draw again after so many seconds at most.
    pub again_in: Option<f64>,
}

/// What a frame is drawn to.
pub struct Target {
    pub image: ImageId,
    pub format: Format,
}

impl Stage {
    /// * `samples`: a pixel of the drawn panes.
    /// * `wake`: called on another thread when there is something new to draw.
    pub fn new(
        gpu: &mut Gpu,
        samples: u32,
        planned_mm_s: f64,
        tolerance: Tolerance,
        files: Files,
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, AppError> {
        let context = egui::Context::default();
        context.set_theme(egui::Theme::Dark);
        context.global_style_mut(|style| {
            // Pictures of scripts depend on input alone.
            style.animation_time = 0.0;
            style.visuals.text_cursor.blink = false;
            style.visuals.panel_fill = egui::Color32::from_rgb(33, 36, 41);
        });
        Ok(Self {
            model: Model::new(planned_mm_s),
            context,
            state: UiState::default(),
            panes: Panes::new(gpu, samples)?,
            overlay: None,
            textures: HashMap::new(),
            changes: Vec::new(),
            freed: Vec::new(),
            tolerance,
            samples,
            painter: None,
            wake: Arc::new(wake),
            files,
        })
    }

    /// Takes a product in.
    pub fn learn(&mut self, gpu: &mut Gpu, news: News) -> Result<(), AppError> {
        self.model.learn(news);
        let p = &self.model.products;
        if let (Some(wall), Some(tree), Some(exterior), None) =
            (&p.wall, &p.tree, &p.exterior, &self.painter)
        {
            let of = (Arc::clone(wall), Arc::clone(tree), Arc::clone(exterior));
            let wake = Arc::clone(&self.wake);
            self.painter = Some(Painter::spawn(of, move || wake())?);
        }
        Ok(self.panes.take(gpu, &self.model.products, self.tolerance)?)
    }

    /// Lays out a frame and draws the panes that changed. `dt` seconds pass.
    ///
    /// * `commands`: of a script, before those of the panels.
    pub fn prepare(
        &mut self,
        gpu: &mut Gpu,
        input: egui::RawInput,
        mut commands: Commands,
        study: Option<&Study>,
        (dt, detail): (f64, Detail),
    ) -> Result<(egui::FullOutput, After), AppError> {
        let stage = study.filter(|_| !self.model.is_complete).map(|s| s.progress());
        let stage = match detail {
            Detail::Live => stage.map(|p| (p.stage, p.share)),
            // How far a stage has come depends on the machine.
            Detail::Settled => stage.map(|_| ("computing", 0.0)),
        };
        let mut shown = ui::Shown::default();
        let context = self.context.clone();
        let mut output = context.run_ui(input, |root| {
            shown = ui::window(root, &self.model, &mut self.state, stage, &mut commands);
        });
        // Before anything can fail: a frame that is not drawn loses none of it.
        self.collect(std::mem::take(&mut output.textures_delta));
        if let Some([width, height]) = shown.inside {
            self.model.set_aspect(width as f32 / height as f32);
        }
        let bookmarks = self.model.bookmarks.len();
        self.model.step(dt, &commands.actions);
        self.paint(detail, shown.inside.is_some());
        self.panes.draw(gpu, &self.model, (shown.inside, shown.overview), detail)?;
        if self.model.bookmarks.len() > bookmarks {
            self.picture_bookmark(gpu)?;
        }
        let mut export_flight = None;
        for request in &commands.requests {
            match request {
                Request::Export(Export::View) => self.export_view(gpu)?,
                Request::Export(Export::Report) => self.export_report(),
                Request::Export(Export::Flight) => export_flight = Some(self.files.export.clone()),
                _ => {}
            }
        }
        let delay = output
            .viewport_output
            .get(&ViewportId::ROOT)
            .map_or(f64::INFINITY, |v| v.repaint_delay.as_secs_f64());
        let moving =
            self.model.is_moving() || self.panes.is_settling() || keys::moves(&self.context);
        let again_in = if moving || !commands.is_empty() { Some(0.0) } else { None };
        let again_in = again_in.or((delay < 1e6).then_some(delay));
        let after = After {
            quit: commands.requests.contains(&Request::Quit),
            cancel: commands.requests.contains(&Request::Cancel),
            route: commands.requests.iter().rev().find_map(|a| match a {
                Request::Branch(branch) => Some(FlightRoute::Leaf(*branch)),
                _ => None,
            }),
            export_flight,
            change: commands
                .requests
                .iter()
                .rev()
                .find_map(|a| Change::of(a, self.model.contents_of_mask)),
            again_in,
        };
        Ok((output, after))
    }

    /// Takes note of what the inside view shows from now on.
    fn paint(&mut self, detail: Detail, is_shown: bool) {
        let Some(painter) = &mut self.painter else { return };
        if let Some(pose) = self.model.pose.filter(|_| is_shown) {
            let lens = self.model.lens();
            match self.model.view {
                WallView::Eye => painter.add(&[(pose, lens)]),
                WallView::Cube | WallView::Panorama => painter.add(&cube_faces(&pose, &lens, 0.0)),
            }
        }
        let shown = match detail {
            Detail::Live => painter.poll(),
            Detail::Settled => painter.settle(),
        };
        if let Some(shown) = shown {
            self.model.take_shown(shown);
        }
    }

    /// Says what became of a file that was to be written.
    fn say(&mut self, written: Result<String, AppError>) {
        self.model.message = Some(match written {
            Ok(said) => said,
            Err(e) => {
                tracing::error!("{e}");
                e.to_string()
            }
        });
    }

    /// Keeps the inside view as the picture of the bookmark made last, beside the session file.
    fn picture_bookmark(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        if !self.panes.has_pictures() {
            return Ok(());
        }
        let ([width, height], rgb) = self.panes.inside_picture(gpu)?;
        let png = encode_png(width, height, &rgb);
        let written = self.files.beside_session().map(|(folder, stem)| {
            let name = export::free_name(folder, &format!("{stem}-bookmark"));
            export::write(folder, &name, &png).map(|_| name)
        });
        let picture = match written {
            Some(Ok(name)) => Some(name),
            Some(Err(e)) => {
                self.say(Err(e));
                None
            }
            None => None,
        };
        if let Some(b) = self.model.bookmarks.last_mut() {
            (b.picture, b.png) = (picture, Some(Arc::new(png)));
        }
        Ok(())
    }

    fn export_view(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        if self.panes.has_pictures() {
            let ([width, height], rgb) = self.panes.inside_picture(gpu)?;
            let name = export::free_name(&self.files.export, "view");
            let png = encode_png(width, height, &rgb);
            let written = export::write(&self.files.export, &name, &png);
            self.say(written.map(|path| format!("wrote {}", shown(&path))));
        }
        Ok(())
    }

    fn export_report(&mut self) {
        let html = export::report_html(&self.model, self.files.beside_session().map(|f| f.0));
        let written = export::write(&self.files.export, "report.html", html.as_bytes());
        self.say(written.map(|path| format!("wrote {}", shown(&path))));
    }

    /// Draws what was laid out; `send` submits the frame.
    pub fn draw(
        &mut self,
        gpu: &mut Gpu,
        target: &Target,
        output: egui::FullOutput,
        send: impl FnOnce(&mut Gpu, &Frame<'_>) -> Result<(), VkError>,
    ) -> Result<(), AppError> {
        let scale = output.pixels_per_point;
        let primitives = self.context.tessellate(output.shapes, scale);
        let changes = std::mem::take(&mut self.changes);
        self.make_textures(gpu, &changes)?;
        if self.overlay.as_ref().is_none_or(|o| o.1 != target.format) {
            self.overlay = Some((Overlay::new(gpu, target.format)?, target.format));
        }
        let meshes: Vec<FlatMesh> =
            primitives.into_iter().filter_map(|p| self.mesh(p, scale)).collect();
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

    /// Notes what has become of textures.
    fn collect(&mut self, mut delta: egui::TexturesDelta) {
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

    /// Nothing of a volume is shown any more; another one may come.
    ///
    /// # Errors
    /// The device's.
    pub fn begin_anew(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        self.model = self.model.anew();
        self.state.reset();
        self.painter = None;
        self.panes = Panes::new(gpu, self.samples)?;
        Ok(())
    }

    /// Puts everything on another device: the one before was lost.
    ///
    /// # Errors
    /// The device's.
    pub fn reopen(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
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
        self.panes = Panes::new(gpu, self.samples)?;
        Ok(self.panes.take(gpu, &self.model.products, self.tolerance)?)
    }

    fn mesh(&self, p: egui::ClippedPrimitive, scale: f32) -> Option<FlatMesh> {
        let Primitive::Mesh(mesh) = p.primitive else { return None };
        let (picture, filtered) = match mesh.texture_id {
            INSIDE => (self.panes.inside(), false),
            OVERVIEW => (self.panes.overview(), false),
            id => (self.textures.get(&id)?.image?, true),
        };
        let size = |v: f32| (v * scale).round().max(0.0) as u32;
        let (min, max) = (p.clip_rect.min, p.clip_rect.max);
        let (x, y) = (size(min.x), size(min.y));
        let clip = Area {
            x,
            y,
            width: size(max.x).saturating_sub(x),
            height: size(max.y).saturating_sub(y),
        };
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

    /// Whether the wall is drawn.
    pub fn has_pictures(&self) -> bool {
        self.panes.has_pictures()
    }
}
