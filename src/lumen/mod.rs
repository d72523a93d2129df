//! The lumen: its voxels in sparse bricks, with the paper's three classes.
//!
//! Connectivity is 6 for the inside throughout; the surface room's cell table agrees with that.

mod bits;
mod body;
pub mod bricks;
mod components;
mod grow;
mod joining;
mod leak;
mod intensity_selection;
mod morphology;
mod stored_layers;
mod streamed;
mod thickening;
mod voxelized;

pub use bits::{BitVolume, Run};
pub use bricks::{Bricks, bits_in, surrounding_bricks};
pub use components::{Component, Piece, fill_cavities, pieces};
pub use grow::grow;
pub use intensity_selection::IntensitySelection;
pub use leak::{Flood, LeakReport, grow_controlled};
pub use morphology::{closed, dilated, eroded, holes_filled, open_background, opened};
pub use streamed::{
    GreyBricks, GreyValues, SLAB_BYTES, check_seed_in_parts, each_slab, select_in_parts,
};
pub use thickening::{Neighborhood, thickened};
pub use voxelized::{VoxelizeError, enclosing_grid, voxelized};

use glam::{DVec3, IVec3, UVec3};
use rayon::prelude::*;

use crate::volume::{AxisOrder, Grid, Volume};
use body::BodyHull;
use bricks::{NONE, near_index};
use stored_layers::StoredLayers;

/// Reasons why there is no lumen.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum LumenError {
    /// The seed is not a voxel of the volume.
    #[error("seed {seed} is outside the volume of {dims} voxels")]
    SeedOutside {
        /// Index of the seed.
        seed: UVec3,
        /// Size of the volume, voxels.
        dims: UVec3,
    },
    /// The seed's world point is not in the volume.
    #[error("seed ({}, {}, {}) mm is outside the volume", .0[0], .0[1], .0[2])]
    SeedPoint([f64; 3]),
    /// The seed's value is not in the selection.
    #[error("seed {seed} has value {value}, which is not in {selection}")]
    SeedValue {
        /// Index of the seed.
        seed: UVec3,
        /// Value at the seed, real units.
        value: f64,
        /// Requested selection.
        selection: IntensitySelection,
    },
    /// No voxel is in the selection.
    #[error("empty lumen: no voxel is in {selection}{}", range_note(.range))]
    Empty {
        /// Requested selection.
        selection: IntensitySelection,
        /// Smallest and largest value of the volume, real units.
        range: Option<(f64, f64)>,
    },
    /// All that is in the selection lies outside the patient.
    #[error(
        "no lumen: all {ml:.0} ml in {selection} lie outside the body; \
         give a seed in the lumen, or a range that holds it"
    )]
    OnlyOutside {
        /// Requested selection.
        selection: IntensitySelection,
        /// Volume outside the body, ml.
        ml: f64,
    },
    /// The grid is sheared: distances along its axes are not distances in space.
    #[error(
        "the grid's axes are not at right angles (off by {degrees:.2} degrees); resample the volume first"
    )]
    Sheared {
        /// Largest difference of an angle between axes from a right one, degrees.
        degrees: f64,
    },
    /// Leak control asked for where it has no meaning.
    #[error("leak control needs a threshold with at least one end, and a seed")]
    LeakWindow,
}

fn range_note(range: &Option<(f64, f64)>) -> String {
    range.map_or(String::new(), |(lo, hi)| format!(" (values run from {lo} to {hi})"))
}

/// Options of the segmentation of the lumen.
#[derive(Clone, Debug)]
pub struct SegmentationOptions {
    /// Values that count as inside.
    pub selection: IntensitySelection,
    /// Keep the 6-component of this voxel; without it the largest, of a range of values the largest
    /// that is not outside the body.
    pub seed: Option<UVec3>,
    /// Keep every component (only without a seed), of a range of values but those outside the body.
    pub all_components: bool,
    /// Fill closed cavities.
    pub fill: bool,
    /// Narrow the selection before the first leak (needs a seed).
    pub leak_control: bool,
}

