//! Frames in order, several in flight.

use std::collections::VecDeque;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};
use std::sync::mpsc::{Receiver, channel};

use super::RenderError;
use super::renderer::{IN_FLIGHT, Renderer, Ticket};
use super::scene::{FrameStats, Scene, Shot};
use crate::geometry::Camera;
use crate::lod::VisibleWall;
use crate::vk::Gpu;

/// Frames whose visible wall is found together, on a thread of its own, while those before are drawn.
const AHEAD: usize = 8;

/// Visible wall of some shots, by their cameras; or why finding it panicked.
type SeenShots = std::thread::Result<Vec<Vec<VisibleWall>>>;

/// Frames of a list of shots, drawn as they are asked for while the device draws the next ones. Each
/// depends on its shot alone.
pub struct FrameSequence {
    scene: Scene,
    shots: Vec<Shot>,
    /// Visible wall of the next shots, by their cameras.
    seen: VecDeque<Vec<VisibleWall>>,
    /// Visible wall of the shots after them, once it is found.
    coming: Option<Receiver<SeenShots>>,
    /// Shots submitted so far.
    begun: usize,
    in_flight: VecDeque<Ticket>,
}

impl FrameSequence {
    /// Creates a sequence; nothing is drawn yet.
    pub fn new(scene: Scene, shots: Vec<Shot>) -> Self {
        let in_flight = VecDeque::with_capacity(IN_FLIGHT);
        let seen = VecDeque::new();
        Self { scene, shots, seen, coming: None, begun: 0, in_flight }
    }

    /// Leaves the first frames out, before any is drawn.
    pub fn skip(&mut self, frames: usize) {
        self.begun = frames.min(self.shots.len());
    }

    /// Returns the number of frames in all.
    pub fn count(&self) -> usize {
        self.shots.len()
    }

    /// Returns the next frame, RGB as of [`Renderer::fetch`]; `None` after the last. The renderer
    /// must be the same in each call and have no other frame in flight.
    ///
    /// # Errors
    /// The device's. There are no more frames then, and none in flight.
    pub fn next_frame(
        &mut self,
        renderer: &mut Renderer,
        gpu: &mut Gpu,
    ) -> Result<Option<(Vec<u8>, FrameStats)>, RenderError> {
        let next = self.begin_and_fetch(renderer, gpu);
        if next.is_err() {
            self.finish(renderer, gpu);
        }
        next
    }

    fn begin_and_fetch(
        &mut self,
        renderer: &mut Renderer,
        gpu: &mut Gpu,
    ) -> Result<Option<(Vec<u8>, FrameStats)>, RenderError> {
        while self.in_flight.len() < IN_FLIGHT && self.begun < self.shots.len() {
            if self.seen.is_empty() {
                self.take_seen(renderer);
            }
            let (shot, seen) = (self.shots[self.begun], self.seen.pop_front());
            let ticket = renderer.begin_seen_frame(gpu, &self.scene, &shot, seen.as_deref())?;
            self.in_flight.push_back(ticket);
            self.begun += 1;
        }
        let Some(ticket) = self.in_flight.pop_front() else { return Ok(None) };
        let stats = ticket.stats;
        Ok(Some((renderer.fetch(gpu, ticket)?, stats)))
    }

    /// Waits for the visible wall of the next shots, and asks for the visible wall of the shots after
    /// them.
    fn take_seen(&mut self, renderer: &Renderer) {
        let coming = self.coming.take().or_else(|| self.ask(renderer));
        let Some(coming) = coming else { return };
        match coming.recv().expect("an answer or a panic") {
            Ok(seen) => self.seen.extend(seen),
            Err(panic) => resume_unwind(panic),
        }
        self.coming = self.ask(renderer);
    }

    /// Has the visible wall of some shots found on another thread; `None` after the last shot, and of
    /// a wall that is drawn whole.
    fn ask(&mut self, renderer: &Renderer) -> Option<Receiver<SeenShots>> {
        let wall = renderer.drawn_wall(&self.scene)?;
        let first = self.begun + self.seen.len();
        let next = self.shots.iter().skip(first).take(AHEAD);
        let cameras: Vec<Vec<Camera>> = next.map(|shot| renderer.cameras(shot)).collect();
        if cameras.is_empty() {
            return None;
        }
        let (answer, coming) = channel();
        let look = move || {
            let of = |cameras: &Vec<Camera>| cameras.iter().map(|c| wall.visible(c)).collect();
            let seen = catch_unwind(AssertUnwindSafe(|| cameras.iter().map(of).collect()));
            // Nobody listens any more where the sequence ended early.
            let _ = answer.send(seen);
        };
        // A thread of its own: the session's pool may be busy for long with other stages.
        // Without one the renderer finds the visible wall of each frame as it draws.
        let thread = std::thread::Builder::new().name("ahead".into()).spawn(look);
        thread.is_ok().then_some(coming)
    }

    /// Ends the sequence, also before its last frame: the renderer then has no frame in flight.
    pub fn finish(&mut self, renderer: &mut Renderer, gpu: &mut Gpu) {
        self.begun = self.shots.len();
        for ticket in self.in_flight.drain(..) {
            // Frames that nobody wants; their slots are free once the device is done with them.
            let _ = renderer.fetch(gpu, ticket);
        }
    }
}
