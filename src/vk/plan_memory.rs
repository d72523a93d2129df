//! Memory of a plan's buffers: an arena that is kept for the next plan.

use std::time::Instant;

use ash::vk;
use gpu_allocator::vulkan::Allocation;

use super::arena::ArenaLayout;
use super::memory::{Buffer, MemoryUse};
use super::transfers::copy_bytes;
use super::{BufferId, Gpu, Releaser, VkError};
use crate::compute::{Contents, DeviceCopy, Plan, PlanBuffer};

/// Most bytes of a block of an arena, where no buffer is larger: every device takes as many at once.
const BLOCK_BYTES: u64 = 1 << 30;
/// Most bytes of an arena that are kept where the device uses the host's memory.
const KEPT_UNIFIED_BYTES: u64 = 64 << 20;
/// Share of a device's own memory that a kept arena may take.
const KEPT_SHARE: u64 = 8;

/// Blocks of device memory.
#[derive(Default)]
pub(super) struct Arena {
    blocks: Vec<Allocation>,
    /// Types of memory that the buffers allow.
    type_bits: u32,
}

/// A buffer of a plan with its memory.
pub(super) struct PlacedBuffer {
    pub raw: vk::Buffer,
    /// Size, bytes: whole words.
    pub bytes: u64,
    owner: BufferOwner,
}

/// Owner of a buffer's memory.
#[derive(Clone, Copy, PartialEq, Eq)]
enum BufferOwner {
    /// The arena: the buffer goes when the plan ends.
    Arena,
    /// This buffer, which becomes a device copy when the plan ends.
    Plan,
    /// A device copy of an earlier plan.
    Copy,
}

impl PlacedBuffer {
    /// Whether an earlier plan left it on the device with its contents.
    pub fn is_resident(&self) -> bool {
        self.owner == BufferOwner::Copy
    }
}

/// Memory of a [`DeviceCopy`](crate::compute::DeviceCopy), freed when it is dropped.
struct CopyMemory {
    id: BufferId,
    /// Size of the array, bytes.
    bytes: usize,
    releaser: Releaser,
}

impl Drop for CopyMemory {
    fn drop(&mut self) {
        self.releaser.buffer(self.id);
    }
}

/// Buffers of a plan and their memory.
#[derive(Default)]
pub(super) struct PlanMemory {
    /// Buffers in the order of the plan's; `None` where no launch binds one or it has no bytes.
    pub buffers: Vec<Option<PlacedBuffer>>,
    pub layout: ArenaLayout,
    /// Buffer that is bound in place of those without bytes. A shader sees four words there and no
    /// size, so kernels take their sizes from the immediate block.
    pub dummy: Option<Buffer>,
    /// Buffers that become device copies, each with its index.
    copies: Vec<(usize, Buffer)>,
    arena: Arena,
}

impl PlanMemory {
    /// Size of all memory, bytes.
    pub fn bytes(&self) -> u64 {
        self.layout.blocks.iter().sum::<u64>() + self.copied_bytes()
    }

    /// Size of the buffers in use at once and of the device copies, bytes.
    pub fn least_bytes(&self) -> u64 {
        self.layout.least_bytes + self.copied_bytes()
    }

    /// Size of inputs that were on the device already, bytes.
    pub fn resident_bytes(&self, plan: &Plan<'_>) -> u64 {
        let with_buffers = plan.buffers().iter().zip(&self.buffers);
        let resident = with_buffers.filter(|(_, b)| b.as_ref().is_some_and(|b| b.is_resident()));
        resident.map(|(b, _)| b.bytes as u64).sum()
    }

    /// Size of the buffers that are or become device copies, bytes.
    fn copied_bytes(&self) -> u64 {
        let placed = self.buffers.iter().flatten();
        placed.filter(|b| b.owner != BufferOwner::Arena).map(|b| b.bytes).sum()
    }