/// Statistics of a segmentation.
#[derive(Clone, Debug, Default)]
pub struct SegmentationStats {
    /// The component taken, where no seed chose it and not all were taken.
    pub taken: Option<Component>,
    /// Components left out though they lie in the body, largest first.
    pub others: Vec<Component>,
    /// Number of voxels in `others`.
    pub other_voxels: u64,
    /// Components left out because they lie outside the body, largest first.
    pub outside: Vec<Component>,
    /// Number of voxels grown before filling.
    pub grown_voxels: u64,
    /// Voxels added to a label map where parts of it touched by an edge or a corner.
    pub joined: Vec<UVec3>,
    /// Numbers of voxels and of cavities filled.
    pub filled: (u64, usize),
    /// Voxels of the filled cavities; `None` if no cavity was filled.
    pub cavities: Option<BitVolume>,
    /// Report of leak control, if it was on.
    pub leak: Option<LeakReport>,
}

/// The lumen in bricks.
///
/// Bricks and everything that is computed in them stand in the lumen's own frame: axes nearest to
/// LPS, and a corner at the lumen's box. So no product depends on how much background the volume
/// has around the lumen, or on the order in which its file stores the axes. Files are written in the
/// frame of the file that was read.
#[derive(Clone, Debug)]
pub struct Lumen {
    /// Grid about the lumen: voxel (1, 1, 1) is the lowest corner of the lumen's box.
    pub grid: Grid,
    /// Place of that grid in the volume.
    place: VolumePlace,
    /// Bricks that cover the lumen.
    pub bricks: Bricks,
    /// Inside bits, eight words a slot, one a z-layer, bit x + 8 y.
    pub inside: Vec<u64>,
    /// Boundary bits (inside with an external 6-neighbour), laid out as `inside`.
    pub boundary: Vec<u64>,
    /// Number of inside voxels with no external 6-neighbour (class 1).
    pub internal_voxels: u64,
    /// Number of inside voxels with an external 6-neighbour (class 2).
    pub boundary_voxels: u64,
    /// Whether the lumen reaches the edge of the volume.
    pub touches_edge: bool,
}

/// Place of a lumen's grid in the volume that the lumen lies in.
#[derive(Clone, Copy, Debug, PartialEq)]
struct VolumePlace {
    /// Grid of the volume.
    volume: Grid,
    /// Voxel of the volume that is the grid's first.
    corner: IVec3,
}

impl SegmentationOptions {
    /// Options with the defaults of the command line.
    pub fn new(selection: IntensitySelection) -> Self {
        Self { selection, seed: None, all_components: false, fill: true, leak_control: false }
    }

    /// Chooses the lumen, in bricks.
    ///
    /// # Errors
    /// As [`SegmentationOptions::select`].
    pub fn apply(&self, volume: &Volume) -> Result<(Lumen, SegmentationStats), LumenError> {
        let (mask, found) = self.select(volume)?;
        Ok((Lumen::new(volume.grid, &mask), found))
    }

    /// Chooses the lumen.
    ///
    /// # Errors
    /// [`LumenError`] names the seed or selection at fault, [`LumenError::Sheared`] a grid that is
    /// no box. No lumen is ever empty.
    pub fn select(&self, volume: &Volume) -> Result<(BitVolume, SegmentationStats), LumenError> {
        if !volume.grid.is_orthogonal() {
            return Err(LumenError::Sheared { degrees: volume.grid.shear_rad().to_degrees() });
        }
        let mut found = SegmentationStats::default();
        let mask = match self.seed {
            Some(seed) if self.leak_control => {
                let (mask, leak) = grow_controlled(volume, &self.selection, seed)?;
                found.leak = Some(leak);
                mask
            }
            Some(seed) if self.is_labels() => {
                // What the seed lies in is checked first.
                grow(volume, &self.selection, seed)?;
                let mut selected = self.selection.select(volume);
                found.joined = joining::join_touching(&mut selected);
                components::containing(&selected, seed)
            }
            Some(seed) => grow(volume, &self.selection, seed)?,
            None if self.leak_control => return Err(LumenError::LeakWindow),
            None => {
                let selected = self.selection.select(volume);
                self.unseeded(selected, &volume.grid, &|| volume.range(), &mut found)?
            }
        };
        self.finish(mask, found, &|| volume.range())
    }

