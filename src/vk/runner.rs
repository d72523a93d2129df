//! Execution of a plan: in as many submissions as keep each short (`pieces`), with one barrier
//! between dependent launches (`hazards`), in memory that is kept for the next plan (`arena`,
//! `plan_memory`); only requested buffers are read back, at the end (`transfers`).

use std::time::{Duration, Instant};

use ash::vk;
use tracing::debug;

use super::arena::bound;
use super::counts::PlanCounts;
use super::hazards::Hazards;
use super::pieces::{AIM, LaunchSegment, Pieces, most_threads};
use super::pipeline::Compute;
use super::plan_memory::{PlanMemory, input};
use super::transfers::{HOST_READ, TRANSFER_WRITE, copy_bytes, input_batches, result_batches};
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
    /// Fills buffers of undefined contents with nonsense, as the memory of other plans would be.
    pub nonsense: bool,
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
        let (start, counted) = (Instant::now(), self.counts[0]);
        let before = (self.timeline.submitted, self.waits.get(), self.memory.allocations());
        let mut held = PlanMemory::default();
        let result = self.run_held(plan, &bound, options, &mut held);
        if result.is_ok() {
            self.leave_copies(plan, &mut held);
        }
        let staged = !self.memory.unified();
        self.counts[1].add(&PlanCounts::least(plan, &bound, &held, staged));
        self.counts[0].add(&PlanCounts {
            plans: 1,
            launches: plan.steps().len() as u64,
            allocations: self.memory.allocations() - before.2,
            submissions: self.timeline.submitted - before.0,
            waits: self.waits.get().0 - before.1.0,
            arena_bytes: held.bytes(),
            wait_us: (self.waits.get().1 - before.1.1).as_micros() as u64,
            ..PlanCounts::default()
        });
        self.destroy_run(held, result.is_err());
        let host_us = start.elapsed().as_micros() as u64;
        self.counts[0].host_us += host_us;
        let now = self.counts[0].since(&counted);
        debug!(
            launches = plan.steps().len(),
            uploaded_bytes = now.uploaded_bytes,
            read_back_bytes = now.read_back_bytes,
            host_us,
            write_us = now.write_us,
            wait_us = now.wait_us,
            take_us = now.take_us,
            kernels_us = result
                .as_ref()
                .map_or(0.0, |o| o.times.iter().map(|t| t.seconds * 1e6).sum::<f64>())
                .round(),
            "plan"
        );
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
        held: &mut PlanMemory,
    ) -> Result<Outputs, VkError> {
        self.allocate_plan(plan, bound, held)?;
        let sets = self.write_sets(plan, held)?;
        let steps = plan.steps().len() as u32;
        if self.info.limits.timestamp_bits > 0 {
            self.pools.make_queries(&self.device, steps + 1)?;
        }
        // Pipelines first: creating one can fail, and then nothing has been recorded.
        let mut pipelines = Vec::with_capacity(plan.steps().len());
        for step in plan.steps() {
            let shader = step.kernel.shader;
            let restricted = self.info.limits.restricted;
            pipelines.push(self.pipelines.get(&self.device, &self.cache, shader, restricted)?);
        }

        let staged = !self.memory.unified();
        let (mut inputs, mut results) = (Vec::new(), Vec::new());
        if staged {
            inputs = input_batches(plan, held);
            results = result_batches(plan, held);
            self.room_for_results(&results)?;
        } else {
            self.write_in_place(plan, held);
        }
        // The last batch of inputs goes with the first launches, a single one of results with the
        // last.
        let mut last_input = inputs.pop();
        self.send_inputs(plan, held, &inputs)?;

        let fills = fills(plan, options.nonsense);
        let mut pieces = Pieces::new(plan, self.info.limits.groups[0]);
        let mut hazards = Hazards::new(&held.layout.aliases);
        let mut seconds = vec![0.0; plan.steps().len()];
        // Earlier plans wrote the copies that they left.
        let mut sees_copies = !held.buffers.iter().flatten().any(|b| b.is_resident());
        loop {
            let piece = pieces.next(plan, &self.rates, options.piece.unwrap_or(AIM));
            let is_last = pieces.is_done();
            let inputs = last_input.take();
            let place = inputs.as_ref().map(|batch| self.stage_inputs(plan, batch)).transpose()?;
            let reached = self.reached()?;
            let cmd = self.commands.begin(reached)?;
            self.reset_stamps(cmd, piece.len() as u32 + 1);
            if let (Some(batch), Some(place)) = (&inputs, place) {
                self.record_inputs(cmd, held, batch, place);
                self.barrier(cmd, TRANSFER_WRITE, COMPUTE_ACCESS);
            }
            if !std::mem::replace(&mut sees_copies, true) {
                self.barrier(cmd, ALL_WRITES, COMPUTE_ACCESS);
            }
            self.stamp(cmd, 0);
            for (i, segment) in piece.iter().enumerate() {
                let step = &plan.steps()[segment.step];
                // Parts of one launch need nothing between them.
                if segment.is_first() {
                    let clash = hazards.before(step);
                    if !fills[segment.step].is_empty() {
                        self.record_fills(cmd, held, &fills[segment.step]);
                    } else if clash && !options.skip_barriers && !fault::hit(fault::Point::Barrier)
                    {
                        self.barrier(cmd, COMPUTE_WRITE, COMPUTE_ACCESS);
                    }
                }
                self.record_segment(
                    cmd,
                    &pipelines[segment.step],
                    sets[segment.step],
                    step,
                    segment,
                );
                self.stamp(cmd, i as u32 + 1);
            }
            if is_last && !plan.downloads().is_empty() {
                match &results[..] {
                    [] => self.barrier(cmd, COMPUTE_WRITE, HOST_READ),
                    [batch] => {
                        self.barrier(cmd, COMPUTE_WRITE, COPY_READ);
                        self.record_results(cmd, held, batch, 0);
                        self.barrier(cmd, TRANSFER_WRITE, HOST_READ);
                    }
                    _ => self.barrier(cmd, COMPUTE_WRITE, COPY_READ),
                }
            }
            let start = Instant::now();
            let sent = self.commands.submit(self.queue, &mut self.timeline, cmd, None);
            self.staging.close(sent.as_ref().ok().copied());
            let value = sent?;
            self.dispatched();
            self.wait(value, "a piece of a plan")?;
            self.measure(plan, &piece, start.elapsed(), &mut seconds)?;
            if is_last {
                break;
            }
            if task::is_cancelled() {
                return Err(VkError::Cancelled);
            }
        }

        let mut out = Outputs::default();
        out.times = times(plan, &seconds);
        match &results[..] {
            [] => {}
            [batch] => self.take_results(plan, batch, 0, &mut out),
            batches => self.fetch_results(plan, held, batches, &mut out)?,
        }
        for id in plan.downloads() {
            let at = id.0 as usize;
            let bytes = plan.buffers()[at].bytes;
            let buffer = &held.buffers[at];
            if buffer.as_ref().is_none_or(|b| b.is_resident()) {
                // No launch writes it: what went in comes out.
                match input(&plan.buffers()[at].contents) {
                    Some(data) => out.insert_bytes(*id, data),
                    None => out.insert_bytes(*id, &vec![0; bytes]),
                }
            } else if !staged && let Some(data) = held.mapped(at, bytes) {
                let start = Instant::now();
                copy_bytes(out.bytes_mut(*id, bytes), data);
                self.counts[0].take_us += start.elapsed().as_micros() as u64;
                self.counts[0].read_back_bytes += bytes as u64;
            }
        }
        Ok(out)
    }

    /// Records fills of buffers that the next launch is the first to use: after all work before,
    /// which may have used their memory, and before the launch.
    fn record_fills(&mut self, cmd: vk::CommandBuffer, held: &PlanMemory, fills: &[(usize, u32)]) {
        self.barrier(cmd, COMPUTE_WRITE, FILL_AND_COMPUTE);
        for (at, word) in fills {
            let Some(b) = &held.buffers[*at] else { continue };
            // SAFETY: `cmd` is recording; the buffer is ours, has transfer usage, and whatever used
            // its memory before ends at the barrier above.
            unsafe { self.device.cmd_fill_buffer(cmd, b.raw, 0, vk::WHOLE_SIZE, *word) };
            self.counts[0].cleared_bytes += b.bytes;
        }
        self.barrier(cmd, TRANSFER_WRITE, COMPUTE_ACCESS);
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

    /// Allocates and writes one descriptor set a launch.
    fn write_sets(
        &mut self,
        plan: &Plan<'_>,
        held: &mut PlanMemory,
    ) -> Result<Vec<vk::DescriptorSet>, VkError> {
        let steps = plan.steps();
        if steps.is_empty() {
            return Ok(Vec::new());
        }
        let count: usize = steps.iter().map(|s| s.buffers.len()).sum();
        let room = [steps.len(), count.max(1)].map(|n| n as u32);
        let pool = self.pools.sets(&self.device, room)?;
        let mut sets = Vec::with_capacity(steps.len());
        for step in steps {
            let shader = step.kernel.shader;
            let restricted = self.info.limits.restricted;
            let p = self.pipelines.get(&self.device, &self.cache, shader, restricted)?;
            let layouts = [p.set];
            let info = vk::DescriptorSetAllocateInfo::default()
                .descriptor_pool(pool)
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

    /// Resets the first `count` queries for a submission.
    fn reset_stamps(&self, cmd: vk::CommandBuffer, count: u32) {
        if self.pools.queries != vk::QueryPool::null() {
            // SAFETY: `cmd` is recording; the pool is ours, holds one query more than there are
            // launches, and the submission before, which used it too, has been waited for.
            unsafe { self.device.cmd_reset_query_pool(cmd, self.pools.queries, 0, count) };
        }
    }

    fn stamp(&self, cmd: vk::CommandBuffer, query: u32) {
        if self.pools.queries != vk::QueryPool::null() {
            let after_all = vk::PipelineStageFlags2::ALL_COMMANDS;
            // SAFETY: `cmd` is recording, the pool was reset in it, the queue has timestamps.
            unsafe { self.device.cmd_write_timestamp2(cmd, after_all, self.pools.queries, query) };
        }
    }

    /// Adds the durations of a piece's segments to those of their launches. Rates follow from the
    /// duration of the whole piece if the queue has no timestamps, or if the timestamps add up to less
    /// than half of the piece: portable drivers write equal timestamps within a command buffer (MoltenVK
    /// issues 2150 and 2235), and pieces would grow without a bound.
    fn measure(
        &mut self,
        plan: &Plan<'_>,
        piece: &[LaunchSegment],
        whole: Duration,
        seconds: &mut [f64],
    ) -> Result<(), VkError> {
        self.longest_piece = self.longest_piece.max(whole);
        let stamped = self.pools.queries != vk::QueryPool::null();
        let took = if stamped {
            let mut ticks = vec![0u64; piece.len() + 1];
            let flags = vk::QueryResultFlags::TYPE_64 | vk::QueryResultFlags::WAIT;
            // SAFETY: the pool is ours, these queries of it were written by the submission that we
            // have waited for, and the slice has a word for each.
            unsafe { self.device.get_query_pool_results(self.pools.queries, 0, &mut ticks, flags) }
                .map_err(VkError::of("vkGetQueryPoolResults"))?;
            let mask = u64::MAX >> (64 - self.info.limits.timestamp_bits.clamp(1, 64));
            let period_s = f64::from(self.info.timestamp_period_ns) * 1e-9;
            let between = |t: &[u64]| (t[1].wrapping_sub(t[0]) & mask) as f64 * period_s;
            let took: Vec<f64> = ticks.windows(2).map(between).collect();
            for (segment, took) in piece.iter().zip(&took) {
                seconds[segment.step] += took;
            }
            took
        } else {
            Vec::new()
        };
        let whole_s = whole.as_secs_f64();
        let is_doubtful = !stamped
            || self.info.limits.restricted
            || took.iter().sum::<f64>() < CREDIBLE * (whole_s - HANDOVER_S);
        let took = if is_doubtful { self.rates.shares(plan, piece, whole_s) } else { took };
        self.rates.measured(plan, piece, &took);
        Ok(())
    }

    fn destroy_run(&mut self, held: PlanMemory, failed: bool) {
        // A run that succeeded has waited already; one that failed may have left work behind.
        if failed && !self.comes_to_rest() {
            return;
        }
        self.free_plan(held);
    }
}

/// Least share of a piece's duration that believable timestamps add up to.
const CREDIBLE: f64 = 0.5;
/// Time that a submission and its wait take beside the work, s.
const HANDOVER_S: f64 = 2e-4;

const COMPUTE_WRITE: StageAccess =
    (vk::PipelineStageFlags2::COMPUTE_SHADER, vk::AccessFlags2::SHADER_STORAGE_WRITE);
/// Writes by launches, copies and fills.
const ALL_WRITES: StageAccess = (
    vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::ALL_TRANSFER.as_raw()
            | vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw(),
    ),
    vk::AccessFlags2::from_raw(
        vk::AccessFlags2::TRANSFER_WRITE.as_raw() | vk::AccessFlags2::SHADER_STORAGE_WRITE.as_raw(),
    ),
);
const COMPUTE_ACCESS: StageAccess = (
    vk::PipelineStageFlags2::COMPUTE_SHADER,
    vk::AccessFlags2::from_raw(
        vk::AccessFlags2::SHADER_STORAGE_READ.as_raw()
            | vk::AccessFlags2::SHADER_STORAGE_WRITE.as_raw(),
    ),
);
/// After the first barrier of fills: fills, and launches that use other buffers.
const FILL_AND_COMPUTE: StageAccess = (
    vk::PipelineStageFlags2::from_raw(
        vk::PipelineStageFlags2::ALL_TRANSFER.as_raw()
            | vk::PipelineStageFlags2::COMPUTE_SHADER.as_raw(),
    ),
    vk::AccessFlags2::from_raw(
        vk::AccessFlags2::TRANSFER_WRITE.as_raw()
            | vk::AccessFlags2::SHADER_STORAGE_READ.as_raw()
            | vk::AccessFlags2::SHADER_STORAGE_WRITE.as_raw(),
    ),
);
const COPY_READ: StageAccess = (vk::PipelineStageFlags2::COPY, vk::AccessFlags2::TRANSFER_READ);

/// Word that undefined contents are filled with on request.
const NONSENSE: u32 = 0xA5A5_A5A5;

/// Fills before each launch: buffers that it is the first to use, each with its word.
fn fills(plan: &Plan<'_>, nonsense: bool) -> Vec<Vec<(usize, u32)>> {
    let mut used = vec![false; plan.buffers().len()];
    let mut fills_of = |step: &Step| {
        let mut fills = Vec::new();
        for id in step.buffers.iter().filter(|_| step.threads > 0) {
            let at = id.0 as usize;
            let word = match plan.buffers()[at].contents {
                Contents::Zeroed => Some(0),
                Contents::Undefined if nonsense => Some(NONSENSE),
                _ => None,
            };
            if !std::mem::replace(&mut used[at], true) {
                fills.extend(word.map(|w| (at, w)));
            }
        }
        fills
    };
    plan.steps().iter().map(&mut fills_of).collect()
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
