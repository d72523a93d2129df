//! Buffers and images that outlive one submission, by handle: sources, targets and read-back of the
//! renderer.

use ash::vk;

use super::ids::{BufferId, ImageId, ResourceId};
use super::memory::{self, Buffer, ImageDesc, MemoryUse};
use super::{Gpu, VkError};

/// Pixel formats drawing uses; every Vulkan 1.3 device can draw to them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Format {
    /// Four bytes, encoded as sRGB on writing; shaders and blending see linear light.
    Rgba8Srgb,
    /// Four bytes, red first, stored as the shader writes them, which are encoded already
    /// ([`super::Pass::encoded`]).
    Rgba8Stored,
    /// Four bytes stored as by [`Format::Rgba8Stored`], blue first, as windows often want them.
    Bgra8Stored,
    /// Four half floats, linear.
    Rgba16Float,
    /// Four floats of 32 bits, linear.
    Rgba32Float,
    /// 32-bit float depth.
    Depth32,
}

impl Format {
    pub(super) fn raw(self) -> vk::Format {
        match self {
            Self::Rgba8Srgb => vk::Format::R8G8B8A8_SRGB,
            Self::Rgba8Stored => vk::Format::R8G8B8A8_UNORM,
            Self::Bgra8Stored => vk::Format::B8G8R8A8_UNORM,
            Self::Rgba16Float => vk::Format::R16G16B16A16_SFLOAT,
            Self::Rgba32Float => vk::Format::R32G32B32A32_SFLOAT,
            Self::Depth32 => vk::Format::D32_SFLOAT,
        }
    }

    /// Whether numbers are kept as shaders write them: colours are encoded already.
    pub(super) fn is_stored(self) -> bool {
        matches!(self, Self::Rgba8Stored | Self::Bgra8Stored)
    }

    /// Returns the size of one sample of a pixel, bytes.
    pub fn pixel_bytes(self) -> u64 {
        match self {
            Self::Rgba8Srgb | Self::Rgba8Stored | Self::Bgra8Stored | Self::Depth32 => 4,
            Self::Rgba16Float => 8,
            Self::Rgba32Float => 16,
        }
    }
}

/// Description of an image to be created.
#[derive(Clone, Copy, Debug)]
pub struct ImageSpec {
    /// Pixel format.
    pub format: Format,
    /// Width and height.
    pub extent: [u32; 2],
    /// Samples a pixel.
    pub samples: u32,
}

/// A buffer of the device with its history.
pub(super) struct GpuBuffer {
    pub(super) buffer: Buffer,
    /// Timeline value of its latest use.
    pub(super) last_use: u64,
    /// Whether it holds indices, words of 32 bits.
    pub(super) holds_indices: bool,
    pub(super) holds_vertices: bool,
    /// Whether shaders of draws read it.
    pub(super) is_storage: bool,
    /// Whether the host reads it.
    pub(super) reads_back: bool,
    /// Largest vertex that the indices of an index buffer name, or have ever named.
    pub(super) max_index: u32,
    /// Bytes of an index buffer that frames have written so far, from the first without a gap; `None`
    /// of all other buffers. Memory that was never written may hold any index.
    pub(super) written: Option<u64>,
}

/// An image of the device with its history.
pub(super) struct GpuImage {
    pub(super) spec: ImageSpec,
    pub(super) image: memory::Image,
    pub(super) layout: vk::ImageLayout,
}

impl Gpu {
    /// Creates a vertex buffer on the device.
    ///
    /// # Errors
    /// [`VkError::OutOfMemory`], [`VkError::DeviceLost`], or the failing call.
    pub fn vertex_buffer(&mut self, name: &str, data: &[u8]) -> Result<BufferId, VkError> {
        self.filled(name, data, vk::BufferUsageFlags::VERTEX_BUFFER, 0)
    }

    /// Creates a vertex buffer of `bytes`, to be written by frames; until then its content is
    /// undefined.
    ///
    /// # Errors
    /// As [`Gpu::vertex_buffer`]; [`VkError::TooLarge`].
    pub fn empty_vertices(&mut self, name: &'static str, bytes: u64) -> Result<BufferId, VkError> {
        self.unwritten(name, bytes, vk::BufferUsageFlags::VERTEX_BUFFER)
    }