    /// Chooses the lumen among all voxels in the selection, of which the seed is one.
    ///
    /// # Errors
    /// As [`Self::select`]; no leak control, which tries other selections.
    pub fn select_among(
        &self,
        mut selected: BitVolume,
        grid: &Grid,
    ) -> Result<(BitVolume, SegmentationStats), LumenError> {
        if self.leak_control {
            return Err(LumenError::LeakWindow);
        }
        let mut found = SegmentationStats::default();
        let mask = match self.seed {
            Some(seed) => {
                if self.is_labels() {
                    found.joined = joining::join_touching(&mut selected);
                }
                components::containing(&selected, seed)
            }
            None => self.unseeded(selected, grid, &|| None, &mut found)?,
        };
        self.finish(mask, found, &|| None)
    }

    /// Whether labels are selected, which someone drew.
    fn is_labels(&self) -> bool {
        matches!(self.selection, IntensitySelection::Labels(_))
    }

    /// Counts and fills a lumen.
    fn finish(
        &self,
        mut mask: BitVolume,
        mut found: SegmentationStats,
        range: &dyn Fn() -> Option<(f64, f64)>,
    ) -> Result<(BitVolume, SegmentationStats), LumenError> {
        found.grown_voxels = mask.count();
        if found.grown_voxels == 0 {
            return Err(LumenError::Empty { selection: self.selection.clone(), range: range() });
        }
        if self.fill {
            let grown = mask.clone();
            found.filled = components::fill_cavities(&mut mask);
            if found.filled.0 > 0 {
                let mut cavities = mask.clone();
                cavities.remove(&grown);
                found.cavities = Some(cavities);
            }
        }
        Ok((mask, found))
    }

    /// The largest component, or all of them.
    fn unseeded(
        &self,
        mut selected: BitVolume,
        grid: &Grid,
        range: &dyn Fn() -> Option<(f64, f64)>,
        found: &mut SegmentationStats,
    ) -> Result<BitVolume, LumenError> {
        let selection = || self.selection.clone();
        // Labels were drawn by someone; what is bright and open upwards is no air.
        let air = matches!(self.selection, IntensitySelection::Range { hi, .. } if hi.is_finite());
        if self.is_labels() {
            found.joined = joining::join_touching(&mut selected);
        }
        if self.all_components && !air && !selected.is_empty() {
            return Ok(selected);
        }
        let body = air.then(|| BodyHull::of(&selected, grid));
        let split = components::split(&selected, body.as_ref(), self.all_components)
            .ok_or_else(|| LumenError::Empty { selection: selection(), range: range() })?;
        if split.largest.is_none() {
            let voxels: u64 = split.outside.iter().map(|c| c.voxels).sum();
            let ml = voxels as f64 * grid.voxel_mm3() / 1000.0;
            return Err(LumenError::OnlyOutside { selection: selection(), ml });
        }
        found.taken = split.largest.filter(|_| !self.all_components);
        found.other_voxels = split.others.iter().map(|c| c.voxels).sum();
        found.others = split.others;
        found.outside = split.outside;
        Ok(split.kept)
    }
}

impl Lumen {
    /// Builds the bricks and classes of a mask.
    ///
    /// * `volume`: the mask's grid.
    pub fn new(volume: Grid, mask: &BitVolume) -> Self {
        Self::with_margin(volume, mask, UVec3::ONE)
    }

    /// Builds the bricks and classes of a mask with so many voxels between the lumen's box and the
    /// corner of its grid: a figure that depends on them depends on where the bricks' sides lie.
    pub fn with_margin(volume: Grid, mask: &BitVolume, margin: UVec3) -> Self {
        let bounds = mask.bounds();
        let (lo, hi) = bounds.unwrap_or_default();
        let corner = lo.as_ivec3() - margin.as_ivec3();
        let dims = (hi.as_ivec3() - corner + 2).as_uvec3();
        let corner_mm = volume.world_from_voxel().transform_point3(corner.as_dvec3());
        let grid = Grid { dims, origin_mm: rounded_mm(corner_mm), ..volume };
        Self::on_grid(grid, VolumePlace { volume, corner }, mask, bounds)
    }

    /// Builds the bricks and classes of a mask on the grid of its whole volume.
    pub fn of_volume(volume: Grid, mask: &BitVolume) -> Self {
        Self::on_grid(volume, VolumePlace { volume, corner: IVec3::ZERO }, mask, mask.bounds())
    }

