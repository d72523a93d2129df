//! Execution of a plan: in as many submissions as keep each short (`pieces`), with one barrier
//! between dependent launches; only requested buffers are read back, at the end.

use std::time::{Duration, Instant};

use ash::vk;

use super::memory::{Buffer, MemoryUse};
use super::pieces::{AIM, LaunchSegment, Pieces, most_threads};
use super::pipeline::Compute;
use super::{Gpu, StageAccess, VkError};
use crate::compute::{Contents, Outputs, Plan, Step, StepTime};
use crate::{fault, task};

/// Knobs of a run for tests of the tests.
#[doc(hidden)]
#[derive(Clone, Copy, Debug, Default)]
pub struct RunOptions {
    /// Leaves out the barriers between launches, so that validation has a hazard to find.
    pub skip_barriers: bool,
    /// Target duration of a submission; [`Duration::MAX`] makes one of the whole plan.
    pub piece: Option<Duration>,
}

/// Device resources of one run.
#[derive(Default)]
struct RunResources {
    /// Buffers in the order of the plan's; `None` where no launch binds it or it has no bytes.
    buffers: Vec<Option<Buffer>>,
    /// Buffer that is bound in place of those without bytes. A shader sees four words there and no
    /// size, so kernels take their sizes from the immediate block.
    dummy: Option<Buffer>,
    staging: Vec<(usize, Buffer)>,
    readback: Vec<(usize, Buffer)>,
    sets: vk::DescriptorPool,
    queries: vk::QueryPool,
}

impl Gpu {
    /// Runs a plan and waits for it.
    ///
    /// # Errors
    /// [`VkError::TooLarge`] before anything is done, [`VkError::OutOfMemory`],
    /// [`VkError::DeviceLost`], [`VkError::Cancelled`] between two submissions, or the failing call.
    /// Nothing stays allocated.
    pub fn run(&mut self, plan: &Plan<'_>) -> Result<Outputs, VkError> {
        self.run_with(plan, RunOptions::default())
    }

    /// Runs a plan as [`Gpu::run`] does, with options for tests.
    ///
    /// # Errors
    /// As [`Gpu::run`].
    #[doc(hidden)]
    pub fn run_with(&mut self, plan: &Plan<'_>, options: RunOptions) -> Result<Outputs, VkError> {
        let bound = bound(plan);
        self.check(plan, &bound)?;
        let mut held = RunResources::default();
        let result = self.run_held(plan, &bound, options, &mut held);
        self.destroy_run(held, result.is_err());
        result
    }

    fn check(&self, plan: &Plan<'_>, bound: &[bool]) -> Result<(), VkError> {
        let limit = self.info.max_storage_buffer_range.min(self.info.max_buffer_bytes);
        for (b, _) in plan.buffers().iter().zip(bound).filter(|(_, bound)| **bound) {
            if b.bytes as u64 > limit {
                let device = self.info.name.clone();
                let bytes = b.bytes as u64;
                return Err(VkError::TooLarge { buffer: b.name, bytes, limit, device });
            }
        }
        for step in plan.steps() {
            let limit = most_threads(self.info.limits.groups, step.kernel.shader.workgroup);
            if step.threads as u64 > limit {
                let (kernel, threads) = (step.kernel.name(), step.threads as u64);
                return Err(VkError::TooManyThreads { kernel, threads, limit });
            }
        }
        Ok(())
    }

