//! Compute pipelines: created when first used, kept as long as the device.

use std::collections::HashMap;

use ash::vk;

use super::VkError;
use super::cache::Cache;
use super::spirv::Module;
use crate::compute::Shader;

/// A compute pipeline with its layouts.
#[derive(Clone, Copy)]
pub(super) struct Compute {
    pub pipeline: vk::Pipeline,
    pub layout: vk::PipelineLayout,
    pub set: vk::DescriptorSetLayout,
}

/// Compute pipelines by shader.
#[derive(Default)]
pub(super) struct ComputePipelines {
    // Shaders are statics, so the address is the identity; a name alone would let a test's twin
    // of a kernel run the original.
    made: HashMap<usize, Compute>,
}

impl ComputePipelines {
    /// Returns the pipeline of a shader.
    ///
    /// * `restricted`: whether it holds every index within its array.
    pub fn get(
        &mut self,
        device: &ash::Device,
        cache: &Cache,
        shader: &'static Shader,
        restricted: bool,
    ) -> Result<Compute, VkError> {
        let key = std::ptr::from_ref(shader).addr();
        if let Some(found) = self.made.get(&key) {
            return Ok(*found);
        }
        let made = create(device, cache, shader, restricted)?;
        self.made.insert(key, made);
        Ok(made)
    }

    /// Destroys all. The device is idle.
    pub fn destroy(&mut self, device: &ash::Device) {
        for (_, c) in self.made.drain() {
            // SAFETY: made by this device, owned here, drained so that each goes once; the device
            // is idle.
            unsafe {
                device.destroy_pipeline(c.pipeline, None);
                device.destroy_pipeline_layout(c.layout, None);
                device.destroy_descriptor_set_layout(c.set, None);
            }
        }
    }
}

fn create(
    device: &ash::Device,
    cache: &Cache,
    shader: &Shader,
    restricted: bool,
) -> Result<Compute, VkError> {
    let bindings: Vec<_> = (0..shader.bindings.len() as u32)
        .map(|i| {
            vk::DescriptorSetLayoutBinding::default()
                .binding(i)
                .descriptor_type(vk::DescriptorType::STORAGE_BUFFER)
                .descriptor_count(1)
                .stage_flags(vk::ShaderStageFlags::COMPUTE)
        })
        .collect();
    let spirv = if restricted { shader.restricted } else { shader.spirv };
    let module = Module::new(device, spirv)?;
    // SAFETY: all handles are of this live device and all structs outlive their calls. Should a
    // later call fail, the earlier layouts are destroyed below, unused.
    unsafe {
        let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        let set = device
            .create_descriptor_set_layout(&info, None)
            .map_err(VkError::of("vkCreateDescriptorSetLayout"))?;
        let layout = pipeline_layout(device, &[set], shader.params_size, COMPUTE)
            .inspect_err(|_| device.destroy_descriptor_set_layout(set, None))?;
        let stage = vk::PipelineShaderStageCreateInfo::default()
            .stage(COMPUTE)
            .module(module.raw)
            .name(c"main");
        let info = vk::ComputePipelineCreateInfo::default()
            .flags(vk::PipelineCreateFlags::DISPATCH_BASE)
            .stage(stage)
            .layout(layout);
        match device.create_compute_pipelines(cache.raw, &[info], None) {
            Ok(made) => Ok(Compute { pipeline: made[0], layout, set }),
            Err((_, result)) => {
                device.destroy_pipeline_layout(layout, None);
                device.destroy_descriptor_set_layout(set, None);
                Err(VkError::of("vkCreateComputePipelines")(result))
            }
        }
    }
}

const COMPUTE: vk::ShaderStageFlags = vk::ShaderStageFlags::COMPUTE;

/// Creates a pipeline layout with one block of push constants for `stages`.
pub(super) fn pipeline_layout(
    device: &ash::Device,
    sets: &[vk::DescriptorSetLayout],
    push_bytes: u32,
    stages: vk::ShaderStageFlags,
) -> Result<vk::PipelineLayout, VkError> {
    let push = [vk::PushConstantRange { stage_flags: stages, offset: 0, size: push_bytes }];
    let mut info = vk::PipelineLayoutCreateInfo::default().set_layouts(sets);
    if push_bytes > 0 {
        info = info.push_constant_ranges(&push);
    }
    // SAFETY: the set layouts are of this device; arrays outlive the call.
    unsafe { device.create_pipeline_layout(&info, None) }
        .map_err(VkError::of("vkCreatePipelineLayout"))
}
