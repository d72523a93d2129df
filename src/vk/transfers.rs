//! Inputs and results of a plan through mapped memory, where the host does not reach the device's:
//! in batches of a few megabytes, so that the device copies one while the host handles the next.

use std::time::Instant;

use ash::vk;
use rayon::prelude::*;

use super::memory::MemoryUse;
use super::plan_memory::{PlanMemory, input};
use super::{Gpu, STAGING_BYTES, StageAccess, VkError};
use crate::compute::{BufId, Outputs, Plan};

/// Most bytes of a batch of inputs: four are under way.
const INPUT_BATCH: u64 = STAGING_BYTES / 4;
/// Most bytes of a batch of results: two are under way.
const RESULT_BATCH: u64 = 16 << 20;

/// Size of what a thread copies at once, bytes.
const COPIED_AT_ONCE: usize = 512 << 10;

/// Region of a buffer that is copied at once.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct CopyRegion {
    /// Index of the buffer.
    buffer: usize,
    /// First byte.
    offset: u64,
    /// Size, bytes.
    bytes: u64,
}

/// Parts that are copied together.
pub(super) type Batch = Vec<CopyRegion>;

/// Cuts buffers, each with its size, into batches of at most `most` bytes.
fn batches(buffers: impl Iterator<Item = (usize, u64)>, most: u64) -> Vec<Batch> {
    let mut all: Vec<Batch> = Vec::new();
    let mut room = 0;
    for (buffer, size) in buffers {
        let mut offset = 0;
        while offset < size {
            if room == 0 {
                all.push(Batch::new());
                room = most;
            }
            let bytes = room.min(size - offset);
            if let Some(batch) = all.last_mut() {
                batch.push(CopyRegion { buffer, offset, bytes });
            }
            (offset, room) = (offset + bytes, room - bytes);
        }
    }
    all
}

/// Size of a batch, bytes.
fn bytes_of(batch: &Batch) -> u64 {
    batch.iter().map(|p| p.bytes).sum()
}

/// Batches of a plan's inputs.
pub(super) fn input_batches(plan: &Plan<'_>, held: &PlanMemory) -> Vec<Batch> {
    let buffers = plan.buffers().iter().enumerate();
    let is_written = |at: usize| held.buffers[at].as_ref().is_some_and(|b| !b.is_resident());
    let inputs = buffers.filter(|(at, b)| is_written(*at) && input(&b.contents).is_some());
    batches(inputs.map(|(at, b)| (at, b.bytes as u64)), INPUT_BATCH)
}

/// Batches of a plan's results.
pub(super) fn result_batches(plan: &Plan<'_>, held: &PlanMemory) -> Vec<Batch> {
    let results = plan.downloads().iter().map(|id| id.0 as usize);
    let is_made = |at: &usize| held.buffers[*at].as_ref().is_some_and(|b| !b.is_resident());
    let bound = results.filter(is_made);
    batches(bound.map(|at| (at, plan.buffers()[at].bytes as u64)), RESULT_BATCH)
}

/// Copies bytes on all threads: one alone does not fill the bus to a graphics card, and the pages of
/// fresh memory, which the system clears when they are first written, take longer than the copy.
pub(super) fn copy_bytes(to: &mut [u8], from: &[u8]) {
    if from.len() <= COPIED_AT_ONCE {
        return to.copy_from_slice(from);
    }
    let parts = to.par_chunks_mut(COPIED_AT_ONCE).zip(from.par_chunks(COPIED_AT_ONCE));
    parts.for_each(|(to, from)| to.copy_from_slice(from));
}

impl Gpu {
    /// Sends batches of inputs, each in a submission of its own.
    pub(super) fn send_inputs(
        &mut self,
        plan: &Plan<'_>,
        held: &PlanMemory,
        batches: &[Batch],
    ) -> Result<(), VkError> {
        for batch in batches {
            let place = self.stage_inputs(plan, batch)?;
            let reached = self.reached()?;
            let cmd = self.commands.begin(reached)?;
            self.record_inputs(cmd, held, batch, place);
            let sent = self.commands.submit(self.queue, &mut self.timeline, cmd, None);
            self.staging.close(sent.as_ref().ok().copied());
            sent?;
        }
        Ok(())
    }

    /// Puts a batch of inputs into the staging ring; returns their place. The caller closes the ring
    /// once it has submitted their copies.
    pub(super) fn stage_inputs(&mut self, plan: &Plan<'_>, batch: &Batch) -> Result<u64, VkError> {
        let all = bytes_of(batch);
        self.make_room(all)?;
        let reached = self.reached()?;
        let place = self.stage(all, reached)?;
        let start = Instant::now();
        let mut at = place;
        for part in batch {
            let data = input(&plan.buffers()[part.buffer].contents).expect("an input");
            let data = &data[part.offset as usize..][..part.bytes as usize];
            copy_bytes(self.staging.bytes_mut(at, part.bytes), data);
            at += part.bytes;
        }
        self.counts[0].write_us += start.elapsed().as_micros() as u64;
        self.counts[0].uploaded_bytes += all;
        Ok(place)
    }

