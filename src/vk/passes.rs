//! Recording of draw passes: layouts and barriers, targets, draws, the copy of the picture.

use ash::vk;

use super::Gpu;
use super::draw::{Area, DrawRange, IndexedRange, Pass};
use super::draw_pipeline::STAGES;
use super::frame::COMMAND_BYTES;
use super::ids::{BufferId, ImageId};

/// Layout of depth targets. `separateDepthStencilLayouts` is optional; this layout is not, and
/// holds for depth without stencil too.
const DEPTH_LAYOUT: vk::ImageLayout = vk::ImageLayout::DEPTH_STENCIL_ATTACHMENT_OPTIMAL;
const EVERYTHING: vk::PipelineStageFlags2 = vk::PipelineStageFlags2::ALL_COMMANDS;

impl Gpu {
    /// Records one barrier that waits for everything before and brings images into their layouts.
    /// Their layouts before are noted: a submission that fails changes no layout.
    pub(super) fn transition_images(
        &mut self,
        cmd: vk::CommandBuffer,
        images: &[(ImageId, vk::ImageLayout)],
    ) {
        let memory = [vk::MemoryBarrier2::default()
            .src_stage_mask(EVERYTHING)
            .src_access_mask(vk::AccessFlags2::MEMORY_WRITE)
            .dst_stage_mask(EVERYTHING)
            .dst_access_mask(vk::AccessFlags2::MEMORY_READ | vk::AccessFlags2::MEMORY_WRITE)];
        let mut transitions = Vec::with_capacity(images.len());
        for (id, layout) in images {
            let image = &mut self.images[*id];
            self.transitions.push((*id, image.layout));
            transitions.push(
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
        let info = vk::DependencyInfo::default()
            .memory_barriers(&memory)
            .image_memory_barriers(&transitions);
        // SAFETY: `cmd` is recording; the images are live and in the layouts we have tracked.
        unsafe { self.device.cmd_pipeline_barrier2(cmd, &info) };
    }

    pub(super) fn record_pass(
        &mut self,
        cmd: vk::CommandBuffer,
        pass: &Pass,
        sets: &mut impl Iterator<Item = vk::DescriptorSet>,
        place: &mut u64,
    ) {
        let colour_layout = vk::ImageLayout::COLOR_ATTACHMENT_OPTIMAL;
        let depth_layout = DEPTH_LAYOUT;
        let mut transitions = vec![(pass.colour, colour_layout)];
        transitions.extend(pass.resolve.map(|r| (r, colour_layout)));
        transitions
            .extend([pass.depth, pass.kept_depth].into_iter().flatten().map(|d| (d, depth_layout)));
        for image in pass.draws.iter().flat_map(|d| &d.images) {
            if transitions.iter().all(|t| t.0 != *image) {
                transitions.push((*image, vk::ImageLayout::SHADER_READ_ONLY_OPTIMAL));
            }
        }
        self.transition_images(cmd, &transitions);

        let a = pass.area;
        let rect = rect_of(a);
        let viewport = vk::Viewport {
            x: a.x as f32,
            y: a.y as f32,
            width: a.width as f32,
            height: a.height as f32,
            min_depth: 0.0,
            max_depth: 1.0,
        };
        let target = &self.images[pass.colour].image;
        let view = if pass.encoded { target.stored } else { target.view };
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
                .resolve_image_view(self.images[resolve].image.view)
                .resolve_image_layout(colour_layout);
        }
        let colours = [colour];
        let far = vk::ClearDepthStencilValue { depth: 0.0, stencil: 0 };
        let depth = pass.depth.map(|d| {
            let target = &self.images[d];
            let store = match target.spec.samples {
                1 => vk::AttachmentStoreOp::STORE,
                _ => vk::AttachmentStoreOp::DONT_CARE,
            };
            let depth = vk::RenderingAttachmentInfo::default()
                .image_view(target.image.view)
                .image_layout(depth_layout)
                .load_op(vk::AttachmentLoadOp::CLEAR)
                .store_op(store)
                .clear_value(vk::ClearValue { depth_stencil: far });
            match pass.kept_depth {
                // Every device can take the first sample.
                Some(kept) => depth
                    .resolve_mode(vk::ResolveModeFlags::SAMPLE_ZERO)
                    .resolve_image_view(self.images[kept].image.view)
                    .resolve_image_layout(depth_layout),
                None => depth,
            }
        });
        let mut info = vk::RenderingInfo::default()
            .render_area(rect)
            .layer_count(1)
            .color_attachments(&colours);
        if let Some(depth) = &depth {
            info = info.depth_attachment(depth);
        }
        // SAFETY: `cmd` is recording; viewport and area lie in the targets (`check_pass`); the
        // views are of live images, in the layouts named, that live until the timeline passes
        // this submission.
        unsafe {
            self.device.cmd_begin_rendering(cmd, &info);
            self.device.cmd_set_viewport(cmd, 0, &[viewport]);
        }
        for draw in &pass.draws {
            // SAFETY: `cmd` is recording within a rendering; every handle below was found live in
            // its slab and stays so until the timeline passes this submission.
            unsafe {
                let p = &self.draw_pipelines[draw.pipeline];
                let point = vk::PipelineBindPoint::GRAPHICS;
                self.device.cmd_bind_pipeline(cmd, point, p.pipeline);
                if draw.has_set() {
                    let set = sets.next().expect("one set a draw that reads");
                    self.device.cmd_bind_descriptor_sets(cmd, point, p.layout, 0, &[set], &[]);
                }
                if !draw.push.is_empty() {
                    self.device.cmd_push_constants(cmd, p.layout, STAGES, 0, &draw.push);
                }
                let scissor = draw.scissor.map_or(rect, rect_of);
                self.device.cmd_set_scissor(cmd, 0, &[scissor]);
                if let Some(v) = draw.vertices {
                    let raw = self.buffers[v].buffer.raw;
                    self.device.cmd_bind_vertex_buffers(cmd, 0, &[raw], &[0]);
                }
                if let Some(i) = draw.indices {
                    let raw = self.buffers[i].buffer.raw;
                    self.device.cmd_bind_index_buffer(cmd, raw, 0, vk::IndexType::UINT32);
                }
            }
            match &draw.range {
                DrawRange::Direct(r) => {
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
                DrawRange::Indirect(ranges) => self.record_indirect(cmd, ranges, place),
            }
        }
        // SAFETY: `cmd` is recording within the rendering begun above.
        unsafe { self.device.cmd_end_rendering(cmd) };
    }

    /// Draws ranges by commands in the staging ring from `place` on. The host wrote them before
    /// the submission, which makes them visible to it without a barrier.
    fn record_indirect(
        &mut self,
        cmd: vk::CommandBuffer,
        ranges: &[IndexedRange],
        place: &mut u64,
    ) {
        let (first, at_once) = (*place, u64::from(self.info.limits.draws_at_once));
        *place += ranges.len() as u64 * COMMAND_BYTES;
        if at_once <= 1 {
            for p in ranges {
                let offset = p.first_vertex as i32;
                // SAFETY: `cmd` is recording within a rendering with pipeline and buffers bound;
                // `check_draw` compared each range and the largest index with the buffers.
                unsafe {
                    let (n, i) = (p.indices, p.first_index);
                    self.device.cmd_draw_indexed(cmd, n, 1, i, offset, p.instance);
                }
            }
            return;
        }
        let bytes = self.staging.bytes_mut(first, *place - first);
        for (to, p) in bytes.chunks_exact_mut(COMMAND_BYTES as usize).zip(ranges) {
            let words = [p.indices, 1, p.first_index, p.first_vertex, p.instance];
            to.copy_from_slice(bytemuck::cast_slice(&words));
        }
        let Some(ring) = &self.staging.buffer else { return };
        let mut done = 0;
        while done < ranges.len() as u64 {
            let n = at_once.min(ranges.len() as u64 - done);
            let at = first + done * COMMAND_BYTES;
            // SAFETY: as above; the commands lie in the ring, which nobody writes there until the
            // timeline passes this submission, at a multiple of four; the device has
            // multiDrawIndirect and drawIndirectFirstInstance and takes this many.
            unsafe {
                let stride = COMMAND_BYTES as u32;
                self.device.cmd_draw_indexed_indirect(cmd, ring.raw, at, n as u32, stride);
            }
            done += n;
        }
    }

    pub(super) fn record_copy(&mut self, cmd: vk::CommandBuffer, from: ImageId, to: BufferId) {
        self.transition_images(cmd, &[(from, vk::ImageLayout::TRANSFER_SRC_OPTIMAL)]);
        let image = &self.images[from].image;
        let buffer = &self.buffers[to].buffer;
        let [width, height] = image.extent;
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
        // the
        // buffer is long enough (`check_picture`).
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

fn rect_of(a: Area) -> vk::Rect2D {
    vk::Rect2D {
        offset: vk::Offset2D { x: a.x as i32, y: a.y as i32 },
        extent: vk::Extent2D { width: a.width, height: a.height },
    }
}

#[cfg(test)]
mod tests {
    use ash::vk;

    #[test]
    fn depth_targets_have_a_layout_that_needs_no_feature() {
        let separate = [
            vk::ImageLayout::DEPTH_ATTACHMENT_OPTIMAL,
            vk::ImageLayout::DEPTH_READ_ONLY_OPTIMAL,
            vk::ImageLayout::STENCIL_ATTACHMENT_OPTIMAL,
            vk::ImageLayout::STENCIL_READ_ONLY_OPTIMAL,
        ];
        assert!(!separate.contains(&super::DEPTH_LAYOUT));
    }
}
