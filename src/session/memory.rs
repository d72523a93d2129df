//! Memory: what a run will need, and what it took.

use super::{Product, SessionError};

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

/// Sizes that decide how much memory a run takes.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct RunSize {
    /// Bytes of the stored samples.
    pub stored: u64,
    /// Voxels of the volume.
    pub voxels: u64,
    /// Bricks of the lumen.
    pub bricks: u64,
    /// Sides between a voxel of the lumen and one outside: vertices of the wall.
    pub wall_sides: u64,
    /// Whether the wall follows grey values.
    pub is_field: bool,
    /// Whether an organ was searched for.
    pub is_organ: bool,
    /// Pixels of a frame.
    pub pixels: u64,
}

/// Estimates the peak of resident memory, bytes, of a run that makes these products.
///
/// Fitted to the peaks of seven commands on nine label maps and scans with 2 to 120 million voxels,
/// 30 thousand to 430 thousand vertices of the wall, on software Vulkan
/// (`tests/program/memory.rs` holds it to a quarter).
pub(super) fn estimate_bytes(size: &RunSize, makes: impl Fn(Product) -> bool) -> u64 {
    const MB: u64 = 1_000_000;
    let when = |is_made: bool, bytes: u64| if is_made { bytes } else { 0 };
    let distance = makes(Product::Distance);
    let has_plans = makes(Product::Fields) || distance || makes(Product::Wall);
    // The program, the volume, a mask, and Vulkan once a plan opens it.
    let held = 13 * MB + size.stored + size.voxels / 8 + when(has_plans, 45 * MB);
    // Let go once the lumen is there: values, levels and growth of the wall field, and what the
    // search for an organ labels.
    let choosing = when(size.is_field, 40 * MB + 20_000 * size.bricks)
        + when(size.is_organ, size.voxels * 5 / 2);
    let kept = when(size.is_field, 38 * MB);
    let products = when(makes(Product::Fields) || distance, 6200 * size.bricks)
        // Written as a dense file, some slices at a time.
        + when(distance, 15 * MB + size.voxels / 4)
        + when(makes(Product::Wall), 235 * size.wall_sides);
    // Trees, clusters and base mesh of the wall, and frames.
    let has_levels = makes(Product::Clusters) || makes(Product::Levels);
    let is_recorded = has_levels || makes(Product::Base) || makes(Product::Coverage);
    let recorded = when(is_recorded, 793 * size.wall_sides)
        + when(
            makes(Product::Levels) && !makes(Product::Clusters),
            60 * MB + 600 * size.wall_sides,
        )
        + when(makes(Product::Display), 45 * MB + 60 * size.pixels);
    held + products + choosing.max(kept + recorded)
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
