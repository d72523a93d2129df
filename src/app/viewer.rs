//! State and loop of the viewer, the same for the window and for scripts: products that came are
//! read, panels laid out, actions carried out, panes drawn, requests started, notes saved. It shows
//! one case, or two beside each other.

mod branches;
mod exports;
mod notes;
mod open_case;
mod pair;
mod title;

use std::path::PathBuf;
use std::sync::Arc;

use egui::ViewportId;

use super::action::{Action, ActionQueue, Export, Request};
use super::canvas::{Canvas, Target};
use super::dialogs::open_request;
use super::error::AppError;
use super::keys;
use super::panes::Detail;
use super::session_file::SessionFile;
use super::ui;
use crate::session::{Settings, Source};
use crate::vk::{Frame, Gpu, VkError};
use open_case::OpenCase;
use pair::Pair;

/// Volume that is opened, its settings, and folders of files.
#[derive(Clone, Debug)]
pub struct ViewerOptions {
    /// The volumes; `None` where some are opened later.
    pub source: Option<Source>,
    /// Choice of the lumen and settings of each stage.
    pub settings: Settings,
    /// Bookmarks and how the window is set, read if it is there; pictures are beside it.
    pub session_file: Option<PathBuf>,
    /// File or DICOM folder of another case, which is shown beside the first.
    pub beside: Option<PathBuf>,
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
    pub context: egui::Context,
    canvas: Canvas,
    /// One, or two that are shown beside each other.
    cases: Vec<OpenCase>,
    pair: Pair,
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
    /// [`crate::session::SessionError::System`] if the system gives no thread.
    pub fn new(
        gpu: &mut Gpu,
        options: ViewerOptions,
        kind: (Detail, u32),
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
        let beside = options.beside.clone();
        let first = OpenCase::new(gpu, options, kind, Arc::new(wake))?;
        let (canvas, pair) = (Canvas::default(), Pair::default());
        let mut viewer = Self { context, canvas, cases: vec![first], pair };
        if let Some(path) = beside {
            viewer.open_beside(gpu, 0, open_request(path))?;
            viewer.pair = Pair::default();
        }
        Ok(viewer)
    }

    /// The case that keys and panels are of.
    pub fn active(&mut self) -> &mut OpenCase {
        &mut self.cases[self.pair.active]
    }

    /// Takes in the products that are there and the outcomes of tasks, and notes once their volume is
    /// known. Never waits.
    ///
    /// # Errors
    /// The device's. What is wrong with notes is a message.
    pub fn receive(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        for case in &mut self.cases {
            case.receive(gpu)?;
            if let Err(e) = case.apply_notes(gpu) {
                tracing::error!("{e}");
                // Slices and wall are as good as ever.
                case.model.message = Some(e.to_string());
            }
        }
        Ok(())
    }