    /// The bytes of a buffer, where the host reaches them. The caller has waited for the device.
    pub fn mapped(&self, at: usize, bytes: usize) -> Option<&[u8]> {
        if let Some((_, copy)) = self.copies.iter().find(|c| c.0 == at) {
            return copy.mapped().map(|all| &all[..bytes]);
        }
        let place = self.layout.places[at]?;
        let block = self.arena.blocks[place.block].mapped_slice()?;
        Some(&block[place.offset as usize..][..bytes])
    }

    /// The bytes of a buffer for writing, where the host reaches them. The device is not using them.
    pub fn mapped_mut(&mut self, at: usize, bytes: usize) -> Option<&mut [u8]> {
        if let Some((_, copy)) = self.copies.iter_mut().find(|c| c.0 == at) {
            return copy.mapped_mut().map(|all| &mut all[..bytes]);
        }
        let place = self.layout.places[at]?;
        let block = self.arena.blocks[place.block].mapped_slice_mut()?;
        Some(&mut block[place.offset as usize..][..bytes])
    }
}

impl Gpu {
    /// Makes the buffers of a plan that launches bind, without contents. What was made before an
    /// error is in `held`.
    pub(super) fn allocate_plan(
        &mut self,
        plan: &Plan<'_>,
        bound: &[bool],
        held: &mut PlanMemory,
    ) -> Result<(), VkError> {
        use vk::BufferUsageFlags as Use;
        let storage = Use::STORAGE_BUFFER | Use::TRANSFER_SRC | Use::TRANSFER_DST;
        let mut sizes = vec![0; plan.buffers().len()];
        let (mut alignment, mut type_bits) = (16, u32::MAX);
        held.buffers.resize_with(plan.buffers().len(), || None);
        for (at, b) in plan.buffers().iter().enumerate() {
            if !bound[at] || b.bytes == 0 {
                continue;
            }
            let bytes = b.bytes as u64;
            if let Some(copy) = b.copy {
                held.buffers[at] = Some(self.copied_buffer(at, b, copy, storage, held)?);
                continue;
            }
            let (raw, needs) = self.with_memory(|m| m.unbound_buffer(b.name, bytes, storage))?;
            let (bytes, owner) = (bytes.next_multiple_of(4).max(16), BufferOwner::Arena);
            held.buffers[at] = Some(PlacedBuffer { raw, bytes, owner });
            sizes[at] = needs.size;
            alignment = alignment.max(needs.alignment);
            type_bits &= needs.memory_type_bits;
        }
        let is_empty = |id: &crate::compute::BufId| held.buffers[id.0 as usize].is_none();
        if plan.steps().iter().any(|s| s.buffers.iter().any(is_empty)) {
            held.dummy = Some(self.new_buffer("nothing", 16, storage, MemoryUse::Device)?);
        }
        held.layout = ArenaLayout::new(plan, &sizes, alignment, BLOCK_BYTES);
        held.arena = std::mem::take(&mut self.arena);
        self.grow(&held.layout.blocks, alignment, type_bits, &mut held.arena)?;
        for (buffer, place) in held.buffers.iter().zip(&held.layout.places) {
            if let (Some(b), Some(place)) = (buffer, place) {
                self.memory.bind(b.raw, &held.arena.blocks[place.block], place.offset)?;
            }
        }
        Ok(())
    }

    /// The device copy of a buffer, or memory for one.
    fn copied_buffer(
        &mut self,
        at: usize,
        buffer: &PlanBuffer<'_>,
        copy: &DeviceCopy,
        usage: vk::BufferUsageFlags,
        held: &mut PlanMemory,
    ) -> Result<PlacedBuffer, VkError> {
        let bytes = (buffer.bytes as u64).next_multiple_of(4).max(16);
        let own = copy.memory::<CopyMemory>().filter(|m| self.owns(&m.releaser));
        if let (Some(m), true) = (own, input(&buffer.contents).is_some()) {
            assert_eq!(m.bytes, buffer.bytes, "`{}` is the copy of another array", buffer.name);
            let raw = self.buffers[m.id].buffer.raw;
            return Ok(PlacedBuffer { raw, bytes, owner: BufferOwner::Copy });
        }
        let new = self.new_buffer(buffer.name, bytes, usage, MemoryUse::Device)?;
        let raw = new.raw;
        held.copies.push((at, new));
        Ok(PlacedBuffer { raw, bytes, owner: BufferOwner::Plan })
    }

