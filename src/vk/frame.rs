//! One submission to the device: writes, passes, and the picture to be read back.

use std::borrow::Cow;

use ash::vk;

use super::ids::BufferId;
use super::{Area, DrawRange, Gpu, ImageId, Pass, StageAccess};

/// Bytes to be written to a buffer before anything is drawn.
#[derive(Clone, Debug)]
pub struct Write<'a> {
    /// The buffer.
    pub to: BufferId,
    /// First byte that changes.
    pub offset: u64,
    /// New content, from that byte on.
    pub bytes: Cow<'a, [u8]>,
}

/// Pixels to be written to an image before anything is drawn. Parts of it that were never written
/// nor drawn hold anything.
#[derive(Clone, Debug)]
pub struct ImageWrite<'a> {
    /// Image that is written: colours, one sample a pixel.
    pub to: ImageId,
    /// Part of the image that is written.
    pub area: Area,
    /// Pixels of the area, rows from the top, without gaps.
    pub bytes: Cow<'a, [u8]>,
}

/// One submission. Writes come first, then passes in order, then the copy of the picture.
#[derive(Clone, Debug, Default)]
pub struct Frame<'a> {
    /// Writes to buffers; no two of them overlap.
    pub writes: Vec<Write<'a>>,
    /// Writes to images, in order.
    pub image_writes: Vec<ImageWrite<'a>>,
    /// Passes, in order.
    pub passes: Vec<Pass>,
    /// A colour image of one sample a pixel and the read-back buffer it is copied to, rows from
    /// the top, as many bytes a pixel as its format has.
    pub picture: Option<(ImageId, BufferId)>,
}

/// Knobs of a submission for tests of the tests.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, Default)]
pub struct FrameOptions {
    /// Leaves out the barriers around writes, so that validation has a hazard to find.
    pub skip_barriers: bool,
    /// Records the writes twice, as the next frame might.
    pub write_twice: bool,
}

/// Bytes of one indirect command (`VkDrawIndexedIndirectCommand`).
pub(super) const COMMAND_BYTES: u64 = 20;

impl Frame<'_> {
    /// Returns the bytes of the staging ring that the frame takes: each write and each indirect
    /// command, whole words.
    pub fn staged_bytes(&self) -> u64 {
        let writes = self.writes.iter().map(|w| (w.bytes.len() as u64).next_multiple_of(4));
        let pieces = self.passes.iter().flat_map(|p| &p.draws).map(|d| match &d.range {
            DrawRange::Indirect(ranges) => ranges.len() as u64 * COMMAND_BYTES,
            DrawRange::Direct(_) => 0,
        });
        let pixels = self.image_writes.iter().map(|w| (w.bytes.len() as u64).next_multiple_of(4));
        writes.chain(pixels).chain(pieces).sum()
    }
}

/// Stage and accesses by which draws read buffers that frames write.
const DRAWN: StageAccess = (
    vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::VERTEX_INPUT.as_raw()
            | vk::PipelineStageFlags2::VERTEX_SHADER.as_raw()
            | vk::PipelineStageFlags2::FRAGMENT_SHADER.as_raw(),
    ),
    vk::AccessFlags2::from_raw(
        vk::AccessFlags2::VERTEX_ATTRIBUTE_READ.as_raw()
            | vk::AccessFlags2::INDEX_READ.as_raw()
            | vk::AccessFlags2::SHADER_STORAGE_READ.as_raw(),
    ),
);
const COPIED: StageAccess = (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::TRANSFER_WRITE);

