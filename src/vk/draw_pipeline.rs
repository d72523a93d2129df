//! Graphics pipelines, described in our own few words.

use std::ffi::CString;

use ash::vk;

use super::ids::{DrawPipelineId, ResourceId};
use super::pipeline::pipeline_layout;
use super::resources::Format;
use super::spirv::Module;
use super::{Gpu, VkError};

/// Use of the depth target by a draw. Depth is reversed: 1 at the near plane, 0 at infinity.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum DepthUse {
    /// Depth is neither tested nor written.
    Ignore,
    /// A nearer fragment passes and writes its depth.
    Nearest,
}

/// Blending of a fragment with the colour in the target; colours are linear.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Blend {
    /// The fragment's colour replaces the target's.
    Opaque,
    /// One layer of glass behind those in the target: colour `dst + t rgb` with the target's alpha
    /// t, their transmittance, which is multiplied by `1 - a`.
    Under,
    /// Stack of glass layers over a picture: `rgb + a dst`.
    Stack,
    /// Premultiplied colour over the target's: `rgb + (1 - a) dst`; alpha alike.
    Over,
}

/// Format of a vertex attribute.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Attribute {
    /// Two floats.
    F32x2,
    /// Three floats.
    F32x3,
    /// Four signed 16-bit fractions.
    Snorm16x4,
    /// Four unsigned 8-bit fractions.
    Unorm8x4,
    /// An unsigned number.
    U32,
}

impl Attribute {
    fn raw(self) -> (vk::Format, u32) {
        match self {
            Self::F32x2 => (vk::Format::R32G32_SFLOAT, 8),
            Self::F32x3 => (vk::Format::R32G32B32_SFLOAT, 12),
            Self::Snorm16x4 => (vk::Format::R16G16B16A16_SNORM, 8),
            Self::Unorm8x4 => (vk::Format::R8G8B8A8_UNORM, 4),
            Self::U32 => (vk::Format::R32_UINT, 4),
        }
    }
}

/// An entry point of a [`DrawShader`].
#[derive(Debug)]
pub struct DrawEntry {
    /// Name in the WGSL source.
    pub name: &'static str,
    /// Whether it is for vertices; else it is for fragments.
    pub is_vertex: bool,
    /// Vertex attributes it reads, locations 0, 1, …
    pub attributes: u32,
    /// Whether it reads images or buffers.
    pub has_bindings: bool,
}

/// A compiled module for drawing. Only the build script makes it, from WGSL that naga has
/// validated: a driver trusts SPIR-V as it trusts code.
#[derive(Debug)]
pub struct DrawShader {
    /// SPIR-V words in native byte order.
    pub(crate) spirv: &'static [u8],
    pub(crate) entries: &'static [DrawEntry],
    /// Bytes of the immediate block, both stages.
    pub(crate) push_bytes: u32,
    /// Images that entry points read, bindings 0, 1, … of group 0.
    pub(crate) images: u32,
    /// Buffers that entry points read, bindings after those of the images.
    pub(crate) buffers: u32,
}

impl DrawShader {
    /// Returns the size of the immediate block, bytes.
    pub fn push_bytes(&self) -> u32 {
        self.push_bytes
    }

    fn entry(&self, name: &str, is_vertex: bool) -> &DrawEntry {
        let found = self.entries.iter().find(|e| e.name == name && e.is_vertex == is_vertex);
        found.unwrap_or_else(|| panic!("the shader has an entry point `{name}` of that stage"))
    }
}

