//! State and loop of the viewer, the same for the window and for scripts: products that came are
//! read, panels laid out, actions carried out, panes drawn, requests started, notes saved.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use egui::ViewportId;

use super::action::{ActionQueue, Export, Request, WallView};
use super::canvas::{Canvas, Target};
use super::computation::{Computation, Outcome, TaskKind, WorkStatus};
use super::coverage_recorder::CoverageRecorder;
use super::error::AppError;
use super::export::{self, Notes};
use super::keys;
use super::model::Model;
use super::opening::{Opening, with_branches};
use super::panes::{Detail, Panes};
use super::saved_flight::save_flight;
use super::session_file::SessionFile;
use super::ui::{self, INSIDE, OVERVIEW, UiState};
use crate::flight::Frames;
use crate::formats::{encode_png, shown};
use crate::geometry::cube_faces;
use crate::lod::Tolerance;
use crate::organ::glance;
use crate::session::{
    FlightRoute, Lod, PAGE_FILE, Product, Session, SessionError, Settings, Source, VolumeSource,
};
use crate::vk::{Frame, Gpu, VkError};

/// Volume that is opened, its settings, and folders of files.
#[derive(Clone, Debug)]
pub struct ViewerOptions {
    /// The volume; `None` where one is opened later.
    pub source: Option<Source>,
    /// Choice of the lumen and settings of each stage.
    pub settings: Settings,
    /// Bookmarks and how the window is set, read if it is there; pictures are beside it.
    pub session_file: Option<PathBuf>,
    /// Folder of exported files.
    pub export: PathBuf,
}

impl ViewerOptions {
    /// The session file, if it is there.
    ///
    /// # Errors
    /// As [`SessionFile::read`].
    pub fn notes(&self) -> Result<Option<SessionFile>, AppError> {
        let file = self.session_file.as_deref().filter(|p| p.exists());
        file.map(SessionFile::read).transpose()
    }
}

/// Products that are shown, in the order in which a script takes them in: its pictures show those
/// up to what it waited for, whatever else is there.
const SHOWN: [Product; 16] = [
    Product::Volume,
    Product::ValueRange,
    Product::Lumen,
    Product::Wall,
    Product::PreparedWall,
    Product::Evidence,
    Product::Identity,
    Product::TriangleTree,
    Product::Exterior,
    Product::Fields,
    Product::Centerline,
    Product::Flight,
    Product::Levels,
    Product::Sections,
    Product::CenterlineDistances,
    Product::Coverage,
];

/// Returns those of these products that a session makes: without levels of detail the whole wall is
/// drawn.
fn made(products: &[Product], session: &Session) -> Vec<Product> {
    let has_levels = session.settings().levels.lod != Lod::Off;
    products.iter().copied().filter(|p| has_levels || *p != Product::Levels).collect()
}

/// Number of products of [`SHOWN`] that the first picture of the wall needs.
const FIRST_PICTURE: usize = 5;

/// Work to be done after a frame.
pub struct FrameEnd {
    /// For the system: cursor, texts to copy.
    pub platform: egui::PlatformOutput,
    /// The window is to be closed.
    pub quit: bool,
    /// Seconds after which to draw again, at most.
    pub again_in: Option<f64>,
}

/// Everything of a window but the window.
pub struct Viewer {
    pub model: Model,
    pub context: egui::Context,
    ui: UiState,
    panes: Panes,
    canvas: Canvas,
    /// Volume that is open, or settings of one that is opened later.
    options: ViewerOptions,
    computation: Option<Computation>,
    /// Number of products of [`SHOWN`] that a script has taken in.
    shown_count: usize,
    recorder: Option<CoverageRecorder>,
    /// Whether frames are drawn with what is there, or wait for what was asked for.
    detail: Detail,
    samples: u32,
    /// Notes of the session file, until the volume is known.
    notes: Option<SessionFile>,
    wake: Arc<dyn Fn() + Send + Sync>,
}

