//! Frames in order, several in flight; with level of detail, each from a settled cut.

use std::collections::VecDeque;

use super::RenderError;
use super::renderer::{IN_FLIGHT, Renderer, Ticket};
use super::scene::{FrameStats, Scene, SceneWall, Shot};
use crate::geometry::Camera;
use crate::lod::Worker;
use crate::vk::Gpu;

/// Frames of a list of shots, drawn as they are asked for while the device draws the next ones.
///
/// With a worker each shows the settled cut of its own camera; the worker refines for the next
/// frame while this one is drawn. Frames depend on cameras alone, not on timing or number of
/// threads; their pages do depend on the frames before.
pub struct FrameSequence {
    scene: Scene,
    shots: Vec<Shot>,
    worker: Option<Worker>,
    /// Shots submitted so far.
    begun: usize,
    in_flight: VecDeque<Ticket>,
}

impl FrameSequence {
    /// Creates a sequence; nothing is drawn yet. `worker` is that of the scene's pages; without it,
    /// pages show the steps applied to them before.
    ///
    /// # Panics
    /// If there is a worker and the scene's wall is not in pages.
    pub fn new(scene: Scene, shots: Vec<Shot>, worker: Option<Worker>) -> Self {
        assert!(
            worker.is_none() || matches!(scene.wall, SceneWall::Pages { .. }),
            "a worker refines a wall in pages"
        );
        Self { scene, shots, worker, begun: 0, in_flight: VecDeque::with_capacity(IN_FLIGHT) }
    }

    /// Returns the number of frames in all.
    pub fn count(&self) -> usize {
        self.shots.len()
    }

    /// Returns the next frame, RGB as of [`Renderer::fetch`]; `None` after the last. The renderer
    /// must be the same in each call and have no other frame in flight.
    ///
    /// # Errors
    /// The device's; [`RenderError::Detail`] if the worker fails. There are no more frames then,
    /// and none in flight.
    pub fn next_frame(
        &mut self,
        renderer: &mut Renderer,
        gpu: &mut Gpu,
    ) -> Result<Option<(Vec<u8>, FrameStats)>, RenderError> {
        let next = self.begin_and_fetch(renderer, gpu);
        if next.is_err() {
            self.give_up(renderer, gpu);
        }
        next
    }

    fn begin_and_fetch(
        &mut self,
        renderer: &mut Renderer,
        gpu: &mut Gpu,
    ) -> Result<Option<(Vec<u8>, FrameStats)>, RenderError> {
        while self.in_flight.len() < IN_FLIGHT && self.begun < self.shots.len() {
            let shot = self.shots[self.begun];
            let cameras = renderer.cameras(&shot);
            let last = cameras.len().max(1) - 1;
            let mut stats = FrameStats::default();
            for (eye, camera) in cameras.iter().enumerate() {
                let next = cameras.get(eye + 1).copied();
                self.settle(renderer, *camera, next)?;
                if eye < last {
                    stats = stats.plus(renderer.draw_eye(gpu, &self.scene, &shot, eye)?);
                }
            }
            let mut ticket = renderer.begin_frame_from(gpu, &self.scene, &shot, last)?;
            ticket.stats = ticket.stats.plus(stats);
            self.in_flight.push_back(ticket);
            self.begun += 1;
        }
        let Some(ticket) = self.in_flight.pop_front() else { return Ok(None) };
        let stats = ticket.stats;
        Ok(Some((renderer.fetch(gpu, ticket)?, stats)))
    }

    /// Brings the pages to the settled cut of a camera and asks for the next one's: that of the
    /// same frame, or the first of the next frame.
    fn settle(
        &mut self,
        renderer: &mut Renderer,
        camera: Camera,
        next: Option<Camera>,
    ) -> Result<(), RenderError> {
        let after = || renderer.cameras(self.shots.get(self.begun + 1)?).first().copied();
        let next = next.or_else(after);
        let Some(worker) = &mut self.worker else { return Ok(()) };
        // Asked already while the eye before was drawn; asked now for the first.
        if worker.outstanding() == 0 {
            worker.request(camera);
        }
        // The answer is taken before the next question, so that at most one is on its way.
        self.apply_answers(renderer)?;
        if let (Some(worker), Some(camera)) = (&mut self.worker, next) {
            worker.request(camera);
        }
        Ok(())
    }

    fn apply_answers(&mut self, renderer: &mut Renderer) -> Result<(), RenderError> {
        let (Some(worker), SceneWall::Pages { pages, .. }) = (&mut self.worker, self.scene.wall)
        else {
            return Ok(());
        };
        while worker.outstanding() > 0 {
            renderer.apply(pages, worker.recv()?)?;
        }
        Ok(())
    }

    /// Drops the frames in flight: their slots are free once the device is done with them.
    fn give_up(&mut self, renderer: &mut Renderer, gpu: &mut Gpu) {
        self.begun = self.shots.len();
        for ticket in self.in_flight.drain(..) {
            let _ = renderer.fetch(gpu, ticket);
        }
    }

    /// Ends the sequence, also before its last frame: the renderer then has no frame in flight, and
    /// the pages hold the content the worker assumes. Returns the worker.
    ///
    /// # Errors
    /// [`RenderError::Detail`] if the worker fails; the renderer is free even so.
    pub fn finish(
        mut self,
        renderer: &mut Renderer,
        gpu: &mut Gpu,
    ) -> Result<Option<Worker>, RenderError> {
        self.give_up(renderer, gpu);
        // A frame that was never drawn may have been refined for: its pages are not lost.
        self.apply_answers(renderer)?;
        Ok(self.worker)
    }
}
