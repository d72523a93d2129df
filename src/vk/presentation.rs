//! Pictures in a window: surface, swapchain, and the steps of a frame: acquire, submit, present.
//!
//! Two frames are in flight. Each has a semaphore that the presentation engine signals when an
//! image is free; each image has one that it waits for before it shows the image: an image comes
//! round when its semaphore has been waited for, a frame's slot may come round earlier
//! (Vulkan-ValidationLayers #9840). Replaced swapchains are kept until every image of the new one
//! has come round, since an idle device says nothing of what the presentation engine still holds
//! (Vulkan-Docs #1059); of a window that is being resized, where none comes round, the last two.

use std::fmt::Debug;
use std::sync::Arc;

use ash::{khr, vk};
use raw_window_handle::{HasDisplayHandle, HasWindowHandle, RawDisplayHandle};

use super::commands::Handover;
use super::frame::{Frame, FrameOptions};
use super::ids::ImageId;
use super::instance::Instance;
use super::memory;
use super::resources::{Format, GpuImage, ImageSpec};
use super::{Gpu, VkError};

/// Frames that may be in flight to a window.
const IN_FLIGHT: usize = 2;
/// Most replaced swapchains that are kept. What was handed to the presentation engine with the
/// oldest has two successors by then.
const MAX_OLD: usize = 2;
/// Longest wait for an image, ns: a window that is hidden may never give one.
const PATIENCE_NS: u64 = 100_000_000;

/// A window to draw to.
pub trait WindowHandles: HasDisplayHandle + HasWindowHandle + Debug + Send + Sync {}

impl<T: HasDisplayHandle + HasWindowHandle + Debug + Send + Sync> WindowHandles for T {}

/// Returns the display a window is on.
pub(super) fn display_of(window: &Arc<dyn WindowHandles>) -> Result<RawDisplayHandle, VkError> {
    let display = window.display_handle();
    display.map(|d| d.as_raw()).map_err(|_| VkError::NoSurface("the display is gone"))
}

/// Presentation surface of a window. Dropped before the instance, after its swapchains.
pub(super) struct PresentationSurface {
    functions: khr::surface::Instance,
    raw: vk::SurfaceKHR,
    // Dropped after `raw` was destroyed.
    window: Arc<dyn WindowHandles>,
}

impl PresentationSurface {
    pub fn new(instance: &Instance, window: Arc<dyn WindowHandles>) -> Result<Self, VkError> {
        let functions = khr::surface::Instance::new(&instance.entry, &instance.raw);
        let raw = Self::create(instance, &window)?;
        Ok(Self { functions, raw, window })
    }

    fn create(
        instance: &Instance,
        window: &Arc<dyn WindowHandles>,
    ) -> Result<vk::SurfaceKHR, VkError> {
        let display = display_of(window)?;
        let handle = window.window_handle();
        let handle = handle.map_err(|_| VkError::NoSurface("the window is gone"))?;
        let (entry, raw) = (&instance.entry, &instance.raw);
        VkError::planted("vkCreateSurface")?;
        // SAFETY: the instance was made with the extensions of this display; both handles are
        // valid while the window lives, which the caller holds longer than the surface.
        unsafe { ash_window::create_surface(entry, raw, display, handle.as_raw(), None) }
            .map_err(VkError::of("vkCreateSurface"))
    }

    /// Whether a queue family of a device can show pictures here.
    pub fn is_supported(&self, physical: vk::PhysicalDevice, family: u32) -> bool {
        // SAFETY: the device comes from the instance that the surface was made on; both are live.
        unsafe { self.functions.get_physical_device_surface_support(physical, family, self.raw) }
            .unwrap_or(false)
    }
}

impl Drop for PresentationSurface {
    fn drop(&mut self) {
        // SAFETY: the surface is ours and goes once; its swapchains are gone (`Gpu::close_chains`)
        // or never were.
        unsafe { self.functions.destroy_surface(self.raw, None) };
    }
}