impl Viewer {
    /// Opens what the options say.
    ///
    /// * `detail`: of all frames. Where it is [`Detail::Live`], products are computed beside the
    ///   frames, else when they are waited for.
    /// * `samples`: a pixel of the drawn panes.
    /// * `wake`: called on another thread when there is something new to draw.
    ///
    /// # Errors
    /// A session file that is there and cannot be read; the device's;
    /// [`SessionError::System`] if the system gives no thread.
    pub fn new(
        gpu: &mut Gpu,
        options: ViewerOptions,
        (detail, samples): (Detail, u32),
        wake: impl Fn() + Send + Sync + 'static,
    ) -> Result<Self, AppError> {
        let notes = options.notes()?;
        let context = egui::Context::default();
        context.set_theme(egui::Theme::Dark);
        context.global_style_mut(|style| {
            // Pictures of scripts depend on input alone.
            style.animation_time = 0.0;
            style.visuals.text_cursor.blink = false;
            style.visuals.panel_fill = egui::Color32::from_rgb(33, 36, 41);
        });
        let planned_mm_s = match options.settings.flight.frames {
            Frames::Speed { mm_per_s, .. } => mm_per_s,
            Frames::Count(_) => DEFAULT_MM_S,
        };
        let opening = Opening {
            source: options.source.clone(),
            settings: options.settings.clone(),
            is_same_volume: false,
        };
        let mut viewer = Self {
            model: Model::new(planned_mm_s),
            context,
            ui: UiState::default(),
            panes: Panes::new(gpu, samples)?,
            canvas: Canvas::default(),
            options,
            computation: None,
            shown_count: 0,
            recorder: None,
            detail,
            samples,
            notes,
            wake: Arc::new(wake),
        };
        viewer.compute(opening)?;
        Ok(viewer)
    }

    /// Has the session compute other volumes or other settings, and nothing else any more.
    fn compute(&mut self, opening: Opening) -> Result<(), AppError> {
        let Opening { source, settings, .. } = opening;
        self.options.settings = settings.clone();
        let settings = with_branches(settings);
        match (&mut self.computation, source) {
            (Some(computation), source) => {
                // What is computed for nobody ends first.
                computation.stop();
                let session = Arc::get_mut(&mut computation.session);
                let session = session.expect("tasks that held it have ended");
                source.into_iter().for_each(|source| session.set_source(source));
                session.apply(settings)?;
            }
            (None, Some(source)) => {
                let mut session = Session::new(source, settings)?;
                session.keep_volume();
                let wake = Arc::clone(&self.wake);
                session.wake_by(move || wake());
                self.computation = Some(Computation::new(session));
            }
            (None, None) => {}
        }
        if self.detail == Detail::Live && self.is_lumen_open() {
            self.spawn(TaskKind::Glance, |session| {
                let seen = session.volume().ok().map(|volume| glance(&volume));
                Box::new(move |model| seen.into_iter().for_each(|seen| model.set_glance(seen)))
            })?;
        }
        self.compute_on()
    }

    /// Has the products computed that are not there. Where frames wait for products, they are
    /// computed when they are waited for.
    fn compute_on(&mut self) -> Result<(), AppError> {
        if self.detail == Detail::Live {
            self.spawn(TaskKind::Products, |session| {
                // First what the first picture needs, then the rest side by side.
                let all = made(&SHOWN, session);
                let outcome = session.prepare_in_order(&[&SHOWN[..FIRST_PICTURE], &all]);
                let contents = outcome.as_ref().err().and_then(|e| session.contents(e));
                match &outcome {
                    Ok(()) => {}
                    // A question that the window asks.
                    Err(SessionError::LumenNotChosen { .. }) => {
                        tracing::info!("the lumen is not chosen yet")
                    }
                    Err(e) => tracing::error!("{e}"),
                }
                Box::new(move |model| model.finish(outcome, contents))
            })?;
        }
        Ok(())
    }

