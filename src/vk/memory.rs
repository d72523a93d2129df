//! Device memory: buffers and images, each with an allocation of its own from one allocator.

use ash::vk;
use gpu_allocator::MemoryLocation;
use gpu_allocator::vulkan::{
    Allocation, AllocationCreateDesc, AllocationScheme, Allocator, AllocatorCreateDesc,
};

use super::VkError;
use super::instance::Instance;
use crate::fault;

/// Least size, bytes, of a resource with an allocation of its own instead of a place in a block.
const DEDICATED: u64 = 32 << 20; // blocks are 64-256 MiB; larger pieces would strand their rest

/// Writer and reader of a buffer, which decide the memory it lives in.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum MemoryUse {
    /// Memory on the device; mapped too where host and device share memory.
    Device,
    /// Written by the host, read by the device.
    Upload,
    /// Written by the device, read by the host.
    Readback,
}

/// A buffer and its memory. Freed through [`Memory::free_buffer`], never by dropping.
pub(super) struct Buffer {
    pub raw: vk::Buffer,
    pub bytes: u64,
    memory: Allocation,
}

impl Buffer {
    /// Returns the bytes of a mapped buffer as the host sees them.
    ///
    /// The caller has waited for the device's writes; coherent memory needs nothing else.
    pub fn mapped(&self) -> Option<&[u8]> {
        self.memory.mapped_slice()
    }
    /// Returns the bytes of a mapped buffer for writing. No submission in flight uses the buffer.
    pub fn mapped_mut(&mut self) -> Option<&mut [u8]> {
        self.memory.mapped_slice_mut()
    }
}

/// An image with its views and its memory. Freed through [`Memory::free_image`].
pub(super) struct Image {
    pub raw: vk::Image,
    pub view: vk::ImageView,
    /// Second view, of an image stored as sRGB with one sample a pixel, that reads its bytes
    /// without decoding. Null for others.
    pub stored: vk::ImageView,
    pub aspect: vk::ImageAspectFlags,
    pub extent: [u32; 2],
    /// Allocation of the image; `None` where a swapchain owns it.
    memory: Option<Allocation>,
}

impl Image {
    /// Wraps an image of a swapchain, with a view that is ours.
    pub fn of_swapchain(raw: vk::Image, view: vk::ImageView, extent: [u32; 2]) -> Self {
        let (stored, aspect) = (vk::ImageView::null(), vk::ImageAspectFlags::COLOR);
        Self { raw, view, stored, aspect, extent, memory: None }
    }
}

/// Description of an image to be created.
#[derive(Clone, Copy)]
pub(super) struct ImageDesc {
    pub format: vk::Format,
    pub extent: [u32; 2],
    pub samples: u32,
    pub pixel_bytes: u64,
    pub usage: vk::ImageUsageFlags,
    pub aspect: vk::ImageAspectFlags,
}

/// Allocator of device memory. Must be dropped before the device.
pub(super) struct Memory {
    device: ash::Device,
    allocator: Allocator,
    unified: bool,
    given_up: bool,
    allocations: u64,
}

impl Memory {
    pub fn new(
        instance: &Instance,
        device: &ash::Device,
        physical: vk::PhysicalDevice,
        unified: bool,
    ) -> Result<Self, VkError> {
        VkError::planted("the allocator")?;
        let allocator = Allocator::new(&AllocatorCreateDesc {
            instance: instance.raw.clone(),
            device: device.clone(),
            physical_device: physical,
            debug_settings: Default::default(),
            buffer_device_address: false,
            allocation_sizes: Default::default(),
        })
        .map_err(|e| VkError::OutOfMemory {
            what: "the allocator".into(),
            bytes: 0,
            detail: e.to_string(),
        })?;
        Ok(Self { device: device.clone(), allocator, unified, given_up: false, allocations: 0 })
    }

    /// Keeps what is freed from now on: the device was given up and may still use it.
    pub fn give_up(&mut self) {
        self.given_up = true;
    }

    /// Whether buffers placed on the device are mapped as well.
    pub fn unified(&self) -> bool {
        self.unified
    }

    /// Returns the memory the allocator holds from the device, bytes.
    pub fn capacity(&self) -> u64 {
        self.allocator.capacity()
    }

