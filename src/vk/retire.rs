//! Retired resources: freed by their owner, destroyed once the device is past their last use.
//!
//! A resource is freed in one of two ways: by a call on the [`Gpu`], or, where its owner has no
//! `Gpu` at hand (a renderer that is dropped), through a [`Releaser`]. Either way it waits in the
//! retire queue until the timeline has reached the last submission that may use it.

use std::collections::VecDeque;
use std::sync::{Arc, Mutex, PoisonError};

use ash::vk;

use super::draw_pipeline::DrawPipeline;
use super::ids::{BufferId, DrawPipelineId, ImageId, ResourceId};
use super::memory::{self, Buffer, Memory};
use super::{Gpu, VkError};

/// A resource that was freed and that the device may still use.
pub(super) enum Retired {
    Buffer(Buffer),
    Image(memory::Image),
    Sets(vk::DescriptorPool),
    Pipeline(DrawPipeline),
}

/// Values waiting for the device to reach a timeline value. Timeline values pushed never decrease.
pub(super) struct RetireQueue<T> {
    queue: VecDeque<(u64, T)>,
}

impl<T> Default for RetireQueue<T> {
    fn default() -> Self {
        Self { queue: VecDeque::new() }
    }
}

impl<T> RetireQueue<T> {
    /// Holds `item` until `value` is reached.
    pub fn push(&mut self, value: u64, item: T) {
        debug_assert!(self.queue.back().is_none_or(|(v, _)| *v <= value), "values decrease");
        self.queue.push_back((value, item));
    }

    /// Takes out everything whose timeline value has been reached.
    pub fn reap(&mut self, reached: u64) -> impl Iterator<Item = T> + '_ {
        let n = self.queue.iter().take_while(|(v, _)| *v <= reached).count();
        self.queue.drain(..n).map(|(_, t)| t)
    }
}

/// Frees resources of a [`Gpu`] without holding it, from any thread: they are retired at its next
/// submission. Handles that are stale by then are ignored.
#[derive(Clone, Default)]
pub struct Releaser(Arc<Mutex<Vec<ResourceId>>>);

impl Releaser {
    /// Frees a buffer.
    pub fn buffer(&self, id: BufferId) {
        self.push(ResourceId::Buffer(id));
    }

    /// Frees an image.
    pub fn image(&self, id: ImageId) {
        self.push(ResourceId::Image(id));
    }

    /// Frees a graphics pipeline.
    pub fn draw_pipeline(&self, id: DrawPipelineId) {
        self.push(ResourceId::Pipeline(id));
    }

    fn push(&self, id: ResourceId) {
        self.0.lock().unwrap_or_else(PoisonError::into_inner).push(id);
    }

    fn take(&self) -> Vec<ResourceId> {
        std::mem::take(&mut *self.0.lock().unwrap_or_else(PoisonError::into_inner))
    }
}

impl Gpu {
    /// Frees resources of this device for owners that do not hold it.
    pub fn releaser(&self) -> Releaser {
        self.releaser.clone()
    }

    /// Whether a releaser is of this device.
    pub fn owns(&self, releaser: &Releaser) -> bool {
        Arc::ptr_eq(&self.releaser.0, &releaser.0)
    }

    /// Makes resources in `make`; if it fails, what it made is freed.
    ///
    /// # Errors
    /// Those of `make`.
    pub fn all_or_none<T, E>(
        &mut self,
        make: impl FnOnce(&mut Self) -> Result<T, E>,
    ) -> Result<T, E> {
        let outer = self.made.replace(Vec::new());
        let result = make(self);
        let made = std::mem::replace(&mut self.made, outer).unwrap_or_default();
        match (&result, &mut self.made) {
            (Err(_), _) => made.into_iter().for_each(|id| self.free(id)),
            (Ok(_), Some(outer)) => outer.extend(made),
            (Ok(_), None) => {}
        }
        result
    }

    /// Notes a resource for [`Gpu::all_or_none`].
    pub(super) fn note_made(&mut self, id: ResourceId) {
        self.made.iter_mut().for_each(|made| made.push(id));
    }

