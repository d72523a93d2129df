//! State and loop of the viewer, the same for the window and for scripts: products that came are
//! read, panels laid out, actions carried out, panes drawn, requests started, notes saved.

mod branches;
mod exports;
mod notes;
mod title;

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use egui::ViewportId;
use glam::DVec3;

use super::action::{Action, ActionQueue, Colouring, Export, Request, WallView};
use super::canvas::{Canvas, Target};
use super::computation::{Computation, Outcome, TaskKind, WorkStatus};
use super::coverage_recorder::CoverageRecorder;
use super::error::AppError;
use super::kept_notes::KeptNotes;
use super::keys;
use super::model::Model;
use super::opening::{Opening, with_branches};
use super::panes::{Detail, Panes};
use super::saved_case::SavedCase;
use super::session_file::{NotesFile, SessionFile};
use super::ui::{self, INSIDE, OVERVIEW, UiState};
use crate::flight::Frames;
use crate::geometry::cube_faces;
use crate::organ::glance;
use crate::session::{FlightRoute, Product, Session, SessionError, Settings, Source};
use crate::vk::{Frame, Gpu, VkError};
use notes::Files;

/// Volume that is opened, its settings, and folders of files.
#[derive(Clone, Debug)]
pub struct ViewerOptions {
    /// The volumes; `None` where some are opened later.
    pub source: Option<Source>,
    /// Choice of the lumen and settings of each stage.
    pub settings: Settings,
    /// Bookmarks and how the window is set, read if it is there; pictures are beside it.
    pub session_file: Option<PathBuf>,
    /// Folder of exported files.
    pub export: PathBuf,
    /// Folder of notes that are kept from one start to the next; nothing is kept without one.
    pub state: Option<PathBuf>,
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
    // Notes are kept by it, from the first on.
    Product::Identity,
    Product::Lumen,
    Product::Wall,
    Product::PreparedWall,
    Product::Evidence,
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

/// Number of products of [`SHOWN`] that the first picture of the wall needs.
const FIRST_PICTURE: usize = 6;

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
    /// Files of the notes.
    files: Files,
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
        let waiting = options.notes()?;
        let own = options.session_file.clone().map(|p| NotesFile::new(p, waiting.clone()));
        let store = KeptNotes::new(options.state.clone());
        let recent = store.recent();
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
            model: Model::of_window(planned_mm_s, recent, window_number(detail)),
            context,
            ui: UiState::new(detail == Detail::Live),
            panes: Panes::new(gpu, samples)?,
            canvas: Canvas::default(),
            options,
            computation: None,
            shown_count: 0,
            recorder: None,
            detail,
            samples,
            files: Files::new(own, waiting, store),
            wake: Arc::new(wake),
        };
        viewer.compute(opening)?;
        Ok(viewer)
    }

    /// Has the session compute other volumes or other settings, and nothing else any more.
    fn compute(&mut self, opening: Opening) -> Result<(), AppError> {
        let Opening { source, settings, .. } = opening;
        self.options.settings = settings.clone();
        let has_files = |source: &&Source| SavedCase::of(source, None).is_some();
        if let Some(source) = source.as_ref().filter(has_files) {
            self.options.source = Some(source.clone());
        }
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
            // The lumen of a session file is taken once it is known to be of this volume.
            let known_first: &'static [Product] = match self.is_lumen_to_restore() {
                true => &[Product::Volume, Product::ValueRange, Product::Identity],
                false => &[],
            };
            self.spawn(TaskKind::Products, move |session| {
                // First what the first picture needs, then the rest side by side.
                let groups = [known_first, &SHOWN[..FIRST_PICTURE], &SHOWN];
                let outcome = session.prepare_in_order(&groups);
                let contents = outcome.as_ref().err().and_then(|e| session.contents(e));
                match &outcome {
                    Ok(()) => {}
                    // A question that the window asks.
                    Err(SessionError::LumenNotChosen { .. }) => {
                        tracing::info!("the lumen is not chosen yet")
                    }
                    Err(e) if contents.is_some() => tracing::info!("{e}"),
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
        Ok(self.restore_branch()?)
    }

    /// Computes the products up to one, waits for them and takes in these alone, so that what is
    /// shown depends on the input alone; whether there is a volume to make them of.
    ///
    /// # Errors
    /// What the stages fail with; the device's.
    pub fn wait_for(&mut self, gpu: &mut Gpu, last: Product) -> Result<bool, AppError> {
        self.restore_lumen(gpu)?;
        let Some(computation) = &self.computation else { return Ok(false) };
        let at = SHOWN.iter().position(|p| *p == last).expect("a product that is shown");
        if self.shown_count <= at {
            computation.session.prepare(&SHOWN[..=at])?;
            self.show_first(gpu, at + 1)?;
        }
        if self.shown_count == SHOWN.len() {
            self.model.finish(Ok(()), None);
        }
        self.restore_branch()?;
        Ok(true)
    }

    /// Computes product after product until one fails and shows why; whether one did.
    pub fn wait_for_failure(&mut self, gpu: &mut Gpu) -> Result<bool, AppError> {
        let Some(computation) = &self.computation else { return Ok(false) };
        let session = Arc::clone(&computation.session);
        let wanted = SHOWN.iter().enumerate();
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
        let behind = (self.model.colouring == Colouring::Behind).then_some(Product::Behind);
        let products: Vec<Product> = products.iter().copied().chain(behind).collect();
        self.model.update(computation.session.products(&products));
        let p = &self.model.products;
        if let (Some(wall), Some(tree), Some(exterior), None) =
            (&p.wall, &p.triangle_tree, &p.exterior, &self.recorder)
        {
            let of = (Arc::clone(wall), Arc::clone(tree), Arc::clone(exterior));
            let wake = Arc::clone(&self.wake);
            self.recorder = Some(CoverageRecorder::spawn(of, move || wake())?);
        }
        Ok(self.panes.take(gpu, &self.model.products)?)
    }

    /// Whether something is being computed, or will be when it is waited for.
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
        self.model.step(dt, &commands.actions);
        self.record_coverage(sizes.inside.is_some());
        self.look_behind(gpu)?;
        let notes_place = commands.actions.iter().any(|a| matches!(a, Action::Bookmark(_)));
        let wants_view = commands.requests.contains(&Request::Export(Export::View));
        if (notes_place || wants_view) && sizes.inside.is_none() {
            // Not shown, but its picture is asked for.
            const COLUMNS: f32 = 640.0;
            let rows = (COLUMNS / self.model.aspect).clamp(64.0, 1024.0);
            sizes.inside = Some([COLUMNS as u32, rows as u32]);
        }
        self.panes.draw(gpu, &self.model, (sizes.inside, sizes.overview), self.detail)?;
        if notes_place {
            self.picture_bookmark(gpu)?;
        }
        for request in &commands.requests {
            if *request == Request::Export(Export::View) {
                self.export_view(gpu)?;
            }
        }
        let scale = output.pixels_per_point;
        let primitives = self.context.tessellate(output.shapes, scale);
        let inside = (self.panes.inside(), self.panes.is_inside_fine());
        let overview = (self.panes.overview(), false);
        let pane = |id| match id {
            INSIDE => Some(inside),
            OVERVIEW => Some(overview),
            _ => None,
        };
        if commands.requests.contains(&Request::Export(Export::Window)) {
            let size = self.context.content_rect().size() * scale;
            let size = [size.x, size.y].map(|s| s.round().max(1.0) as u32);
            let picture = self.canvas.picture(gpu, size, (primitives.clone(), scale), pane)?;
            self.export_window(size, &picture);
        }
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
                self.leave_volume();
            }
            self.open(gpu, opening)?;
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
                Request::OpenSession(path) => self.open_session(gpu, path, true)?,
                Request::OpenKept(path) => self.open_session(gpu, path, false)?,
                Request::TakeKept => self.take_kept_notes(),
                Request::LeaveKept => self.leave_kept_notes(),
                Request::Branch(branch) => {
                    self.model.give_up_way();
                    self.plan_branch(FlightRoute::Leaf(*branch))?;
                }
                Request::FlyThrough(place) => {
                    if let Some(route) = self.model.set_out_through_tree(DVec3::from(*place)) {
                        self.plan_branch(route)?;
                    }
                }
                Request::Export(Export::Flight) => self.export_flight()?,
                Request::Export(Export::Report) => self.export_report()?,
                Request::Export(Export::Findings) => self.export_findings(),
                _ => {}
            }
        }
        if let (Detail::Settled, Some(computation)) = (self.detail, &mut self.computation) {
            computation.join().into_iter().for_each(|outcome| outcome(&mut self.model));
        }
        Ok(requests.contains(&Request::Quit))
    }

    /// Shows other volumes, or another lumen of the same.
    fn open(&mut self, gpu: &mut Gpu, opening: Opening) -> Result<(), AppError> {
        if opening.is_same_volume {
            self.model = self.model.reset_lumen();
            self.ui.reset_lumen();
        } else {
            self.model = self.model.reset();
            self.ui.reset();
        }
        self.recorder = None;
        self.shown_count = 0;
        self.panes = Panes::new(gpu, self.samples)?;
        self.compute(opening)
    }

    /// Has the tissue behind the wall prepared, once somebody looks at it.
    fn look_behind(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        let model = &self.model;
        let is_wanted = model.colouring == Colouring::Behind && model.may_look_behind();
        let Some(computation) = self.computation.as_ref().filter(|_| is_wanted) else {
            return Ok(());
        };
        if self.model.products.behind.is_some() || computation.runs(TaskKind::Behind) {
            return Ok(());
        }
        match self.detail {
            Detail::Settled => {
                let outcome = computation.session.behind();
                outcome.err().iter().for_each(|e| self.model.refuse_behind(e));
                self.show(gpu, &SHOWN[..self.shown_count])
            }
            Detail::Live => Ok(self.spawn(TaskKind::Behind, |session| {
                let outcome = session.behind();
                Box::new(move |model| outcome.err().iter().for_each(|e| model.refuse_behind(e)))
            })?),
        }
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

    /// Puts everything on another device: the one before was lost.
    pub fn reopen(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        self.canvas.forget_device();
        self.panes = Panes::new(gpu, self.samples)?;
        Ok(self.panes.take(gpu, &self.model.products)?)
    }

    /// Whether the wall is drawn.
    pub fn has_pictures(&self) -> bool {
        self.panes.has_pictures()
    }
}

/// Number of a window: that of the moment. Scripts have one.
fn window_number(detail: Detail) -> u64 {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as u64);
    if detail == Detail::Live { now() ^ u64::from(std::process::id()).rotate_left(32) } else { 0 }
}

/// Cruising speed where the flight's frames are counted, mm/s.
const DEFAULT_MM_S: f64 = 20.0;
