//! Command buffers: recorded once, submitted once, used again when the device is done.

use ash::vk;

use super::VkError;
use super::retire::RetireQueue;
use super::timeline::Timeline;
use crate::fault;

/// Semaphores between the window's images and a submission: waited for, and signalled.
#[derive(Clone, Copy)]
pub(super) struct Handover {
    pub acquired: vk::Semaphore,
    pub finished: vk::Semaphore,
}

/// Pool of command buffers of the one queue; dropped before the device, once that is idle.
pub(super) struct Commands {
    device: ash::Device,
    pool: vk::CommandPool,
    idle: Vec<vk::CommandBuffer>,
    busy: RetireQueue<vk::CommandBuffer>,
}

impl Commands {
    pub fn new(device: &ash::Device, family: u32) -> Result<Self, VkError> {
        let info = vk::CommandPoolCreateInfo::default()
            .queue_family_index(family)
            .flags(vk::CommandPoolCreateFlags::RESET_COMMAND_BUFFER);
        VkError::planted("vkCreateCommandPool")?;
        // SAFETY: `device` is live and was created with this family.
        let pool = unsafe { device.create_command_pool(&info, None) }
            .map_err(VkError::of("vkCreateCommandPool"))?;
        Ok(Self { device: device.clone(), pool, idle: Vec::new(), busy: RetireQueue::default() })
    }

    /// Returns a command buffer in recording state.
    pub fn begin(&mut self, reached: u64) -> Result<vk::CommandBuffer, VkError> {
        self.idle.extend(self.busy.reap(reached));
        let cmd = match self.idle.pop() {
            Some(cmd) => cmd,
            None => {
                let info = vk::CommandBufferAllocateInfo::default()
                    .command_pool(self.pool)
                    .command_buffer_count(1);
                // SAFETY: the pool is ours and of this device; `&mut self` synchronizes it.
                unsafe { self.device.allocate_command_buffers(&info) }
                    .map_err(VkError::of("vkAllocateCommandBuffers"))?[0]
            }
        };
        let info = vk::CommandBufferBeginInfo::default()
            .flags(vk::CommandBufferUsageFlags::ONE_TIME_SUBMIT);
        // SAFETY: `cmd` is of our pool and idle: new, never submitted, or past its timeline value, so it
        // may be reset, which beginning does.
        unsafe { self.device.begin_command_buffer(cmd, &info) }
            .map_err(VkError::of("vkBeginCommandBuffer"))?;
        Ok(cmd)
    }

    /// Ends and submits `cmd`, for an image of a window between its two semaphores; returns the timeline value that marks its completion.
    pub fn submit(
        &mut self,
        queue: vk::Queue,
        timeline: &mut Timeline,
        cmd: vk::CommandBuffer,
        shown: Option<Handover>,
    ) -> Result<u64, VkError> {
        let value = timeline.submitted + 1;
        let buffers = [vk::CommandBufferSubmitInfo::default().command_buffer(cmd)];
        let semaphore =
            |s, stage| vk::SemaphoreSubmitInfo::default().semaphore(s).stage_mask(stage);
        let all = vk::PipelineStageFlags2::ALL_COMMANDS;
        let mut signals = vec![semaphore(timeline.semaphore, all).value(value)];
        let mut waits = Vec::new();
        if let Some(Handover { acquired, finished }) = shown {
            // What is drawn before the window's image may begin earlier.
            waits.push(semaphore(acquired, vk::PipelineStageFlags2::COLOR_ATTACHMENT_OUTPUT));
            signals.push(semaphore(finished, all));
        }
        let submit = vk::SubmitInfo2::default()
            .wait_semaphore_infos(&waits)
            .command_buffer_infos(&buffers)
            .signal_semaphore_infos(&signals);
        // SAFETY: `cmd` was begun by us and everything recorded in it is alive until the timeline
        // reaches `value`: frees go through the retire queue. `&mut self` makes us the only user
        // of queue and pool.
        let sent = unsafe {
            self.device.end_command_buffer(cmd).map_err(VkError::of("vkEndCommandBuffer")).and_then(
                |()| match fault::hit(fault::Point::Submit) {
                    true => Err(VkError::DeviceLost { during: "vkQueueSubmit2" }),
                    false => self
                        .device
                        .queue_submit2(queue, &[submit], vk::Fence::null())
                        .map_err(VkError::of("vkQueueSubmit2")),
                },
            )
        };
        match sent {
            Ok(()) => {
                timeline.submitted = value;
                self.busy.push(value, cmd);
                Ok(value)
            }
            Err(e) => {
                self.idle.push(cmd);
                Err(e)
            }
        }
    }
}

impl Drop for Commands {
    fn drop(&mut self) {
        // SAFETY: the pool is ours and goes once with all its command buffers; the device is idle
        // (`Gpu::drop` waits) or nothing was submitted to it.
        unsafe { self.device.destroy_command_pool(self.pool, None) };
    }
}
