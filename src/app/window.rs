//! The window itself: events in, frames out. Everything else is in [`Stage`].
//!
//! One thread: winit, panels, and drawing of panes that changed. What takes long is done by the
//! study's thread and by that of the levels of detail.

use std::path::PathBuf;
use std::sync::Arc;
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::dpi::{LogicalSize, PhysicalSize};
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Window, WindowId};

use super::action::Commands;
use super::error::AppError;
use super::panes::Detail;
use super::session_file::SessionFile;
use super::stage::{After, Files, Stage, Target};
use super::study::{Case, Change, News, Study};
use crate::formats::shown;
use crate::lod::Tolerance;
use crate::vk::{Choice, Gpu, OpenOptions, WindowHandles};

/// How to open the window.
#[derive(Clone, Debug)]
pub struct WindowOptions {
    /// Columns and rows, points.
    pub size: [u32; 2],
    /// Notes to begin with, and where bookmarks are saved.
    pub session_file: Option<PathBuf>,
    /// Folder of what is exported.
    pub export: PathBuf,
    /// The device that draws.
    pub device: Choice,
    /// Of levels of detail.
    pub tolerance: Tolerance,
    /// Speed the session's flight is planned with, mm/s.
    pub planned_mm_s: f64,
}

/// Shortest time between frames of a flight: not every driver waits for the screen.
const FRAME: Duration = Duration::from_millis(16);
/// How often the progress line is looked at.
const PROGRESS: Duration = Duration::from_millis(250);
/// When bookmarks that could not be saved are tried again.
const SAVE_AGAIN: Duration = Duration::from_secs(1);
/// Longest step of the flight's clock: a window that was held up does not jump.
const MAX_STEP_S: f64 = 0.1;

/// Opens a window on a case and stays until it is closed.
///
/// # Errors
/// [`AppError::NoDisplay`]; what the device or a file fails with. Bookmarks are saved by then.
pub fn open(case: Case, options: WindowOptions) -> Result<(), AppError> {
    let notes = options.session_file.as_deref().filter(|p| p.exists());
    let notes = notes.map(SessionFile::read).transpose()?;
    // The library's own text holds paths of the machine it was built on.
    let no_display = |_| AppError::NoDisplay("neither X11 nor Wayland answers".into());
    let events = EventLoop::<()>::with_user_event().build().map_err(no_display)?;
    let proxy = events.create_proxy();
    let begun = Instant::now();
    let mut app = App { case, options, notes, proxy, running: None, failed: None, begun };
    let ran = events.run_app(&mut app);
    // The window goes before the display connection does.
    app.running = None;
    match (app.failed, ran) {
        (Some(e), _) => Err(e),
        (None, Err(_)) => Err(AppError::NoDisplay("the connection to the display broke".into())),
        (None, Ok(())) => Ok(()),
    }
}

struct App {
    case: Case,
    options: WindowOptions,
    notes: Option<SessionFile>,
    proxy: EventLoopProxy<()>,
    running: Option<Running>,
    failed: Option<AppError>,
    begun: Instant,
}

/// An open window. Fields are dropped in order: what is on the device before the device.
struct Running {
    stage: Stage,
    /// Of what is open, if anything is.
    study: Option<Study>,
    egui: egui_winit::State,
    gpu: Gpu,
    window: Arc<Window>,
    last: Instant,
    /// When to draw again, if nothing happens before.
    again_at: Option<Instant>,
    has_notes: bool,
    /// What was reported of how far it has come: first frame, first picture, everything.
    told: [bool; 3],
    /// How often a lost device was opened again.
    reopened: u32,
    times: FrameTimes,
}

/// How long frames took, from the first look at the news to the present call's end.
#[derive(Default)]
struct FrameTimes {
    /// Milliseconds, while something was computed and after.
    ms: [Vec<f32>; 2],
}

impl FrameTimes {
    /// Frames that are kept: a day at twenty a second.
    const MAX_KEPT: usize = 2_000_000;

    fn note(&mut self, is_computing: bool, took: Duration) {
        let own = &mut self.ms[usize::from(!is_computing)];
        if own.len() < Self::MAX_KEPT {
            own.push(took.as_secs_f32() * 1e3);
        }
    }

    /// Reports what there is.
    fn tell(&mut self) {
        for (ms, when) in self.ms.iter_mut().zip(["while computing", "after that"]) {
            ms.sort_by(f32::total_cmp);
            let at = |share: f32| ms[((ms.len() - 1) as f32 * share).round() as usize];
            if !ms.is_empty() {
                let (n, p50, p99, most) = (ms.len(), at(0.5), at(0.99), at(1.0));
                tracing::info!(
                    "{n} frames {when}: {p50:.1} ms (median), {p99:.1} ms (99 %), {most:.1} ms (longest)"
                );
            }
        }
    }
}

impl Drop for Running {
    fn drop(&mut self) {
        self.times.tell();
    }
}

/// Slower frames are reported with what they waited for.
const SLOW_FRAME: Duration = Duration::from_millis(100);