    fn free(&mut self, id: ResourceId) {
        match id {
            ResourceId::Buffer(id) => self.free_buffer(id),
            ResourceId::Image(id) => self.free_image(id),
            ResourceId::Pipeline(id) => self.free_draw_pipeline(id),
        }
    }

    /// Frees a buffer once the device is done with it. A stale handle does nothing.
    pub fn free_buffer(&mut self, id: BufferId) {
        if let Some(b) = self.buffers.remove(id) {
            self.retired.push(self.timeline.submitted, Retired::Buffer(b.buffer));
        }
    }

    /// Frees an image once the device is done with it. A stale handle does nothing.
    pub fn free_image(&mut self, id: ImageId) {
        if let Some(i) = self.images.remove(id) {
            self.retired.push(self.timeline.submitted, Retired::Image(i.image));
        }
    }

    /// Frees a graphics pipeline once the device is done with it. A stale handle does nothing.
    pub fn free_draw_pipeline(&mut self, id: DrawPipelineId) {
        if let Some(p) = self.draw_pipelines.remove(id) {
            self.retired.push(self.timeline.submitted, Retired::Pipeline(p));
        }
    }

    /// Destroys the retired resources that the device has passed; returns the timeline value it
    /// has reached.
    pub(super) fn reap(&mut self) -> Result<u64, VkError> {
        for id in self.releaser.take() {
            self.free(id);
        }
        let reached = self.reached()?;
        let retired: Vec<_> = self.retired.reap(reached).collect();
        retired.into_iter().for_each(|r| self.destroy(r));
        Ok(reached)
    }

    /// Takes device memory. Retired resources that the device has passed are destroyed first; where
    /// memory has run out, all retired ones are waited for and destroyed, and `take` is tried once
    /// more.
    pub(super) fn with_memory<T>(
        &mut self,
        take: impl Fn(&mut Memory) -> Result<T, VkError>,
    ) -> Result<T, VkError> {
        self.reap()?;
        match take(&mut self.memory) {
            Err(VkError::OutOfMemory { .. }) => {
                self.wait(self.timeline.submitted, "the last use of retired memory")?;
                self.reap()?;
                self.free_arena();
                take(&mut self.memory)
            }
            taken => taken,
        }
    }

    fn destroy(&mut self, retired: Retired) {
        match retired {
            Retired::Buffer(b) => self.memory.free_buffer(b),
            Retired::Image(i) => self.memory.free_image(i),
            Retired::Pipeline(p) => self.destroy_draw_pipeline(&p),
            // SAFETY: the pool is ours; the timeline has passed the submission that used its sets.
            Retired::Sets(pool) => unsafe { self.device.destroy_descriptor_pool(pool, None) },
        }
    }

    /// Destroys every resource, retired or not. The device is idle.
    pub(super) fn destroy_all(&mut self) {
        let mut all: Vec<Retired> = self.retired.reap(u64::MAX).collect();
        all.extend(self.staging.buffer.take().map(Retired::Buffer));
        all.extend(self.readback.take().map(Retired::Buffer));
        self.free_arena();
        all.extend(self.buffers.drain().map(|(_, b)| b).map(|b| Retired::Buffer(b.buffer)));
        all.extend(self.draw_pipelines.drain().map(|(_, p)| p).map(Retired::Pipeline));
        all.extend(self.images.drain().map(|(_, i)| i).map(|i| Retired::Image(i.image)));
        all.into_iter().for_each(|r| self.destroy(r));
    }
}

#[cfg(test)]
mod tests {
    use super::RetireQueue;

    #[test]
    fn retired_items_leave_only_once_their_timeline_value_is_reached() {
        let mut r = RetireQueue::default();
        for (value, thing) in [(1, 'a'), (1, 'b'), (3, 'c')] {
            r.push(value, thing);
        }
        assert_eq!(r.reap(0).count(), 0);
        assert_eq!(r.reap(2).collect::<String>(), "ab");
        assert_eq!(r.reap(2).count(), 0);
        assert_eq!(r.reap(3).collect::<String>(), "c");
    }
}