    /// Creates a buffer of `count` indices, to be written by frames from its start on, and drawn as far
    /// as it was written.
    ///
    /// # Errors
    /// As [`Gpu::empty_vertices`].
    pub fn empty_indices(&mut self, name: &'static str, count: u64) -> Result<BufferId, VkError> {
        let bytes = count.saturating_mul(size_of::<u32>() as u64);
        let id = self.unwritten(name, bytes, vk::BufferUsageFlags::INDEX_BUFFER)?;
        self.buffers[id].written = Some(0);
        Ok(id)
    }

    /// Creates a buffer of words that the shaders of draws read, to be written by frames; until then
    /// its content is undefined.
    ///
    /// # Errors
    /// As [`Gpu::storage_buffer`].
    pub fn empty_storage(&mut self, name: &'static str, bytes: u64) -> Result<BufferId, VkError> {
        self.check_storage(name, bytes)?;
        self.unwritten(name, bytes, vk::BufferUsageFlags::STORAGE_BUFFER)
    }

    /// Creates an index buffer on the device.
    ///
    /// # Errors
    /// As [`Gpu::vertex_buffer`].
    pub fn index_buffer(&mut self, name: &str, data: &[u32]) -> Result<BufferId, VkError> {
        let max = data.iter().copied().max().unwrap_or(0);
        self.filled(name, bytemuck::cast_slice(data), vk::BufferUsageFlags::INDEX_BUFFER, max)
    }

    /// Creates a buffer of words on the device that the shaders of draws read.
    ///
    /// # Errors
    /// As [`Gpu::vertex_buffer`]; [`VkError::TooLarge`] if the device cannot bind so many.
    pub fn storage_buffer(&mut self, name: &'static str, data: &[u8]) -> Result<BufferId, VkError> {
        self.check_storage(name, data.len() as u64)?;
        self.filled(name, data, vk::BufferUsageFlags::STORAGE_BUFFER, 0)
    }

    fn check_storage(&self, buffer: &'static str, bytes: u64) -> Result<(), VkError> {
        let limit = self.info.max_storage_buffer_range;
        if bytes > limit {
            let device = self.info.name.clone();
            return Err(VkError::TooLarge { buffer, bytes, limit, device });
        }
        Ok(())
    }

    /// Creates a persistently mapped buffer that images are copied to.
    ///
    /// # Errors
    /// As [`Gpu::vertex_buffer`].
    pub fn readback_buffer(&mut self, name: &str, bytes: u64) -> Result<BufferId, VkError> {
        let usage = vk::BufferUsageFlags::TRANSFER_DST;
        let buffer = self.new_buffer(name, bytes, usage, MemoryUse::Readback)?;
        Ok(self.insert(buffer, usage, 0))
    }

    /// Creates an image to draw to; with one sample a pixel it can also be read in shaders, and one of
    /// colours written and read back.
    ///
    /// # Errors
    /// As [`Gpu::vertex_buffer`].
    pub fn image(&mut self, name: &str, spec: ImageSpec) -> Result<ImageId, VkError> {
        use vk::ImageUsageFlags as Use;
        let depth = spec.format == Format::Depth32;
        let usage = match (depth, spec.samples) {
            (true, 1) => Use::DEPTH_STENCIL_ATTACHMENT | Use::SAMPLED,
            (true, _) => Use::DEPTH_STENCIL_ATTACHMENT,
            (false, 1) => {
                Use::COLOR_ATTACHMENT | Use::TRANSFER_SRC | Use::TRANSFER_DST | Use::SAMPLED
            }
            (false, _) => Use::COLOR_ATTACHMENT,
        };
        let aspect = if depth { vk::ImageAspectFlags::DEPTH } else { vk::ImageAspectFlags::COLOR };
        let desc = ImageDesc {
            format: spec.format.raw(),
            extent: spec.extent,
            samples: spec.samples,
            pixel_bytes: spec.format.pixel_bytes(),
            usage,
            aspect,
        };
        let image = self.with_memory(|m| m.image(name, desc))?;
        let id = self.images.insert(GpuImage { spec, image, layout: vk::ImageLayout::UNDEFINED });
        self.note_made(ResourceId::Image(id));
        Ok(id)
    }

    /// Columns and rows of an image.
    ///
    /// # Panics
    /// If the handle is stale.
    pub fn image_extent(&self, id: ImageId) -> [u32; 2] {
        self.images[id].spec.extent
    }

