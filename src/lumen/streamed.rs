//! Selection from a volume that is read in parts, and its grey values about a lumen: memory follows
//! the selected voxels, not the volume.

use std::collections::BTreeMap;

use glam::{IVec3, UVec3};
use rayon::prelude::*;

use super::bricks::{BRICK, SIDE, local};
use super::{BitVolume, Bricks, IntensitySelection, LumenError};
use crate::formats::{FormatError, VolumeParts};
use crate::task::checkpoint;
use crate::volume::{Grid, Rescale, Samples, Volume};

/// Bytes of samples that are held while a volume is read from end to end: what a slab of whole
/// chunks takes, if that is less; chunks of a deeper one are decoded more than once.
pub const SLAB_BYTES: u64 = 256 << 20;
/// Bytes of a slab to which shallow chunks are put together.
const SMALL_SLAB_BYTES: u64 = 32 << 20;

/// Slices that are read at once.
fn slab_depth(parts: &VolumeParts) -> u32 {
    let dims = parts.grid().dims;
    let slice = u64::from(dims.x) * u64::from(dims.y) * parts.sample_type().size() as u64;
    let fit = |bytes: u64| (bytes / slice.max(1)) as u32;
    let block = parts.block().z.max(1);
    let depth = match block {
        b if b > fit(SLAB_BYTES) => fit(SLAB_BYTES),
        b => b * (fit(SMALL_SLAB_BYTES) / b).max(1),
    };
    depth.clamp(1, dims.z)
}

/// Reads a volume from end to end, slab by slab: the first slice of each, and its volume.
///
/// # Errors
/// As [`VolumeParts::read`].
pub fn each_slab(
    parts: &VolumeParts,
    mut each: impl FnMut(u32, &Volume),
) -> Result<(), FormatError> {
    let (grid, depth) = (*parts.grid(), slab_depth(parts));
    for z in (0..grid.dims.z).step_by(depth as usize) {
        checkpoint();
        let end = (z + depth).min(grid.dims.z);
        let samples = parts.read(UVec3::new(0, 0, z), UVec3::new(grid.dims.x, grid.dims.y, end))?;
        let slab = Grid { dims: UVec3::new(grid.dims.x, grid.dims.y, end - z), ..grid };
        each(z, &Volume { rescale: parts.rescale(), ..Volume::new(slab, samples) });
    }
    Ok(())
}

/// Every voxel of a volume that is in a selection. `also` sees each slab's samples, in order.
///
/// # Errors
/// As [`VolumeParts::read`].
pub fn select_in_parts(
    parts: &VolumeParts,
    selection: &IntensitySelection,
    mut also: impl FnMut(&Samples),
) -> Result<BitVolume, FormatError> {
    let mut out = BitVolume::new(parts.grid().dims);
    each_slab(parts, |z, slab| {
        also(&slab.samples);
        out.put_slices(z, selection.select(slab));
    })?;
    Ok(out)
}

/// Whether a seed is a voxel of a volume and in the selection.
///
/// # Errors
/// [`LumenError`] as of a volume in memory, in the first place the file's.
pub fn check_seed_in_parts(
    parts: &VolumeParts,
    selection: &IntensitySelection,
    seed: UVec3,
) -> Result<Result<(), LumenError>, FormatError> {
    let dims = parts.grid().dims;
    if seed.cmpge(dims).any() {
        return Ok(Err(LumenError::SeedOutside { seed, dims }));
    }
    let value = parts.rescale().real(parts.read(seed, seed + 1)?.get(0));
    let is_held = selection.holds(value);
    let error = || LumenError::SeedValue { seed, value, selection: selection.clone() };
    Ok(if is_held { Ok(()) } else { Err(error()) })
}

/// Samples of a volume in bricks, in their stored type.
pub struct GreyBricks {
    grid: Grid,
    rescale: Rescale,
    bricks: Bricks,
    /// Samples in slot order of the bricks; what lies beyond the volume is 0.
    samples: Samples,
}