    /// Whether the settings leave it to the volume which lumen there is.
    fn is_lumen_open(&self) -> bool {
        let lumen = &self.options.settings.lumen;
        lumen.organ.is_none() && lumen.select.is_none()
    }

    /// Starts a task of the session, if there is one.
    fn spawn(
        &mut self,
        kind: TaskKind,
        work: impl FnOnce(&Session) -> Outcome + Send + 'static,
    ) -> Result<(), SessionError> {
        let wake = Arc::clone(&self.wake);
        self.computation.as_mut().map_or(Ok(()), |c| c.spawn(kind, wake, work))
    }

    /// Takes in the products that are there and the outcomes of tasks. Never waits.
    pub fn receive(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        // Outcomes are of products that are read after them.
        let outcomes = self.computation.as_mut().map(Computation::outcomes).unwrap_or_default();
        self.show(gpu, &SHOWN)?;
        outcomes.into_iter().for_each(|outcome| outcome(&mut self.model));
        Ok(())
    }

    /// Computes the products up to one, waits for them and takes in these alone, so that what is
    /// shown depends on the input alone; whether there is a volume to make them of.
    ///
    /// # Errors
    /// What the stages fail with; the device's.
    pub fn wait_for(&mut self, gpu: &mut Gpu, last: Product) -> Result<bool, AppError> {
        let Some(computation) = &self.computation else { return Ok(false) };
        let at = SHOWN.iter().position(|p| *p == last).expect("a product that is shown");
        if self.shown_count <= at {
            let session = &computation.session;
            session.prepare(&made(&SHOWN[..=at], session))?;
            self.show_first(gpu, at + 1)?;
        }
        if self.shown_count == SHOWN.len() {
            self.model.finish(Ok(()), None);
        }
        Ok(true)
    }

    /// Computes product after product until one fails and shows why; whether one did.
    pub fn wait_for_failure(&mut self, gpu: &mut Gpu) -> Result<bool, AppError> {
        let Some(computation) = &self.computation else { return Ok(false) };
        let session = Arc::clone(&computation.session);
        let made = made(&SHOWN, &session);
        let wanted = SHOWN.iter().enumerate().filter(|(_, product)| made.contains(product));
        let failed =
            wanted.map(|(count, product)| Some((count, session.prepare(&[*product]).err()?)));
        let Some((count, e)) = failed.flatten().next() else {
            return Ok(false);
        };
        let contents = session.contents(&e);
        self.show_first(gpu, count.max(self.shown_count))?;
        if let Some(seen) = self.model.volume().map(|volume| glance(volume)) {
            self.model.set_glance(seen);
        }
        self.model.finish(Err(e), contents);
        Ok(true)
    }

    fn show_first(&mut self, gpu: &mut Gpu, count: usize) -> Result<(), AppError> {
        self.shown_count = count;
        self.show(gpu, &SHOWN[..count])
    }

    /// Takes those of these products in that are there.
    fn show(&mut self, gpu: &mut Gpu, products: &[Product]) -> Result<(), AppError> {
        let Some(computation) = &self.computation else { return Ok(()) };
        self.model.update(computation.session.products(products));
        let p = &self.model.products;
        if let (Some(wall), Some(tree), Some(exterior), None) =
            (&p.wall, &p.triangle_tree, &p.exterior, &self.recorder)
        {
            let of = (Arc::clone(wall), Arc::clone(tree), Arc::clone(exterior));
            let wake = Arc::clone(&self.wake);
            self.recorder = Some(CoverageRecorder::spawn(of, move || wake())?);
        }
        Ok(self.panes.take(gpu, &self.model.products, self.tolerance())?)
    }

    fn tolerance(&self) -> Tolerance {
        Tolerance { pixels: self.options.settings.levels.pixel_error }
    }

