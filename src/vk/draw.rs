//! Draw passes as data: recorded into one command buffer and submitted; the caller reads the
//! picture when it likes, so several frames can be in flight.

use std::ops::Range;

use ash::vk;

use super::draw_pipeline::{DrawPipelineId, STAGES};
use super::frame::{COMMAND_BYTES, Frame, FrameOptions};
use super::resources::{BufferId, Dead, ImageId};
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

/// Some of an index buffer's triangles, with vertices counted from a place of their own.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Piece {
    /// First index taken.
    pub first_index: u32,
    /// Indices taken.
    pub indices: u32,
    /// Added to every index.
    pub first_vertex: u32,
}

/// What of its buffers a draw takes.
#[derive(Clone, Debug)]
pub enum Take {
    /// A range of indices, or of vertices where there are no indices.
    Range(Range<u32>),
    /// Pieces in this order, by one indirect command where the device can.
    Pieces(Vec<Piece>),
}

/// Triangles from one pair of buffers.
#[derive(Clone, Debug)]
pub struct Draw {
    /// How.
    pub pipeline: DrawPipelineId,
    /// The immediate block; as long as the pipeline's.
    pub push: Vec<u8>,
    /// Vertices, unless the pipeline takes none.
    pub vertices: Option<BufferId>,
    /// Indices; without them vertices are taken in order.
    pub indices: Option<BufferId>,
    /// Which of them.
    pub take: Take,
    /// Images the fragments read, as many as the pipeline has.
    pub images: Vec<ImageId>,
}

/// Draws to one set of targets. Each pass sees everything earlier passes drew.
#[derive(Clone, Debug)]
pub struct Pass {
    /// Colour target.
    pub colour: ImageId,
    /// Where a multisampled colour target is averaged to at the end.
    pub resolve: Option<ImageId>,
    /// Depth target; always cleared to infinity.
    pub depth: Option<ImageId>,
    /// Shaders write sRGB themselves ([`super::Format::Rgba8Stored`]): the colour target, one sample
    /// a pixel and not resolved, takes their numbers as they are.
    pub encoded: bool,
    /// Colour the area is cleared to, linear or as `encoded` says; `None` keeps it.
    pub clear: Option<[f32; 4]>,
    /// The part of the targets that is drawn to.
    pub area: Area,
    /// In order.
    pub draws: Vec<Draw>,
}

const EVERYTHING: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::ALL_COMMANDS;

impl Gpu {
    /// Records and submits a frame and returns without waiting; [`Gpu::read`] waits.
    ///
    /// # Errors
    /// [`VkError::StagingFull`] if earlier frames still hold the staging ring: nothing was done,
    /// and [`Gpu::make_room`] waits for them; [`VkError::OutOfMemory`], [`VkError::DeviceLost`],
    /// or the failing call.
    ///
    /// # Panics
    /// If a handle is stale, a write does not fit its buffer, two writes overlap, or a draw does
    /// not fit its pipeline or buffers: errors of the caller.
    pub fn submit_draws(&mut self, frame: &Frame<'_>) -> Result<(), VkError> {
        self.submit_draws_with(frame, FrameOptions::default())
    }

    /// [`Gpu::submit_draws`] with knobs.
    ///
    /// # Errors
    /// As [`Gpu::submit_draws`].
    #[doc(hidden)]
    pub fn submit_draws_with(
        &mut self,
        frame: &Frame<'_>,
        options: FrameOptions,
    ) -> Result<(), VkError> {
        let passes = &frame.passes[..];
        self.check_writes(&frame.writes);
        for draw in passes.iter().flat_map(|p| &p.draws) {
            self.check_draw(draw);
        }
        let reached = self.reap()?;
        let place = match frame.staged_bytes() {
            0 => 0,
            bytes => self.stage(bytes, reached)?,
        };
        let sent = self.record_frame(frame, options, place, reached);
        self.staging.close(sent.as_ref().ok().copied());
        let now = sent?;
        let used = passes.iter().flat_map(|p| &p.draws).flat_map(|d| [d.vertices, d.indices]);
        let written = frame.writes.iter().map(|w| w.to);
        for id in used.flatten().chain(written).chain(frame.picture.map(|p| p.1)) {
            self.buffers.get_mut(id).last_use = now;
        }
        Ok(())
    }