/// Description of a graphics pipeline, which draws triangles.
#[derive(Clone, Debug)]
pub struct DrawSpec {
    /// Module with both entry points.
    pub shader: &'static DrawShader,
    /// Entry points for vertices and fragments.
    pub entries: [&'static str; 2],
    /// Attributes of one interleaved vertex buffer, locations 0, 1, …; empty for none.
    pub attributes: &'static [Attribute],
    /// Format of the colour target.
    pub colour: Format,
    /// Format of the depth target, if the pass has one.
    pub depth: Option<Format>,
    /// Use of the depth target.
    pub depth_use: DepthUse,
    /// Samples a pixel.
    pub samples: u32,
    /// Blending with the colour target.
    pub blend: Blend,
    /// Whether back faces are left out.
    pub cull_backs: bool,
}

/// A graphics pipeline with its layouts, and the properties that passes and draws have to match.
pub(super) struct DrawPipeline {
    pub(super) pipeline: vk::Pipeline,
    pub(super) layout: vk::PipelineLayout,
    pub(super) set: vk::DescriptorSetLayout,
    pub(super) stride: u32,
    pub(super) push_bytes: u32,
    pub(super) images: u32,
    pub(super) buffers: u32,
    pub(super) colour: Format,
    pub(super) depth: Option<Format>,
    pub(super) samples: u32,
    pub(super) blend: Blend,
}

/// Shader stages that see the immediate block, images and buffers: both.
pub(super) const STAGES: vk::ShaderStageFlags = vk::ShaderStageFlags::from_raw(
    vk::ShaderStageFlags::VERTEX.as_raw() | vk::ShaderStageFlags::FRAGMENT.as_raw(),
);

impl Gpu {
    /// Creates a graphics pipeline.
    ///
    /// # Errors
    /// The failing call.
    ///
    /// # Panics
    /// If the shader has no such entry points or reads more attributes than the spec names: an
    /// error of the caller.
    pub fn draw_pipeline(&mut self, spec: &DrawSpec) -> Result<DrawPipelineId, VkError> {
        let shader = spec.shader;
        let reads = shader.entry(spec.entries[0], true).attributes as usize;
        assert!(reads <= spec.attributes.len(), "`{}` reads {reads} attributes", spec.entries[0]);
        // A draw has all images and buffers of its shader, or none if its entry points read none.
        let has_bindings = shader.entry(spec.entries[0], true).has_bindings
            || shader.entry(spec.entries[1], false).has_bindings;
        let [images, buffers] =
            [shader.images, shader.buffers].map(|n| if has_bindings { n } else { 0 });
        let bindings: Vec<_> = (0..images + buffers)
            .map(|i| {
                let kind = match i < images {
                    true => vk::DescriptorType::SAMPLED_IMAGE,
                    false => vk::DescriptorType::STORAGE_BUFFER,
                };
                vk::DescriptorSetLayoutBinding::default()
                    .binding(i)
                    .descriptor_type(kind)
                    .descriptor_count(1)
                    .stage_flags(STAGES)
            })
            .collect();
        let info = vk::DescriptorSetLayoutCreateInfo::default().bindings(&bindings);
        // SAFETY: the device is live; the bindings outlive the call.
        let set = unsafe { self.device.create_descriptor_set_layout(&info, None) }
            .map_err(VkError::of("vkCreateDescriptorSetLayout"))?;
        let stride = spec.attributes.iter().map(|a| a.raw().1).sum();
        let mut made = DrawPipeline {
            pipeline: vk::Pipeline::null(),
            layout: vk::PipelineLayout::null(),
            set,
            stride,
            push_bytes: shader.push_bytes,
            images,
            buffers,
            colour: spec.colour,
            depth: spec.depth,
            samples: spec.samples,
            blend: spec.blend,
        };
        let sets = [set];
        let sets = if bindings.is_empty() { &[] } else { &sets[..] };
        let built =
            pipeline_layout(&self.device, sets, shader.push_bytes, STAGES).and_then(|layout| {
                made.layout = layout;
                self.build(spec, layout, stride)
            });
        match built {
            Ok(pipeline) => {
                made.pipeline = pipeline;
                let id = self.draw_pipelines.insert(made);
                self.note_made(ResourceId::Pipeline(id));
                Ok(id)
            }
            Err(e) => {
                self.destroy_draw_pipeline(&made);
                Err(e)
            }
        }
    }

    /// Destroys a pipeline. The device is idle, or never used it.
    pub(super) fn destroy_draw_pipeline(&self, p: &DrawPipeline) {
        // SAFETY: all three are ours and go once; by the contract above nothing uses them. Null
        // handles are ignored.
        unsafe {
            self.device.destroy_pipeline(p.pipeline, None);
            self.device.destroy_pipeline_layout(p.layout, None);
            self.device.destroy_descriptor_set_layout(p.set, None);
        }
    }

