//! Refined faces of a wall on the device.

use std::sync::Arc;

use super::RenderError;
use crate::lod::VisibleWall;
use crate::lod::refined::{PlacedFaces, RefinedSlots, RefinedWall, SlotWrite};
use crate::vk::{BufferId, Frame, Gpu, IndexedRange, Releaser, Write};

/// Bytes of vertices, and of indices, that are written with the frame that draws them; more are written
/// before it, in parts.
const WITH_FRAME: usize = 4 << 20;
/// Largest number of inside views of a frame: the faces of a cube.
const MAX_EYES: u32 = 6;
/// Bytes of an index and of the fineness of a slot.
const WORD: u64 = size_of::<u32>() as u64;
/// Indices for which there is room from the start.
const FIRST_INDICES: u64 = 1 << 18;

/// Slots of refined faces on the device. The faces that an eye draws are one range of indices, written
/// anew for each frame, and a word for each slot.
pub struct RefinedFaces {
    wall: Arc<RefinedWall>,
    slots: RefinedSlots,
    releaser: Releaser,
    pub vertices: BufferId,
    pub indices: BufferId,
    /// Number of indices for which there is room.
    room: u64,
    /// Fineness of the faces in all slots, for one eye after the other.
    pub fineness: BufferId,
}

/// The refined faces of a frame.
pub struct FrameFaces {
    /// What each eye draws.
    pub eyes: Vec<PlacedFaces>,
    /// Vertices that the frame writes.
    vertices: Vec<SlotWrite>,
    /// Whether the indices were written before the frame.
    has_indices: bool,
    /// Number of faces that wait for a later frame.
    pub waiting: usize,
}

impl FrameFaces {
    /// Returns the range of indices that an eye draws, if there are any.
    pub fn range(&self, eye: usize) -> Option<IndexedRange> {
        let indices = self.eyes[eye].indices.len() as u32;
        (indices > 0).then(|| IndexedRange {
            first_index: self.first_index(eye) as u32,
            indices,
            first_vertex: 0,
            instance: first_word(eye),
        })
    }

    /// Indices of all earlier eyes.
    fn first_index(&self, eye: usize) -> u64 {
        self.eyes[..eye].iter().map(|eye| eye.indices.len() as u64).sum()
    }
}

/// Where the slots of an eye begin.
fn first_word(eye: usize) -> u32 {
    eye as u32 * RefinedSlots::count()
}

impl RefinedFaces {
    /// Creates slots without content.
    pub fn new(gpu: &mut Gpu, wall: Arc<RefinedWall>) -> Result<Self, RenderError> {
        let words = u64::from(MAX_EYES * RefinedSlots::count());
        gpu.all_or_none(|gpu| {
            Ok(Self {
                wall,
                slots: RefinedSlots::new(),
                releaser: gpu.releaser(),
                vertices: gpu.empty_vertices("refined faces", RefinedSlots::buffer_bytes())?,
                indices: gpu.empty_indices("indices of refined faces", FIRST_INDICES)?,
                room: FIRST_INDICES,
                fineness: gpu.empty_storage("fineness of slots", WORD * words)?,
            })
        })
    }

    /// Forgets the content of all slots.
    pub fn forget(&mut self) {
        self.slots = RefinedSlots::new();
    }

    /// Finds slots for the refined faces of a frame, and makes room for their indices.
    ///
    /// * `seen`: what each eye sees.
    /// * `made`: largest number of faces of each level that are made.
    pub fn place(
        &mut self,
        gpu: &mut Gpu,
        seen: &[VisibleWall],
        made: u32,
    ) -> Result<FrameFaces, RenderError> {
        let seen: Vec<&VisibleWall> = seen.iter().collect();
        let (eyes, new, waiting) = self.slots.place(&self.wall, &seen, made);
        let mut faces = FrameFaces { eyes, vertices: new, has_indices: false, waiting };
        let sent = self.make_room(gpu, &faces).and_then(|()| self.send_most(gpu, &mut faces));
        if sent.is_err() {
            self.forget();
        }
        sent.map(|()| faces)
    }

    /// Writes vertices and indices before the frame, but for as many as go with it.
    fn send_most(&self, gpu: &mut Gpu, faces: &mut FrameFaces) -> Result<(), RenderError> {
        let mut first_of_part = vec![0];
        let mut left = WITH_FRAME;
        for (i, write) in faces.vertices.iter().enumerate() {
            let bytes = size_of_val(&write.vertices[..]);
            if bytes > left {
                first_of_part.push(i);
                left = WITH_FRAME;
            }
            left -= bytes;
        }
        let mut send = |writes: Vec<Write<'_>>| {
            let frame = Frame { writes, ..Frame::default() };
            gpu.make_room(frame.staged_bytes())?;
            Ok::<_, RenderError>(gpu.submit_draws(&frame)?)
        };
        for part in first_of_part.windows(2) {
            send(self.vertex_writes(&faces.vertices[part[0]..part[1]]).collect())?;
        }
        faces.vertices.drain(..first_of_part.pop().unwrap_or(0));
        if WORD * faces.first_index(faces.eyes.len()) > WITH_FRAME as u64 {
            for write in self.index_writes(faces) {
                let parts = write.bytes.chunks(WITH_FRAME).zip((0..).step_by(WITH_FRAME));
                for (bytes, at) in parts {
                    let offset = write.offset + at as u64;
                    send(vec![Write { bytes: bytes.into(), offset, ..write }])?;
                }
            }
            faces.has_indices = true;
        }
        Ok(())
    }

    fn index_writes<'f>(&self, faces: &'f FrameFaces) -> impl Iterator<Item = Write<'f>> + use<'f> {
        let to = self.indices;
        faces.eyes.iter().enumerate().map(move |(eye, drawn)| {
            let bytes = bytemuck::cast_slice(&drawn.indices).into();
            Write { to, offset: WORD * faces.first_index(eye), bytes }
        })
    }

    fn make_room(&mut self, gpu: &mut Gpu, faces: &FrameFaces) -> Result<(), RenderError> {
        let needed = faces.first_index(faces.eyes.len());
        if needed > self.room {
            let room = needed.next_power_of_two();
            let indices = gpu.empty_indices("indices of refined faces", room)?;
            self.releaser.buffer(std::mem::replace(&mut self.indices, indices));
            self.room = room;
        }
        Ok(())
    }

    /// Returns the writes that a frame needs before its draws.
    pub fn writes<'f>(&self, faces: &'f FrameFaces) -> Vec<Write<'f>> {
        let mut writes: Vec<Write<'f>> = self.vertex_writes(&faces.vertices).collect();
        if !faces.has_indices {
            writes.extend(self.index_writes(faces));
        }
        for (eye, drawn) in faces.eyes.iter().enumerate() {
            let of_level = |(slot, words): (u32, &'f [u32])| {
                let offset = WORD * u64::from(first_word(eye) + slot);
                Write { to: self.fineness, offset, bytes: bytemuck::cast_slice(words).into() }
            };
            writes.extend(drawn.fineness_of_slots().map(of_level));
        }
        writes
    }

    fn vertex_writes<'f>(
        &self,
        writes: &'f [SlotWrite],
    ) -> impl Iterator<Item = Write<'f>> + use<'f> {
        let to = self.vertices;
        writes.iter().map(move |w| {
            let bytes = bytemuck::cast_slice(&w.vertices).into();
            Write { to, offset: w.offset, bytes }
        })
    }

    pub fn release(&self, releaser: &Releaser) {
        for buffer in [self.vertices, self.indices, self.fineness] {
            releaser.buffer(buffer);
        }
    }
}