/// Images of one size, in turn.
struct Swapchain {
    raw: vk::SwapchainKHR,
    images: Vec<ImageId>,
    /// Semaphores that mark the end of drawing, one an image.
    finished: Vec<vk::Semaphore>,
    /// Size of its images, which the display may choose.
    extent: [u32; 2],
    /// Size of the window it was made for.
    asked: [u32; 2],
    acquired: usize,
    /// Whether two images may be held between acquire and present.
    holds_two: bool,
}

impl Swapchain {
    /// Whether it serves a window of `size`. The display may give images of another size than
    /// asked for, at its limits or while a window is being resized: the same request would get
    /// the same answer, and a swapchain that does not fit any more is reported as out of date.
    fn serves(asked: [u32; 2], extent: [u32; 2], size: [u32; 2]) -> bool {
        size == asked || size == extent
    }
}

/// Surface, swapchain and semaphores of a window.
pub(super) struct Presenter {
    chains: khr::swapchain::Device,
    chain: Option<Swapchain>,
    /// Replaced swapchains, perhaps still on the screen.
    old: Vec<Swapchain>,
    /// Semaphores of the frames in flight, each with the timeline value of the submission that
    /// waited for it last.
    acquired: Vec<(vk::Semaphore, u64)>,
    slot: usize,
    /// Index and handle of the image that was acquired and not drawn to yet.
    current: Option<(u32, ImageId)>,
    /// Index of the image that a submission draws to and that was not presented yet.
    submitted: Option<u32>,
    /// Whether the swapchain does not fit the surface any more.
    is_stale: bool,
    surface_lost: bool,
    physical: vk::PhysicalDevice,
    surface: PresentationSurface,
}

impl Presenter {
    pub fn new(
        instance: &Instance,
        device: &ash::Device,
        physical: vk::PhysicalDevice,
        surface: PresentationSurface,
    ) -> Result<Self, VkError> {
        Ok(Self {
            chains: khr::swapchain::Device::new(&instance.raw, device),
            chain: None,
            old: Vec::new(),
            acquired: Vec::new(),
            slot: 0,
            current: None,
            submitted: None,
            is_stale: false,
            surface_lost: false,
            physical,
            surface,
        })
    }
}

impl Gpu {
    /// Takes an image of the window to draw the next frame to; `None` where there is nothing to
    /// draw to at the moment: the window has no pixels, or the screen holds all images.
    ///
    /// * `size`: columns and rows of the window, where its display leaves them to us.
    ///
    /// The image has the window's own size ([`Gpu::image_extent`]) and takes encoded colours
    /// ([`Format::Bgra8Stored`] or [`Format::Rgba8Stored`]). What it held is lost.
    ///
    /// # Errors
    /// [`VkError::DeviceLost`], [`VkError::OutOfMemory`], or the failing call.
    ///
    /// # Panics
    /// If the device was not opened for a window, or the last image was not submitted.
    pub fn acquire(&mut self, size: [u32; 2]) -> Result<Option<ImageId>, VkError> {
        let mut p = self.presenter.take().expect("a device opened for a window");
        assert!(p.current.is_none(), "the image before was submitted");
        let image = self.acquire_from(&mut p, size);
        self.presenter = Some(p);
        image
    }

    /// Submits a frame that draws to the image taken last; [`Gpu::present`] shows it.
    ///
    /// # Errors
    /// As [`Gpu::submit_draws`]; the image is given up then.
    ///
    /// # Panics
    /// If no image was taken, or the one before was not presented; as [`Gpu::submit_draws`].
    pub fn submit_to_window(&mut self, frame: &Frame<'_>) -> Result<(), VkError> {
        let mut p = self.presenter.take().expect("a device opened for a window");
        let sent = self.submit_to(&mut p, frame);
        self.presenter = Some(p);
        sent
    }