    fn run_held(
        &mut self,
        plan: &Plan<'_>,
        bound: &[bool],
        options: RunOptions,
        held: &mut RunResources,
    ) -> Result<Outputs, VkError> {
        self.allocate(plan, bound, held)?;
        let sets = self.write_sets(plan, held)?;
        let steps = plan.steps().len() as u32;
        if self.info.limits.timestamp_bits > 0 && steps > 0 {
            let info = vk::QueryPoolCreateInfo::default()
                .query_type(vk::QueryType::TIMESTAMP)
                .query_count(steps + 1);
            // SAFETY: the device is live; the pool goes to `held`, which is destroyed after the wait.
            held.queries = unsafe { self.device.create_query_pool(&info, None) }
                .map_err(VkError::of("vkCreateQueryPool"))?;
        }
        // Pipelines first: creating one can fail, and then nothing has been recorded.
        let mut pipelines = Vec::with_capacity(plan.steps().len());
        for step in plan.steps() {
            let shader = step.kernel.shader;
            let restricted = self.info.limits.restricted;
            pipelines.push(self.pipelines.get(&self.device, &self.cache, shader, restricted)?);
        }

        let mut pieces = Pieces::new(plan, self.info.limits.groups[0]);
        let mut hazards = Hazards::new(plan.buffers().len());
        let mut seconds = vec![0.0; plan.steps().len()];
        let mut is_first = true;
        loop {
            let piece = pieces.next(plan, &self.rates, options.piece.unwrap_or(AIM));
            let is_last = pieces.is_done();
            let reached = self.reached()?;
            let cmd = self.commands.begin(reached)?;
            self.reset_stamps(cmd, held, piece.len() as u32 + 1);
            if is_first {
                self.record_uploads(cmd, plan, held);
            }
            self.stamp(cmd, held, 0);
            for (i, segment) in piece.iter().enumerate() {
                let step = &plan.steps()[segment.step];
                // Parts of one launch need nothing between them.
                if segment.is_first()
                    && hazards.before(step)
                    && !options.skip_barriers
                    && !fault::hit(fault::Point::Barrier)
                {
                    self.barrier(cmd, COMPUTE_WRITE, COMPUTE_ACCESS);
                }
                self.record_segment(
                    cmd,
                    &pipelines[segment.step],
                    sets[segment.step],
                    step,
                    segment,
                );
                self.stamp(cmd, held, i as u32 + 1);
            }
            if is_last {
                self.record_downloads(cmd, plan, held);
            }
            let start = Instant::now();
            let value = self.commands.submit(self.queue, &mut self.timeline, cmd, None)?;
            self.dispatched();
            self.wait(value, "a piece of a plan")?;
            self.measure(plan, held, &piece, start.elapsed(), &mut seconds)?;
            if is_last {
                break;
            }
            if task::is_cancelled() {
                return Err(VkError::Cancelled);
            }
            is_first = false;
        }

        let mut out = Outputs::default();
        out.times = times(plan, &seconds);
        for id in plan.downloads() {
            let at = id.0 as usize;
            let bytes = plan.buffers()[at].bytes;
            let copied = held.readback.iter().find(|(b, _)| *b == at).map(|(_, b)| b);
            match copied.or(held.buffers[at].as_ref()).and_then(Buffer::mapped) {
                Some(data) => out.insert_bytes(*id, &data[..bytes]),
                // No launch touches it: what went in comes out.
                None => match &plan.buffers()[at].contents {
                    Contents::Zeroed => out.insert_bytes(*id, &vec![0; bytes]),
                    Contents::Borrowed(data) => out.insert_bytes(*id, data),
                    Contents::Owned(data) => out.insert_bytes(*id, data),
                },
            }
        }
        Ok(out)
    }

    /// Records a launch or a part of one.
    fn record_segment(
        &self,
        cmd: vk::CommandBuffer,
        p: &Compute,
        set: vk::DescriptorSet,
        step: &Step,
        LaunchSegment { base, groups, .. }: &LaunchSegment,
    ) {
        // SAFETY: `cmd` is recording; pipeline, layout and set are alive until the timeline passes
        // this submission, which `run_held` waits for; the params have the layout's size (checked
        // when the launch was appended); group counts with their base are within the limits that
        // `check` compared with, and pipelines are made for dispatches with a base.
        unsafe {
            let point = vk::PipelineBindPoint::COMPUTE;
            self.device.cmd_bind_pipeline(cmd, point, p.pipeline);
            self.device.cmd_bind_descriptor_sets(cmd, point, p.layout, 0, &[set], &[]);
            if !step.params.is_empty() {
                let stage = vk::ShaderStageFlags::COMPUTE;
                self.device.cmd_push_constants(cmd, p.layout, stage, 0, &step.params);
            }
            // The same with a base of zero; synchronization validation looks at this one alone.
            if *base == [0, 0] {
                self.device.cmd_dispatch(cmd, groups[0], groups[1], 1);
            } else {
                self.device.cmd_dispatch_base(cmd, base[0], base[1], 0, groups[0], groups[1], 1);
            }
        }
    }

