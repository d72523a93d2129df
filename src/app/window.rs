//! The window itself: events in, frames out. Everything else is in [`Viewer`].
//!
//! One thread: winit, panels, and drawing of panes that changed. What takes long is done by the
//! session's threads and by that of the levels of detail; they wake the window.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::{Duration, Instant};

use winit::application::ApplicationHandler;
use winit::dpi::{LogicalSize, PhysicalSize};
use winit::event::{StartCause, WindowEvent};
use winit::event_loop::{ActiveEventLoop, ControlFlow, EventLoop, EventLoopProxy};
use winit::window::{Window, WindowId};

use super::action::ActionQueue;
use super::canvas::Target;
use super::error::AppError;
use super::panes::Detail;
use super::viewer::{FrameEnd, Viewer, ViewerOptions};
use crate::vk::{Choice, Gpu, OpenOptions, VkError, WindowHandles};

/// Options of the window.
#[derive(Clone, Debug)]
pub struct WindowOptions {
    /// Columns and rows, points.
    pub size: [u32; 2],
    /// The device that draws.
    pub device: Choice,
    /// Volume and settings to open.
    pub viewer: ViewerOptions,
}

/// Shortest time between frames of a flight on software Vulkan; a card waits for the screen.
const FRAME: Duration = Duration::from_millis(16);
/// Time between two looks at the progress line.
const PROGRESS: Duration = Duration::from_millis(250);
/// Time after which bookmarks that could not be saved are tried again.
const SAVE_AGAIN: Duration = Duration::from_secs(1);
/// Longest step of the flight's clock: a window that was held up does not jump. Frames of a slow
/// machine take less, so that the speed that is shown is that of the wall clock.
const MAX_STEP_S: f64 = 0.5;

/// Opens a window and stays until it is closed.
///
/// # Errors
/// [`AppError::NoDisplay`]; what the device or a file fails with. Bookmarks are saved by then.
pub fn open(options: WindowOptions) -> Result<(), AppError> {
    // What is wrong with it is an error of its own, with or without a display.
    options.viewer.notes()?;
    // The library's own text holds paths of the machine it was built on.
    let no_display = |_| AppError::NoDisplay("neither X11 nor Wayland answers".into());
    let events = EventLoop::<()>::with_user_event().build().map_err(no_display)?;
    let proxy = events.create_proxy();
    *locked(&OPEN) = Some((proxy.clone(), false));
    let begun = Instant::now();
    let mut app = App { options, proxy, running: None, failed: None, begun };
    let ran = events.run_app(&mut app);
    if let Some(running) = app.running.as_mut().filter(|_| app.failed.is_none()) {
        let saved = running.viewer.close();
        running.report_save(saved);
    }
    // The window goes before the display connection does.
    app.running = None;
    *locked(&OPEN) = None;
    match (app.failed, ran) {
        (Some(e), _) => Err(e),
        (None, Err(_)) => Err(AppError::NoDisplay("the connection to the display broke".into())),
        (None, Ok(())) => Ok(()),
    }
}

/// The window that is open, and whether it was asked to close.
static OPEN: Mutex<Option<(EventLoopProxy<()>, bool)>> = Mutex::new(None);

/// Asks the window that is open to save its notes and close, as a signal does. False if there is no
/// window, or it was asked before: nobody need wait for it then.
pub fn close_window() -> bool {
    match &mut *locked(&OPEN) {
        Some((proxy, asked)) if !*asked => {
            *asked = true;
            proxy.send_event(()).is_ok()
        }
        _ => false,
    }
}

/// A flag and a proxy are whole whatever panicked.
fn locked<T>(mutex: &Mutex<T>) -> MutexGuard<'_, T> {
    mutex.lock().unwrap_or_else(PoisonError::into_inner)
}

struct App {
    options: WindowOptions,
    proxy: EventLoopProxy<()>,
    running: Option<Running>,
    failed: Option<AppError>,
    begun: Instant,
}

/// Step of the flight's clock, s.
///
/// * `frame`: time since the last frame.
/// * `is_moving`: whether the flight was moving in that frame. A flight that begins now has flown for
///   no time, however long the window was idle.
fn clock_step_s(frame: Duration, is_moving: bool) -> f64 {
    if is_moving { frame.as_secs_f64().min(MAX_STEP_S) } else { 0.0 }
}

