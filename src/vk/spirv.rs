//! Shader modules.

use std::io::Write as _;
use std::process::{Command, Stdio};

use ash::vk;

use super::VkError;

/// Converts SPIR-V bytes to words.
pub(super) fn words(bytes: &[u8]) -> Vec<u32> {
    bytes.chunks_exact(4).map(|c| u32::from_ne_bytes([c[0], c[1], c[2], c[3]])).collect()
}

/// Rewrites a module for the validation layer, which loses track of buffers behind nested access
/// chains, and with them of missing barriers and accesses outside a buffer. Returns the module
/// unchanged where `spirv-opt` is not installed.
pub(super) fn flattened(words: Vec<u32>) -> Vec<u32> {
    optimised(&words).unwrap_or(words)
}

fn optimised(words: &[u32]) -> Option<Vec<u32>> {
    let mut child = Command::new("spirv-opt")
        .args(["--combine-access-chains", "--eliminate-dead-code-aggressive", "-", "-o", "-"])
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::null())
        .spawn()
        .ok()?;
    let input: Vec<u8> = words.iter().flat_map(|w| w.to_ne_bytes()).collect();
    let mut stdin = child.stdin.take()?;
    // The tool reads all before it writes, but a thread costs nothing and cannot deadlock.
    let writer = std::thread::spawn(move || stdin.write_all(&input));
    let output = child.wait_with_output().ok()?;
    writer.join().ok()?.ok()?;
    (output.status.success() && output.stdout.len() > 20).then(|| self::words(&output.stdout))
}

/// A shader module, destroyed when dropped.
pub(super) struct Module<'a> {
    device: &'a ash::Device,
    pub raw: vk::ShaderModule,
}

impl<'a> Module<'a> {
    pub fn new(device: &'a ash::Device, bytes: &[u8], validating: bool) -> Result<Self, VkError> {
        let mut code = words(bytes);
        if validating {
            code = flattened(code);
        }
        let info = vk::ShaderModuleCreateInfo::default().code(&code);
        // SAFETY: naga validated the module when it was built, `spirv-opt` keeps it valid; `code`
        // outlives the call.
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