    fn allocate(
        &mut self,
        plan: &Plan<'_>,
        bound: &[bool],
        held: &mut RunResources,
    ) -> Result<(), VkError> {
        use vk::BufferUsageFlags as Use;
        let storage = Use::STORAGE_BUFFER | Use::TRANSFER_SRC | Use::TRANSFER_DST;
        held.buffers.resize_with(plan.buffers().len(), || None);
        for (at, b) in plan.buffers().iter().enumerate() {
            if !bound[at] || b.bytes == 0 {
                continue;
            }
            let bytes = b.bytes as u64;
            let mut buffer = self.new_buffer(b.name, bytes, storage, MemoryUse::Device)?;
            let data: Option<&[u8]> = match &b.contents {
                Contents::Zeroed => None,
                Contents::Borrowed(data) => Some(data),
                Contents::Owned(data) => Some(data),
            };
            if let Some(data) = data {
                if self.memory.unified()
                    && let Some(to) = buffer.mapped_mut()
                {
                    to[..data.len()].copy_from_slice(data);
                } else {
                    let mut s =
                        self.new_buffer(b.name, bytes, Use::TRANSFER_SRC, MemoryUse::Upload)?;
                    let to = s.mapped_mut().expect("upload memory is mapped");
                    to[..data.len()].copy_from_slice(data);
                    held.staging.push((at, s));
                }
            }
            held.buffers[at] = Some(buffer);
        }
        if plan.steps().iter().any(|s| s.buffers.iter().any(|b| is_empty(plan, b.0))) {
            held.dummy = Some(self.new_buffer("nothing", 16, storage, MemoryUse::Device)?);
        }
        if !self.memory.unified() {
            for id in plan.downloads() {
                let at = id.0 as usize;
                if held.buffers[at].is_some() {
                    let b = &plan.buffers()[at];
                    let to = Use::TRANSFER_DST;
                    let r = self.new_buffer(b.name, b.bytes as u64, to, MemoryUse::Readback)?;
                    held.readback.push((at, r));
                }
            }
        }
        Ok(())
    }

    /// Allocates and writes one descriptor set a launch, from a pool of this run.
    fn write_sets(
        &mut self,
        plan: &Plan<'_>,
        held: &mut RunResources,
    ) -> Result<Vec<vk::DescriptorSet>, VkError> {
        let steps = plan.steps();
        if steps.is_empty() {
            return Ok(Vec::new());
        }
        let count: usize = steps.iter().map(|s| s.buffers.len()).sum();
        let sizes = [vk::DescriptorPoolSize {
            ty: vk::DescriptorType::STORAGE_BUFFER,
            descriptor_count: count.max(1) as u32,
        }];
        let info =
            vk::DescriptorPoolCreateInfo::default().max_sets(steps.len() as u32).pool_sizes(&sizes);
        // SAFETY: the device is live; the pool goes to `held`, which is destroyed after the wait.
        held.sets = unsafe { self.device.create_descriptor_pool(&info, None) }
            .map_err(VkError::of("vkCreateDescriptorPool"))?;
        let mut sets = Vec::with_capacity(steps.len());
        for step in steps {
            let shader = step.kernel.shader;
            let restricted = self.info.limits.restricted;
            let p = self.pipelines.get(&self.device, &self.cache, shader, restricted)?;
            let layouts = [p.set];
            let info = vk::DescriptorSetAllocateInfo::default()
                .descriptor_pool(held.sets)
                .set_layouts(&layouts);
            // SAFETY: pool and layout are of this device and ours alone; the pool has room for one
            // set a launch and all its descriptors.
            let set = unsafe { self.device.allocate_descriptor_sets(&info) }
                .map_err(VkError::of("vkAllocateDescriptorSets"))?[0];
            let shown: Vec<_> = step
                .buffers
                .iter()
                .map(|id| match &held.buffers[id.0 as usize] {
                    Some(b) => [vk::DescriptorBufferInfo {
                        buffer: b.raw,
                        offset: 0,
                        range: plan.buffers()[id.0 as usize].bytes as u64,
                    }],
                    None => [vk::DescriptorBufferInfo {
                        buffer: held.dummy.as_ref().expect("allocated for empty buffers").raw,
                        offset: 0,
                        range: 16,
                    }],
                })
                .collect();
            let writes: Vec<_> = shown
                .iter()
                .enumerate()
                .map(|(i, shown)| {
                    vk::WriteDescriptorSet::default()
                        .dst_set(set)
                        .dst_binding(i as u32)
                        .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                        .buffer_info(shown)
                })
                .collect();
            // SAFETY: the set is fresh and not in use; buffers live in `held` until after the wait.
            unsafe { self.device.update_descriptor_sets(&writes, &[]) };
            sets.push(set);
        }
        Ok(sets)
    }