    /// Records and submits; returns the timeline value that marks completion.
    fn record_frame(
        &mut self,
        frame: &Frame<'_>,
        options: FrameOptions,
        mut place: u64,
        reached: u64,
    ) -> Result<u64, VkError> {
        let (pool, sets) = self.image_sets(&frame.passes)?;
        let cmd = match self.commands.begin(&self.device, reached) {
            Ok(cmd) => cmd,
            Err(e) => {
                self.dead.push(self.timeline.submitted, Dead::Sets(pool));
                return Err(e);
            }
        };
        if options.write_twice {
            self.record_writes(cmd, &frame.writes, place, options);
        }
        place = self.record_writes(cmd, &frame.writes, place, options);
        let mut sets = sets.into_iter();
        for pass in &frame.passes {
            self.record_pass(cmd, pass, &mut sets, &mut place);
        }
        if let Some((from, to)) = frame.picture {
            self.record_copy(cmd, from, to);
        }
        let sent = self.commands.submit(&self.device, self.queue, &mut self.timeline, cmd);
        self.dead.push(self.timeline.submitted, Dead::Sets(pool));
        sent
    }

    fn check_draw(&self, draw: &Draw) {
        let p = self.draw_pipelines.get(draw.pipeline);
        assert_eq!(draw.push.len(), p.push_bytes as usize, "immediate block");
        assert_eq!(draw.images.len(), p.images as usize, "images");
        let bytes = |id: Option<BufferId>| id.map_or(0, |b| self.buffers.get(b).buffer.bytes);
        let vertices = match p.stride {
            0 => u64::MAX,
            stride => bytes(draw.vertices) / u64::from(stride),
        };
        let index = draw.indices.map(|i| self.buffers.get(i));
        let room = index.map_or(0, |i| i.buffer.bytes / u64::from(i.index_bytes.max(1)));
        assert!(index.is_none_or(|i| i.index_bytes > 0), "an index buffer");
        let last = index.map_or(0, |i| u64::from(i.max_index));
        match (&draw.take, index) {
            (Take::Range(r), Some(_)) => {
                assert!(u64::from(r.end) <= room, "index range");
                assert!(last < vertices, "index past vertices");
            }
            (Take::Range(r), None) => assert!(u64::from(r.end) <= vertices, "vertex range"),
            (Take::Pieces(pieces), _) => {
                assert!(index.is_some(), "pieces have indices");
                for p in pieces {
                    let end = u64::from(p.first_index) + u64::from(p.indices);
                    assert!(end <= room, "index range");
                    let v = u64::from(p.first_vertex);
                    assert!(v <= i32::MAX as u64 && v + last < vertices, "index past vertices");
                }
            }
        }
    }