    /// Creates a buffer of `bytes`, rounded up to whole words; its contents are undefined.
    pub fn buffer(
        &mut self,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
        memory_use: MemoryUse,
    ) -> Result<Buffer, VkError> {
        let (raw, requirements) = self.unbound_buffer(name, bytes, usage)?;
        let bytes = whole_words(bytes);
        let scheme = if bytes >= DEDICATED {
            AllocationScheme::DedicatedBuffer(raw)
        } else {
            AllocationScheme::GpuAllocatorManaged
        };
        let location = self.location(memory_use);
        let bound = self
            .allocate(name, requirements, location, true, scheme)
            .and_then(|memory| self.bind(raw, &memory, 0).map(|()| memory));
        match bound {
            Ok(memory) => Ok(Buffer { raw, bytes, memory }),
            Err(e) => {
                self.free_unbound(raw);
                Err(e)
            }
        }
    }

    fn location(&self, memory_use: MemoryUse) -> MemoryLocation {
        match memory_use {
            // Cached where possible: results are read back by the host in place.
            MemoryUse::Device if self.unified => MemoryLocation::GpuToCpu,
            MemoryUse::Device => MemoryLocation::GpuOnly,
            MemoryUse::Upload => MemoryLocation::CpuToGpu,
            MemoryUse::Readback => MemoryLocation::GpuToCpu,
        }
    }

    /// Creates a buffer of `bytes`, rounded up to whole words, without memory; returns it and what
    /// it asks of memory.
    pub fn unbound_buffer(
        &mut self,
        name: &str,
        bytes: u64,
        usage: vk::BufferUsageFlags,
    ) -> Result<(vk::Buffer, vk::MemoryRequirements), VkError> {
        let bytes = whole_words(bytes);
        self.room_for(name, bytes)?;
        let info = vk::BufferCreateInfo::default().size(bytes).usage(usage);
        // SAFETY: the device is live: `Gpu` drops `Memory` before it.
        let raw = unsafe { self.device.create_buffer(&info, None) }
            .map_err(VkError::of("vkCreateBuffer"))?;
        // SAFETY: `raw` was just created by this device.
        Ok((raw, unsafe { self.device.get_buffer_memory_requirements(raw) }))
    }

    /// Takes memory on the device for buffers that are bound later.
    pub fn block(&mut self, requirements: vk::MemoryRequirements) -> Result<Allocation, VkError> {
        let location = self.location(MemoryUse::Device);
        let scheme = AllocationScheme::GpuAllocatorManaged;
        self.allocate("the buffers of a plan", requirements, location, true, scheme)
    }

    /// Binds a buffer of this device that has no memory to a place in memory of its kind, which has
    /// room for it there.
    pub fn bind(&self, raw: vk::Buffer, memory: &Allocation, offset: u64) -> Result<(), VkError> {
        // SAFETY: both are of this device and the buffer unbound; size, alignment and type of the
        // place come from the buffer's own requirements. The offset within a block is aligned for
        // every buffer of the block, and so is the block.
        let bound = unsafe {
            self.device.bind_buffer_memory(raw, memory.memory(), memory.offset() + offset)
        };
        bound.map_err(VkError::of("vkBindBufferMemory"))
    }

    /// Destroys a buffer that the device is done with and whose memory is not its own.
    pub fn free_unbound(&mut self, raw: vk::Buffer) {
        if !self.given_up {
            // SAFETY: `raw` is ours, goes once, and no submission that uses it is running.
            unsafe { self.device.destroy_buffer(raw, None) };
        }
    }

    /// Frees a block that the device is done with.
    pub fn free_block(&mut self, block: Allocation) {
        if self.given_up {
            return std::mem::forget(block);
        }
        // Freeing fails only for an allocation that is not ours.
        let _ = self.allocator.free(block);
    }

    /// Returns how often memory was taken.
    pub fn allocations(&self) -> u64 {
        self.allocations
    }

