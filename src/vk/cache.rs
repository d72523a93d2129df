//! The driver's pipeline cache, kept on disk between runs.
//!
//! A file holds a magic word, a hash of the data and the data; both hash and Vulkan header are
//! checked before the driver sees a byte, because drivers trust what they are given. Every failure
//! here costs start-up time and nothing else, so none is reported.

use std::io::Write as _;
use std::path::{Path, PathBuf};

use ash::vk;

use super::VkError;
use super::info::Limits;

const MAGIC: &[u8; 8] = b"intimaPC";
const HASH: usize = 32;

/// A `VkPipelineCache` and where it is kept; dropped before the device, it is written to disk.
pub(super) struct Cache {
    device: ash::Device,
    pub raw: vk::PipelineCache,
    path: Option<PathBuf>,
    loaded: Vec<u8>,
}

impl Cache {
    /// Opens the cache of this device and driver; `dir` is `None` to keep nothing on disk.
    pub fn open(
        device: &ash::Device,
        limits: &Limits,
        dir: Option<PathBuf>,
    ) -> Result<Self, VkError> {
        let uuid: String = limits.uuid.iter().map(|b| format!("{b:02x}")).collect();
        let name = format!("pipelines-{uuid}-{:08x}.bin", limits.driver_version);
        let path = dir.map(|d| d.join(name));
        let loaded = path.as_deref().and_then(|p| read(p, limits)).unwrap_or_default();
        VkError::planted("vkCreatePipelineCache")?;
        let info = vk::PipelineCacheCreateInfo::default().initial_data(&loaded);
        // SAFETY: `device` is live; the initial data is empty or written by this driver for this
        // device, as its header and our hash say.
        let raw = unsafe { device.create_pipeline_cache(&info, None) }
            .map_err(VkError::of("vkCreatePipelineCache"))?;
        Ok(Self { device: device.clone(), raw, path, loaded })
    }
}

impl Drop for Cache {
    /// Writes the cache to disk, if it has changed.
    fn drop(&mut self) {
        // SAFETY: the cache is ours, of this device, and `&mut self` makes us its only user.
        let data = unsafe { self.device.get_pipeline_cache_data(self.raw) }.unwrap_or_default();
        if let Some(path) = &self.path
            && data.len() > 32
            && data != self.loaded
        {
            let _ = write(path, &data);
        }
        // SAFETY: as above; goes once, before the device (field order of `Gpu`). Pipelines do not
        // need it to live.
        unsafe { self.device.destroy_pipeline_cache(self.raw, None) };
    }
}

fn read(path: &Path, limits: &Limits) -> Option<Vec<u8>> {
    let file = std::fs::read(path).ok()?;
    let data = file.strip_prefix(MAGIC)?;
    let (hash, data) = data.split_at_checked(HASH)?;
    (blake3::hash(data).as_bytes() == hash && header_fits(data, limits)).then(|| data.to_vec())
}

/// Whether the data starts with `VkPipelineCacheHeaderVersionOne` of this device.
fn header_fits(data: &[u8], limits: &Limits) -> bool {
    let word = |i: usize| data.get(4 * i..4 * i + 4).and_then(|b| b.try_into().ok());
    let word = |i| word(i).map(u32::from_le_bytes);
    word(0) == Some(32)
        && word(1) == Some(1)
        && word(2) == Some(limits.vendor)
        && word(3) == Some(limits.device)
        && data.get(16..32) == Some(&limits.uuid)
}

fn write(path: &Path, data: &[u8]) -> std::io::Result<()> {
    let dir = path.parent().ok_or(std::io::ErrorKind::InvalidInput)?;
    std::fs::create_dir_all(dir)?;
    let mut file = tempfile::NamedTempFile::new_in(dir)?;
    file.write_all(MAGIC)?;
    file.write_all(blake3::hash(data).as_bytes())?;
    file.write_all(data)?;
    file.persist(path)?;
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn limits() -> Limits {
        Limits { vendor: 0x1234, device: 7, uuid: [9; 16], ..Default::default() }
    }

    fn data() -> Vec<u8> {
        let words = [32u32, 1, 0x1234, 7];
        let mut d: Vec<u8> = words.iter().flat_map(|w| w.to_le_bytes()).collect();
        d.extend([9; 16]);
        d.extend(b"compiled");
        d
    }

    #[test]
    fn a_cache_file_comes_back_only_whole_and_for_its_device() {
        let dir = tempfile::tempdir().unwrap();
        let path = dir.path().join("deep/down/p.bin");
        write(&path, &data()).unwrap();
        assert_eq!(read(&path, &limits()), Some(data()));
        let other = Limits { device: 8, ..limits() };
        assert_eq!(read(&path, &other), None);

        let whole = std::fs::read(&path).unwrap();
        for at in [0, 10, whole.len() - 1] {
            let mut bad = whole.clone();
            bad[at] ^= 1;
            std::fs::write(&path, bad).unwrap();
            assert_eq!(read(&path, &limits()), None, "byte {at} was changed");
        }
        std::fs::write(&path, &whole[..30]).unwrap();
        assert_eq!(read(&path, &limits()), None, "cut short");
    }
}