    /// Sets the model as the session file says, once the volume is known.
    ///
    /// # Errors
    /// [`AppError::SessionFile`] if it is of another volume.
    pub fn apply_notes(&mut self) -> Result<(), AppError> {
        if self.model.products.identity.is_none() {
            return Ok(());
        }
        let Some(notes) = self.notes.take() else { return Ok(()) };
        notes.apply(&mut self.model).map_err(|what| {
            // It is not overwritten.
            let path = self.options.session_file.take().unwrap_or_default();
            AppError::SessionFile { path, what }
        })
    }

    /// Whether something is being computed, or will be when it is waited for.
    /// The window's title: the name of the file or folder that is open, nothing of its contents.
    pub fn title(&self) -> String {
        const PROGRAM: &str = "intima";
        let name = self.computation.as_ref().and_then(|c| file_name(c.session.source()));
        name.map_or(PROGRAM.into(), |name| format!("{name} - {PROGRAM}"))
    }

    pub fn is_computing(&self) -> bool {
        self.computation.is_some() && !self.model.is_complete
    }

    /// Whether a flight is being saved.
    pub fn is_saving(&self) -> bool {
        self.computation.as_ref().is_some_and(|c| c.runs(TaskKind::SavedFlight))
    }

    /// Returns what is at work and how far it has come.
    fn status(&self) -> Option<WorkStatus> {
        let computation = self.computation.as_ref()?;
        match self.detail {
            Detail::Live => computation.status(self.is_computing()),
            // How far a stage has come depends on the machine.
            Detail::Settled => self.is_computing().then(|| WorkStatus {
                text: "computing".into(),
                share: 0.0,
                is_computing: true,
            }),
        }
    }