    fn on_grid(
        grid: Grid,
        place: VolumePlace,
        mask: &BitVolume,
        bounds: Option<(UVec3, UVec3)>,
    ) -> Self {
        let (bricks, inside) = bricks::of_mask(mask, bounds, place.corner);
        let boundary = boundary_of(&bricks, &inside);
        let count = |b: &[u64]| b.iter().map(|w| u64::from(w.count_ones())).sum::<u64>();
        let boundary_voxels = count(&boundary);
        let internal_voxels = count(&inside) - boundary_voxels;
        let top = place.volume.dims - 1;
        let touches_edge =
            bounds.is_some_and(|(lo, hi)| lo.cmpeq(UVec3::ZERO).any() || hi.cmpeq(top).any());
        let grid = Grid { order: AxisOrder::IDENTITY, ..grid };
        Self {
            grid,
            place,
            bricks,
            inside,
            boundary,
            internal_voxels,
            boundary_voxels,
            touches_edge,
        }
    }

    /// Grid of the volume that the lumen lies in.
    pub fn volume_grid(&self) -> &Grid {
        &self.place.volume
    }

    /// The voxel of the volume that a voxel of the lumen's grid is; it may lie beyond the volume.
    #[inline]
    pub fn volume_voxel(&self, v: IVec3) -> IVec3 {
        v + self.place.corner
    }

    /// The voxel of the lumen's grid that a voxel of the volume is.
    #[inline]
    pub fn own_voxel(&self, of_volume: IVec3) -> IVec3 {
        of_volume - self.place.corner
    }

    /// Whether a voxel of the lumen's grid lies in the volume.
    #[inline]
    pub fn is_in_volume(&self, v: IVec3) -> bool {
        self.place.volume.contains(v + self.place.corner)
    }

    /// The voxel of the file that a voxel of the lumen's grid is.
    pub fn stored_voxel(&self, v: IVec3) -> IVec3 {
        self.place.volume.stored_voxel(self.volume_voxel(v))
    }

    /// Grid of the file: that of all dense volumes below.
    pub fn stored_grid(&self) -> Grid {
        self.place.volume.as_stored()
    }

    /// The inside voxels as a mask of the whole volume.
    pub fn mask(&self) -> BitVolume {
        let mut out = BitVolume::new(self.place.volume.dims);
        for element in self.elements(&self.inside) {
            let v = self.volume_voxel(self.bricks.voxel(element)).as_uvec3();
            out.set(v.x, v.y, v.z);
        }
        out
    }

    /// Number of inside voxels.
    pub fn inside_voxels(&self) -> u64 {
        self.internal_voxels + self.boundary_voxels
    }

    /// Volume, ml.
    pub fn volume_ml(&self) -> f64 {
        self.inside_voxels() as f64 * self.grid.voxel_mm3() / 1000.0
    }

    /// Whether a field element is inside.
    #[inline]
    pub fn is_inside(&self, element: usize) -> bool {
        bit(&self.inside, element)
    }

    /// Whether a voxel is inside.
    #[inline]
    pub fn holds(&self, v: IVec3) -> bool {
        self.bricks.element(v).is_some_and(|e| self.is_inside(e))
    }