    /// Leaves the buffers that stay on the device to their copies. The plan has succeeded.
    pub(super) fn leave_copies(&mut self, plan: &Plan<'_>, held: &mut PlanMemory) {
        for (at, buffer) in held.copies.drain(..) {
            let PlanBuffer { bytes, copy, .. } = &plan.buffers()[at];
            let id = self.insert(buffer, vk::BufferUsageFlags::STORAGE_BUFFER, 0);
            let memory = CopyMemory { id, bytes: *bytes, releaser: self.releaser() };
            if let Some(copy) = copy {
                copy.set(memory);
            }
        }
    }

    /// Makes an arena's blocks as large as is needed.
    fn grow(
        &mut self,
        blocks: &[u64],
        alignment: u64,
        memory_type_bits: u32,
        arena: &mut Arena,
    ) -> Result<(), VkError> {
        let same_kind = arena.type_bits == memory_type_bits
            && arena.blocks.iter().all(|b| b.offset().is_multiple_of(alignment));
        if !same_kind {
            arena.blocks.drain(..).for_each(|b| self.memory.free_block(b));
        }
        arena.type_bits = memory_type_bits;
        let large_enough = arena.blocks.iter().zip(blocks).all(|(b, bytes)| b.size() >= *bytes);
        if !large_enough {
            // All at once: several plans that grow leave no holes.
            arena.blocks.drain(..).for_each(|b| self.memory.free_block(b));
        }
        for &size in blocks.get(arena.blocks.len()..).unwrap_or_default() {
            let needs = vk::MemoryRequirements { size, alignment, memory_type_bits };
            arena.blocks.push(self.with_memory(|m| m.block(needs))?);
        }
        Ok(())
    }

    /// Puts what the host has into the device's memory, where that is the host's too.
    pub(super) fn write_in_place(&mut self, plan: &Plan<'_>, held: &mut PlanMemory) {
        let start = Instant::now();
        for (at, b) in plan.buffers().iter().enumerate() {
            if let Some(data) = input(&b.contents)
                && let Some(to) = held.mapped_mut(at, b.bytes)
            {
                copy_bytes(to, data);
                self.counts[0].uploaded_bytes += data.len() as u64;
            }
        }
        self.counts[0].write_us += start.elapsed().as_micros() as u64;
    }

    /// Destroys the buffers of a plan that the device is done with, and keeps their memory for the
    /// next plan where it is not too large.
    pub(super) fn free_plan(&mut self, held: PlanMemory) {
        let placed = held.buffers.into_iter().flatten();
        let of_arena = placed.filter(|b| b.owner == BufferOwner::Arena);
        of_arena.for_each(|b| self.memory.free_unbound(b.raw));
        held.copies.into_iter().for_each(|(_, b)| self.memory.free_buffer(b));
        held.dummy.into_iter().for_each(|b| self.memory.free_buffer(b));
        let kept = if self.memory.unified() {
            KEPT_UNIFIED_BYTES
        } else {
            let heaps = self.info.memory.iter().filter(|h| h.device_local);
            heaps.map(|h| h.bytes).max().unwrap_or(0) / KEPT_SHARE
        };
        self.free_arena();
        self.arena = held.arena;
        if self.arena.blocks.iter().map(Allocation::size).sum::<u64>() > kept {
            self.free_arena();
        }
    }

    /// Frees the memory that is kept for the next plan. No plan is running.
    pub(super) fn free_arena(&mut self) {
        let blocks = std::mem::take(&mut self.arena.blocks);
        blocks.into_iter().for_each(|b| self.memory.free_block(b));
    }
}

/// Contents that the host has.
pub(super) fn input<'p>(contents: &'p Contents<'_>) -> Option<&'p [u8]> {
    match contents {
        Contents::Zeroed | Contents::Undefined => None,
        Contents::Borrowed(data) => Some(data),
        Contents::Owned(data) => Some(data),
    }
}