/// A device that is lost more often is given up.
const MAX_REOPENED: u32 = 5;

fn open_gpu(device: Choice, window: &Arc<Window>) -> Result<Gpu, AppError> {
    let handles: Arc<dyn WindowHandles> = Arc::clone(window) as _;
    Ok(Gpu::open_for_window(device, OpenOptions::default(), handles)?)
}

/// Samples a pixel of the drawn panes.
fn samples_of(gpu: &Gpu) -> u32 {
    if gpu.info().is_real() { gpu.info().max_samples.min(4) } else { 1 }
}

impl App {
    /// Has the window drawn again, from any thread. One that is gone needs no waking.
    fn waking(&self) -> impl Fn() + Send + Sync + 'static {
        let proxy = self.proxy.clone();
        move || {
            let _ = proxy.send_event(());
        }
    }

    fn start(&mut self, events: &ActiveEventLoop) -> Result<(), AppError> {
        if self.running.is_some() {
            return Ok(());
        }
        let [width, height] = self.options.size;
        let attributes = Window::default_attributes()
            .with_title("intima")
            .with_inner_size(LogicalSize::new(width, height))
            .with_min_inner_size(LogicalSize::new(320, 240));
        let window = events
            .create_window(attributes)
            .map_err(|_| AppError::NoDisplay("the display gives no window".into()))?;
        let window = Arc::new(window);
        let mut gpu = open_gpu(self.options.device, &window)?;
        let samples = samples_of(&gpu);
        let options = &self.options;
        let files = Files { session: options.session_file.clone(), export: options.export.clone() };
        let (speed, tolerance) = (options.planned_mm_s, options.tolerance);
        let stage = Stage::new(&mut gpu, samples, speed, tolerance, files, self.waking())?;
        let egui = egui_winit::State::new(
            stage.context.clone(),
            egui::ViewportId::ROOT,
            &*window,
            Some(window.scale_factor() as f32),
            window.theme(),
            Some(gpu.info().max_image_side as usize),
        );
        let study = self.case.begin(self.waking())?;
        window.request_redraw();
        self.running = Some(Running {
            stage,
            study,
            egui,
            gpu,
            window,
            last: Instant::now(),
            again_at: None,
            has_notes: false,
            told: [false; 3],
            reopened: 0,
            times: FrameTimes::default(),
        });
        Ok(())
    }

    /// Draws a frame and does what it asks for; false where the window is to be closed.
    fn frame(&mut self) -> Result<bool, AppError> {
        let waking = self.waking();
        let Some(running) = &mut self.running else { return Ok(true) };
        let after = match running.frame(&self.options, self.notes.as_ref(), self.begun) {
            Ok(after) => after,
            Err(e) if e.is_device_lost() && running.reopened < MAX_REOPENED => {
                tracing::warn!("{e}; the device is opened again");
                running.reopen(self.options.device)?;
                return Ok(true);
            }
            Err(e) => return Err(e),
        };
        if let Some(change) = after.change {
            if let Change::Open(_) = change {
                // Notes are of one volume.
                self.notes = None;
                self.options.session_file = None;
            }
            self.case.change(change, running.stage.model.products.volume.clone());
            // What is computed for nobody ends first.
            running.study = None;
            running.stage.begin_anew(&mut running.gpu)?;
            running.study = self.case.begin(waking)?;
            running.again_at = Some(Instant::now());
        }
        Ok(!after.quit)
    }

    fn redraw(&mut self, events: &ActiveEventLoop) {
        match self.frame() {
            Ok(true) => {}
            Ok(false) => events.exit(),
            Err(e) => {
                self.failed = Some(e);
                events.exit();
            }
        }
    }
}

impl ApplicationHandler for App {
    fn resumed(&mut self, events: &ActiveEventLoop) {
        if let Err(e) = self.start(events) {
            self.failed = Some(e);
            events.exit();
        }
    }

    fn new_events(&mut self, _: &ActiveEventLoop, cause: StartCause) {
        if let (StartCause::ResumeTimeReached { .. }, Some(r)) = (cause, &self.running) {
            r.window.request_redraw();
        }
    }

    fn user_event(&mut self, _: &ActiveEventLoop, (): ()) {
        self.running.iter().for_each(|r| r.window.request_redraw());
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        let response = running.egui.on_window_event(&running.window, &event);
        match event {
            // It asks to be drawn again for having been drawn.
            WindowEvent::RedrawRequested => self.redraw(events),
            WindowEvent::CloseRequested | WindowEvent::Destroyed => events.exit(),
            WindowEvent::Resized(_) | WindowEvent::ScaleFactorChanged { .. } => {
                running.window.request_redraw();
            }
            _ if response.repaint => running.window.request_redraw(),
            _ => {}
        }
    }

    fn about_to_wait(&mut self, events: &ActiveEventLoop) {
        let at = self.running.as_ref().and_then(|r| r.again_at);
        events.set_control_flow(at.map_or(ControlFlow::Wait, ControlFlow::WaitUntil));
    }
}

