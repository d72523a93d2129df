//! Frames in order, several in flight; with level of detail, each from a settled cut.

use std::collections::VecDeque;

use super::RenderError;
use super::pages::PagesHandle;
use super::renderer::{IN_FLIGHT, Renderer};
use super::scene::{FrameStats, Scene, Shot, Wall};
use crate::lod::Worker;
use crate::vk::Gpu;

impl Renderer {
    /// Draws frames in order and hands each to `sink` with its number while the device draws the
    /// next ones.
    ///
    /// # Errors
    /// The first of the device's or the sink's errors; later frames are dropped.
    pub fn render_sequence<E: From<RenderError>>(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shots: impl IntoIterator<Item = Shot>,
        sink: impl FnMut(usize, Vec<u8>, FrameStats) -> Result<(), E>,
    ) -> Result<(), E> {
        self.sequence(gpu, scene, shots, |_, _, _| Ok(()), sink)
    }

    /// The same for a wall in pages: each frame shows the settled cut of its own camera. The worker
    /// refines for the next frame while this one is drawn. Frames depend on cameras alone, not on
    /// timing or number of threads; their pages do depend on the frames before.
    ///
    /// # Errors
    /// As [`Renderer::render_sequence`]; [`RenderError::Detail`] if the worker fails. The worker
    /// and the pages agree afterwards whatever happened, unless the worker itself failed.
    ///
    /// # Panics
    /// If the scene's wall is not in pages.
    pub fn render_settled<E: From<RenderError>>(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        worker: &mut Worker,
        shots: impl IntoIterator<Item = Shot>,
        sink: impl FnMut(usize, Vec<u8>, FrameStats) -> Result<(), E>,
    ) -> Result<(), E> {
        let Wall::Pages { pages, .. } = scene.wall else { panic!("a wall in pages") };
        let prepare = |r: &mut Self, shot: &Shot, next: Option<&Shot>| {
            // Asked already while the frame before was made; asked now for the first.
            if let (0, Some(camera)) = (worker.outstanding(), r.camera(shot)) {
                worker.request(camera);
            }
            // The answer is taken before the next question, so that at most one is on its way.
            let result = r.take_answers(pages, worker);
            if let (Ok(()), Some(camera)) = (&result, next.and_then(|n| r.camera(n))) {
                worker.request(camera);
            }
            result
        };
        let result = self.sequence(gpu, scene, shots, prepare, sink);
        // A frame that was never drawn may have been refined for: its pages are not lost.
        result.and(self.take_answers(pages, worker).map_err(E::from))
    }

    fn take_answers(&mut self, pages: PagesHandle, worker: &mut Worker) -> Result<(), RenderError> {
        while worker.outstanding() > 0 {
            let step = worker.recv()?;
            self.apply(pages, step)?;
        }
        Ok(())
    }

    fn sequence<E: From<RenderError>>(
        &mut self,
        gpu: &mut Gpu,
        scene: &Scene,
        shots: impl IntoIterator<Item = Shot>,
        mut prepare: impl FnMut(&mut Self, &Shot, Option<&Shot>) -> Result<(), RenderError>,
        mut sink: impl FnMut(usize, Vec<u8>, FrameStats) -> Result<(), E>,
    ) -> Result<(), E> {
        let mut waiting = VecDeque::with_capacity(IN_FLIGHT);
        let mut done = 0;
        let mut result = Ok(());
        let mut shots = shots.into_iter().peekable();
        loop {
            while result.is_ok() && waiting.len() < IN_FLIGHT {
                let Some(shot) = shots.next() else { break };
                let begun = prepare(self, &shot, shots.peek());
                match begun.and_then(|()| self.begin_frame(gpu, scene, &shot)) {
                    Ok(ticket) => waiting.push_back(ticket),
                    Err(e) => result = Err(e.into()),
                }
            }
            let Some(ticket) = waiting.pop_front() else { return result };
            let stats = ticket.stats;
            match self.fetch(gpu, ticket) {
                Ok(rgb) if result.is_ok() => result = sink(done, rgb, stats),
                Ok(_) => {}
                Err(e) => result = result.and(Err(e.into())),
            }
            done += 1;
        }
    }
}