    /// Whether an image was submitted and not presented yet.
    pub fn awaits_present(&self) -> bool {
        self.presenter.as_ref().is_some_and(|p| p.submitted.is_some())
    }

    /// Shows the image that was submitted last, if it was not presented yet. Software Vulkan
    /// returns when the image is drawn.
    ///
    /// # Errors
    /// [`VkError::DeviceLost`], [`VkError::OutOfMemory`], or the failing call.
    pub fn present(&mut self) -> Result<(), VkError> {
        let Some(mut p) = self.presenter.take() else { return Ok(()) };
        let shown = self.present_submitted(&mut p);
        self.presenter = Some(p);
        shown
    }

    /// Returns the format of the window's images; before the first was acquired, `None`.
    pub fn window_format(&self) -> Option<Format> {
        let chain = self.presenter.as_ref()?.chain.as_ref()?;
        Some(self.images[chain.images[0]].spec.format)
    }

    fn acquire_from(
        &mut self,
        p: &mut Presenter,
        size: [u32; 2],
    ) -> Result<Option<ImageId>, VkError> {
        self.reap()?;
        // Each failure below is mended by what the next round does first.
        for _ in 0..4 {
            if p.surface_lost {
                self.renew_surface(p)?;
            }
            let serves = |c: &Swapchain| Swapchain::serves(c.asked, c.extent, size);
            let fits = !p.is_stale && p.chain.as_ref().is_some_and(serves);
            if !fits || p.chain.as_ref().is_some_and(|c| !c.holds_two) {
                self.present_submitted(p)?;
            }
            if !fits && !self.remake_chain(p, size)? {
                return Ok(None);
            }
            let Some(chain) = &mut p.chain else { return Ok(None) };
            let (semaphore, used) = p.acquired[p.slot];
            self.wait(used, "a frame of the window")?;
            // SAFETY: the swapchain is ours and live; the semaphore is unsignalled with nothing
            // pending, since the submission that waited for it has ended.
            let found = unsafe {
                p.chains.acquire_next_image(chain.raw, PATIENCE_NS, semaphore, vk::Fence::null())
            };
            match found {
                Ok((index, suboptimal)) => {
                    // Acquired all the same: drawn and shown once before it is remade.
                    p.is_stale |= suboptimal;
                    let image = chain.images[index as usize];
                    self.images[image].layout = vk::ImageLayout::UNDEFINED;
                    p.current = Some((index, image));
                    chain.acquired += 1;
                    if chain.acquired > 2 * chain.images.len() {
                        self.close_old(p, 0)?;
                    }
                    return Ok(Some(image));
                }
                Err(vk::Result::NOT_READY | vk::Result::TIMEOUT) => return Ok(None),
                Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => p.is_stale = true,
                Err(vk::Result::ERROR_SURFACE_LOST_KHR) => p.surface_lost = true,
                Err(e) => return Err(VkError::of("vkAcquireNextImageKHR")(e)),
            }
        }
        Ok(None)
    }

    fn submit_to(&mut self, p: &mut Presenter, frame: &Frame<'_>) -> Result<(), VkError> {
        assert!(p.submitted.is_none(), "the image before was presented");
        let (index, image) = p.current.take().expect("an image of the window");
        let chain = p.chain.as_ref().expect("the chain of an image");
        let finished = chain.finished[index as usize];
        let acquired = p.acquired[p.slot].0;
        let sent = self.make_room(frame.staged_bytes()).and_then(|()| {
            let handover = Handover { acquired, finished };
            self.submit_frame(frame, FrameOptions::default(), Some((image, handover)))
        });
        if let Err(e) = sent {
            // Nobody waits for the semaphore of the image any more.
            self.close_all(p);
            return Err(e);
        }
        p.acquired[p.slot].1 = self.timeline.submitted;
        p.slot = (p.slot + 1) % p.acquired.len();
        p.submitted = Some(index);
        Ok(())
    }