    /// Elements of all set bits of a layout like [`Lumen::inside`], ascending.
    pub fn elements<'a>(&self, bits: &'a [u64]) -> impl Iterator<Item = usize> + 'a {
        bits.iter().enumerate().flat_map(|(w, &word)| {
            std::iter::successors((word != 0).then_some(word), |b| {
                let b = b & (b - 1);
                (b != 0).then_some(b)
            })
            .map(move |b| w * 64 + b.trailing_zeros() as usize)
        })
    }

    /// Counts the sides between a voxel inside and one outside.
    pub fn wall_sides(&self) -> u64 {
        let slots = (0..self.bricks.len()).into_par_iter();
        let sides = |slot: usize| {
            let layers = (0..8).map(|z| {
                let own = self.inside[slot * 8 + z];
                let near = layer_neighbours(&self.bricks, &self.inside, slot, z);
                near.map(|n| u64::from((own & !n).count_ones())).iter().sum::<u64>()
            });
            layers.sum::<u64>()
        };
        slots.map(sides).sum()
    }

    /// A field as a dense volume as the file stores it, `outside` beyond the bricks.
    pub fn dense<T: Copy + Send + Sync>(&self, field: &[T], outside: T) -> Vec<T> {
        let writer = StoredLayers::new(self);
        let mut out = vec![outside; self.place.volume.len()];
        let layers = out.par_chunks_mut(writer.layer_len()).enumerate();
        layers.for_each(|(layer, out)| writer.fill(layer, field, out));
        out
    }

    /// Passes a field as a dense volume as the file stores it to `put`, eight slices at a time, so
    /// that a file can be written without holding the whole volume.
    ///
    /// # Errors
    /// The first error of `put`, which is not called again.
    pub fn each_layer<T: Copy, E>(
        &self,
        field: &[T],
        outside: T,
        put: &mut dyn FnMut(&[T]) -> Result<(), E>,
    ) -> Result<(), E> {
        let writer = StoredLayers::new(self);
        let (all, layer) = (self.place.volume.len(), writer.layer_len());
        let mut out = vec![outside; layer.min(all)];
        for i in 0..all.div_ceil(layer) {
            let out = &mut out[..layer.min(all - i * layer)];
            writer.fill(i, field, out);
            put(out)?;
            // Only the voxels just filled differ from `outside`.
            writer.each(i, out.len(), |_, to| out[to] = outside);
        }
        Ok(())
    }

    /// The classes of the paper as a dense volume: 0 external, 1 internal, 2 boundary.
    pub fn classes(&self) -> Vec<u8> {
        self.dense(&self.class_field(), 0)
    }

    /// The classes of the paper as a field, numbered as in [`Self::classes`].
    pub fn class_field(&self) -> Vec<u8> {
        let class = |e: usize| u8::from(self.is_inside(e)) + u8::from(bit(&self.boundary, e));
        (0..self.bricks.field_len()).into_par_iter().map(class).collect()
    }

    /// Memory held, bytes.
    pub fn bytes(&self) -> u64 {
        (self.bricks.len() * (12 + 108 + 128)) as u64
    }
}

/// A place to 2^-20 mm, a nanometer: background that was added to a volume or cut off moves its
/// origin, and the last bits of a place in it.
fn rounded_mm(at: DVec3) -> DVec3 {
    const STEPS: f64 = (1u32 << 20) as f64;
    /// Sums of spacings lie halfway between two steps in one of some cases, and would be rounded to
    /// either; they do not lie there.
    const SHIFT: f64 = 0.618_033_988_75;
    (at * STEPS + SHIFT).floor() / STEPS + DVec3::ZERO
}

/// Bit of a field element.
#[inline]
pub fn bit(bits: &[u64], element: usize) -> bool {
    bits[element >> 6] >> (element & 63) & 1 != 0
}

/// For each z-layer word of a slot: the same layer one voxel to each of the six sides.
/// Returns `[+x, -x, +y, -y, +z, -z]`: bit at (x, y) of `+x` is the voxel at x + 1.
#[inline]
pub fn layer_neighbours(bricks: &Bricks, bits: &[u64], slot: usize, z: usize) -> [u64; 6] {
    const LOW_X: u64 = 0x0101_0101_0101_0101;
    let near = &bricks.near()[slot];
    let word = |n: usize, z: usize| match near[n] {
        NONE => 0,
        s => bits[s as usize * 8 + z],
    };
    let m = bits[slot * 8 + z];
    let xp = word(near_index(1, 0, 0), z);
    let xm = word(near_index(-1, 0, 0), z);
    let yp = word(near_index(0, 1, 0), z);
    let ym = word(near_index(0, -1, 0), z);
    [
        (m >> 1 & !(LOW_X << 7)) | (xp & LOW_X) << 7,
        (m << 1 & !LOW_X) | (xm >> 7 & LOW_X),
        m >> 8 | yp << 56,
        m << 8 | ym >> 56,
        if z < 7 { bits[slot * 8 + z + 1] } else { word(near_index(0, 0, 1), 0) },
        if z > 0 { bits[slot * 8 + z - 1] } else { word(near_index(0, 0, -1), 7) },
    ]
}

fn boundary_of(bricks: &Bricks, inside: &[u64]) -> Vec<u64> {
    (0..inside.len())
        .into_par_iter()
        .with_min_len(4096)
        .map(|w| {
            let around = layer_neighbours(bricks, inside, w / 8, w % 8);
            inside[w] & !around.iter().fold(!0, |a, b| a & b)
        })
        .collect()
}

#[cfg(test)]
mod tests;