impl Running {
    /// Draws a frame; what it asks for is left to the caller where it concerns more than the window.
    fn frame(
        &mut self,
        options: &WindowOptions,
        notes: Option<&SessionFile>,
        begun: Instant,
    ) -> Result<After, AppError> {
        let now = Instant::now();
        self.take_news(options, notes)?;
        let news = now.elapsed();
        let PhysicalSize { width, height } = self.window.inner_size();
        let Some(image) = self.gpu.acquire([width, height])? else {
            // Nothing to draw to: a window without pixels waits to be resized.
            let hidden = width == 0 || height == 0;
            self.again_at = (!hidden).then(|| now + PROGRESS);
            return Ok(After::default());
        };
        let format = self.gpu.window_format().expect("an image has a format");
        let input = self.egui.take_egui_input(&self.window);
        let dt = now.duration_since(self.last).as_secs_f64().min(MAX_STEP_S);
        self.last = now;
        let clock = (dt, Detail::Live);
        let study = self.study.as_ref();
        let acquired = now.elapsed();
        let (mut output, after) =
            self.stage.prepare(&mut self.gpu, input, Commands::default(), study, clock)?;
        let prepared = now.elapsed();
        let platform = std::mem::take(&mut output.platform_output);
        self.egui.handle_platform_output(&self.window, platform);
        let target = Target { image, format };
        self.window.pre_present_notify();
        self.stage.draw(&mut self.gpu, &target, output, |gpu, frame| gpu.present(frame))?;
        if let Some(study) = &mut self.study {
            if after.cancel {
                study.cancel();
            }
            if let Some(route) = after.route {
                study.fly_along(route)?;
            }
            if let Some(folder) = after.export_flight.clone() {
                study.export_flight(folder)?;
            }
        }
        self.save(options);
        self.tell(begun);
        if now.elapsed() > SLOW_FRAME {
            let drawn = now.elapsed();
            tracing::debug!(
                "slow frame: news {news:.1?}, image {:.1?}, panes {:.1?}, drawn {:.1?}",
                acquired - news,
                prepared - acquired,
                drawn - prepared
            );
        }
        let is_computing = self.study.is_some() && !self.stage.model.is_complete;
        self.times.note(is_computing, now.elapsed());
        let computing = is_computing.then_some(PROGRESS);
        let wanted = after.again_in.map(|s| Duration::from_secs_f64(s.min(3600.0)).max(FRAME));
        let unsaved = options.session_file.is_some() && self.stage.model.has_unsaved_notes();
        let again = unsaved.then_some(SAVE_AGAIN);
        let next = wanted.into_iter().chain(computing).chain(again).min();
        self.again_at = next.map(|after| now + after);
        Ok(after)
    }

    /// Opens the device again after it was lost; what is shown and noted stays.
    fn reopen(&mut self, device: Choice) -> Result<(), AppError> {
        self.reopened += 1;
        // A window has one surface: that of the lost device goes first.
        self.gpu.close_window();
        let mut gpu = open_gpu(device, &self.window)?;
        self.stage.reopen(&mut gpu)?;
        self.gpu = gpu;
        self.again_at = Some(Instant::now());
        Ok(())
    }

    fn take_news(
        &mut self,
        options: &WindowOptions,
        notes: Option<&SessionFile>,
    ) -> Result<(), AppError> {
        while let Some(news) = self.study.as_ref().and_then(Study::poll) {
            if let News::Failed(e) = &news {
                tracing::error!("{e}");
            }
            self.stage.learn(&mut self.gpu, news)?;
        }
        if let (Some(notes), false, true) =
            (notes, self.has_notes, self.stage.model.identity.is_some())
        {
            self.has_notes = true;
            if let Err(what) = notes.apply(&mut self.stage.model) {
                let file = options.session_file.clone().unwrap_or_default();
                tracing::error!("{}: {what}", shown(&file));
                self.stage.model.failure = Some(what);
            }
        }
        Ok(())
    }

    /// Saves bookmarks that were made; what cannot be saved now is tried again.
    fn save(&mut self, options: &WindowOptions) {
        let model = &mut self.stage.model;
        let Some(path) = options.session_file.as_ref().filter(|_| model.has_unsaved_notes()) else {
            return;
        };
        let Some(file) = SessionFile::of(model) else { return };
        match file.write(path) {
            Ok(()) => model.notes_saved(),
            Err(e) => {
                let said = format!("bookmarks are not saved: {e}");
                if model.message.as_ref() != Some(&said) {
                    tracing::error!("{said}");
                }
                model.message = Some(said);
            }
        }
    }

    /// Reports how far it has come, once each.
    fn tell(&mut self, begun: Instant) {
        let reached = [true, self.stage.has_pictures(), self.stage.model.is_complete];
        let names = ["first frame", "first picture of the wall", "everything is computed"];
        for ((told, reached), name) in self.told.iter_mut().zip(reached).zip(names) {
            if reached && !*told {
                *told = true;
                tracing::info!("{name} after {:.0} ms", begun.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
}