    /// One frame: lays out the panels, carries out the commands, lets `dt` seconds pass, draws, and
    /// starts what is requested.
    ///
    /// * `commands`: of a script, before those of the panels.
    /// * `send`: submits the frame.
    ///
    /// # Errors
    /// The device's.
    pub fn frame(
        &mut self,
        gpu: &mut Gpu,
        input: egui::RawInput,
        mut commands: ActionQueue,
        dt: f64,
        target: &Target,
        send: impl FnOnce(&mut Gpu, &Frame<'_>) -> Result<(), VkError>,
    ) -> Result<FrameEnd, AppError> {
        // Panels.
        let (context, state) = (self.context.clone(), self.pair.state());
        let of_script = |i| match i == state.active {
            true => std::mem::take(&mut commands),
            false => ActionQueue::default(),
        };
        let queues: Vec<ActionQueue> = (0..self.cases.len()).map(of_script).collect();
        let cases = self.cases.iter_mut().zip(queues);
        let mut shown: Vec<_> = cases.map(|(case, queue)| case.shown(queue)).collect();
        let mut output = context.run_ui(input, |root| ui::window(root, &mut shown, state));
        let asked: Vec<_> = shown.into_iter().map(|case| (case.commands, case.sizes)).collect();
        self.canvas.collect(std::mem::take(&mut output.textures_delta));
        if asked.iter().any(|(commands, _)| commands.actions.contains(&Action::Stay)) {
            // The window stays open: everybody is asked anew.
            self.cases.iter_mut().for_each(OpenCase::forget_answer);
        }
        // Actions, and the pictures that show what became of them.
        for (case, (commands, sizes)) in self.cases.iter_mut().zip(&asked) {
            case.step(dt, &commands.actions, *sizes);
        }
        self.pair.keep_together(&mut self.cases);
        for (case, (commands, sizes)) in self.cases.iter_mut().zip(&asked) {
            case.draw(gpu, commands, *sizes)?;
        }
        // The window's own picture.
        let scale = output.pixels_per_point;
        let primitives = self.context.tessellate(output.shapes, scale);
        let pictures: Vec<_> = self.cases.iter().flat_map(OpenCase::pictures).collect();
        let pane = |id| match id {
            egui::TextureId::User(n) => pictures.get(n as usize).copied(),
            egui::TextureId::Managed(_) => None,
        };
        let wants_window =
            |a: &(ActionQueue, _)| a.0.requests.contains(&Request::Export(Export::Window));
        if asked.iter().any(wants_window) {
            let size = self.context.content_rect().size() * scale;
            let size = [size.x, size.y].map(|s| s.round().max(1.0) as u32);
            let picture = self.canvas.picture(gpu, size, (primitives.clone(), scale), pane)?;
            self.active().export_window(size, &picture);
        }
        self.canvas.draw(gpu, target, (primitives, scale), pane, send)?;
        // The work that was asked for, and the time of the next frame.
        let delay = output
            .viewport_output
            .get(&ViewportId::ROOT)
            .map_or(f64::INFINITY, |v| v.repaint_delay.as_secs_f64());
        let moving = self.cases.iter().any(OpenCase::wants_frame) || keys::moves(&self.context);
        let at_once = moving || asked.iter().any(|(commands, _)| !commands.is_empty());
        let quit = self.handle(gpu, asked.into_iter().map(|(commands, _)| commands.requests))?;
        Ok(FrameEnd {
            platform: output.platform_output,
            quit,
            again_in: if at_once { Some(0.0) } else { (delay < 1e6).then_some(delay) },
        })
    }

    /// Starts the work that was asked for, of each case; whether the window is to be closed.
    fn handle(
        &mut self,
        gpu: &mut Gpu,
        requests: impl Iterator<Item = Vec<Request>>,
    ) -> Result<bool, AppError> {
        let (mut quit, mut closed) = (false, None);
        for (i, requests) in requests.enumerate() {
            for request in self.cases[i].handle(gpu, requests)? {
                match request {
                    Request::Quit => quit |= !self.holds_back_quit(),
                    Request::Beside(opens) => self.open_beside(gpu, i, *opens)?,
                    Request::CloseCase => closed = Some(i),
                    Request::Activate(case) => self.pair.activate(case, &mut self.cases),
                    Request::FindInOther => self.pair.find_in_other(&mut self.cases),
                    Request::Link(is_linked) => self.pair.link(is_linked, &self.cases),
                    _ => {}
                }
            }
        }
        if let Some(i) = closed.filter(|_| self.cases.len() > 1) {
            self.cases.remove(i).leave_volume();
            self.pair = Pair::default();
        }
        Ok(quit)
    }

    /// Opens a case beside another one, in the place of the one that is there.
    fn open_beside(&mut self, gpu: &mut Gpu, of: usize, opens: Request) -> Result<(), AppError> {
        let beside = 1 - of;
        if self.cases.len() < 2 {
            let case = self.cases[of].beside(gpu)?;
            self.cases.push(case);
        }
        let organ = self.cases[of].organ().filter(|_| matches!(opens, Request::Open(_)));
        let is_opened = !self.cases[beside].handle(gpu, vec![opens])?.is_empty();
        if let Some(organ) = organ.filter(|_| is_opened) {
            self.cases[beside].take_lumen(gpu, &organ)?;
        }
        // Where it asks about its notes first, the question is seen.
        self.pair = Pair::of(beside);
        Ok(())
    }

    /// Whether closing the window waits for an answer, of any case: see [`OpenCase::holds_back`].
    pub fn holds_back_quit(&mut self) -> bool {
        let waiting = self.cases.iter_mut().position(|case| case.holds_back(&Request::Quit));
        waiting.into_iter().for_each(|i| self.pair.activate(i, &mut self.cases));
        waiting.is_some()
    }

    /// Puts everything on another device: the one before was lost.
    ///
    /// # Errors
    /// The device's.
    pub fn reopen(&mut self, gpu: &mut Gpu) -> Result<(), AppError> {
        self.canvas.forget_device();
        self.cases.iter_mut().try_for_each(|case| case.reopen(gpu))
    }

    /// Saves and keeps notes that were changed; those of the other cases too if one fails.
    ///
    /// # Errors
    /// As [`OpenCase::save_notes`].
    pub fn save_notes(&mut self) -> Result<(), AppError> {
        let saved = self.cases.iter_mut().map(OpenCase::save_notes);
        saved.fold(Ok(()), Result::and)
    }

    /// Saves and keeps all notes before the window is closed.
    ///
    /// # Errors
    /// As [`OpenCase::save_session`] and [`OpenCase::keep_notes`].
    pub fn close(&mut self) -> Result<(), AppError> {
        let saved =
            self.cases.iter_mut().map(|case| case.save_session().and(case.keep_notes(true)));
        saved.fold(Ok(()), Result::and)
    }

    /// Whether notes wait to be saved or kept.
    pub fn has_unsaved_notes(&self) -> bool {
        self.cases.iter().any(OpenCase::has_unsaved_notes)
    }

    /// Whether something is being computed, or will be when it is waited for.
    pub fn is_computing(&self) -> bool {
        self.cases.iter().any(OpenCase::is_computing)
    }

    /// Whether a flight is being saved.
    pub fn is_saving(&self) -> bool {
        self.cases.iter().any(OpenCase::is_saving)
    }

    /// Whether the wall of the first case is drawn, and whether all of the case is computed.
    pub fn progress(&self) -> [bool; 2] {
        let first = &self.cases[0];
        [first.has_pictures(), first.model.is_complete]
    }
}