/// An open window. Fields are dropped in order: what is on the device before the device.
struct Running {
    viewer: Viewer,
    egui: egui_winit::State,
    gpu: Gpu,
    window: Arc<Window>,
    /// Title that the window has.
    title: String,
    last: Instant,
    /// Whether the last frame wanted another one at once.
    is_moving: bool,
    /// Time to draw again, if nothing happens before.
    again_at: Option<Instant>,
    /// Milestones reported so far: first frame, first picture, everything.
    reported: [bool; 3],
    /// Number of times that a lost device was opened again.
    reopened: u32,
    times: FrameTimes,
}

/// Durations of frames, from the first look at the products to the end of the present call; of
/// software Vulkan, where a frame follows at once, to the end of the submission: that frame then
/// holds the present call of this one.
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

    /// Logs what there is.
    fn report(&mut self) {
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
        self.times.report();
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

/// Presents the submitted image, if there is one. The system is told just before: Wayland gives no
/// further redraw until an image comes that was announced.
fn present(gpu: &mut Gpu, window: &Window) -> Result<(), VkError> {
    if gpu.awaits_present() {
        window.pre_present_notify();
        gpu.present()?;
    }
    Ok(())
}

/// Samples a pixel of the drawn panes.
fn samples_of(gpu: &Gpu) -> u32 {
    if gpu.info().is_real() { gpu.info().max_samples.min(4) } else { 1 }
}

impl App {
    fn start(&mut self, events: &ActiveEventLoop) -> Result<(), AppError> {
        if self.running.is_some() {
            return Ok(());
        }
        let [width, height] = self.options.size;
        let title = "intima".to_owned();
        let attributes = Window::default_attributes()
            .with_title(&title)
            .with_inner_size(LogicalSize::new(width, height))
            .with_min_inner_size(LogicalSize::new(320, 240));
        let window = events
            .create_window(attributes)
            .map_err(|_| AppError::NoDisplay("the display gives no window".into()))?;
        let window = Arc::new(window);
        let mut gpu = open_gpu(self.options.device, &window)?;
        let proxy = self.proxy.clone();
        // A window that is gone needs no waking.
        let wake = move || {
            let _ = proxy.send_event(());
        };
        let kind = (Detail::Live, samples_of(&gpu));
        let viewer = Viewer::new(&mut gpu, self.options.viewer.clone(), kind, wake)?;
        let egui = egui_winit::State::new(
            viewer.context.clone(),
            egui::ViewportId::ROOT,
            &*window,
            Some(window.scale_factor() as f32),
            window.theme(),
            Some(gpu.info().max_image_side as usize),
        );
        window.request_redraw();
        self.running = Some(Running {
            viewer,
            egui,
            gpu,
            window,
            title,
            last: Instant::now(),
            is_moving: false,
            again_at: None,
            reported: [false; 3],
            reopened: 0,
            times: FrameTimes::default(),
        });
        Ok(())
    }

    /// Draws a frame; false where the window is to be closed.
    fn frame(&mut self) -> Result<bool, AppError> {
        let Some(running) = &mut self.running else { return Ok(true) };
        match running.frame(self.begun) {
            Ok(quit) => Ok(!quit),
            Err(e) if e.is_device_lost() && running.reopened < MAX_REOPENED => {
                tracing::warn!("{e}; the device is opened again");
                running.reopen(self.options.device)?;
                Ok(true)
            }
            Err(e) => Err(e),
        }
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

    fn user_event(&mut self, events: &ActiveEventLoop, (): ()) {
        if locked(&OPEN).as_ref().is_some_and(|(_, asked)| *asked) {
            events.exit();
        }
        self.running.iter().for_each(|r| r.window.request_redraw());
    }

    fn window_event(&mut self, events: &ActiveEventLoop, _: WindowId, event: WindowEvent) {
        let Some(running) = &mut self.running else { return };
        let response = running.egui.on_window_event(&running.window, &event);
        match event {
            // It asks to be drawn again for having been drawn.
            WindowEvent::RedrawRequested => self.redraw(events),
            WindowEvent::CloseRequested if running.viewer.holds_back_quit() => {
                running.window.request_redraw();
            }
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
    /// Draws a frame with what there is; whether the window is to be closed.
    fn frame(&mut self, begun: Instant) -> Result<bool, AppError> {
        let now = Instant::now();
        self.viewer.receive(&mut self.gpu)?;
        let received = now.elapsed();
        let PhysicalSize { width, height } = self.window.inner_size();
        let Some(image) = self.gpu.acquire([width, height])? else {
            // Nothing to draw to: a window without pixels waits to be resized.
            present(&mut self.gpu, &self.window)?;
            let hidden = width == 0 || height == 0;
            self.again_at = (!hidden).then(|| now + PROGRESS);
            return Ok(false);
        };
        let format = self.gpu.window_format().expect("an image has a format");
        let input = self.egui.take_egui_input(&self.window);
        let dt = clock_step_s(now.duration_since(self.last), self.is_moving);
        self.last = now;
        let target = Target { image, format };
        let is_computing = self.viewer.is_computing();
        let (commands, acquired) = (ActionQueue::default(), now.elapsed());
        let (gpu, window) = (&mut self.gpu, &self.window);
        let mut prepared = acquired;
        let end = self.viewer.frame(gpu, input, commands, dt, &target, |gpu, frame| {
            prepared = now.elapsed();
            present(gpu, window)?;
            gpu.submit_to_window(frame)
        })?;
        let FrameEnd { platform, quit, again_in } = end;
        self.is_moving = again_in == Some(0.0);
        // Software Vulkan draws on the cores of the CPU and returns from the present call when it
        // has: a frame that follows at once is prepared meanwhile.
        if gpu.info().is_real() || again_in != Some(0.0) {
            present(gpu, window)?;
        }
        self.egui.handle_platform_output(&self.window, platform);
        self.name_window();
        let saved = self.viewer.save_notes();
        self.report_save(saved);
        self.report_progress(begun);
        let drawn = now.elapsed();
        if drawn > SLOW_FRAME {
            tracing::debug!(
                "slow frame: products {received:.1?}, image {:.1?}, panes {:.1?}, drawn {:.1?}",
                acquired - received,
                prepared - acquired,
                drawn - prepared
            );
        }
        self.times.note(is_computing, drawn);
        let is_at_work = self.viewer.is_computing() || self.viewer.is_saving();
        let computing = is_at_work.then_some(PROGRESS);
        let least = if self.gpu.info().is_real() { Duration::ZERO } else { FRAME };
        let wanted = again_in.map(|s| Duration::from_secs_f64(s.min(3600.0)).max(least));
        let again = self.viewer.has_unsaved_notes().then_some(SAVE_AGAIN);
        let next = wanted.into_iter().chain(computing).chain(again).min();
        self.again_at = next.map(|after| now + after);
        Ok(quit)
    }

    /// Names what is open in the window's title.
    fn name_window(&mut self) {
        let title = self.viewer.title();
        if self.title != title {
            self.window.set_title(&title);
            self.title = title;
        }
    }

    /// Opens the device again after it was lost; what is shown and noted stays.
    fn reopen(&mut self, device: Choice) -> Result<(), AppError> {
        self.reopened += 1;
        // A window has one surface: that of the lost device goes first.
        self.gpu.close_window();
        let mut gpu = open_gpu(device, &self.window)?;
        self.viewer.reopen(&mut gpu)?;
        self.gpu = gpu;
        self.again_at = Some(Instant::now());
        Ok(())
    }

    /// Shows why bookmarks are not saved; they are tried again.
    fn report_save(&mut self, saved: Result<(), AppError>) {
        let Err(e) = saved else { return };
        let message = format!("bookmarks are not saved: {e}");
        let shown = &mut self.viewer.active().model.message;
        if shown.as_ref() != Some(&message) {
            tracing::error!("{message}");
        }
        *shown = Some(message);
    }

    /// Logs how far it has come, once each.
    fn report_progress(&mut self, begun: Instant) {
        let [has_pictures, is_complete] = self.viewer.progress();
        let reached = [true, has_pictures, is_complete];
        let names = ["first frame", "first picture of the wall", "everything is computed"];
        for ((reported, reached), name) in self.reported.iter_mut().zip(reached).zip(names) {
            if reached && !*reported {
                *reported = true;
                tracing::info!("{name} after {:.0} ms", begun.elapsed().as_secs_f64() * 1e3);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// 20 mm/s were shown while 5.4 were flown: frames of 0.3 s moved the clock by 0.1 s.
    #[test]
    fn frames_of_a_slow_machine_fly_as_fast_as_shown_and_a_window_held_up_does_not_jump() {
        for ms in [4, 33, 300, 500] {
            let frame = Duration::from_millis(ms);
            assert_eq!(clock_step_s(frame, true), frame.as_secs_f64());
        }
        assert!(clock_step_s(Duration::from_secs(60), true) <= 0.5);
        assert_eq!(clock_step_s(Duration::from_secs(60), false), 0.0);
    }
}