    fn present_submitted(&mut self, p: &mut Presenter) -> Result<(), VkError> {
        let Some(index) = p.submitted.take() else { return Ok(()) };
        let chain = p.chain.as_ref().expect("the chain of an image");
        let finished = chain.finished[index as usize];
        let (waits, chains, indices) = ([finished], [chain.raw], [index]);
        let info = vk::PresentInfoKHR::default()
            .wait_semaphores(&waits)
            .swapchains(&chains)
            .image_indices(&indices);
        // SAFETY: queue, swapchain and semaphore are ours and live, the index is of an image we
        // acquired and brought into the layout to be shown; the submission above signals the
        // semaphore. `&mut self` makes us the only user of the queue.
        match unsafe { p.chains.queue_present(self.queue, &info) } {
            Ok(suboptimal) => p.is_stale |= suboptimal,
            Err(vk::Result::ERROR_OUT_OF_DATE_KHR) => p.is_stale = true,
            Err(vk::Result::ERROR_SURFACE_LOST_KHR) => p.surface_lost = true,
            Err(e) => return Err(VkError::of("vkQueuePresentKHR")(e)),
        }
        Ok(())
    }

    /// Makes a swapchain as large as the surface is now; returns false where that has no pixels.
    fn remake_chain(&mut self, p: &mut Presenter, size: [u32; 2]) -> Result<bool, VkError> {
        let s = &p.surface;
        // SAFETY: device and surface are of this instance and live.
        let found =
            unsafe { s.functions.get_physical_device_surface_capabilities(p.physical, s.raw) };
        let can = match found {
            Ok(can) => can,
            Err(vk::Result::ERROR_SURFACE_LOST_KHR) => {
                p.surface_lost = true;
                return Ok(false);
            }
            Err(e) => return Err(VkError::of("vkGetPhysicalDeviceSurfaceCapabilitiesKHR")(e)),
        };
        let (least, most) = (can.min_image_extent, can.max_image_extent);
        // A display that leaves the size to us says so by the largest number.
        let extent = match can.current_extent {
            vk::Extent2D { width: u32::MAX, .. } => vk::Extent2D {
                width: size[0].clamp(least.width.min(most.width), most.width),
                height: size[1].clamp(least.height.min(most.height), most.height),
            },
            own => own,
        };
        if size.contains(&0) || extent.width == 0 || extent.height == 0 {
            return Ok(false);
        }
        let (format, space) = self.surface_format(p)?;
        let most_images = if can.max_image_count == 0 { u32::MAX } else { can.max_image_count };
        let alpha = composite_alpha(can.supported_composite_alpha);
        self.close_old(p, MAX_OLD - 1)?;
        let old = p.chain.as_ref().map_or(vk::SwapchainKHR::null(), |c| c.raw);
        let info = vk::SwapchainCreateInfoKHR::default()
            .surface(p.surface.raw)
            .min_image_count((can.min_image_count + 1).min(most_images))
            .image_format(format.raw())
            .image_color_space(space)
            .image_extent(extent)
            .image_array_layers(1)
            .image_usage(vk::ImageUsageFlags::COLOR_ATTACHMENT)
            .image_sharing_mode(vk::SharingMode::EXCLUSIVE)
            .pre_transform(can.current_transform)
            .composite_alpha(alpha)
            .present_mode(vk::PresentModeKHR::FIFO)
            .clipped(true)
            .old_swapchain(old);
        VkError::planted("vkCreateSwapchainKHR")?;
        // SAFETY: the surface is live and was found to be supported by this device's queue; the
        // old swapchain is ours and not used again.
        let made = unsafe { p.chains.create_swapchain(&info, None) };
        // Made or not, the old one is retired.
        p.old.extend(p.chain.take());
        let raw = match made {
            Ok(raw) => raw,
            Err(vk::Result::ERROR_SURFACE_LOST_KHR) => {
                p.surface_lost = true;
                return Ok(false);
            }
            Err(e) => return Err(VkError::of("vkCreateSwapchainKHR")(e)),
        };
        let extent = [extent.width, extent.height];
        let (images, finished) = (Vec::new(), Vec::new());
        let (acquired, holds_two) = (0, false);
        let mut chain =
            Swapchain { raw, images, finished, extent, asked: size, acquired, holds_two };
        let filled = self.fill_chain(p, &mut chain, format);
        if let Err(e) = filled {
            self.destroy_chain(p, chain);
            return Err(e);
        }
        chain.holds_two = chain.images.len() > can.min_image_count as usize;
        p.chain = Some(chain);
        p.is_stale = false;
        Ok(true)
    }

