//! Draw passes as data: checked, recorded into one command buffer (`passes`) and submitted; the
//! caller reads the picture when it likes, so several frames can be in flight.

use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind, resume_unwind};

use ash::vk;

use super::commands::Handover;
use super::frame::{Frame, FrameOptions};
use super::ids::{BufferId, DrawPipelineId, ImageId};
use super::retire::Retired;
use super::{Gpu, VkError};

/// A rectangle of pixels, from the top left.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Area {
    /// Left edge.
    pub x: u32,
    /// Top edge.
    pub y: u32,
    /// Columns.
    pub width: u32,
    /// Rows.
    pub height: u32,
}

/// A range of an index buffer, with vertices counted from a first one.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct IndexedRange {
    /// First index of the range.
    pub first_index: u32,
    /// Number of indices.
    pub indices: u32,
    /// Number added to every index.
    pub first_vertex: u32,
    /// The instance that vertices are told they belong to: a word of the caller's for each range.
    pub instance: u32,
}

/// Indices or vertices that a draw reads.
#[derive(Clone, Debug)]
pub enum DrawRange {
    /// Range of indices, or of vertices where there are no indices.
    Direct(Range<u32>),
    /// Ranges in this order, by one indirect command where the device can.
    Indirect(Vec<IndexedRange>),
}

/// Triangles from one pair of buffers.
#[derive(Clone, Debug)]
pub struct Draw {
    /// Pipeline the triangles are drawn with.
    pub pipeline: DrawPipelineId,
    /// Bytes of the immediate block; as many as the pipeline's has.
    pub push: Vec<u8>,
    /// Vertex buffer, unless the pipeline takes none.
    pub vertices: Option<BufferId>,
    /// Index buffer; without it vertices are taken in order.
    pub indices: Option<BufferId>,
    /// Range of indices, or of vertices, that is drawn.
    pub range: DrawRange,
    /// Images the fragments read, as many as the pipeline has. One kept as sRGB is read as linear
    /// light, or, by a pipeline that draws stored numbers, as its bytes are.
    pub images: Vec<ImageId>,
    /// Buffers the shaders read ([`Gpu::storage_buffer`]), as many as the pipeline has.
    pub buffers: Vec<BufferId>,
    /// The part of the pass's area that is drawn to; all of it where `None`.
    pub scissor: Option<Area>,
}

impl Draw {
    /// Whether its shaders read images or buffers.
    pub(super) fn has_set(&self) -> bool {
        !self.images.is_empty() || !self.buffers.is_empty()
    }
}

/// Draws to one set of targets. Each pass sees everything earlier passes drew.
#[derive(Clone, Debug)]
pub struct Pass {
    /// Colour target.
    pub colour: ImageId,
    /// Image that a multisampled colour target is averaged into at the end.
    pub resolve: Option<ImageId>,
    /// Depth target; always cleared to infinity.
    pub depth: Option<ImageId>,
    /// Image of one sample a pixel that takes the depth of the first sample at the end. A depth target
    /// of one sample that a later pass reads is its own.
    pub kept_depth: Option<ImageId>,
    /// Whether shaders write sRGB themselves ([`super::Format::Rgba8Stored`]): the colour target,
    /// one sample a pixel and not resolved, takes their numbers as they are.
    pub encoded: bool,
    /// Colour the area is cleared to, linear or as `encoded` says; `None` keeps it.
    pub clear: Option<[f32; 4]>,
    /// The part of the targets that is drawn to.
    pub area: Area,
    /// Draws, in order.
    pub draws: Vec<Draw>,
}

impl Gpu {
    /// Records and submits a frame and returns without waiting; [`Gpu::read`] waits.
    ///
    /// # Errors
    /// [`VkError::StagingFull`] if earlier frames still hold the staging ring: nothing was done,
    /// and [`Gpu::make_room`] waits for them; [`VkError::OutOfMemory`], [`VkError::DeviceLost`],
    /// or the failing call.
    ///
    /// # Panics
    /// If a handle is stale, a write does not fit its buffer, two writes overlap, a draw does not
    /// fit its pipeline or buffers, or a pipeline not its pass: errors of the caller.
    pub fn submit_draws(&mut self, frame: &Frame<'_>) -> Result<(), VkError> {
        self.submit_draws_with(frame, FrameOptions::default())
    }

    /// Submits a frame as [`Gpu::submit_draws`] does, with options for tests.
    ///
    /// # Errors
    /// As [`Gpu::submit_draws`].
    #[doc(hidden)]
    pub fn submit_draws_with(
        &mut self,
        frame: &Frame<'_>,
        options: FrameOptions,
    ) -> Result<(), VkError> {
        self.submit_frame(frame, options, None)
    }

    /// Submits a frame; one that draws a window's image runs between that image's two semaphores.
    ///
    /// * `shown`: the window's image that the frame draws, and its semaphores.
    pub(super) fn submit_frame(
        &mut self,
        frame: &Frame<'_>,
        options: FrameOptions,
        shown: Option<(ImageId, Handover)>,
    ) -> Result<(), VkError> {
        self.check_writes(&frame.writes);
        // A caller that goes on after a panic must not draw what was never written.
        let sent = catch_unwind(AssertUnwindSafe(|| self.send_draws(frame, options, shown)));
        let transitions = std::mem::take(&mut self.transitions);
        if !matches!(sent, Ok(Ok(()))) {
            self.forget_writes(&frame.writes);
            // Nothing was submitted, so the images are in the layouts they had before.
            for (image, before) in transitions.into_iter().rev() {
                self.images[image].layout = before;
            }
        }
        sent.unwrap_or_else(|panic| resume_unwind(panic))
    }