impl Gpu {
    /// Checks that each write lies in its buffer and no two overlap, and notes how far index buffers
    /// are written and the largest index they may hold.
    pub(super) fn check_writes(&mut self, writes: &[Write<'_>]) {
        let mut spans = Vec::with_capacity(writes.len());
        for w in writes {
            let b = &mut self.buffers[w.to];
            let end = w.offset.checked_add(w.bytes.len() as u64).expect("write past the end");
            assert!(end <= b.buffer.bytes, "write past the end of its buffer");
            if b.holds_indices {
                let (indices, rest) = w.bytes.as_chunks();
                assert!(w.offset % 4 == 0 && rest.is_empty(), "half an index");
                let indices = indices.iter().map(|i| u32::from_ne_bytes(*i));
                b.max_index = indices.fold(b.max_index, u32::max);
            }
            spans.push((w.to, w.offset, end));
        }
        spans.sort_unstable();
        assert!(
            spans.windows(2).all(|s| s[0].0 != s[1].0 || s[0].2 <= s[1].1),
            "two writes to one place in one frame"
        );
        for (to, from, end) in spans {
            if let Some(written) = &mut self.buffers[to].written
                && from <= *written
            {
                *written = end.max(*written);
            }
        }
    }

    /// Takes back the effect of [`Gpu::check_writes`] on how far index buffers are written, where a
    /// submission failed or was never made: its writes may not have been done.
    pub(super) fn forget_writes(&mut self, writes: &[Write<'_>]) {
        for w in writes {
            if let Some(written) = &mut self.buffers[w.to].written {
                *written = w.offset.min(*written);
            }
        }
    }

    /// Puts the writes into the ring from `place` on and records their copies; returns the place
    /// after them.
    ///
    /// The barrier before waits for draws of earlier submissions, which may still read what is to
    /// be overwritten, and for their copies; the one after lets draws of this one see the bytes.
    pub(super) fn record_writes(
        &mut self,
        cmd: vk::CommandBuffer,
        writes: &[Write<'_>],
        mut place: u64,
        options: FrameOptions,
    ) -> u64 {
        if writes.is_empty() {
            return place;
        }
        if !options.skip_barriers {
            self.memory_barrier(cmd, (DRAWN.0 | COPIED.0, COPIED.1), COPIED);
        }
        // One command a run of writes to the same buffer.
        let mut regions = Vec::new();
        for same in writes.chunk_by(|a, b| a.to == b.to) {
            regions.clear();
            for w in same.iter().filter(|w| !w.bytes.is_empty()) {
                let n = w.bytes.len() as u64;
                self.staging.bytes_mut(place, n).copy_from_slice(&w.bytes);
                let region = vk::BufferCopy { src_offset: place, dst_offset: w.offset, size: n };
                regions.push(region);
                place += n.next_multiple_of(4);
            }
            let to = self.buffers[same[0].to].buffer.raw;
            if let (Some(from), false) = (&self.staging.buffer, regions.is_empty()) {
                // SAFETY: `cmd` is recording; both buffers are ours and live until the timeline
                // passes this submission (the ring's through the retire queue); regions lie within
                // both (`check_writes`, `stage`) and do not overlap; nobody else writes this part
                // of the ring until then.
                unsafe { self.device.cmd_copy_buffer(cmd, from.raw, to, &regions) };
            }
        }
        if !options.skip_barriers {
            self.memory_barrier(cmd, COPIED, DRAWN);
        }
        place
    }

    /// Puts pixels into the ring from `place` on and records their copies; returns the place after
    /// them. Each is preceded by a barrier that waits for everything before it.
    pub(super) fn record_image_writes(
        &mut self,
        cmd: vk::CommandBuffer,
        writes: &[ImageWrite<'_>],
        mut place: u64,
    ) -> u64 {
        for w in writes {
            self.transition_images(cmd, &[(w.to, vk::ImageLayout::TRANSFER_DST_OPTIMAL)]);
            let n = w.bytes.len() as u64;
            self.staging.bytes_mut(place, n).copy_from_slice(&w.bytes);
            let image = &self.images[w.to].image;
            let a = w.area;
            let region = vk::BufferImageCopy::default()
                .buffer_offset(place)
                .image_subresource(vk::ImageSubresourceLayers {
                    aspect_mask: image.aspect,
                    layer_count: 1,
                    ..Default::default()
                })
                .image_offset(vk::Offset3D { x: a.x as i32, y: a.y as i32, z: 0 })
                .image_extent(vk::Extent3D { width: a.width, height: a.height, depth: 1 });
            place += n.next_multiple_of(4);
            if let Some(from) = &self.staging.buffer {
                let layout = vk::ImageLayout::TRANSFER_DST_OPTIMAL;
                // SAFETY: `cmd` is recording; ring and image are ours and live until the timeline
                // passes this submission; the area lies in the image and its bytes in the ring
                // (`check_image_write`, `stage`); the barrier above brought it into this layout.
                unsafe {
                    self.device.cmd_copy_buffer_to_image(
                        cmd,
                        from.raw,
                        image.raw,
                        layout,
                        &[region],
                    );
                }
            }
        }
        place
    }

    /// Records a memory barrier.
    pub(super) fn memory_barrier(
        &self,
        cmd: vk::CommandBuffer,
        from: StageAccess,
        to: StageAccess,
    ) {
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(from.0)
            .src_access_mask(from.1)
            .dst_stage_mask(to.0)
            .dst_access_mask(to.1)];
        let info = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: `cmd` is recording on this device; a memory barrier names no handle.
        unsafe { self.device.cmd_pipeline_barrier2(cmd, &info) };
    }
}
