//! Memory: what a run will need, and what it took.

use super::SessionError;

/// Largest resident size of this process so far, MB (10⁶ bytes); 0 where the system does not say.
pub fn peak_memory_mb() -> f64 {
    status_mb("VmHWM:")
}

/// Resident size of this process, MB (10⁶ bytes); 0 where the system does not say.
pub fn resident_memory_mb() -> f64 {
    status_mb("VmRSS:")
}

/// A size in the kernel's description of this process.
fn status_mb(name: &str) -> f64 {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find_map(|l| l.strip_prefix(name));
    let kib = line.and_then(|l| l.split_whitespace().next()?.parse::<f64>().ok());
    kib.unwrap_or(0.0) * 1024.0 / 1e6
}

/// Bytes the chain takes for a stored volume and a lumen of so many bricks: samples, one bit a
/// voxel, four fields, and a mesh of about 60 vertices a surface brick.
pub fn estimate_bytes(stored: u64, voxels: u64, bricks: u64) -> u64 {
    stored + voxels / 8 + bricks * (4 * 2048 + 300) + bricks * 60 * 200
}

/// Refuses what needs more than allowed.
///
/// # Errors
/// [`SessionError::Memory`].
pub fn refuse_above(
    allowed_mb: Option<u64>,
    bytes: u64,
    what: &'static str,
) -> Result<(), SessionError> {
    let needed_mb = bytes.div_ceil(1_000_000);
    match allowed_mb {
        Some(allowed_mb) if needed_mb > allowed_mb => {
            Err(SessionError::Memory { needed_mb, allowed_mb, what })
        }
        _ => Ok(()),
    }
}