    fn record_uploads(&self, cmd: vk::CommandBuffer, plan: &Plan<'_>, held: &RunResources) {
        let mut any = false;
        for (at, b) in held.buffers.iter().enumerate() {
            let Some(b) = b else { continue };
            if matches!(plan.buffers()[at].contents, Contents::Zeroed) {
                // SAFETY: `cmd` is recording; the buffer is ours, idle, and has transfer usage.
                unsafe { self.device.cmd_fill_buffer(cmd, b.raw, 0, vk::WHOLE_SIZE, 0) };
                any = true;
            }
        }
        for (at, from) in &held.staging {
            let to = held.buffers[*at].as_ref().expect("staged for this buffer");
            let all = [vk::BufferCopy::default().size(to.bytes)];
            // SAFETY: `cmd` is recording; both buffers are ours, of the same size, and live in
            // `held` until after the wait.
            unsafe { self.device.cmd_copy_buffer(cmd, from.raw, to.raw, &all) };
            any = true;
        }
        if any {
            self.barrier(cmd, TRANSFER_WRITE, COMPUTE_ACCESS);
        }
    }

    /// Resets the first `count` queries for a submission.
    fn reset_stamps(&self, cmd: vk::CommandBuffer, held: &RunResources, count: u32) {
        if held.queries != vk::QueryPool::null() {
            // SAFETY: `cmd` is recording; the pool is ours, holds one query more than there are
            // launches, and the submission before, which used it too, has been waited for.
            unsafe { self.device.cmd_reset_query_pool(cmd, held.queries, 0, count) };
        }
    }

    fn record_downloads(&self, cmd: vk::CommandBuffer, plan: &Plan<'_>, held: &RunResources) {
        if plan.downloads().is_empty() {
            return;
        }
        if !held.readback.is_empty() {
            let copy = (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::TRANSFER_READ);
            self.barrier(cmd, COMPUTE_WRITE, copy);
            for (at, to) in &held.readback {
                let from = held.buffers[*at].as_ref().expect("read back from this buffer");
                let all = [vk::BufferCopy::default().size(from.bytes)];
                // SAFETY: as in `record_uploads`.
                unsafe { self.device.cmd_copy_buffer(cmd, from.raw, to.raw, &all) };
            }
        }
        let source = if held.readback.is_empty() { COMPUTE_WRITE } else { TRANSFER_WRITE };
        self.barrier(cmd, source, (vk::PipelineStageFlags2::HOST, vk::AccessFlags2::HOST_READ));
    }

    fn barrier(&self, cmd: vk::CommandBuffer, from: StageAccess, to: StageAccess) {
        let barriers = [vk::MemoryBarrier2::default()
            .src_stage_mask(from.0)
            .src_access_mask(from.1)
            .dst_stage_mask(to.0)
            .dst_access_mask(to.1)];
        let info = vk::DependencyInfo::default().memory_barriers(&barriers);
        // SAFETY: `cmd` is recording on this device; a memory barrier names no handle.
        unsafe { self.device.cmd_pipeline_barrier2(cmd, &info) };
    }

    fn stamp(&self, cmd: vk::CommandBuffer, held: &RunResources, query: u32) {
        if held.queries != vk::QueryPool::null() {
            let after_all = vk::PipelineStageFlags2::ALL_COMMANDS;
            // SAFETY: `cmd` is recording, the pool was reset in it, the queue has timestamps.
            unsafe { self.device.cmd_write_timestamp2(cmd, after_all, held.queries, query) };
        }
    }