    /// Creates a two-dimensional image in undefined layout, with views of all of it.
    pub fn image(&mut self, name: &str, desc: ImageDesc) -> Result<Image, VkError> {
        let [width, height] = desc.extent;
        let pixels = u64::from(width) * u64::from(height) * u64::from(desc.samples);
        self.room_for(name, pixels * desc.pixel_bytes)?;
        let stored = match (desc.format, desc.samples) {
            (vk::Format::R8G8B8A8_SRGB, 1) => Some(vk::Format::R8G8B8A8_UNORM),
            _ => None,
        };
        let formats = [desc.format, stored.unwrap_or_default()];
        let mut formats = vk::ImageFormatListCreateInfo::default().view_formats(&formats);
        let mut info = vk::ImageCreateInfo::default()
            .image_type(vk::ImageType::TYPE_2D)
            .format(desc.format)
            .extent(vk::Extent3D { width, height, depth: 1 })
            .mip_levels(1)
            .array_layers(1)
            .samples(vk::SampleCountFlags::from_raw(desc.samples))
            .tiling(vk::ImageTiling::OPTIMAL)
            .usage(desc.usage);
        if stored.is_some() {
            info = info.flags(vk::ImageCreateFlags::MUTABLE_FORMAT).push_next(&mut formats);
        }
        // SAFETY: the device is live: `Gpu` drops `Memory` before it.
        let raw = unsafe { self.device.create_image(&info, None) }
            .map_err(VkError::of("vkCreateImage"))?;
        // SAFETY: `raw` was just created by this device.
        let requirements = unsafe { self.device.get_image_memory_requirements(raw) };
        let scheme = AllocationScheme::DedicatedImage(raw);
        let memory = self
            .allocate(name, requirements, MemoryLocation::GpuOnly, false, scheme)
            .inspect_err(|_| {
                // SAFETY: `raw` is ours and was never used.
                unsafe { self.device.destroy_image(raw, None) };
            })?;
        let range = vk::ImageSubresourceRange {
            aspect_mask: desc.aspect,
            level_count: 1,
            layer_count: 1,
            ..Default::default()
        };
        // SAFETY: image and memory are fresh, of this device and unbound, the memory made for the
        // image's own requirements.
        let bound = unsafe { self.device.bind_image_memory(raw, memory.memory(), memory.offset()) };
        let view = |format| {
            let info = vk::ImageViewCreateInfo::default()
                .image(raw)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(format)
                .subresource_range(range);
            // SAFETY: the image is bound when this is called, and the format its own or, with
            // MUTABLE_FORMAT, one of its list.
            unsafe { self.device.create_image_view(&info, None) }
        };
        let null = vk::ImageView::null();
        let (aspect, extent) = (desc.aspect, desc.extent);
        let memory = Some(memory);
        let mut image = Image { raw, view: null, stored: null, aspect, extent, memory };
        let mut made = || -> Result<(), vk::Result> {
            bound?;
            image.view = view(desc.format)?;
            if let Some(format) = stored {
                image.stored = view(format)?;
            }
            Ok(())
        };
        match made() {
            Ok(()) => Ok(image),
            Err(e) => {
                self.free_image(image);
                Err(VkError::of("vkCreateImageView")(e))
            }
        }
    }

    /// Destroys a buffer that the device is done with (the retire queue yielded it, or no
    /// submission ever used it).
    pub fn free_buffer(&mut self, b: Buffer) {
        if self.given_up {
            return std::mem::forget(b);
        }
        // SAFETY: `b.raw` came from this device and is owned by `b`, which we consume; by the
        // contract above the timeline has passed its last use.
        unsafe { self.device.destroy_buffer(b.raw, None) };
        // Freeing fails only for an allocation that is not ours.
        let _ = self.allocator.free(b.memory);
    }

    /// Destroys an image that the device is done with.
    pub fn free_image(&mut self, i: Image) {
        if self.given_up {
            return std::mem::forget(i);
        }
        // SAFETY: image and views came from this device and are owned by `i`, which we consume; the
        // timeline has passed their last use. A null view is ignored; an image without memory of
        // ours goes with its swapchain.
        unsafe {
            self.device.destroy_image_view(i.stored, None);
            self.device.destroy_image_view(i.view, None);
            if i.memory.is_some() {
                self.device.destroy_image(i.raw, None);
            }
        }
        i.memory.map(|memory| self.allocator.free(memory));
    }

    fn room_for(&self, name: &str, bytes: u64) -> Result<(), VkError> {
        if fault::hit(fault::Point::Allocate) {
            return Err(VkError::OutOfMemory {
                what: name.into(),
                bytes,
                detail: "planted".into(),
            });
        }
        Ok(())
    }

    fn allocate(
        &mut self,
        name: &str,
        requirements: vk::MemoryRequirements,
        location: MemoryLocation,
        linear: bool,
        allocation_scheme: AllocationScheme,
    ) -> Result<Allocation, VkError> {
        self.allocations += 1;
        let desc = AllocationCreateDesc { name, requirements, location, linear, allocation_scheme };
        self.allocator.allocate(&desc).map_err(|e| VkError::OutOfMemory {
            what: name.into(),
            bytes: requirements.size,
            detail: e.to_string(),
        })
    }
}

/// Size of a buffer for `bytes`: whole words, and at least four.
fn whole_words(bytes: u64) -> u64 {
    bytes.next_multiple_of(4).max(16)
}