    /// Creates views and semaphores of a swapchain's images, and the frames' semaphores.
    fn fill_chain(
        &mut self,
        p: &mut Presenter,
        chain: &mut Swapchain,
        format: Format,
    ) -> Result<(), VkError> {
        // SAFETY: the swapchain is ours and live.
        let images = unsafe { p.chains.get_swapchain_images(chain.raw) }
            .map_err(VkError::of("vkGetSwapchainImagesKHR"))?;
        for raw in images {
            let info = vk::ImageViewCreateInfo::default()
                .image(raw)
                .view_type(vk::ImageViewType::TYPE_2D)
                .format(format.raw())
                .subresource_range(vk::ImageSubresourceRange {
                    aspect_mask: vk::ImageAspectFlags::COLOR,
                    level_count: 1,
                    layer_count: 1,
                    ..Default::default()
                });
            // SAFETY: the image is of the swapchain, which outlives its view.
            let view = unsafe { self.device.create_image_view(&info, None) }
                .map_err(VkError::of("vkCreateImageView"))?;
            let spec = ImageSpec { format, extent: chain.extent, samples: 1 };
            let image = memory::Image::of_swapchain(raw, view, chain.extent);
            let layout = vk::ImageLayout::UNDEFINED;
            chain.images.push(self.images.insert(GpuImage { spec, image, layout }));
            chain.finished.push(self.semaphore()?);
        }
        while p.acquired.len() < IN_FLIGHT {
            p.acquired.push((self.semaphore()?, 0));
        }
        Ok(())
    }

    fn semaphore(&self) -> Result<vk::Semaphore, VkError> {
        // SAFETY: the device is live.
        unsafe { self.device.create_semaphore(&vk::SemaphoreCreateInfo::default(), None) }
            .map_err(VkError::of("vkCreateSemaphore"))
    }

    /// Returns a format of eight bits a colour, stored as shaders write them, and its colour space.
    fn surface_format(&self, p: &Presenter) -> Result<(Format, vk::ColorSpaceKHR), VkError> {
        let s = &p.surface;
        // SAFETY: device and surface are of this instance and live.
        let offered = unsafe { s.functions.get_physical_device_surface_formats(p.physical, s.raw) }
            .map_err(VkError::of("vkGetPhysicalDeviceSurfaceFormatsKHR"))?;
        let find = |format: Format| {
            let space = vk::ColorSpaceKHR::SRGB_NONLINEAR;
            let fits =
                |o: &vk::SurfaceFormatKHR| o.format == format.raw() && o.color_space == space;
            offered.iter().any(fits).then_some((format, space))
        };
        find(Format::Bgra8Stored)
            .or_else(|| find(Format::Rgba8Stored))
            .ok_or(VkError::NoSurface("the window takes no colours of eight bits"))
    }

    /// Creates a new surface for the same window, after the old one was lost.
    fn renew_surface(&mut self, p: &mut Presenter) -> Result<(), VkError> {
        self.close_all(p);
        let window = Arc::clone(&p.surface.window);
        p.surface = PresentationSurface::new(&self.instance, window)?;
        p.surface_lost = false;
        Ok(())
    }