    /// Adds the durations of a piece's segments to those of their launches: from timestamps, or,
    /// for rates alone, from the duration of the piece.
    fn measure(
        &mut self,
        plan: &Plan<'_>,
        held: &RunResources,
        piece: &[LaunchSegment],
        whole: Duration,
        seconds: &mut [f64],
    ) -> Result<(), VkError> {
        self.longest_piece = self.longest_piece.max(whole);
        let stamped = held.queries != vk::QueryPool::null();
        let took = if stamped {
            let mut ticks = vec![0u64; piece.len() + 1];
            let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
            // SAFETY: the pool is ours, these queries of it were written by the submission that we
            // have waited for, and the slice has a word for each.
            unsafe { self.device.get_query_pool_results(held.queries, 0, &mut ticks, flags) }
                .map_err(VkError::of("vkGetQueryPoolResults"))?;
            let mask = u64::MAX >> (64 - self.info.limits.timestamp_bits.clamp(1, 64));
            let period_s = f64::from(self.info.timestamp_period_ns) * 1e-9;
            let between = |t: &[u64]| (t[1].wrapping_sub(t[0]) & mask) as f64 * period_s;
            ticks.windows(2).map(between).collect()
        } else {
            self.rates.shares(plan, piece, whole.as_secs_f64())
        };
        for (segment, took) in piece.iter().zip(took) {
            self.rates.measured(plan.steps()[segment.step].kernel.name(), segment, took);
            if stamped {
                seconds[segment.step] += took;
            }
        }
        Ok(())
    }

    fn destroy_run(&mut self, held: RunResources, failed: bool) {
        // A run that succeeded has waited already; one that failed may have left work behind.
        if failed && !self.comes_to_rest() {
            return;
        }
        // SAFETY: nothing in `held` is in use, all of it is ours and goes once; null pools are
        // ignored.
        unsafe {
            self.device.destroy_descriptor_pool(held.sets, None);
            self.device.destroy_query_pool(held.queries, None);
        }
        let moved = held.staging.into_iter().chain(held.readback).map(|(_, b)| b);
        for b in held.buffers.into_iter().flatten().chain(held.dummy).chain(moved) {
            self.memory.free_buffer(b);
        }
    }
}

const COMPUTE_WRITE: StageAccess =
    (vk::PipelineStageFlags2::COMPUTE_SHADER, vk::AccessFlags2::SHADER_STORAGE_WRITE);
const COMPUTE_ACCESS: StageAccess = (
    vk::PipelineStageFlags2::COMPUTE_SHADER,
    vk::AccessFlags2::from_raw(
        vk::AccessFlags2::SHADER_STORAGE_READ.as_raw()
            | vk::AccessFlags2::SHADER_STORAGE_WRITE.as_raw(),
    ),
);
const TRANSFER_WRITE: StageAccess =
    (vk::PipelineStageFlags2::ALL_TRANSFER, vk::AccessFlags2::TRANSFER_WRITE);

/// Buffers that were read or written since the last barrier.
struct Hazards {
    read: Vec<bool>,
    written: Vec<bool>,
}

impl Hazards {
    fn new(buffers: usize) -> Self {
        Self { read: vec![false; buffers], written: vec![false; buffers] }
    }

    /// Whether `step` needs a barrier before it; then notes its accesses.
    fn before(&mut self, step: &Step) -> bool {
        let touched = || step.buffers.iter().zip(step.kernel.shader.bindings);
        let clash = touched().any(|(id, b)| {
            let at = id.0 as usize;
            self.written[at] || (b.writable && self.read[at])
        });
        if clash {
            self.read.fill(false);
            self.written.fill(false);
        }
        for (id, b) in touched() {
            let list = if b.writable { &mut self.written } else { &mut self.read };
            list[id.0 as usize] = true;
        }
        clash
    }
}

fn times(plan: &Plan<'_>, seconds: &[f64]) -> Vec<StepTime> {
    let time = |(step, seconds): (&Step, &f64)| StepTime {
        kernel: step.kernel.name(),
        unit: step.kernel.unit,
        items: step.items,
        bytes: step.buffers.iter().map(|b| plan.buffers()[b.0 as usize].bytes as u64).sum(),
        seconds: *seconds,
    };
    plan.steps().iter().zip(seconds).map(time).collect()
}

