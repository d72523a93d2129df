//! Shader modules.

use ash::vk;

use super::VkError;

/// Converts SPIR-V bytes to words.
pub(super) fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|c| u32::from_ne_bytes([c[0], c[1], c[2], c[3]])).collect()
}

/// A shader module, destroyed when dropped.
pub(super) struct Module<'a> {
    device: &'a ash::Device,
    pub raw: vk::ShaderModule,
}

impl<'a> Module<'a> {
    pub fn new(device: &'a ash::Device, bytes: &[u8]) -> Result<Self, VkError> {
        let code = words(bytes);
        let info = vk::ShaderModuleCreateInfo::default().code(&code);
        // SAFETY: naga validated the module when it was built; `code` outlives the call.
        let raw = unsafe { device.create_shader_module(&info, None) }
            .map_err(VkError::of("vkCreateShaderModule"))?;
        Ok(Self { device, raw })
    }
}

impl Drop for Module<'_> {
    fn drop(&mut self) {
        // SAFETY: the module is ours; pipelines keep no reference to it once created.
        unsafe { self.device.destroy_shader_module(self.raw, None) };
    }
}