    /// A pool with one set for each draw that reads images, in order.
    fn image_sets(
        &mut self,
        passes: &[Pass],
    ) -> Result<(vk::DescriptorPool, Vec<vk::DescriptorSet>), VkError> {
        let draws: Vec<&Draw> =
            passes.iter().flat_map(|p| &p.draws).filter(|d| !d.images.is_empty()).collect();
        if draws.is_empty() {
            return Ok((vk::DescriptorPool::null(), Vec::new()));
        }
        let images: usize = draws.iter().map(|d| d.images.len()).sum();
        let sizes = [vk::DescriptorPoolSize {
            ty: vk::DescriptorType::SAMPLED_IMAGE,
            descriptor_count: images as u32,
        }];
        let info =
            vk::DescriptorPoolCreateInfo::default().max_sets(draws.len() as u32).pool_sizes(&sizes);
        let layouts: Vec<_> =
            draws.iter().map(|d| self.draw_pipelines.get(d.pipeline).set).collect();
        // SAFETY: the device is live, the layouts are ours, the pool has room for one set a draw.
        // The sets are fresh, so nothing uses them while they are written; the views live until
        // the retire queue lets go of their images.
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
                    let shown = [vk::DescriptorImageInfo {
                        sampler: vk::Sampler::null(),
                        image_view: self.images.get(*image).image.view,
                        image_layout: vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL,
                    }];
                    let write = vk::WriteDescriptorSet::default()
                        .dst_set(*set)
                        .dst_binding(i as u32)
                        .descriptor_type(vk::DescriptorType::SAMPLED_IMAGE)
                        .image_info(&shown);
                    self.device.update_descriptor_sets(&[write], &[]);
                }
            }
            Ok((pool, sets))
        }
    }

    /// One barrier that waits for everything before and brings images into their layouts.
    fn turn(&mut self, cmd: vk::CommandBuffer, images: &[(ImageId, vk::ImageLayout)]) {
        let memory = [vk::MemoryBarrier2::default()
            .src_stage_mask(EVERYTHING)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(EVERYTHING)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)];
        let mut turns = Vec::with_capacity(images.len());
        for (id, layout) in images {
            let image = self.images.get_mut(*id);
            turns.push(
                vk::ImageMemoryBarrier2::default()
                    .src_stage_mask(EVERYTHING)
                    .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
                    .dst_stage_mask(EVERYTHING)
                    .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)
                    .old_layout(image.layout)
                    .new_layout(*layout)
                    .image(image.image.raw)
                    .subresource_range(vk::ImageSubresourceRange {
                        aspect_mask: image.image.aspect,
                        level_count: 1,
                        layer_count: 1,
                        ..Default::default()
                    }),
            );
            image.layout = *layout;
        }
        let info =
            vk::DependencyInfo::default().memory_barriers(&memory).image_memory_barriers(&turns);
        // SAFETY: `cmd` is recording; the images are live and in the layouts we have tracked.
        unsafe { self.device.cmd_pipeline_barrier2(cmd, &info) };
    }

    fn record_pass(
        &mut self,
        cmd: vk::CommandBuffer,
        pass: &Pass,
        sets: &mut impl Iterator<Item = vk::DescriptorSet>,
        place: &mut u64,
    ) {
        let colour_layout = vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL;
        let depth_layout = vk::ImageLayout::DEPTH_ATTACHMENT_OPTIMAL;
        let mut turns = vec![(pass.colour, colour_layout)];
        turns.extend(pass.resolve.map(|r| (r, colour_layout)));
        turns.extend(pass.depth.map(|d| (d, depth_layout)));
        for image in pass.draws.iter().flat_map(|d| &d.images) {
            if turns.iter().all(|t| t.0 != *image) {
                turns.push((*image, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL));
            }
        }
        self.turn(cmd, &turns);

        let a = pass.area;
        let extent = self.images.get(pass.colour).image.extent;
        assert!(a.x + a.width <= extent[0] && a.y + a.height <= extent[1], "area in the target");
        let rect = vk::Rect2D {
            offset: vk::Offset2D { x: a.x as i32, y: a.y as i32 },
            extent: vk::Extent2D { width: a.width, height: a.height },
        };
        let viewport = vk::Viewport {
            x: a.x as f32,
            y: a.y as f32,
            width: a.width as f32,
            height: a.height as f32,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        let target = &self.images.get(pass.colour).image;
        let view = if pass.encoded { target.stored } else { target.view };
        assert!(view != vk::ImageView::null(), "an encoded target is stored as sRGB");
        let mut colour = vk::RenderingAttachmentInfo::default()
            .image_view(view)
            .image_layout(colour_layout)
            .load_op(vk::AttachmentLoadOp::LOAD)
            .store_op(vk::AttachmentStoreOp::STORE);
        if let Some(float32) = pass.clear {
            colour = colour
                .load_op(vk::AttachmentLoadOp::CLEAR)
                .clear_value(vk::ClearValue { color: vk::ClearColorValue { float32 } });
        }
        if let Some(resolve) = pass.resolve {
            colour = colour
                .resolve_mode(vk::ResolveModeFlags::AVERAGE)
                .resolve_image_view(self.images.get(resolve).image.view)
                .resolve_image_layout(colour_layout);
        }
        let colours = [colour];
        let far = vk::ClearDepthStencilValue { depth: 0.0, stencil: 0 };
        let depth = pass.depth.map(|d| {
            vk::RenderingAttachmentInfo::default()
                .image_view(self.images.get(d).image.view)
                .image_layout(depth_layout)
                .load_op(vk::AttachmentLoadOp::CLEAR)
                .store_op(vk::AttachmentStoreOp::DONT_CARE)
                .clear_value(vk::ClearValue { depth_stencil: far })
        });
        let mut info = vk::RenderingInfo::default()
            .render_area(rect)
            .layer_count(1)
            .color_attachments(&colours);
        if let Some(depth) = &depth {
            info = info.depth_attachment(depth);
        }
        // SAFETY: `cmd` is recording; viewport and area lie in the target, as asserted above; the
        // views are of live images, in the layouts named, that live until the timeline passes
        // this submission.
        unsafe {
            self.device.cmd_begin_rendering(cmd, &info);
            self.device.cmd_set_viewport(cmd, 0, &[viewport]);
            self.device.cmd_set_scissor(cmd, 0, &[rect]);
        }
        for draw in &pass.draws {
            // SAFETY: `cmd` is recording within a rendering; every handle below was found live in
            // its slab and stays so until the timeline passes this submission.
            unsafe {
                let p = self.draw_pipelines.get(draw.pipeline);
                let point = vk::PipelineBindPoint::GRAPHICS;
                self.device.cmd_bind_pipeline(cmd, point, p.pipeline);
                if !draw.images.is_empty() {
                    let set = sets.next().expect("one set a draw with images");
                    self.device.cmd_bind_descriptor_sets(cmd, point, p.layout, 0, &[set], &[]);
                }
                if !draw.push.is_empty() {
                    self.device.cmd_push_constants(cmd, p.layout, STAGES, 0, &draw.push);
                }
                if let Some(v) = draw.vertices {
                    let raw = self.buffers.get(v).buffer.raw;
                    self.device.cmd_bind_vertex_buffers(cmd, 0, &[raw], &[0]);
                }
                if let Some(i) = draw.indices {
                    let i = self.buffers.get(i);
                    let kind = match i.index_bytes {
                        2 => vk::IndexType::UINT16,
                        _ => vk::IndexType::UINT32,
                    };
                    self.device.cmd_bind_index_buffer(cmd, i.buffer.raw, 0, kind);
                }
            }
            match &draw.take {
                Take::Range(r) => {
                    let (first, count) = (r.start, r.len() as u32);
                    // SAFETY: as above; `check_draw` compared the range and the largest index with
                    // the buffers.
                    unsafe {
                        match draw.indices {
                            Some(_) => self.device.cmd_draw_indexed(cmd, count, 1, first, 0, 0),
                            None => self.device.cmd_draw(cmd, count, 1, first, 0),
                        }
                    }
                }
                Take::Pieces(pieces) => self.record_pieces(cmd, pieces, place),
            }
        }
        // SAFETY: `cmd` is recording within the rendering begun above.
        unsafe { self.device.cmd_end_rendering(cmd) };
    }

    /// Draws pieces from commands in the staging ring from `place` on. The host wrote them before
    /// the submission, which makes them visible to it without a barrier.
    fn record_pieces(&mut self, cmd: vk::CommandBuffer, pieces: &[Piece], place: &mut u64) {
        let (first, at_once) = (*place, u64::from(self.info.limits.draws_at_once));
        *place += pieces.len() as u64 * COMMAND_BYTES;
        if at_once <= 1 {
            for p in pieces {
                let offset = p.first_vertex as i32;
                // SAFETY: `cmd` is recording within a rendering with pipeline and buffers bound;
                // `check_draw` compared each piece and the largest index with the buffers.
                unsafe {
                    let (n, i) = (p.indices, p.first_index);
                    self.device.cmd_draw_indexed(cmd, n, 1, i, offset, 0);
                }
            }
            return;
        }
        let bytes = self.staging.bytes_mut(first, *place - first);
        for (to, p) in bytes.chunks_exact_mut(COMMAND_BYTES as usize).zip(pieces) {
            let words = [p.indices, 1, p.first_index, p.first_vertex, 0];
            to.copy_from_slice(bytemuck::cast_slice(&words));
        }
        let Some(ring) = &self.staging.buffer else { return };
        let mut done = 0;
        while done < pieces.len() as u64 {
            let n = at_once.min(pieces.len() as u64 - done);
            let at = first + done * COMMAND_BYTES;
            // SAFETY: as above; the commands lie in the ring, which nobody writes there until the
            // timeline passes this submission, at a multiple of four; the device has
            // multiDrawIndirect and takes this many.
            unsafe {
                let stride = COMMAND_BYTES as u32;
                self.device.cmd_draw_indexed_indirect(cmd, ring.raw, at, n as u32, stride);
            }
            done += n;
        }
    }

    fn record_copy(&mut self, cmd: vk::CommandBuffer, from: ImageId, to: BufferId) {
        self.turn(cmd, &[(from, vk::ImageLayout::TRANSFER_SRC_OPTIMAL)]);
        let image = &self.images.get(from).image;
        let buffer = &self.buffers.get(to).buffer;
        let [width, height] = image.extent;
        assert!(u64::from(width) * u64::from(height) * 4 <= buffer.bytes, "room for the picture");
        let region = vk::BufferImageCopy::default()
            .image_subresource(vk::ImageSubresourceLayers {
                aspect_mask: image.aspect,
                layer_count: 1,
                ..Default::default()
            })
            .image_extent(vk::Extent3D { width, height, depth: 1 });
        let host = [vk::MemoryBarrier2::default()
            .src_stage_mask(vk::PipelineStageFlags2::COPY)
            .src_access_mask(vk::AccessFlags2::TRANSFER_WRITE)
            .dst_stage_mask(vk::PipelineStageFlags2::HOST)
            .dst_access_mask(vk::AccessFlags2::HOST_READ)];
        let info = vk::DependencyInfo::default().memory_barriers(&host);
        // SAFETY: `cmd` is recording; image and buffer are live, the image is in the layout named,
        // the buffer is long enough.
        unsafe {
            self.device.cmd_copy_image_to_buffer(
                cmd,
                image.raw,
                vk::ImageLayout::TRANSFER_SRC_OPTIMAL,
                buffer.raw,
                &[region],
            );
            self.device.cmd_pipeline_barrier2(cmd, &info);
        }
    }
}