    /// One frame: lays out the panels, carries out the commands, lets `dt` seconds pass, draws, and
    /// starts what is requested.
    ///
    /// * `commands`: of a script, before those of the panels.
    /// * `send`: submits the frame.
    pub fn frame(
        &mut self,
        gpu: &mut Gpu,
        input: egui::RawInput,
        mut commands: ActionQueue,
        dt: f64,
        target: &Target,
        send: impl FnOnce(&mut Gpu, &Frame<'_>) -> Result<(), VkError>,
    ) -> Result<FrameEnd, AppError> {
        let status = self.status();
        let mut sizes = ui::PaneSizes::default();
        let context = self.context.clone();
        let mut output = context.run_ui(input, |root| {
            sizes = ui::window(root, &self.model, &mut self.ui, status.as_ref(), &mut commands);
        });
        self.canvas.collect(std::mem::take(&mut output.textures_delta));
        if let Some([width, height]) = sizes.inside {
            self.model.set_aspect(width as f32 / height as f32);
        }
        let bookmarks = self.model.bookmarks.len();
        self.model.step(dt, &commands.actions);
        self.record_coverage(sizes.inside.is_some());
        self.panes.draw(gpu, &self.model, (sizes.inside, sizes.overview), self.detail)?;
        if self.model.bookmarks.len() > bookmarks {
            self.picture_bookmark(gpu)?;
        }
        for request in &commands.requests {
            if *request == Request::Export(Export::View) {
                self.export_view(gpu)?;
            }
        }
        let scale = output.pixels_per_point;
        let primitives = self.context.tessellate(output.shapes, scale);
        let (inside, overview) = (self.panes.inside(), self.panes.overview());
        let pane = |id| match id {
            INSIDE => Some(inside),
            OVERVIEW => Some(overview),
            _ => None,
        };
        self.canvas.draw(gpu, target, (primitives, scale), pane, send)?;
        let delay = output
            .viewport_output
            .get(&ViewportId::ROOT)
            .map_or(f64::INFINITY, |v| v.repaint_delay.as_secs_f64());
        let moving =
            self.model.wants_frame() || self.panes.is_settling() || keys::moves(&self.context);
        let at_once = moving || !commands.is_empty();
        let quit = self.handle(gpu, commands.requests)?;
        Ok(FrameEnd {
            platform: output.platform_output,
            quit,
            again_in: if at_once { Some(0.0) } else { (delay < 1e6).then_some(delay) },
        })
    }

    /// Whether a request waits for an answer, because notes would be lost. Asked for again, it is
    /// carried out.
    pub fn holds_back(&mut self, request: &Request) -> bool {
        let leaves = matches!(
            request,
            Request::Quit | Request::Open(_) | Request::Series(_) | Request::Segment(_)
        );
        let loses = leaves && self.model.has_unsaved_notes() && self.options.session_file.is_none();
        // Nobody answers a script.
        if !loses || self.detail == Detail::Settled || self.model.leaving.as_ref() == Some(request)
        {
            return false;
        }
        tracing::info!("bookmarks are in no file yet");
        self.model.leaving = Some(request.clone());
        true
    }

    /// Starts the work that was asked for; waits for it where frames do. Whether the window is to
    /// be closed.
    fn handle(&mut self, gpu: &mut Gpu, mut requests: Vec<Request>) -> Result<bool, AppError> {
        requests.retain(|request| !self.holds_back(request));
        let is_saved = requests.iter().find_map(|r| match r {
            Request::SaveAs(path) => Some(self.save_as(path.clone())),
            _ => None,
        });
        if is_saved == Some(true) || requests.contains(&Request::Discard) {
            requests.extend(self.model.leaving.take());
        }
        let is_mask = self.model.contents.as_ref().is_some_and(|(_, is_mask)| *is_mask);
        let opening = requests.iter().rev().find_map(|request| {
            let session = self.computation.as_ref().map(|c| &*c.session);
            let is_other = matches!(request, Request::Open(_));
            Some((Opening::of(request, session, &self.options.settings, is_mask)?, is_other))
        });
        if let Some((opening, is_other_volume)) = opening {
            if is_other_volume {
                // Notes are of one volume.
                (self.notes, self.options.session_file) = (None, None);
            }
            self.model = match opening.is_same_volume {
                true => self.model.reset_lumen(),
                false => self.model.reset(),
            };
            self.ui.reset();
            self.recorder = None;
            self.shown_count = 0;
            self.panes = Panes::new(gpu, self.samples)?;
            self.compute(opening)?;
        }
        for request in &requests {
            match request {
                Request::Cancel => {
                    self.computation.iter().for_each(Computation::cancel);
                }
                Request::Resume if self.model.is_stopped => {
                    self.model.resume();
                    self.compute_on()?;
                }
                Request::Branch(branch) => self.plan_branch(FlightRoute::Leaf(*branch))?,
                Request::Export(Export::Flight) => self.export_flight()?,
                Request::Export(Export::Report) => self.export_report()?,
                _ => {}
            }
        }
        if let (Detail::Settled, Some(computation)) = (self.detail, &mut self.computation) {
            computation.join().into_iter().for_each(|outcome| outcome(&mut self.model));
        }
        Ok(requests.contains(&Request::Quit))
    }

    /// Saves notes, with their pictures, to a file from now on; whether they are saved.
    fn save_as(&mut self, path: PathBuf) -> bool {
        self.options.session_file = Some(path);
        for i in 0..self.model.bookmarks.len() {
            let bookmark = &self.model.bookmarks[i];
            if let (Some(png), None) = (bookmark.png.clone(), &bookmark.picture) {
                self.model.bookmarks[i].picture = self.write_picture(&png);
            }
        }
        let saved = self.save_session();
        let is_saved = saved.is_ok();
        let path = self.options.session_file.as_deref().unwrap_or(Path::new(""));
        self.show_written(saved.map(|()| format!("wrote {}", shown(path))));
        is_saved
    }

    /// Plans a flight along another branch of the centerline.
    fn plan_branch(&mut self, route: FlightRoute) -> Result<(), SessionError> {
        self.spawn(TaskKind::Branch, move |session| {
            let planned = session.flight_along(route).and_then(|flight| {
                let sections = session.sections_along(&flight)?;
                Ok((flight, sections))
            });
            Box::new(move |model| match planned {
                Ok((flight, sections)) => model.take_branch(&flight, &sections, route),
                Err(e) => model.message = Some(format!("no flight along that branch: {e}")),
            })
        })
    }

    /// Draws the flight into a new folder of the export folder and, where there is ffmpeg, a video
    /// beside it. One flight at a time.
    fn export_flight(&mut self) -> Result<(), SessionError> {
        let Frames::Speed { fps, .. } = self.options.settings.flight.frames else { return Ok(()) };
        if self.is_saving() {
            return Ok(());
        }
        let folder = self.options.export.clone();
        self.model.message = None;
        self.spawn(TaskKind::SavedFlight, move |session| {
            let message = save_flight(session, &folder, fps).unwrap_or_else(|e| match e {
                SessionError::Cancelled => "saving was stopped; no frame is left".into(),
                e => format!("the flight is not written: {e}"),
            });
            Box::new(move |model| model.message = Some(message))
        })
    }

    /// Records what the inside view shows of the wall from now on.
    fn record_coverage(&mut self, is_shown: bool) {
        let Some(recorder) = &mut self.recorder else { return };
        if let Some(pose) = self.model.pose.filter(|_| is_shown) {
            let lens = self.model.lens();
            match self.model.view {
                WallView::Eye => recorder.add(&[(pose, lens)]),
                WallView::Cube | WallView::Panorama => recorder.add(&cube_faces(&pose, &lens, 0.0)),
            }
        }
        let seen = match self.detail {
            Detail::Live => recorder.poll(),
            Detail::Settled => recorder.settle(),
        };
        if let Some(seen) = seen {
            self.model.set_seen(seen);
        }
    }

    /// Shows what became of a file that was to be written.
    fn show_written(&mut self, written: Result<String, AppError>) {
        self.model.message = Some(written.unwrap_or_else(|e| {
            tracing::error!("{e}");
            e.to_string()
        }));
    }

    /// Folder and stem of the pictures of bookmarks.
    fn beside_session_file(&self) -> Option<(&Path, &str)> {
        let file = self.options.session_file.as_deref()?;
        Some((file.parent()?, file.file_stem()?.to_str()?))
    }

    /// The inside view as PNG, where it shows something.
    fn inside_png(&self, gpu: &mut Gpu) -> Result<Option<Vec<u8>>, AppError> {
        if !self.panes.has_pictures() {
            return Ok(None);
        }
        let ([width, height], rgb) = self.panes.inside_picture(gpu)?;
        Ok(Some(encode_png(width, height, &rgb)))
    }

    /// Keeps the inside view as the picture of the bookmark made last, beside the session file.
    fn picture_bookmark(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let Some(png) = self.inside_png(gpu)? else { return Ok(()) };
        let picture = self.write_picture(&png);
        if let Some(b) = self.model.bookmarks.last_mut() {
            (b.picture, b.png) = (picture, Some(Arc::new(png)));
        }
        Ok(())
    }

    /// Writes the picture of a bookmark beside the session file, if there is one; its name.
    fn write_picture(&mut self, png: &[u8]) -> Option<String> {
        let (folder, stem) = self.beside_session_file()?;
        let name = export::free_name(folder, &format!("{stem}-bookmark"));
        let written = export::write(folder, &name, png);
        written.map_err(|e| self.show_written(Err(e))).ok().map(|_| name)
    }

    fn export_view(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        if let Some(png) = self.inside_png(gpu)? {
            let name = export::free_name(&self.options.export, "view");
            let written = export::write(&self.options.export, &name, &png);
            self.show_written(written.map(|path| format!("wrote {}", shown(&path))));
        }
        Ok(())
    }

    /// Writes the page of the report, with the notes as they are now.
    fn export_report(&mut self) -> Result<(), SessionError> {
        let notes = Notes::of(&self.model, self.beside_session_file().map(|f| f.0));
        let folder = self.options.export.clone();
        self.spawn(TaskKind::Report, move |session| {
            let page = export::page(session, notes).map_err(AppError::from);
            let written = page.and_then(|p| export::write(&folder, PAGE_FILE, p.as_bytes()));
            let message = match written {
                Ok(path) => format!("wrote {}", shown(&path)),
                Err(e) => format!("the report is not written: {e}"),
            };
            Box::new(move |model| model.message = Some(message))
        })
    }

    /// Whether notes wait to be saved.
    pub fn has_unsaved_notes(&self) -> bool {
        self.options.session_file.is_some() && self.model.has_unsaved_notes()
    }

    /// Saves notes that were changed.
    ///
    /// # Errors
    /// [`AppError::Format`]; then they are still to be saved.
    pub fn save_notes(&mut self) -> Result<(), AppError> {
        if self.model.has_unsaved_notes() { self.save_session() } else { Ok(()) }
    }

    /// Saves notes, how the window is set, and the place on the path. Where no volume came to be
    /// known, the file stays as it is.
    ///
    /// # Errors
    /// As [`Viewer::save_notes`].
    pub fn save_session(&mut self) -> Result<(), AppError> {
        if let (Some(path), Some(file)) = (&self.options.session_file, SessionFile::of(&self.model))
            && self.notes.is_none()
        {
            file.write(path)?;
            self.model.notes_saved();
        }
        Ok(())
    }

    /// Puts everything on another device: the one before was lost.
    pub fn reopen(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        self.canvas.forget_device();
        self.panes = Panes::new(gpu, self.samples)?;
        Ok(self.panes.take(gpu, &self.model.products, self.tolerance())?)
    }

    /// Whether the wall is drawn.
    pub fn has_pictures(&self) -> bool {
        self.panes.has_pictures()
    }
}

/// Cruising speed where the flight's frames are counted, mm/s.
/// Name of the file or folder that the slices show, without the way to it.
fn file_name(source: &Source) -> Option<String> {
    let volume = match source {
        Source::Image(image) | Source::Mask { image: Some(image), .. } => image,
        Source::Mask { mask, image: None } => mask,
    };
    let VolumeSource::File { path, .. } = volume else { return None };
    // A path such as `.` ends in no name of its own.
    let whole = path.file_name().is_none().then(|| path.canonicalize().ok()).flatten();
    whole.as_deref().unwrap_or(path).file_name().map(|name| shown(Path::new(name)))
}

const DEFAULT_MM_S: f64 = 20.0;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_title_names_the_file_or_folder_and_not_the_way_to_it() {
        let image = |path: &str| Source::Image(VolumeSource::file(path));
        let name = |source| file_name(&source);
        assert_eq!(name(image("/home/someone/ct.nrrd")).as_deref(), Some("ct.nrrd"));
        assert_eq!(name(image("scans/chest/")).as_deref(), Some("chest"));
        assert_eq!(name(image("a\nb.nrrd")).as_deref(), Some("a\\nb.nrrd"));
        let here = std::env::current_dir().unwrap();
        let here = here.file_name().unwrap().to_string_lossy().into_owned();
        assert_eq!(name(image(".")), Some(here));
        let (mask, ct) = (VolumeSource::file("mask.nrrd"), VolumeSource::file("ct.nrrd"));
        let mask = |image| Source::Mask { mask: mask.clone(), image };
        assert_eq!(name(mask(Some(ct))).as_deref(), Some("ct.nrrd"), "what the slices show");
        assert_eq!(name(mask(None)).as_deref(), Some("mask.nrrd"));
    }
}