    fn send_draws(
        &mut self,
        frame: &Frame<'_>,
        options: FrameOptions,
        shown: Option<(ImageId, Handover)>,
    ) -> Result<(), VkError> {
        self.check_frame(frame);
        let passes = &frame.passes[..];
        let reached = self.reap()?;
        let place = match frame.staged_bytes() {
            0 => 0,
            bytes => self.stage(bytes, reached)?,
        };
        let sent = self.record_frame(frame, options, shown, (place, reached));
        self.staging.close(sent.as_ref().ok().copied());
        let now = sent?;
        let used = passes.iter().flat_map(|p| &p.draws).flat_map(|d| [d.vertices, d.indices]);
        let written = frame.writes.iter().map(|w| w.to);
        let read = passes.iter().flat_map(|p| &p.draws).flat_map(|d| &d.buffers).copied();
        for id in used.flatten().chain(read).chain(written).chain(frame.picture.map(|p| p.1)) {
            self.buffers[id].last_use = now;
        }
        Ok(())
    }

    /// Records and submits; returns the timeline value that marks completion.
    fn record_frame(
        &mut self,
        frame: &Frame<'_>,
        options: FrameOptions,
        shown: Option<(ImageId, Handover)>,
        (mut place, reached): (u64, u64),
    ) -> Result<u64, VkError> {
        let (pool, sets) = self.image_sets(&frame.passes)?;
        let cmd = match self.commands.begin(reached) {
            Ok(cmd) => cmd,
            Err(e) => {
                self.retired.push(self.timeline.submitted, Retired::Sets(pool));
                return Err(e);
            }
        };
        if options.write_twice {
            self.record_writes(cmd, &frame.writes, place, options);
        }
        place = self.record_writes(cmd, &frame.writes, place, options);
        place = self.record_image_writes(cmd, &frame.image_writes, place);
        let mut sets = sets.into_iter();
        for pass in &frame.passes {
            self.record_pass(cmd, pass, &mut sets, &mut place);
        }
        if let Some((from, to)) = frame.picture {
            self.record_copy(cmd, from, to);
        }
        if let Some((image, _)) = shown {
            self.transition_images(cmd, &[(image, vk::ImageLayout::PRESENT_SRC_KHR)]);
        }
        let handover = shown.map(|s| s.1);
        let sent = self.commands.submit(self.queue, &mut self.timeline, cmd, handover);
        self.retired.push(self.timeline.submitted, Retired::Sets(pool));
        sent
    }

    /// Allocates a pool with one set for each draw that reads images or buffers, in order.
    fn image_sets(
        &mut self,
        passes: &[Pass],
    ) -> Result<(vk::DescriptorPool, Vec<vk::DescriptorSet>), VkError> {
        let draws: Vec<&Draw> =
            passes.iter().flat_map(|p| &p.draws).filter(|d| d.has_set()).collect();
        if draws.is_empty() {
            return Ok((vk::DescriptorPool::null(), Vec::new()));
        }
        let images: usize = draws.iter().map(|d| d.images.len()).sum();
        let buffers: usize = draws.iter().map(|d| d.buffers.len()).sum();
        let kinds = [
            (vk::DescriptorType::SAMPLED_IMAGE, images),
            (vk::DescriptorType::STORAGE_BUFFER, buffers),
        ];
        let sizes: Vec<_> = kinds
            .into_iter()
            .filter(|kind| kind.1 > 0)
            .map(|(ty, n)| vk::DescriptorPoolSize { ty, descriptor_count: n as u32 })
            .collect();
        let info =
            vk::DescriptorPoolCreateInfo::default().max_sets(draws.len() as u32).pool_sizes(&sizes);
        let layouts: Vec<_> = draws.iter().map(|d| self.draw_pipelines[d.pipeline].set).collect();
        // SAFETY: the device is live, the layouts are ours, the pool has room for one set a draw.
        // The sets are fresh, so nothing uses them while they are written; views and buffers live
        // until the retire queue lets go of them.
        unsafe {
            let pool = self
                .device
                .create_descriptor_pool(&info, None)
                .map_err(VkError::of("vkCreateDescriptorPool"))?;
            let info = vk::DescriptorSetAllocateInfo::default()
                .descriptor_pool(pool)
                .set_layouts(&layouts);
            let sets = self.device.allocate_descriptor_sets(&info).map_err(|e| {
                self.device.destroy_descriptor_pool(pool, None);
                VkError::of("vkAllocateDescriptorSets")(e)
            })?;
            for (draw, set) in draws.iter().zip(&sets) {
                for (i, image) in draw.images.iter().enumerate() {
                    let found = &self.images[*image].image;
                    let stored = self.draw_pipelines[draw.pipeline].colour.is_stored()
                        && found.stored != vk::ImageView::null();
                    let shown = [vk::DescriptorImageInfo {
                        sampler: vk::Sampler::null(),
                        image_view: if stored { found.stored } else { found.view },
                        image_layout: vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
                    }];
                    let write = vk::WriteDescriptorSet::default()
                        .dst_set(*set)
                        .dst_binding(i as u32)
                        .descriptor_type(vk::DescriptorType::SAMPLED_IMAGE)
                        .image_info(&shown);
                    self.device.update_descriptor_sets(&[write], &[]);
                }
                for (i, buffer) in draw.buffers.iter().enumerate() {
                    let whole = [vk::DescriptorBufferInfo {
                        buffer: self.buffers[*buffer].buffer.raw,
                        offset: 0,
                        range: vk::WHOLE_SIZE,
                    }];
                    let write = vk::WriteDescriptorSet::default()
                        .dst_set(*set)
                        .dst_binding((draw.images.len() + i) as u32)
                        .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                        .buffer_info(&whole);
                    self.device.update_descriptor_sets(&[write], &[]);
                }
            }
            Ok((pool, sets))
        }
    }
}
