//! Memory: what a run will need, and what it took.

use std::path::Path;

use super::{Product, SessionError};
use crate::formats::{ImageInfo, VolumeParts};
use crate::lumen::{BitVolume, SLAB_BYTES};
use crate::volume::Volume;

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
    /// Whether they stay in memory once the lumen is made.
    pub keeps_stored: bool,
    /// Bytes of a mask.
    pub mask: u64,
    /// Voxels of the volume.
    pub voxels: u64,
    /// Bricks of the lumen.
    pub bricks: u64,
    /// Bricks that the wall field is computed on.
    pub field_bricks: u64,
    /// Sides between a voxel of the lumen and one outside: vertices of the wall.
    pub wall_sides: u64,
    /// Whether the wall follows grey values.
    pub is_field: bool,
    /// Whether an organ was searched for.
    pub is_organ: bool,
    /// Pixels of a frame.
    pub pixels: u64,
    /// Whether a pixel has several samples.
    pub is_multisampled: bool,
    /// Whether the wall is drawn as a subdivision.
    pub is_subdivided: bool,
}

/// Estimates the peak of resident memory, bytes, of a run that makes these products.
///
/// Fitted to the peaks of ten commands on nine label maps and scans with 2 to 120 million voxels,
/// 30 thousand to 730 thousand vertices of the wall, on software Vulkan
/// (`tests/program/memory.rs` holds it to a quarter).
pub(super) fn estimate_bytes(size: &RunSize, makes: impl Fn(Product) -> bool) -> u64 {
    const MB: u64 = 1_000_000;
    let when = |is_made: bool, bytes: u64| if is_made { bytes } else { 0 };
    let distance = makes(Product::Distance);
    let has_plans = makes(Product::Fields) || distance || makes(Product::Wall);
    // The program, a mask, and Vulkan once a plan opens it.
    let held = 13 * MB + size.mask + when(has_plans, 45 * MB);
    // Samples that outlive the choice of the lumen.
    let stored_after = when(size.keeps_stored, size.stored);
    // Memory that is freed once the lumen is made: labels of the search for an organ, and after them
    // values, levels and growth of the wall field.
    let searched = size.stored + when(size.is_organ, size.voxels * 5 / 2);
    let levels = stored_after + when(size.is_field, 14 * MB + 20_500 * size.field_bricks);
    let kept = when(size.is_field, 38 * MB);
    let products = when(makes(Product::Fields) || distance, 6200 * size.bricks)
        // Written as a dense file, some slices at a time.
        + when(distance, 15 * MB + size.voxels / 4)
        + when(makes(Product::Wall), 235 * size.wall_sides);
    // Levels and base mesh of the wall, its trees, and frames.
    let is_subdivided = size.is_subdivided && makes(Product::Levels);
    // `run` releases products after their last reader, `record` keeps them.
    let is_run = makes(Product::LumenProfile);
    let drawn = if is_run { 90 } else { 150 } * size.wall_sides;
    let [of_frames, of_pictures] = if size.is_multisampled { [60, 70] } else { [30, 0] };
    let recorded = when(is_subdivided, 10 * MB + 250 * size.wall_sides)
        + when(makes(Product::Base), 250 * size.wall_sides)
        + when(makes(Product::Display), 45 * MB + of_frames * size.pixels + drawn)
        // Pictures of the report.
        + when(is_run, 85 * MB + of_pictures * size.pixels);
    held + searched.max(levels).max(products + stored_after + kept + recorded)
}

/// The program without any data, bytes.
const PROGRAM: u64 = 13_000_000;
/// Vulkan once a device is open, bytes.
const VULKAN: u64 = 68_000_000;

/// Estimates the peak of resident memory, bytes, of reading a volume and looking at each sample.
pub fn reading_bytes(image: &ImageInfo) -> u64 {
    PROGRAM + image.bytes() + image.reading_bytes
}

/// Estimates the peak of resident memory, bytes, of reading a volume in parts: a slab of samples
/// with the chunks it is made of, and a mask of which little is set.
pub(super) fn in_parts_bytes(parts: &VolumeParts) -> u64 {
    let slab = SLAB_BYTES.min(parts.bytes());
    PROGRAM + slab + parts.reading_bytes() + 2 * BitVolume::new(parts.grid().dims).bytes()
}

/// Estimates the peak of resident memory, bytes, of writing a volume to another file: a format
/// without a rescale takes the real values, and MetaImage holds its compressed samples until their
/// number is known.
pub fn converting_bytes(image: &ImageInfo, output: &Path) -> u64 {
    let name = output.to_string_lossy().to_lowercase();
    let is_nifti = name.ends_with(".nii") || name.ends_with(".nii.gz");
    let (slope, intercept) = (image.rescale_slope, image.rescale_intercept);
    let voxels = image.dims.iter().map(|d| u64::from(*d)).product::<u64>();
    let size = image.bytes() / voxels.max(1);
    let is_whole = slope.fract() == 0.0
        && intercept.fract() == 0.0
        && image.sample_type.trim_start_matches('u').starts_with("int");
    let real = match (is_nifti || (slope == 1.0 && intercept == 0.0), is_whole) {
        (true, _) => 0,
        (false, true) => voxels * size.clamp(2, 4),
        (false, false) => voxels * if size <= 4 { 4 } else { 8 },
    };
    // Scans shrink to a half and more, label maps to nearly nothing.
    let packed = if name.ends_with(".mha") { image.bytes().max(real) * 22 / 100 } else { 0 };
    PROGRAM + image.bytes() + image.reading_bytes.max(real + packed)
}

/// A computation on a mesh.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum MeshWork {
    /// Simplification.
    Simplify,
    /// Simplification, and the distance to the original.
    SimplifyAndMeasure,
    /// Multiscale smoothing of normals.
    Multiscale,
    /// Smoothing of normals in steps.
    Steps,
}

/// Estimates the peak of resident memory, bytes, of a computation on a mesh of so many faces.
///
/// Fitted to the peaks on walls of 161, 392 and 860 thousand faces.
pub fn mesh_bytes(work: MeshWork, faces: usize, on_gpu: bool) -> u64 {
    let [fixed, each] = match (work, on_gpu) {
        (MeshWork::Simplify, _) => [0, 220],
        (MeshWork::SimplifyAndMeasure, _) => [0, 250],
        (MeshWork::Multiscale | MeshWork::Steps, true) => [VULKAN, 190],
        (MeshWork::Multiscale, false) => [0, 125],
        (MeshWork::Steps, false) => [0, 74],
    };
    PROGRAM + fixed + each * faces as u64
}

/// Estimates the peak of resident memory, bytes, of taking the normals of a mesh from a volume: beside
/// its samples there are three fields of real values. Most of a mask is zeros, of which no more than
/// one field takes memory.
pub fn gradient_bytes(volume: &Volume, is_mask: bool, faces: usize, on_gpu: bool) -> u64 {
    let voxels = volume.grid.len() as u64;
    let fields = if is_mask { voxels * 26 / 5 } else { voxels * 13 };
    let held = volume.samples.bytes().len() as u64 + fields;
    held + mesh_bytes(MeshWork::Steps, faces, on_gpu)
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