    /// Destroys all but the `kept` youngest of the replaced swapchains, once the device is done
    /// with them.
    fn close_old(&mut self, p: &mut Presenter, kept: usize) -> Result<(), VkError> {
        let gone = p.old.len().saturating_sub(kept);
        if gone > 0 {
            self.wait(self.timeline.submitted, "frames of a replaced swapchain")?;
            // Presenting is work of the queue too, which the timeline does not count.
            self.wait_idle("frames of a replaced swapchain")?;
            for chain in p.old.drain(..gone).collect::<Vec<_>>() {
                self.destroy_chain(p, chain);
            }
        }
        Ok(())
    }

    /// Destroys swapchains and semaphores; the next image comes from new ones.
    fn close_all(&mut self, p: &mut Presenter) {
        let all: Vec<Swapchain> = p.old.drain(..).chain(p.chain.take()).collect();
        if !self.comes_to_rest() {
            p.acquired.clear();
            return;
        }
        all.into_iter().for_each(|chain| self.destroy_chain(p, chain));
        for (semaphore, _) in p.acquired.drain(..) {
            // SAFETY: ours, and the device is idle.
            unsafe { self.device.destroy_semaphore(semaphore, None) };
        }
        (p.slot, p.current, p.submitted) = (0, None, None);
    }

    /// Gives the window up: another device may be opened for it, and this one presents no more.
    pub fn close_window(&mut self) {
        if let Some(mut p) = self.presenter.take() {
            self.close_all(&mut p);
        }
    }

    fn destroy_chain(&mut self, p: &Presenter, chain: Swapchain) {
        for image in chain.images {
            if let Some(image) = self.images.remove(image) {
                self.memory.free_image(image.image);
            }
        }
        // SAFETY: all are ours and go once. No submission uses them: the caller has waited for the
        // timeline or the device; that the presentation engine is done with the semaphores too is
        // shown by the images of a later swapchain coming round, or by an idle queue and two
        // successors, or the device is going down.
        unsafe {
            for semaphore in chain.finished {
                self.device.destroy_semaphore(semaphore, None);
            }
            p.chains.destroy_swapchain(chain.raw, None);
        }
    }
}

/// Returns the first way of laying a window over others that a surface offers; opaque at best.
fn composite_alpha(offered: vk::CompositeAlphaFlagsKHR) -> vk::CompositeAlphaFlagsKHR {
    type Alpha = vk::CompositeAlphaFlagsKHR;
    let wanted = [Alpha::OPAQUE, Alpha::INHERIT, Alpha::PRE_MULTIPLIED, Alpha::POST_MULTIPLIED];
    // Every surface offers one at least.
    wanted.into_iter().find(|alpha| offered.contains(*alpha)).unwrap_or(Alpha::OPAQUE)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn only_a_composite_alpha_that_is_offered_is_asked_for() {
        type Alpha = vk::CompositeAlphaFlagsKHR;
        for (offered, wanted) in [
            (Alpha::OPAQUE | Alpha::INHERIT, Alpha::OPAQUE),
            (Alpha::INHERIT | Alpha::PRE_MULTIPLIED, Alpha::INHERIT),
            // Some compositors offer this one alone.
            (Alpha::PRE_MULTIPLIED, Alpha::PRE_MULTIPLIED),
            (Alpha::POST_MULTIPLIED, Alpha::POST_MULTIPLIED),
        ] {
            assert_eq!(composite_alpha(offered), wanted);
        }
    }

    #[test]
    fn a_display_that_gives_another_size_than_asked_for_gets_no_swapchain_a_frame() {
        let (asked, limited) = ([100, 20], [120, 40]);
        assert!(Swapchain::serves(asked, limited, asked));
        // The window has taken the size of the images by now.
        assert!(Swapchain::serves(asked, limited, limited));
        assert!(!Swapchain::serves(asked, limited, [100, 40]));
    }
}