    /// Returns the bytes of a read-back buffer, after waiting for the device's last write to it.
    ///
    /// # Errors
    /// [`VkError::DeviceLost`] when there is nothing left to wait for.
    ///
    /// # Panics
    /// If the buffer is not a read-back buffer.
    pub fn read(&mut self, id: BufferId) -> Result<&[u8], VkError> {
        let last_use = self.buffers[id].last_use;
        self.wait(last_use, "a frame that is read back")?;
        Ok(self.buffers[id].buffer.mapped().expect("read-back memory is mapped"))
    }

    /// Creates a buffer, out of retired memory where it is short ([`Gpu::with_memory`]).
    pub(super) fn new_buffer(
        &mut self,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        memory_use: MemoryUse,
    ) -> Result<Buffer, VkError> {
        self.with_memory(|m| m.buffer(name, bytes, usage, memory_use))
    }

    fn filled(
        &mut self,
        name: &str,
        data: &[u8],
        usage: vk::BufferUsageFlags,
        max_index: u32,
    ) -> Result<BufferId, VkError> {
        let bytes = data.len() as u64;
        let usage = usage | vk::BufferUsageFlags::TRANSFER_DST;
        let mut buffer = self.new_buffer(name, bytes, usage, MemoryUse::Device)?;
        if self.memory.unified()
            && let Some(to) = buffer.mapped_mut()
        {
            to[..data.len()].copy_from_slice(data);
        } else if let Err(e) = self.copy_in(name, data, &buffer) {
            self.memory.free_buffer(buffer);
            return Err(e);
        }
        Ok(self.insert(buffer, usage, max_index))
    }

    /// Takes over a buffer; returns its handle.
    pub(super) fn insert(
        &mut self,
        buffer: Buffer,
        usage: vk::BufferUsageFlags,
        max_index: u32,
    ) -> BufferId {
        let made = GpuBuffer {
            buffer,
            last_use: self.timeline.submitted,
            holds_indices: usage.contains(vk::BufferUsageFlags::INDEX_BUFFER),
            holds_vertices: usage.contains(vk::BufferUsageFlags::VERTEX_BUFFER),
            is_storage: usage.contains(vk::BufferUsageFlags::STORAGE_BUFFER),
            reads_back: usage == vk::BufferUsageFlags::TRANSFER_DST,
            max_index,
            written: None,
        };
        let id = self.buffers.insert(made);
        self.note_made(ResourceId::Buffer(id));
        id
    }

    /// Creates a buffer that frames write. It is not cleared: it has room for more than most flights
    /// write, and the system provides memory only where it is touched.
    fn unwritten(
        &mut self,
        name: &'static str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
    ) -> Result<BufferId, VkError> {
        let limit = self.info.max_buffer_bytes;
        if bytes > limit {
            let device = self.info.name.clone();
            return Err(VkError::TooLarge { buffer: name, bytes, limit, device });
        }
        let usage = usage | vk::BufferUsageFlags::TRANSFER_DST;
        let buffer = self.new_buffer(name, bytes, usage, MemoryUse::Device)?;
        Ok(self.insert(buffer, usage, 0))
    }

    /// Records, submits and waits. After an error the device is idle, or given up.
    fn at_once(&mut self, record: impl FnOnce(&Self, vk::CommandBuffer)) -> Result<(), VkError> {
        let done = (|| {
            let reached = self.reached()?;
            let cmd = self.commands.begin(reached)?;
            record(self, cmd);
            let value = self.commands.submit(self.queue, &mut self.timeline, cmd, None)?;
            self.wait(value, "an upload")
        })();
        if done.is_err() {
            self.comes_to_rest();
        }
        done
    }

    /// Copies through staging memory and waits.
    fn copy_in(&mut self, name: &str, data: &[u8], to: &Buffer) -> Result<(), VkError> {
        if data.is_empty() {
            return Ok(());
        }
        let usage = vk::BufferUsageFlags::TRANSFER_SRC;
        let mut from = self.new_buffer(name, data.len() as u64, usage, MemoryUse::Upload)?;
        from.mapped_mut().expect("upload memory is mapped")[..data.len()].copy_from_slice(data);
        let done = self.at_once(|gpu, cmd| {
            let all = [vk::BufferCopy::default().size(data.len() as u64)];
            // SAFETY: `cmd` is recording; both buffers are ours, at least this long, and live
            // until after the wait.
            unsafe { gpu.device.cmd_copy_buffer(cmd, from.raw, to.raw, &all) };
        });
        self.memory.free_buffer(from);
        done
    }
}