    fn build(
        &self,
        spec: &DrawSpec,
        layout: vk::PipelineLayout,
        stride: u32,
    ) -> Result<vk::Pipeline, VkError> {
        let module = Module::new(&self.device, spec.shader.spirv)?;
        let names = spec.entries.map(|n| CString::new(n).expect("entry points have no NUL"));
        let stage = |stage, name| {
            vk::PipelineShaderStageCreateInfo::default().stage(stage).module(module.raw).name(name)
        };
        let stages = [
            stage(vk::ShaderStageFlags::VERTEX, &names[0]),
            stage(vk::ShaderStageFlags::FRAGMENT, &names[1]),
        ];
        let (mut attributes, mut offset) = (Vec::new(), 0);
        for (location, a) in spec.attributes.iter().enumerate() {
            let (format, bytes) = a.raw();
            let location = location as u32;
            attributes.push(vk::VertexInputAttributeDescription {
                location,
                binding: 0,
                format,
                offset,
            });
            offset += bytes;
        }
        let bindings = [vk::VertexInputBindingDescription {
            binding: 0,
            stride,
            input_rate: vk::VertexInputRate::VERTEX,
        }];
        let mut vertex_input = vk::PipelineVertexInputStateCreateInfo::default();
        if stride > 0 {
            vertex_input = vertex_input
                .vertex_binding_descriptions(&bindings)
                .vertex_attribute_descriptions(&attributes);
        }
        let assembly = vk::PipelineInputAssemblyStateCreateInfo::default()
            .topology(vk::PrimitiveTopology::TRIANGLE_LIST);
        let viewport =
            vk::PipelineViewportStateCreateInfo::default().viewport_count(1).scissor_count(1);
        let raster = vk::PipelineRasterizationStateCreateInfo::default()
            .polygon_mode(vk::PolygonMode::FILL)
            .cull_mode(match spec.cull_backs {
                true => vk::CullModeFlags::BACK,
                false => vk::CullModeFlags::NONE,
            })
            // World triangles are counter-clockwise; our projections turn y down, Vulkan's
            // framebuffer does so too, so they stay counter-clockwise as the viewer sees them.
            .front_face(vk::FrontFace::COUNTER_CLOCKWISE)
            .line_width(1.0);
        let multisample = vk::PipelineMultisampleStateCreateInfo::default()
            .rasterization_samples(vk::SampleCountFlags::from_raw(spec.samples));
        let depth = vk::PipelineDepthStencilStateCreateInfo::default()
            .depth_test_enable(spec.depth_use != DepthUse::Ignore)
            .depth_write_enable(spec.depth_use == DepthUse::Nearest)
            .depth_compare_op(vk::CompareOp::GREATER);
        let blends = [blend(spec.blend)];
        let blend_state = vk::PipelineColorBlendStateCreateInfo::default().attachments(&blends);
        let dynamic = [vk::DynamicState::VIEWPORT, vk::DynamicState::SCISSOR];
        let dynamic = vk::PipelineDynamicStateCreateInfo::default().dynamic_states(&dynamic);
        let colours = [spec.colour.raw()];
        let mut targets =
            vk::PipelineRenderingCreateInfo::default().color_attachment_formats(&colours);
        if let Some(depth) = spec.depth {
            targets = targets.depth_attachment_format(depth.raw());
        }
        let info = vk::GraphicsPipelineCreateInfo::default()
            .stages(&stages)
            .vertex_input_state(&vertex_input)
            .input_assembly_state(&assembly)
            .viewport_state(&viewport)
            .rasterization_state(&raster)
            .multisample_state(&multisample)
            .depth_stencil_state(&depth)
            .color_blend_state(&blend_state)
            .dynamic_state(&dynamic)
            .layout(layout)
            .push_next(&mut targets);
        // SAFETY: every struct above outlives the call; module and layout are of this device.
        unsafe { self.device.create_graphics_pipelines(self.cache.raw, &[info], None) }
            .map(|made| made[0])
            .map_err(|(_, result)| VkError::of("vkCreateGraphicsPipelines")(result))
    }
}

fn blend(blend: Blend) -> vk::PipelineColorBlendAttachmentState {
    use vk::BlendFactor as F;
    let mixed = |to: F, alpha_to: F| {
        vk::PipelineColorBlendAttachmentState::default()
            .blend_enable(true)
            .src_color_blend_factor(F::ONE)
            .dst_color_blend_factor(to)
            .color_blend_op(vk::BlendOp::ADD)
            .src_alpha_blend_factor(F::ZERO)
            .dst_alpha_blend_factor(alpha_to)
            .alpha_blend_op(vk::BlendOp::ADD)
            .color_write_mask(vk::ColorComponentFlags::RGBA)
    };
    match blend {
        Blend::Opaque => vk::PipelineColorBlendAttachmentState::default()
            .color_write_mask(vk::ColorComponentFlags::RGBA),
        Blend::Under => mixed(F::ONE, F::ONE_MINUS_SRC_ALPHA).src_color_blend_factor(F::DST_ALPHA),
        Blend::Stack => mixed(F::SRC_ALPHA, F::ONE),
        Blend::Over => {
            mixed(F::ONE_MINUS_SRC_ALPHA, F::ONE_MINUS_SRC_ALPHA).src_alpha_blend_factor(F::ONE)
        }
    }
}