impl GreyBricks {
    /// Reads the bricks of a volume, block by block, several at a time.
    ///
    /// # Errors
    /// As [`VolumeParts::read`].
    pub fn read(parts: &VolumeParts, bricks: Bricks) -> Result<Self, FormatError> {
        let (grid, size) = (*parts.grid(), parts.sample_type().size());
        let mut samples = Samples::zeroed(parts.sample_type(), bricks.field_len());
        let block = parts.block();
        let blocks: Vec<(UVec3, Vec<usize>)> =
            blocks_of(&bricks, &grid, block).into_iter().collect();
        for group in blocks.chunks(2 * rayon::current_num_threads()) {
            let read = group.par_iter().map(|(lo, _)| {
                checkpoint();
                parts.read(*lo, (*lo + block).min(grid.dims))
            });
            let read: Vec<Samples> = read.collect::<Result<_, _>>()?;
            for ((lo, slots), from) in group.iter().zip(&read) {
                let hi = (*lo + block).min(grid.dims);
                for slot in slots {
                    let corner = IVec3::from(bricks.corners()[*slot]);
                    let out = &mut samples.bytes_mut()[slot * BRICK * size..][..BRICK * size];
                    copy_brick(from.bytes(), (*lo, hi), corner, size, out);
                }
            }
        }
        Ok(Self { grid, rescale: parts.rescale(), bricks, samples })
    }

    /// The stored value of a voxel.
    ///
    /// # Panics
    /// If its brick was not read.
    #[inline]
    fn stored(&self, v: UVec3) -> f64 {
        let element =
            self.bricks.element(v.as_ivec3()).expect("the bricks about the lumen were read");
        self.samples.get(element)
    }
}

/// Blocks that hold voxels of bricks, by their first voxel, each with the slots of those bricks; in
/// z, y, x order.
fn blocks_of(bricks: &Bricks, grid: &Grid, block: UVec3) -> Vec<(UVec3, Vec<usize>)> {
    let mut blocks: BTreeMap<[u32; 3], Vec<usize>> = BTreeMap::new();
    for (slot, corner) in bricks.corners().iter().enumerate() {
        let corner = IVec3::from(*corner);
        let lo = corner.max(IVec3::ZERO).as_uvec3();
        let hi = (corner + SIDE).clamp(IVec3::ZERO, grid.dims.as_ivec3()).as_uvec3();
        if lo.cmpge(hi).any() {
            continue;
        }
        let (first, last) = (lo / block, (hi - 1) / block);
        for z in first.z..=last.z {
            for y in first.y..=last.y {
                for x in first.x..=last.x {
                    blocks.entry([z, y, x]).or_default().push(slot);
                }
            }
        }
    }
    blocks.into_iter().map(|([z, y, x], slots)| (UVec3::new(x, y, z) * block, slots)).collect()
}

/// Copies what a box holds of a brick.
fn copy_brick(from: &[u8], (lo, hi): (UVec3, UVec3), corner: IVec3, size: usize, out: &mut [u8]) {
    let a = corner.max(lo.as_ivec3());
    let b = (corner + SIDE).min(hi.as_ivec3());
    let extent = (hi - lo).as_usizevec3();
    let run = (b.x - a.x).max(0) as usize * size;
    for z in a.z..b.z {
        for y in a.y..b.y {
            let v = IVec3::new(a.x, y, z);
            let at = (v - lo.as_ivec3()).as_usizevec3();
            let start = (at.x + extent.x * (at.y + extent.y * at.z)) * size;
            let to = local(v) * size;
            out[to..to + run].copy_from_slice(&from[start..start + run]);
        }
    }
}

/// Grey values of a volume: all of them, or those in the bricks about a lumen.
#[derive(Clone, Copy)]
pub enum GreyValues<'a> {
    /// A volume in memory.
    Whole(&'a Volume),
    /// Bricks of one that is read in parts.
    Bricks(&'a GreyBricks),
}

impl<'a> From<&'a Volume> for GreyValues<'a> {
    fn from(volume: &'a Volume) -> Self {
        Self::Whole(volume)
    }
}

impl GreyValues<'_> {
    /// Grid of the whole volume.
    pub fn grid(&self) -> &Grid {
        match self {
            Self::Whole(volume) => &volume.grid,
            Self::Bricks(bricks) => &bricks.grid,
        }
    }

    /// Map from stored to real values.
    pub fn rescale(&self) -> Rescale {
        match self {
            Self::Whole(volume) => volume.rescale,
            Self::Bricks(bricks) => bricks.rescale,
        }
    }

    /// Whether stored values are integers.
    pub fn is_integer(&self) -> bool {
        match self {
            Self::Whole(volume) => volume.samples.sample_type().is_integer(),
            Self::Bricks(bricks) => bricks.samples.sample_type().is_integer(),
        }
    }

    /// Real value of a voxel of the grid.
    ///
    /// # Panics
    /// If its brick was not read.
    #[inline]
    pub fn real(&self, v: UVec3) -> f64 {
        match self {
            Self::Whole(volume) => volume.real(volume.grid.index(v)),
            Self::Bricks(bricks) => bricks.rescale.real(bricks.stored(v)),
        }
    }
}