fn bound(plan: &Plan<'_>) -> Vec<bool> {
    let mut bound = vec![false; plan.buffers().len()];
    for id in plan.steps().iter().flat_map(|s| &s.buffers) {
        bound[id.0 as usize] = true;
    }
    bound
}

fn is_empty(plan: &Plan<'_>, id: u32) -> bool {
    plan.buffers()[id as usize].bytes == 0
}

#[cfg(test)]
mod tests {
    use crate::compute::{Buf, Kernel, Plan, Shader, run_cpu};
    use crate::kernels::fair::{Bindings, KERNEL, Params};
    use crate::vk::{Choice, Gpu};

    /// A ring of vertices, smoothed once.
    fn ring(kernel: &'static Kernel, vertices: u32) -> (Plan<'static>, Buf<f32>) {
        let around = |v: u32| [(v + vertices - 1) % vertices, (v + 1) % vertices];
        let near: Vec<u32> = (0..vertices).flat_map(around).collect();
        let start: Vec<u32> = (0..=vertices).map(|v| 2 * v).collect();
        let normal = |v: u32| {
            let a = v as f32 * 0.37;
            glam::Vec3::new(a.cos(), a.sin(), (3.0 * a).sin()).normalize().to_array()
        };
        let normals: Vec<f32> = (0..vertices).flat_map(normal).collect();
        let mut plan = Plan::new();
        let start = plan.upload_owned("start", &start);
        let weight = plan.upload_owned("weight", &vec![0.5f32; near.len()]);
        let near = plan.upload_owned("near", &near);
        let normal = plan.upload_owned("normal", &normals);
        let faired = plan.zeroed::<f32>("faired", normals.len());
        let bindings = Bindings { start, near, weight, normal, faired };
        let threads = vertices as usize;
        plan.launch(kernel, bindings, Params { vertices, lambda: 0.5 }, threads, threads);
        plan.download(faired);
        (plan, faired)
    }

    /// `fair` with the constant 1 of its shader made a little larger.
    fn planted() -> &'static Kernel {
        let mut spirv = KERNEL.shader.spirv.to_vec();
        let one = 1.0f32.to_ne_bytes();
        let mut patched = 0;
        // OpConstant: opcode 43, four words, the value last.
        let op = (4u32 << 16 | 43).to_ne_bytes();
        for at in (20..spirv.len() - 12).step_by(4) {
            if spirv[at..at + 4] == op && spirv[at + 12..at + 16] == one {
                spirv[at + 12..at + 16].copy_from_slice(&1.001f32.to_ne_bytes());
                patched += 1;
            }
        }
        assert_eq!(patched, 1, "the shader has one constant 1");
        let shader = KERNEL.shader;
        Box::leak(Box::new(Kernel {
            shader: Box::leak(Box::new(Shader {
                name: shader.name,
                spirv: spirv.leak(),
                restricted: shader.restricted,
                workgroup: shader.workgroup,
                params_size: shader.params_size,
                bindings: shader.bindings,
            })),
            twin: KERNEL.twin,
            unit: KERNEL.unit,
            tolerance: KERNEL.tolerance,
        }))
    }

    #[test]
    fn a_shader_that_computes_something_else_than_its_twin_is_caught() {
        let mut gpu = match Gpu::open(Choice::Any) {
            Ok(gpu) => gpu,
            Err(e) if e.is_no_device() && std::env::var_os("INTIMA_REQUIRE_GPU").is_none() => {
                return;
            }
            Err(e) => panic!("{e}"),
        };
        for (kernel, fine) in [(&KERNEL, true), (planted(), false)] {
            let (plan, out) = ring(kernel, 1000);
            let (want, got) = (run_cpu(&plan), gpu.run(&plan).unwrap());
            let allowed = |want: f32| kernel.tolerance.abs + kernel.tolerance.rel * want.abs();
            let pairs = want.get(out).iter().zip(got.get(out));
            let agree = pairs.clone().all(|(w, g)| (w - g).abs() <= allowed(*w));
            assert_eq!(agree, fine, "{:?}", pairs.take(3).collect::<Vec<_>>());
        }
    }
}
