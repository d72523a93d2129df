//! Refined faces of a wall on the device.

use std::sync::Arc;

use super::RenderError;
use crate::lod::VisibleWall;
use crate::lod::refined::{PlacedFaces, RefinedSlots, RefinedWall, SlotWrite};
use crate::vk::{BufferId, Frame, Gpu, Releaser, Write};

/// Bytes that are written with the frame that draws them; more are written before it, in parts.
const WITH_FRAME: usize = 4 << 20;

/// Slots of refined faces on the device, and the templates that index them.
pub struct RefinedFaces {
    wall: Arc<RefinedWall>,
    slots: RefinedSlots,
    pub vertices: BufferId,
    pub indices: BufferId,
}

impl RefinedFaces {
    /// Creates slots without content.
    pub fn new(gpu: &mut Gpu, wall: Arc<RefinedWall>) -> Result<Self, RenderError> {
        gpu.all_or_none(|gpu| {
            Ok(Self {
                wall,
                slots: RefinedSlots::new(),
                vertices: gpu.empty_vertices("refined faces", RefinedSlots::buffer_bytes())?,
                indices: gpu.index_buffer("templates", RefinedSlots::indices())?,
            })
        })
    }

    /// Forgets the content of all slots.
    pub fn forget(&mut self) {
        self.slots = RefinedSlots::new();
    }

    /// Finds slots for the refined faces of a frame. Returns the draws of each eye, the writes that the
    /// frame needs before them, and the number of faces that wait for a later frame.
    ///
    /// * `made`: largest number of faces of each level that are made.
    pub fn place(
        &mut self,
        gpu: &mut Gpu,
        seen: &[VisibleWall],
        made: u32,
    ) -> Result<(Vec<PlacedFaces>, Vec<Write<'static>>, usize), RenderError> {
        let seen: Vec<&VisibleWall> = seen.iter().collect();
        let (placed, new, waiting) = self.slots.place(&self.wall, &seen, made);
        let bytes = |w: &SlotWrite| size_of_val(&w.vertices[..]);
        let mut parts: Vec<Vec<Write<'_>>> = vec![Vec::new()];
        let mut left = WITH_FRAME;
        for write in new {
            if bytes(&write) > left {
                parts.push(Vec::new());
                left = WITH_FRAME;
            }
            left -= bytes(&write);
            let content = bytemuck::cast_slice(&write.vertices).to_vec();
            let write = Write { to: self.vertices, offset: write.offset, bytes: content.into() };
            parts.last_mut().expect("one part").push(write);
        }
        let last = parts.pop().expect("one part");
        for writes in parts {
            let sent = send(gpu, writes);
            if sent.is_err() {
                self.forget();
            }
            sent?;
        }
        Ok((placed, last, waiting))
    }

    pub fn release(&self, releaser: &Releaser) {
        releaser.buffer(self.vertices);
        releaser.buffer(self.indices);
    }
}

fn send(gpu: &mut Gpu, writes: Vec<Write<'_>>) -> Result<(), RenderError> {
    let frame = Frame { writes, ..Frame::default() };
    gpu.make_room(frame.staged_bytes())?;
    Ok(gpu.submit_draws(&frame)?)
}
