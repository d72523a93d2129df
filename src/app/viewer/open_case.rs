//! A case that is open: its model, what is computed of it, its notes and its pictures.

use std::sync::Arc;
use std::time::{SystemTime, UNIX_EPOCH};

use glam::DVec3;

use super::super::action::{Action, ActionQueue, Colouring, Export, Request, WallView};
use super::super::computation::{Computation, Outcome, TaskKind, WorkStatus};
use super::super::coverage_recorder::CoverageRecorder;
use super::super::error::AppError;
use super::super::kept_notes::KeptNotes;
use super::super::marked_view::MarkedView;
use super::super::model::Model;
use super::super::opening::{Opening, SavedLumen, with_branches};
use super::super::panes::{Detail, Panes};
use super::super::saved_case::SavedCase;
use super::super::session_file::NotesFile;
use super::super::ui::{CaseUi, PaneSizes, UiState};
use super::ViewerOptions;
use super::notes::Files;
use crate::flight::Frames;
use crate::geometry::cube_faces;
use crate::organ::glance;
use crate::session::{FlightRoute, LumenSettings, Product, Session, SessionError, Source};
use crate::vk::{Gpu, ImageId};

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

/// A case and everything of it that the window shows.
pub struct OpenCase {
    pub model: Model,
    pub(super) ui: UiState,
    pub(super) panes: Panes,
    pub(super) marked_view: MarkedView,
    /// Volume that is open, or settings of one that is opened later.
    pub(super) options: ViewerOptions,
    pub(super) computation: Option<Computation>,
    /// Number of products of [`SHOWN`] that a script has taken in.
    shown_count: usize,
    recorder: Option<CoverageRecorder>,
    /// Whether a frame is drawn with the products that are there, or waits for the products that it shows.
    pub(super) detail: Detail,
    samples: u32,
    /// Files of the notes.
    pub(super) files: Files,
    /// Number of changes of the notes when somebody chose to close the window without them, and
    /// without the flight that is being saved.
    pub(super) left_unsaved: Option<u64>,
    wake: Arc<dyn Fn() + Send + Sync>,
}

impl OpenCase {
    /// Opens what the options say; parameters and errors as of [`super::Viewer::new`].
    pub fn new(
        gpu: &mut Gpu,
        options: ViewerOptions,
        (detail, samples): (Detail, u32),
        wake: Arc<dyn Fn() + Send + Sync>,
    ) -> Result<Self, AppError> {
        let waiting = options.notes()?;
        let own = options.session_file.clone().map(|p| NotesFile::new(p, waiting.clone()));
        let store = KeptNotes::new(options.state.clone());
        let recent = store.recent();
        let planned_mm_s = match options.settings.flight.frames {
            Frames::Speed { mm_per_s, .. } => mm_per_s,
            Frames::Count(_) => DEFAULT_MM_S,
        };
        let opening = Opening {
            source: options.source.clone(),
            settings: options.settings.clone(),
            is_same_volume: false,
        };
        let mut case = Self {
            model: Model::of_window(planned_mm_s, recent, window_number(detail)),
            ui: UiState::new(detail == Detail::Live),
            panes: Panes::new(gpu, samples)?,
            marked_view: MarkedView::default(),
            options,
            computation: None,
            shown_count: 0,
            recorder: None,
            detail,
            samples,
            files: Files::new(own, waiting, store),
            left_unsaved: None,
            wake,
        };
        case.compute(opening)?;
        Ok(case)
    }

    /// A case beside this one, empty yet.
    ///
    /// # Errors
    /// As [`OpenCase::new`].
    pub fn beside(&self, gpu: &mut Gpu) -> Result<Self, AppError> {
        let settings = Opening::settings_of_case(&self.options.settings);
        let options =
            ViewerOptions { source: None, settings, session_file: None, ..self.options.clone() };
        let mut case =
            Self::new(gpu, options, (self.detail, self.samples), Arc::clone(&self.wake))?;
        case.model = self.model.reset();
        Ok(case)
    }

    /// The organ that is found in this case, as it is looked for, or will be when its notes are read.
    pub fn organ(&self) -> Option<SavedLumen> {
        let organ = self.options.settings.lumen.organ;
        let own = LumenSettings { organ, ..LumenSettings::default() };
        let waiting = self.files.waiting.as_ref().and_then(|notes| notes.lumen.clone());
        SavedLumen::of(&own).or(waiting.filter(SavedLumen::is_of_an_organ))
    }

    /// Takes another lumen of the volume.
    pub fn take_lumen(&mut self, gpu: &mut Gpu, lumen: &SavedLumen) -> Result<(), AppError> {
        let session = self.computation.as_ref().map(|c| &*c.session);
        let opening = Opening::of_saved(lumen, session, &self.options.settings);
        self.open(gpu, opening)
    }