    /// Records the copies of a batch of inputs that is staged at `place`.
    pub(super) fn record_inputs(
        &mut self,
        cmd: vk::CommandBuffer,
        held: &PlanMemory,
        batch: &Batch,
        mut place: u64,
    ) {
        let from = self.staging.buffer.as_ref().expect("staged before").raw;
        for part in batch {
            let Some(to) = &held.buffers[part.buffer] else { continue };
            let region =
                [vk::BufferCopy { src_offset: place, dst_offset: part.offset, size: part.bytes }];
            // SAFETY: `cmd` is recording; both ranges are within their buffers, which live until the
            // timeline has passed this submission: the ring keeps the bytes, `held` is waited for.
            unsafe { self.device.cmd_copy_buffer(cmd, from, to.raw, &region) };
            place += part.bytes;
        }
        self.counts[0].copied_bytes += bytes_of(batch);
    }

    /// Makes room to read back as many of the batches as are under way at once.
    pub(super) fn room_for_results(&mut self, batches: &[Batch]) -> Result<(), VkError> {
        let wanted = match batches {
            [] => return Ok(()),
            [one] => bytes_of(one),
            _ => 2 * RESULT_BATCH,
        };
        if self.readback.as_ref().is_some_and(|r| r.bytes >= wanted) {
            return Ok(());
        }
        let usage = vk::BufferUsageFlags::TRANSFER_DST;
        let bytes = wanted.next_power_of_two();
        let new = self.new_buffer("results", bytes, usage, MemoryUse::Readback)?;
        if let Some(old) = self.readback.replace(new) {
            // Plans wait for their results.
            self.memory.free_buffer(old);
        }
        Ok(())
    }

    /// Records the copies of a batch of results, to be taken from `place` of the memory for them.
    pub(super) fn record_results(
        &mut self,
        cmd: vk::CommandBuffer,
        held: &PlanMemory,
        batch: &Batch,
        mut place: u64,
    ) {
        let to = self.readback.as_ref().expect("room was made").raw;
        for part in batch {
            let Some(from) = &held.buffers[part.buffer] else { continue };
            let region =
                [vk::BufferCopy { src_offset: part.offset, dst_offset: place, size: part.bytes }];
            // SAFETY: as in `record_inputs`; nothing else uses this half of the memory for results:
            // what was copied there before was waited for and taken.
            unsafe { self.device.cmd_copy_buffer(cmd, from.raw, to, &region) };
            place += part.bytes;
        }
        self.counts[0].copied_bytes += bytes_of(batch);
    }

    /// Takes a batch of results that the device has copied.
    pub(super) fn take_results(
        &mut self,
        plan: &Plan<'_>,
        batch: &Batch,
        mut place: u64,
        out: &mut Outputs,
    ) {
        let start = Instant::now();
        let mapped = self.readback.as_ref().and_then(|r| r.mapped()).expect("mapped for reading");
        for part in batch {
            let (id, all) = (BufId(part.buffer as u32), plan.buffers()[part.buffer].bytes);
            let to = &mut out.bytes_mut(id, all)[part.offset as usize..][..part.bytes as usize];
            copy_bytes(to, &mapped[place as usize..][..part.bytes as usize]);
            place += part.bytes;
        }
        self.counts[0].take_us += start.elapsed().as_micros() as u64;
        self.counts[0].read_back_bytes += bytes_of(batch);
    }

    /// Reads back more than one batch of results: the device copies one while the host takes the
    /// one before.
    pub(super) fn fetch_results(
        &mut self,
        plan: &Plan<'_>,
        held: &PlanMemory,
        batches: &[Batch],
        out: &mut Outputs,
    ) -> Result<(), VkError> {
        let mut under_way: Option<(u64, &Batch, u64)> = None;
        for (i, batch) in batches.iter().enumerate() {
            let place = RESULT_BATCH * (i as u64 % 2);
            let reached = self.reached()?;
            let cmd = self.commands.begin(reached)?;
            self.record_results(cmd, held, batch, place);
            self.barrier(cmd, TRANSFER_WRITE, HOST_READ);
            let value = self.commands.submit(self.queue, &mut self.timeline, cmd, None)?;
            if let Some((value, batch, place)) = under_way.replace((value, batch, place)) {
                self.wait(value, "results of a plan")?;
                self.take_results(plan, batch, place, out);
            }
        }
        if let Some((value, batch, place)) = under_way {
            self.wait(value, "results of a plan")?;
            self.take_results(plan, batch, place, out);
        }
        Ok(())
    }

    /// Records a memory barrier of a plan, and counts it.
    pub(super) fn barrier(&mut self, cmd: vk::CommandBuffer, from: StageAccess, to: StageAccess) {
        self.counts[0].barriers += 1;
        self.memory_barrier(cmd, from, to);
    }
}

/// Writes by copies and fills.
pub(super) const TRANSFER_WRITE: StageAccess =
    (vk::PipelineStageFlags2::ALL_TRANSFER, vk::AccessFlags2::TRANSFER_WRITE);
/// Reading by the host.
pub(super) const HOST_READ: StageAccess =
    (vk::PipelineStageFlags2::HOST, vk::AccessFlags2::HOST_READ);

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn batches_cover_every_byte_once_in_order_and_are_full_but_for_the_last() {
        for most in [1, 7, 64, 1000] {
            let sizes = [5, 0, 64, 1, 300];
            let all = batches(sizes.into_iter().enumerate(), most);
            let full = all.split_last().map_or(&all[..], |(_, full)| full);
            assert!(full.iter().all(|b| bytes_of(b) == most), "{most}");
            let mut next = [0; 5];
            for part in all.iter().flatten() {
                assert_eq!(part.offset, next[part.buffer], "{part:?}");
                assert!(part.bytes > 0);
                next[part.buffer] += part.bytes;
            }
            assert_eq!(next, sizes, "{most}");
        }
    }
}