    /// Forgets that notes were left unsaved: the window was not closed.
    pub fn forget_answer(&mut self) {
        self.left_unsaved = None;
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
                // Tasks of the lumen before end first: nobody waits for their products.
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
    pub(super) fn is_lumen_open(&self) -> bool {
        let lumen = &self.options.settings.lumen;
        lumen.organ.is_none() && lumen.select.is_none()
    }

    /// Starts a task of the session, if there is one.
    pub(super) fn spawn(
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
        self.restore_branch()?;
        Ok(self.cover_branch()?)
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
    pub(super) fn show(&mut self, gpu: &mut Gpu, products: &[Product]) -> Result<(), AppError> {
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

    /// Returns the work in progress and its share that is done.
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

    /// Returns the case as the panels show it.
    ///
    /// * `commands`: of a script, before those of the panels.
    pub fn shown(&mut self, commands: ActionQueue) -> CaseUi<'_> {
        let (name, status) = (self.name().unwrap_or_default(), self.status());
        let sizes = PaneSizes::default();
        CaseUi { model: &self.model, state: &mut self.ui, status, name, commands, sizes }
    }

    /// Carries out actions, then lets `dt` seconds pass.
    pub fn step(&mut self, dt: f64, actions: &[Action], sizes: PaneSizes) {
        if let Some([width, height]) = sizes.inside {
            self.model.set_aspect(width as f32 / height as f32);
        }
        self.model.step(dt, actions);
        self.record_coverage(sizes.inside.is_some());
    }

    /// Draws the panes that changed, and keeps pictures that were asked for.
    pub fn draw(
        &mut self,
        gpu: &mut Gpu,
        commands: &ActionQueue,
        mut sizes: PaneSizes,
    ) -> Result<(), AppError> {
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
                self.export_view(gpu, sizes.scale)?;
            }
        }
        Ok(())
    }

    /// Images of the inside view and of the overview, and whether each has more pixels than its pane.
    pub fn pictures(&self) -> [(ImageId, bool); 2] {
        let inside = (self.panes.inside(), self.panes.is_inside_fine());
        [inside, (self.panes.overview(), false)]
    }

    /// Whether another frame is to be drawn although nothing is asked for.
    pub fn wants_frame(&self) -> bool {
        self.model.wants_frame() || self.panes.is_settling()
    }

    /// Starts the work that was asked for; waits for it where frames do. Returns the requests but
    /// those that wait for an answer.
    pub fn handle(
        &mut self,
        gpu: &mut Gpu,
        mut requests: Vec<Request>,
    ) -> Result<Vec<Request>, AppError> {
        requests.retain(|request| !self.holds_back(request));
        let is_saved = requests.iter().find_map(|r| match r {
            Request::SaveAs(path) => Some(self.save_as(path.clone())),
            _ => None,
        });
        let is_discarded = requests.contains(&Request::Discard);
        if (is_saved == Some(true) || is_discarded)
            && let Some(request) = self.model.leaving.take()
        {
            // Another case may ask too before the window is closed.
            let is_quit = request == Request::Quit;
            self.left_unsaved = (is_discarded && is_quit).then(|| self.model.notes_version());
            requests.push(request);
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
        if self.detail == Detail::Settled {
            self.join_tasks();
            self.cover_branch()?;
            self.join_tasks();
        }
        Ok(requests)
    }

    /// Waits for all tasks and takes in their outcomes.
    fn join_tasks(&mut self) {
        let outcomes = self.computation.as_mut().map(Computation::join).unwrap_or_default();
        outcomes.into_iter().for_each(|outcome| outcome(&mut self.model));
    }

    /// Shows other volumes, or another lumen of the same.
    pub(super) fn open(&mut self, gpu: &mut Gpu, opening: Opening) -> Result<(), AppError> {
        if opening.is_same_volume {
            self.model = self.model.reset_lumen();
            self.ui.reset_lumen();
        } else {
            self.model = self.model.reset();
            self.ui.reset();
            self.left_unsaved = None;
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
        self.panes = Panes::new(gpu, self.samples)?;
        self.marked_view.forget_device();
        Ok(self.panes.take(gpu, &self.model.products)?)
    }

    /// Whether the wall is drawn.
    pub fn has_pictures(&self) -> bool {
        self.panes.has_pictures()
    }
}

/// Returns a number for a window: the present time, mixed with the number of the process. All scripts
/// have the number 0.
fn window_number(detail: Detail) -> u64 {
    let now = || SystemTime::now().duration_since(UNIX_EPOCH).map_or(0, |d| d.as_nanos() as u64);
    if detail == Detail::Live { now() ^ u64::from(std::process::id()).rotate_left(32) } else { 0 }
}

/// Cruising speed where the flight's frames are counted, mm/s.
const DEFAULT_MM_S: f64 = 20.0;
